//! The scalar types that the recursions are generic over.
//!
//! The trait [`Real`] has the arithmetic that nalgebra's matrices need, and the few functions that the sweeps call.
//! Every `nalgebra::RealField + Copy` type implements it (f64, dual numbers), and so does [`DoubleDouble`], the
//! reference with about 31 digits.
//!
//! ```
//! use phipsi::scalar::{DoubleDouble, Dual, Real};
//!
//! // A difference that cancels in f64 is resolved in double-double.
//! let small = DoubleDouble::from_f64(1.0) + DoubleDouble::from_f64(1e-20) - DoubleDouble::from_f64(1.0);
//! assert_eq!(small.lane(0), 1e-20);
//! // Functions of dual numbers compute derivatives: d(sin x)/dx = cos x.
//! let (sine, _) = Dual { value: 0.3, tangent: 1.0 }.sin_cos();
//! assert_eq!(sine.tangent, 0.3_f64.cos());
//! ```

mod columns;
mod counting;
mod double_double;
mod dual;
mod folding;
mod fused;
#[cfg(feature = "lanes")]
mod instructions;
#[cfg(feature = "lanes")]
mod lanes;
mod operators;
mod recording;
#[cfg(feature = "lanes")]
mod register_columns;
mod traced;
#[cfg(feature = "lanes")]
mod transposed;
pub(crate) mod trigonometry;

#[doc(hidden)]
pub use columns::ColumnsOf;
#[doc(hidden)]
pub use counting::Operations;
pub use double_double::DoubleDouble;
pub use dual::Dual;
#[doc(hidden)]
pub use fused::Fused;
#[cfg(feature = "lanes")]
#[doc(hidden)]
pub use instructions::Instructions;
#[cfg(feature = "lanes")]
#[doc(hidden)]
pub use lanes::Lanes;
pub use recording::{Operation, Traced};

use nalgebra::{ClosedAddAssign, ClosedDivAssign, ClosedMulAssign, ClosedSubAssign, Scalar};
use num_traits::{One, Zero};
use std::ops::Neg;

/// Largest number of lanes of any scalar.
pub(crate) const MOST_LANES: usize = 8;

/// A scalar for the recursions: one real number, or one per lane of a register.
///
/// Sweeps never branch on values of this type. [`Real::worst`] accumulates a monitored quantity, which [`Real::lane`]
/// reads afterwards.
pub trait Real:
    Scalar
    + Copy
    + Zero
    + One
    + Neg<Output = Self>
    + ClosedAddAssign
    + ClosedSubAssign
    + ClosedMulAssign
    + ClosedDivAssign
    + Send
    + Sync
{
    /// Number of lanes of one value.
    const LANES: usize;

    /// Whether values are known when the code runs, so that [`Real::lane`] can choose between formulas. False for a
    /// scalar that records its operations.
    const IS_KNOWN: bool = true;

    /// The value nearest to `x`, in every lane.
    fn from_f64(x: f64) -> Self;

    /// `x` in every lane, like [`Real::from_f64`]; `self` determines only the type. For lanes, `from_f64` detects the
    /// processor in each call, which costs more than the arithmetic of the kernels.
    #[must_use]
    #[inline(always)]
    fn constant(self, x: f64) -> Self {
        Self::from_f64(x)
    }

    /// The type in which constants of a scene are stored: one value for all lanes.
    type Parameter: Scalar + Copy + Send + Sync;

    /// Whether the passes of `dynamics` are compiled for the general joint only. For a scalar whose operations are
    /// function calls, code for each kind of joint multiplies the size of the program and saves no time.
    const GENERAL_JOINTS: bool = false;

    /// The stored value nearest to `x`.
    fn parameter(x: f64) -> Self::Parameter;

    /// A stored value in every lane; `self` determines only the type, as for [`Real::constant`].
    #[must_use]
    fn splat(self, x: Self::Parameter) -> Self;

    /// The value of the first lane, exactly: the inverse of [`Real::splat`].
    #[must_use]
    fn to_parameter(self) -> Self::Parameter;

    /// The value of one lane, rounded to f64.
    fn lane(self, index: usize) -> f64;

    /// `self * b + c`: one instruction with a single rounding if the scalar has one, else product and sum.
    #[must_use]
    fn mul_add(self, b: Self, c: Self) -> Self;

    /// `self - b * c`, as [`Real::mul_add`].
    #[must_use]
    fn minus_product(self, b: Self, c: Self) -> Self {
        (-b).mul_add(c, self)
    }

    /// `1 / self`.
    #[must_use]
    fn recip(self) -> Self;

    /// The square root.
    #[must_use]
    fn sqrt(self) -> Self;

    /// Sine and cosine of `self` in radians.
    fn sin_cos(self) -> (Self, Self);

    /// The absolute value.
    #[must_use]
    fn abs(self) -> Self;

    /// The smaller of the two; NaN if either is NaN.
    #[must_use]
    fn worst(self, other: Self) -> Self;

    /// 1 if `self` is zero, else 0, to avoid divisions by zero without a branch.
    #[must_use]
    fn one_if_zero(self) -> Self;

    /// Machine epsilon, the spacing of values at 1 (2.2e-16 for f64), in every lane.
    fn epsilon() -> Self;
}

