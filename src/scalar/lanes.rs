//! Several states side by side: one number of each in a lane of a vector register, and every operation on all lanes at once.
//!
//! The registers and their instructions are pulp's, for the instruction set `S`. Operations are one instruction inside work that an
//! arm runs (see [`arms`](crate::batch::arms)), and slow calls outside.

use super::Real;
use super::trigonometry as t;
use num_traits::{One, Zero};
use pulp::Simd;
use pulp::bytemuck::{cast_slice, cast_slice_mut};
use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};
use std::slice::{from_mut, from_ref};

/// An instruction set, and how its registers are aligned in memory.
pub trait Instructions: Simd {
    /// A type of no size with that alignment.
    type Alignment: Debug + Copy + Send + Sync + 'static;

    /// The set, where this processor has it.
    fn token() -> Option<Self>;
}

/// 32 bytes.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
pub struct Align32;

/// 64 bytes.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub struct Align64;

#[cfg(target_arch = "x86_64")]
impl Instructions for pulp::x86::V3 {
    type Alignment = Align32;

    #[inline(always)]
    fn token() -> Option<Self> {
        Self::try_new()
    }
}

#[cfg(target_arch = "x86_64")]
impl Instructions for pulp::x86::V4 {
    type Alignment = Align64;

    #[inline(always)]
    fn token() -> Option<Self> {
        Self::try_new()
    }
}

/// One f64 of each state, as many as a register of `S` holds.
#[derive(Debug, Clone, Copy)]
pub struct Lanes<S: Instructions> {
    /// Of no size; aligns the rest.
    _alignment: [S::Alignment; 0],
    simd: S,
    value: S::f64s,
}

impl<S: Instructions> Lanes<S> {
    #[inline(always)]
    fn new(simd: S, value: S::f64s) -> Self {
        Self { _alignment: [], simd, value }
    }

    /// The same number in every lane.
    ///
    /// # Panics
    ///
    /// Where the processor lacks the instructions: no arm that it cannot run is ever picked.
    #[inline(always)]
    #[must_use]
    pub fn splat(x: f64) -> Self {
        let simd = S::token().expect("an arm of this processor");
        Self::new(simd, simd.splat_f64s(x))
    }

    /// The numbers, lane by lane.
    #[inline(always)]
    pub fn lanes(&self) -> &[f64] {
        cast_slice(from_ref(&self.value))
    }

    /// The numbers, lane by lane.
    #[inline(always)]
    pub fn lanes_mut(&mut self) -> &mut [f64] {
        cast_slice_mut(from_mut(&mut self.value))
    }
}

impl<S: Instructions> PartialEq for Lanes<S> {
    fn eq(&self, other: &Self) -> bool {
        self.lanes() == other.lanes()
    }
}

macro_rules! operator {
    ($operator:ident, $function:ident, $assigning:ident, $assign:ident, $instruction:ident) => {
        impl<S: Instructions> $operator for Lanes<S> {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                Self::new(self.simd, self.simd.$instruction(self.value, other.value))
            }
        }

        impl<S: Instructions> $assigning for Lanes<S> {
            #[inline(always)]
            fn $assign(&mut self, other: Self) {
                self.value = self.simd.$instruction(self.value, other.value);
            }
        }
    };
}

operator!(Add, add, AddAssign, add_assign, add_f64s);
operator!(Sub, sub, SubAssign, sub_assign, sub_f64s);
operator!(Mul, mul, MulAssign, mul_assign, mul_f64s);
operator!(Div, div, DivAssign, div_assign, div_f64s);

impl<S: Instructions> Neg for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        let s = self.simd;
        Self::new(s, s.xor_f64s(self.value, s.splat_f64s(-0.0)))
    }
}

impl<S: Instructions> Zero for Lanes<S> {
    #[inline(always)]
    fn zero() -> Self {
        Self::splat(0.0)
    }

    #[inline(always)]
    fn is_zero(&self) -> bool {
        self.lanes().iter().all(Zero::is_zero)
    }
}

