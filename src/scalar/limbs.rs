//! Limbs of one state side by side: a number of each in a lane of a vector register.

use super::{Lanes, Real};
use pulp::x86::V3;

/// Numbers of one state, of as many limbs as there are lanes; what the limbs hang on has the same number in every lane.
///
/// Constants of a scene are of one body, so each lane has its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limbs(pub(crate) Lanes<V3>);

super::wrapped_operators!(Limbs);

impl Limbs {
    /// The numbers, limb by limb.
    #[inline(always)]
    pub(crate) fn lanes(&self) -> &[f64] {
        self.0.lanes()
    }

    /// The same, to be written.
    #[inline(always)]
    pub(crate) fn lanes_mut(&mut self) -> &mut [f64] {
        self.0.lanes_mut()
    }

    /// Takes one limb's number from another.
    pub(crate) fn take_limb(&mut self, limb: usize, from: &Self) {
        self.lanes_mut()[limb] = from.lanes()[limb];
    }
}

impl Real for Limbs {
    const LANES: usize = <Lanes<V3> as Real>::LANES;
    const LIMBS: usize = <Lanes<V3> as Real>::LANES;

    #[inline(always)]
    fn from_f64(x: f64) -> Self {
        Self(Lanes::splat(x))
    }

    #[inline(always)]
    fn constant(self, x: f64) -> Self {
        Self(self.0.constant(x))
    }

    super::its_own_parameter!();

    #[inline(always)]
    fn of_limb(self, limb: usize) -> Self {
        Self(self.0.constant(self.0.lanes()[limb]))
    }

    #[inline(always)]
    fn lane(self, index: usize) -> f64 {
        self.0.lanes()[index]
    }

    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        Self(self.0.mul_add(b.0, c.0))
    }

    #[inline(always)]
    fn minus_product(self, b: Self, c: Self) -> Self {
        Self(self.0.minus_product(b.0, c.0))
    }

    #[inline(always)]
    fn recip(self) -> Self {
        Self(self.0.recip())
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.sqrt())
    }

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let (sine, cosine) = self.0.sin_cos();
        (Self(sine), Self(cosine))
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0.abs())
    }

    #[inline(always)]
    fn worst(self, other: Self) -> Self {
        Self(self.0.worst(other.0))
    }

    #[inline(always)]
    fn one_if_zero(self) -> Self {
        Self(self.0.one_if_zero())
    }

    #[inline(always)]
    fn epsilon() -> Self {
        Self(Lanes::epsilon())
    }
}
