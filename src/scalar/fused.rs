//! An f64 with fused multiply-adds, for one state on processors that support them.

use super::Real;
use super::trigonometry::{LARGEST, ROUNDER, far, of_reduced};
use std::slice::from_mut;

/// An f64 whose [`Real::mul_add`] is one instruction inside code compiled for such a processor, and a slow call
/// elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
#[repr(transparent)]
pub struct Fused(pub f64);

super::operators! {
    impl [] for Fused, #[inline(always)];
    #[inline(always)] a + b => { Self(a.0 + b.0) }
    #[inline(always)] a - b => { Self(a.0 - b.0) }
    #[inline(always)] a * b => { Self(a.0 * b.0) }
    #[inline(always)] a / b => { Self(a.0 / b.0) }
    #[inline(always)] -a => { Self(-a.0) }
    #[inline(always)] 0 => Self(0.0); a == 0 => a.0 == 0.0; 1 => Self(1.0)
}

impl Real for Fused {
    const LANES: usize = 1;

    #[inline(always)]
    fn from_f64(x: f64) -> Self {
        Self(x)
    }

    super::its_own_parameter!();

    #[inline(always)]
    fn lane(self, _index: usize) -> f64 {
        self.0
    }

    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        Self(self.0.mul_add(b.0, c.0))
    }

    #[inline(always)]
    fn minus_product(self, b: Self, c: Self) -> Self {
        Self((-b.0).mul_add(c.0, self.0))
    }

    #[inline(always)]
    fn recip(self) -> Self {
        Self(1.0 / self.0)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.sqrt())
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let shifted = self.0.mul_add(std::f64::consts::FRAC_2_PI, ROUNDER);
        let (sine, cosine) = of_reduced(self, Self(shifted - ROUNDER));
        // As in `Lanes`.
        let quadrant = shifted.to_bits();
        let (s, c) = if quadrant & 1 == 1 { (cosine.0, sine.0) } else { (sine.0, cosine.0) };
        let (of_sine, of_cosine) = ((quadrant & 2) << 62, (quadrant.wrapping_add(1) & 2) << 62);
        let (mut s, mut c) = (f64::from_bits(s.to_bits() ^ of_sine), f64::from_bits(c.to_bits() ^ of_cosine));
        if !(self.0.abs() <= LARGEST) {
            far(&[self.0], from_mut(&mut s), from_mut(&mut c));
        }
        (Self(s), Self(c))
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0.abs())
    }

    #[inline(always)]
    fn worst(self, other: Self) -> Self {
        // Written as selections instead of branches: the smaller value, or NaN if either is NaN.
        let smaller = if self.0 < other.0 { self } else { other };
        if self.0.is_nan() { self } else { smaller }
    }

    #[inline(always)]
    fn one_if_zero(self) -> Self {
        Self(Real::one_if_zero(self.0))
    }

    #[inline(always)]
    fn epsilon() -> Self {
        Self(f64::EPSILON)
    }
}
