//! Limbs of one state side by side: a number of each in a lane of a vector register.

use super::{Lanes, Real};
use num_traits::{One, Zero};
use pulp::x86::V3;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// Numbers of one state, of as many limbs as there are lanes; what the limbs hang on has the same number in every lane.
///
/// Constants of a scene are of one body, so each lane has its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limbs(pub(crate) Lanes<V3>);

macro_rules! operator {
    ($operator:ident, $function:ident, $assigning:ident, $assign:ident) => {
        impl $operator for Limbs {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                Self(self.0.$function(other.0))
            }
        }

        impl $assigning for Limbs {
            #[inline(always)]
            fn $assign(&mut self, other: Self) {
                self.0.$assign(other.0);
            }
        }
    };
}

operator!(Add, add, AddAssign, add_assign);
operator!(Sub, sub, SubAssign, sub_assign);
operator!(Mul, mul, MulAssign, mul_assign);
operator!(Div, div, DivAssign, div_assign);

impl Neg for Limbs {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

impl Zero for Limbs {
    #[inline(always)]
    fn zero() -> Self {
        Self(Lanes::zero())
    }

    #[inline(always)]
    fn is_zero(&self) -> bool {
        self.0.is_zero()
    }
}

impl One for Limbs {
    #[inline(always)]
    fn one() -> Self {
        Self(Lanes::one())
    }
}

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