/// The larger of the two; NaN if either is NaN.
#[inline(always)]
pub(crate) fn larger<T: Real>(a: T, b: T) -> T {
    -(-a).worst(-b)
}

/// The largest absolute value, at least `least`; NaN if any is NaN. A loop, because a closure that is not inlined is
/// compiled for the baseline.
#[inline(always)]
pub(crate) fn largest_of<T: Real>(x: &[T], least: T) -> T {
    let mut most = least;
    for x in x {
        most = larger(most, x.abs());
    }
    most
}

/// For scalars with one lane: the stored type of constants is the scalar itself.
macro_rules! its_own_parameter {
    () => {
        type Parameter = Self;

        #[inline(always)]
        fn parameter(x: f64) -> Self {
            <Self as Real>::from_f64(x)
        }

        #[inline(always)]
        fn splat(self, x: Self) -> Self {
            x
        }

        #[inline(always)]
        fn to_parameter(self) -> Self {
            self
        }
    };
}
use its_own_parameter;
use operators::operators;

/// The lanes of `T` for which `holds` is false, as bits.
#[inline(always)]
pub(crate) fn lanes_but<T: Real>(holds: impl Fn(usize) -> bool) -> u64 {
    let mut bits = 0;
    for lane in 0..T::LANES {
        bits |= u64::from(!holds(lane)) << lane;
    }
    bits
}

impl<T: nalgebra::RealField + Copy> Real for T {
    const LANES: usize = 1;

    #[inline]
    fn from_f64(x: f64) -> Self {
        nalgebra::convert(x)
    }

    its_own_parameter!();

    #[inline]
    fn lane(self, _index: usize) -> f64 {
        // Exact for f64; the real part of a dual number.
        nalgebra::try_convert(self).unwrap_or(f64::NAN)
    }

    #[inline]
    fn mul_add(self, b: Self, c: Self) -> Self {
        // std's fused multiply-add is a call to libm on processors without the instruction.
        self * b + c
    }

    #[inline]
    fn minus_product(self, b: Self, c: Self) -> Self {
        self - b * c
    }

    #[inline]
    fn recip(self) -> Self {
        nalgebra::ComplexField::recip(self)
    }

    #[inline]
    fn sqrt(self) -> Self {
        nalgebra::ComplexField::sqrt(self)
    }

    #[inline]
    fn sin_cos(self) -> (Self, Self) {
        nalgebra::ComplexField::sin_cos(self)
    }

    #[inline]
    fn abs(self) -> Self {
        nalgebra::ComplexField::abs(self)
    }

    #[inline]
    fn worst(self, other: Self) -> Self {
        if self <= other {
            self
        } else if other <= self {
            other
        } else {
            self + other
        }
    }

    #[inline]
    fn one_if_zero(self) -> Self {
        if self == Self::zero() { Self::one() } else { Self::zero() }
    }

    #[inline]
    fn epsilon() -> Self {
        Self::default_epsilon()
    }
}
