//! A number that counts what is done to it: the generic code, run on it, says how many operations an algorithm is.

use super::Real;
use num_traits::{One, Zero};
use std::cell::Cell;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// How many operations were done; changes of sign, absolute values and comparisons are not counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Operations {
    /// Sums and differences.
    pub additions: u64,
    /// Products that nothing is added to.
    pub multiplications: u64,
    /// Products with a sum: one instruction where the processor has it.
    pub fused: u64,
    /// Divisions and reciprocals.
    pub divisions: u64,
    /// Square roots.
    pub roots: u64,
    /// Sine and cosine of one angle, both together.
    pub sines: u64,
}

impl Operations {
    /// None at all.
    pub const NONE: Self = Self { additions: 0, multiplications: 0, fused: 0, divisions: 0, roots: 0, sines: 0 };

    /// Floating-point operations that a sine with its cosine is, in the polynomials of the arms with fused products.
    pub const OF_SINES: u64 = 52;

    /// Floating-point operations: one for each, two for a fused product, [`Operations::OF_SINES`] for a sine with its cosine.
    #[must_use]
    pub fn flops(&self) -> u64 {
        self.additions
            + self.multiplications
            + 2 * self.fused
            + self.divisions
            + self.roots
            + Self::OF_SINES * self.sines
    }

    /// The counts by name, in the order of the fields.
    #[must_use]
    pub fn named(&self) -> [(&'static str, u64); 6] {
        [
            ("additions", self.additions),
            ("multiplications", self.multiplications),
            ("fused", self.fused),
            ("divisions", self.divisions),
            ("roots", self.roots),
            ("sines", self.sines),
        ]
    }
}

impl Add for Operations {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            additions: self.additions + other.additions,
            multiplications: self.multiplications + other.multiplications,
            fused: self.fused + other.fused,
            divisions: self.divisions + other.divisions,
            roots: self.roots + other.roots,
            sines: self.sines + other.sines,
        }
    }
}

thread_local! {
    static DONE: Cell<Operations> = const { Cell::new(Operations::NONE) };
}

/// Notes one operation of this thread.
fn note(change: impl FnOnce(&mut Operations)) {
    let mut operations = DONE.get();
    change(&mut operations);
    DONE.set(operations);
}

/// An f64 whose operations are counted, for each thread by itself; the results have the bits of f64's.
///
/// Nothing is inlined: the kernels are long, and what is counted need not be fast.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
#[repr(transparent)]
pub struct Counted(pub f64);

impl Counted {
    /// What `work` gives, and the operations on [`Counted`] that it did in this thread.
    pub fn during<R>(work: impl FnOnce() -> R) -> (R, Operations) {
        let before = DONE.replace(Operations::NONE);
        let result = work();
        (result, DONE.replace(before))
    }
}

macro_rules! operator {
    ($operator:ident, $function:ident, $assigning:ident, $assign:ident, $count:ident) => {
        impl $operator for Counted {
            type Output = Self;

            #[inline(never)]
            fn $function(self, other: Self) -> Self {
                note(|done| done.$count += 1);
                Self(self.0.$function(other.0))
            }
        }

        impl $assigning for Counted {
            fn $assign(&mut self, other: Self) {
                *self = self.$function(other);
            }
        }
    };
}

operator!(Add, add, AddAssign, add_assign, additions);
operator!(Sub, sub, SubAssign, sub_assign, additions);
operator!(Mul, mul, MulAssign, mul_assign, multiplications);
operator!(Div, div, DivAssign, div_assign, divisions);

impl Neg for Counted {
    type Output = Self;

    fn neg(self) -> Self {
        Self(-self.0)
    }
}

impl Zero for Counted {
    fn zero() -> Self {
        Self(0.0)
    }

    fn is_zero(&self) -> bool {
        self.0 == 0.0
    }
}

impl One for Counted {
    fn one() -> Self {
        Self(1.0)
    }
}

impl Real for Counted {
    const LANES: usize = 1;
    fn from_f64(x: f64) -> Self {
        Self(x)
    }

    super::its_own_parameter!();

    fn lane(self, _index: usize) -> f64 {
        self.0
    }

    #[inline(never)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        note(|done| done.fused += 1);
        Self(Real::mul_add(self.0, b.0, c.0))
    }

    #[inline(never)]
    fn minus_product(self, b: Self, c: Self) -> Self {
        note(|done| done.fused += 1);
        Self(Real::minus_product(self.0, b.0, c.0))
    }

    #[inline(never)]
    fn recip(self) -> Self {
        note(|done| done.divisions += 1);
        Self(Real::recip(self.0))
    }

    #[inline(never)]
    fn sqrt(self) -> Self {
        note(|done| done.roots += 1);
        Self(Real::sqrt(self.0))
    }

    #[inline(never)]
    fn sin_cos(self) -> (Self, Self) {
        note(|done| done.sines += 1);
        let (s, c) = Real::sin_cos(self.0);
        (Self(s), Self(c))
    }

    fn abs(self) -> Self {
        Self(Real::abs(self.0))
    }

    fn worst(self, other: Self) -> Self {
        Self(Real::worst(self.0, other.0))
    }

    fn one_if_zero(self) -> Self {
        Self(Real::one_if_zero(self.0))
    }

    fn epsilon() -> Self {
        Self(f64::EPSILON)
    }
}
