//! Vectorization over states: each lane of a vector register holds one value of one state, and every operation applies
//! to all lanes.
//!
//! Registers and instructions are those of pulp for the instruction set `S`. An operation is one instruction inside
//! work that it runs (see [`Target`](crate::batch::Target)), and a slow call elsewhere.

use super::trigonometry as t;
use super::{Instructions, Real};
use pulp::Simd;
use pulp::bytemuck::{cast_slice, cast_slice_mut};
use std::slice::{from_mut, from_ref};

/// One value per state in a register of `S`.
#[derive(Debug, Clone, Copy)]
pub struct Lanes<S: Instructions> {
    /// Zero-sized; determines the alignment.
    _alignment: [S::Alignment; 0],
    pub(super) simd: S,
    pub(super) value: S::f64s,
}

impl<S: Instructions> Lanes<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, value: S::f64s) -> Self {
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
        Self::new(simd, simd.splat_f64s(x))
    }

    /// The values of all lanes.
    #[inline(always)]
    pub fn lanes(&self) -> &[f64] {
        cast_slice(from_ref(&self.value))
    }

    /// The values of all lanes.
    #[inline(always)]
    pub fn lanes_mut(&mut self) -> &mut [f64] {
        cast_slice_mut(from_mut(&mut self.value))
    }
}

/// -a, also for zeros.
#[inline(always)]
fn negated<S: Simd>(simd: S, a: S::f64s) -> S::f64s {
    simd.xor_f64s(a, simd.splat_f64s(-0.0))
}

/// |a|.
#[inline(always)]
fn absolute<S: Simd>(simd: S, a: S::f64s) -> S::f64s {
    simd.and_f64s(a, simd.splat_f64s(f64::from_bits(!(-0.0_f64).to_bits())))
}

/// True if no lane exceeds `bound` in magnitude or is NaN.
#[inline(always)]
fn all_within<S: Simd>(simd: S, a: S::f64s, bound: f64) -> bool {
    let within = simd.less_than_or_equal_f64s(absolute(simd, a), simd.splat_f64s(bound));
    simd.first_true_m64s(simd.not_m64s(within)) >= size_of::<S::f64s>() / size_of::<f64>()
}

/// Sine and cosine of the whole angle from those of the reduced angle. `shifted` is the number of quarter turns plus
/// [`t::ROUNDER`], whose low-order mantissa bits contain that number.
#[inline(always)]
fn turned<S: Simd>(simd: S, shifted: S::f64s, sine: S::f64s, cosine: S::f64s) -> (S::f64s, S::f64s) {
    // Quadrants 1 and 3 swap sine and cosine, 2 and 3 change the sign of the sine, 1 and 2 that of the cosine.
    let quadrant = simd.transmute_u64s_f64s(shifted);
    let (one, two) = (simd.splat_u64s(1), simd.splat_u64s(2));
    let swapped = simd.equal_u64s(simd.and_u64s(quadrant, one), one);
    let sine_turned = simd.equal_u64s(simd.and_u64s(quadrant, two), two);
    let cosine_turned = simd.equal_u64s(simd.and_u64s(simd.add_u64s(quadrant, one), two), two);
    let (s, c) = (simd.select_f64s(swapped, cosine, sine), simd.select_f64s(swapped, sine, cosine));
    let sine = simd.select_f64s(sine_turned, negated(simd, s), s);
    (sine, simd.select_f64s(cosine_turned, negated(simd, c), c))
}

impl<S: Instructions> PartialEq for Lanes<S> {
    fn eq(&self, other: &Self) -> bool {
        self.lanes() == other.lanes()
    }
}

super::operators! {
    impl [S: Instructions] for Lanes<S>, #[inline(always)];
    #[inline(always)] a + b => { Self::new(a.simd, a.simd.add_f64s(a.value, b.value)) }
    #[inline(always)] a - b => { Self::new(a.simd, a.simd.sub_f64s(a.value, b.value)) }
    #[inline(always)] a * b => { Self::new(a.simd, a.simd.mul_f64s(a.value, b.value)) }
    #[inline(always)] a / b => { Self::new(a.simd, a.simd.div_f64s(a.value, b.value)) }
    #[inline(always)] -a => { Self::new(a.simd, negated(a.simd, a.value)) }
    #[inline(always)] 0 => Self::filled(0.0); a == 0 => a.lanes().iter().all(|&x| x == 0.0); 1 => Self::filled(1.0)
}

impl<S: Instructions> Real for Lanes<S> {
    const LANES: usize = size_of::<S::f64s>() / size_of::<f64>();

    #[inline(always)]
    fn from_f64(x: f64) -> Self {
        Self::filled(x)
    }

    #[inline(always)]
    fn constant(self, x: f64) -> Self {
        Self::new(self.simd, self.simd.splat_f64s(x))
    }

    type Parameter = f64;

    #[inline(always)]
    fn parameter(x: f64) -> f64 {
        x
    }

    #[inline(always)]
    fn splat(self, x: f64) -> Self {
        self.constant(x)
    }

    #[inline(always)]
    fn to_parameter(self) -> f64 {
        self.lanes()[0]
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
        self.constant(1.0) / self
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self::new(self.simd, self.simd.sqrt_f64s(self.value))
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let s = self.simd;
        let rounder = self.constant(t::ROUNDER);
        let shifted = self.mul_add(self.constant(std::f64::consts::FRAC_2_PI), rounder);
        let (sine, cosine) = t::of_reduced(self, shifted - rounder);
        let (sine, cosine) = turned(s, shifted.value, sine.value, cosine.value);
        let (sine, cosine) = (Self::new(s, sine), Self::new(s, cosine));
        // Rare: lanes beyond the range of the reduction are recomputed separately, so that no lane affects another.
        if !all_within(s, self.value, t::LARGEST) {
            // Copies, because sine and cosine would otherwise be stored in memory from the start.
            let (mut sine, mut cosine) = (sine, cosine);
            t::far(self.lanes(), sine.lanes_mut(), cosine.lanes_mut());
            return (sine, cosine);
        }
        (sine, cosine)
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self::new(self.simd, absolute(self.simd, self.value))
    }

    #[inline(always)]
    fn worst(self, other: Self) -> Self {
        let (s, a, b) = (self.simd, self.value, other.value);
        // For a NaN and a number, x86 returns the second operand and NEON the NaN: one of the two orders returns the
        // NaN, and OR with the other result preserves it.
        Self::new(s, s.or_f64s(s.min_f64s(a, b), s.min_f64s(b, a)))
    }

    #[inline(always)]
    fn one_if_zero(self) -> Self {
        let (s, zero) = (self.simd, self.simd.splat_f64s(0.0));
        Self::new(s, s.select_f64s(s.equal_f64s(self.value, zero), s.splat_f64s(1.0), zero))
    }

    #[inline(always)]
    fn epsilon() -> Self {
        Self::filled(f64::EPSILON)
    }
}