impl<S: Instructions> One for Lanes<S> {
    #[inline(always)]
    fn one() -> Self {
        Self::splat(1.0)
    }
}

impl<S: Instructions> Real for Lanes<S> {
    const LANES: usize = S::F64_LANES;

    #[inline(always)]
    fn from_f64(x: f64) -> Self {
        Self::splat(x)
    }

    #[inline(always)]
    fn constant(self, x: f64) -> Self {
        Self::new(self.simd, self.simd.splat_f64s(x))
    }

    #[inline(always)]
    fn lane(self, index: usize) -> f64 {
        self.lanes()[index]
    }

    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        Self::new(self.simd, self.simd.mul_add_f64s(self.value, b.value, c.value))
    }

    #[inline(always)]
    fn minus_product(self, b: Self, c: Self) -> Self {
        Self::new(self.simd, self.simd.negate_mul_add_f64s(b.value, c.value, self.value))
    }

    #[inline(always)]
    fn recip(self) -> Self {
        Self::new(self.simd, self.simd.div_f64s(self.simd.splat_f64s(1.0), self.value))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self::new(self.simd, self.simd.sqrt_f64s(self.value))
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let s = self.simd;
        let shifted = self.mul_add(self.constant(std::f64::consts::FRAC_2_PI), self.constant(t::ROUNDER));
        let (sine, cosine) = t::of_reduced(self, shifted - self.constant(t::ROUNDER));

        // As `Fused` chooses, in every lane.
        let quadrant = s.transmute_u64s_f64s(shifted.value);
        let (one, two) = (s.splat_u64s(1), s.splat_u64s(2));
        let swapped = s.equal_u64s(s.and_u64s(quadrant, one), one);
        let sine_turned = s.equal_u64s(s.and_u64s(quadrant, two), two);
        let cosine_turned = s.equal_u64s(s.and_u64s(s.add_u64s(quadrant, one), two), two);
        let (sine, cosine) =
            (s.select_f64s(swapped, cosine.value, sine.value), s.select_f64s(swapped, sine.value, cosine.value));
        let mut sine = Self::new(s, s.select_f64s(sine_turned, (-Self::new(s, sine)).value, sine));
        let mut cosine = Self::new(s, s.select_f64s(cosine_turned, (-Self::new(s, cosine)).value, cosine));
        // Rare: each lane that the reduction is not good for, by itself, so that no lane changes another's bits.
        let largest = s.reduce_max_f64s(self.abs().value);
        if !(largest <= t::LARGEST) || !self.is_finite() {
            t::far(self.lanes(), sine.lanes_mut(), cosine.lanes_mut());
        }
        (sine, cosine)
    }

    #[inline(always)]
    fn abs(self) -> Self {
        let s = self.simd;
        Self::new(s, s.and_f64s(self.value, s.splat_f64s(f64::from_bits(!(1 << 63)))))
    }

    #[inline(always)]
    fn worst(self, other: Self) -> Self {
        let s = self.simd;
        let (a, b) = (self.value, other.value);
        // A NaN on either side compares false: the sum keeps it.
        let (less, more) = (s.less_than_or_equal_f64s(a, b), s.less_than_or_equal_f64s(b, a));
        Self::new(s, s.select_f64s(less, a, s.select_f64s(more, b, s.add_f64s(a, b))))
    }

    #[inline(always)]
    fn one_if_zero(self) -> Self {
        let s = self.simd;
        let zero = s.splat_f64s(0.0);
        Self::new(s, s.select_f64s(s.equal_f64s(self.value, zero), s.splat_f64s(1.0), zero))
    }

    #[inline(always)]
    fn epsilon() -> Self {
        Self::splat(f64::EPSILON)
    }
}

impl<S: Instructions> Lanes<S> {
    /// Whether no lane is NaN: x - x is zero then, and NaN for infinities too.
    #[inline(always)]
    fn is_finite(self) -> bool {
        let s = self.simd;
        let zero = s.sub_f64s(self.value, self.value);
        s.reduce_sum_f64s(zero) == 0.0
    }
}
