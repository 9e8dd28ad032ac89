//! Vectorization over states: each lane of a vector register holds one value of one state, and every operation applies
//! to all lanes.
//!
//! Registers and instructions are those of pulp for the instruction set `S`. An operation is one instruction inside
//! work that it runs (see [`Target`](crate::batch::Target)), and a slow call elsewhere.

use super::trigonometry as t;
use super::{Element, Instructions, Real};
use num_traits::{One, Zero};
use pulp::bytemuck::{cast_slice, cast_slice_mut};
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};
use std::slice::{from_mut, from_ref};

/// One value per state in a register of `S`: f64, or f32 with twice as many states.
#[derive(Debug, Clone, Copy)]
pub struct Lanes<S: Instructions, P: Element = f64> {
    /// Zero-sized; determines the alignment.
    _alignment: [S::Alignment; 0],
    pub(super) simd: S,
    pub(super) value: P::Register<S>,
}

impl<S: Instructions, P: Element> Lanes<S, P> {
    #[inline(always)]
    pub(super) fn new(simd: S, value: P::Register<S>) -> Self {
        Self { _alignment: [], simd, value }
    }

    /// The value nearest to `x` in every lane.
    ///
    /// # Panics
    ///
    /// If the processor does not support the instruction set, which the selection of arms excludes.
    #[inline(always)]
    #[must_use]
    pub fn filled(x: f64) -> Self {
        let simd = S::token().expect("an arm of this processor");
        Self::new(simd, P::splat(simd, x))
    }

    /// The values of all lanes.
    #[inline(always)]
    pub fn lanes(&self) -> &[P] {
        cast_slice(from_ref(&self.value))
    }

    /// The values of all lanes.
    #[inline(always)]
    pub fn lanes_mut(&mut self) -> &mut [P] {
        cast_slice_mut(from_mut(&mut self.value))
    }
}

impl<S: Instructions, P: Element> PartialEq for Lanes<S, P> {
    fn eq(&self, other: &Self) -> bool {
        self.lanes() == other.lanes()
    }
}

macro_rules! operator {
    ($operator:ident, $function:ident, $assigning:ident, $assign:ident) => {
        impl<S: Instructions, P: Element> $operator for Lanes<S, P> {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                Self::new(self.simd, P::$function(self.simd, self.value, other.value))
            }
        }

        impl<S: Instructions, P: Element> $assigning for Lanes<S, P> {
            #[inline(always)]
            fn $assign(&mut self, other: Self) {
                self.value = P::$function(self.simd, self.value, other.value);
            }
        }
    };
}

operator!(Add, add, AddAssign, add_assign);
operator!(Sub, sub, SubAssign, sub_assign);
operator!(Mul, mul, MulAssign, mul_assign);
operator!(Div, div, DivAssign, div_assign);

impl<S: Instructions, P: Element> Neg for Lanes<S, P> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self::new(self.simd, P::negated(self.simd, self.value))
    }
}

impl<S: Instructions, P: Element> Zero for Lanes<S, P> {
    #[inline(always)]
    fn zero() -> Self {
        Self::filled(0.0)
    }

    #[inline(always)]
    fn is_zero(&self) -> bool {
        self.lanes().iter().all(|x| x.widened() == 0.0)
    }
}

impl<S: Instructions, P: Element> One for Lanes<S, P> {
    #[inline(always)]
    fn one() -> Self {
        Self::filled(1.0)
    }
}

impl<S: Instructions, P: Element> Real for Lanes<S, P> {
    const LANES: usize = size_of::<P::Register<S>>() / size_of::<P>();

    #[inline(always)]
    fn from_f64(x: f64) -> Self {
        Self::filled(x)
    }

    #[inline(always)]
    fn constant(self, x: f64) -> Self {
        Self::new(self.simd, P::splat(self.simd, x))
    }

    type Parameter = P;

    #[inline(always)]
    fn parameter(x: f64) -> P {
        P::nearest(x)
    }

    #[inline(always)]
    fn splat(self, x: P) -> Self {
        self.constant(x.widened())
    }

    #[inline(always)]
    fn to_parameter(self) -> P {
        self.lanes()[0]
    }

    #[inline(always)]
    fn lane(self, index: usize) -> f64 {
        self.lanes()[index].widened()
    }

    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        Self::new(self.simd, P::mul_add(self.simd, self.value, b.value, c.value))
    }

    #[inline(always)]
    fn minus_product(self, b: Self, c: Self) -> Self {
        Self::new(self.simd, P::minus_product(self.simd, b.value, c.value, self.value))
    }

    #[inline(always)]
    fn recip(self) -> Self {
        self.constant(1.0) / self
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self::new(self.simd, P::sqrt(self.simd, self.value))
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let s = self.simd;
        let rounder = self.constant(P::ROUNDER);
        let shifted = self.mul_add(self.constant(std::f64::consts::FRAC_2_PI), rounder);
        let (sine, cosine) = t::of_reduced::<P, _>(self, shifted - rounder);
        let (sine, cosine) = P::turned(s, shifted.value, sine.value, cosine.value);
        let (sine, cosine) = (Self::new(s, sine), Self::new(s, cosine));
        // Rare: lanes beyond the range of the reduction are recomputed separately, so that no lane affects another.
        if !P::all_within(s, self.value, P::LARGEST) {
            // Copies, because sine and cosine would otherwise be stored in memory from the start.
            let (mut sine, mut cosine) = (sine, cosine);
            t::far(self.lanes(), sine.lanes_mut(), cosine.lanes_mut());
            return (sine, cosine);
        }
        (sine, cosine)
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self::new(self.simd, P::absolute(self.simd, self.value))
    }

    #[inline(always)]
    fn worst(self, other: Self) -> Self {
        Self::new(self.simd, P::worst(self.simd, self.value, other.value))
    }

    #[inline(always)]
    fn one_if_zero(self) -> Self {
        Self::new(self.simd, P::one_if_zero(self.simd, self.value))
    }

    #[inline(always)]
    fn epsilon() -> Self {
        Self::filled(P::EPSILON)
    }
}
