//! Double-double arithmetic with about 31 digits: an unevaluated sum of two f64, the reference for error measurements.
//!
//! Built on the two error-free transformations `two_sum` (Knuth) and `two_prod` (through a fused multiply-add). Sums
//! and products are the accurate ones of M. Joldes, J.-M. Muller, V. Popescu, "Tight and rigorous error bounds for
//! basic building blocks of double-word arithmetic", ACM TOMS 44(2), 2017: relative errors of at most 3 u^2
//! (algorithm 6) and 4 u^2 (algorithm 12), with u = 2^-53, cancellation included. The bounds hold while no product
//! or quotient underflows: keep magnitudes within about 1e-290 .. 1e290.
//!
//! Not an IEEE format: overflow and division by zero give NaN, never an infinity.

use super::Real;
use num_traits::{One, Zero};
use std::fmt;

/// pi/2 in three parts, whose sum is exact to about 2^-161. With mpmath at `mp.prec = 400`: `a = float(pi/2)`,
/// `b = float(pi/2 - a)`, `float(pi/2 - a - b)`.
const HALF_PI: [f64; 3] = [
    f64::from_bits(0x3ff9_21fb_5444_2d18),
    f64::from_bits(0x3c91_a626_3314_5c07),
    f64::from_bits(0xb91f_1976_b7ed_8fbc),
];

/// The largest argument of [`Real::sin_cos`], 2^40 (about 1.1e12 radians).
const LARGEST_ANGLE: f64 = 1_099_511_627_776.0;

/// Number of significant digits that [`DoubleDouble`] prints by default.
const SHOWN_DIGITS: usize = 31;

/// A real number as the unevaluated sum `high + low` of two f64, with about 31 digits.
///
/// Normalized: `high` is the f64 nearest to the sum. [`DoubleDouble::from_parts`] normalizes; comparisons and accuracy
/// require it, so that values built from their fields must be normalized already.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct DoubleDouble {
    /// The sum, rounded to f64.
    pub high: f64,
    /// The remainder, at most half a unit in the last place of `high`.
    pub low: f64,
}

impl DoubleDouble {
    /// The exact sum of two f64. Parts that are not finite, or a sum that overflows, give NaN.
    #[must_use]
    pub fn from_parts(high: f64, low: f64) -> Self {
        let (high, low) = two_sum(high, low);
        Self { high, low }
    }

    /// The exact product of two f64 (unless it underflows).
    fn product(a: f64, b: f64) -> Self {
        let (high, low) = two_prod(a, b);
        Self { high, low }
    }

    /// `high + low`, normalized, provided that `high` is zero or has the larger magnitude.
    fn renormalized(high: f64, low: f64) -> Self {
        let sum = high + low;
        Self { high: sum, low: low - (sum - high) }
    }

    /// Each value, lane 0 of scalars with several.
    pub(crate) fn each_of<T: Real>(values: &[T]) -> Vec<Self> {
        values.iter().map(|x| Self::from_f64(x.lane(0))).collect()
    }

    /// An f64, including infinities, unchanged.
    const fn exact(x: f64) -> Self {
        Self { high: x, low: 0.0 }
    }

    /// The alternating tail `t` of a Taylor series for a squared angle of at most about (pi/4)^2.
    ///
    /// `t = x^2/(n(n+1)) (1 - x^2/((n+2)(n+3)) (1 - ...))`, with `cos x = 1 - t` (n = 1) and `sin x = x - x t`
    /// (n = 2). Fourteen factors; the first omitted term is below 1e-33.
    fn series_tail(square: Self, n: f64) -> Self {
        (0..14_u8).rev().fold(Self::zero(), |nested, i| {
            let k = n + 2.0 * f64::from(i);
            square / Self::exact(k * (k + 1.0)) * (Self::one() - nested)
        })
    }

    /// The `count` leading digits of a positive finite number, correctly rounded, and the decimal exponent of the
    /// first.
    fn decimal_digits(self, count: usize) -> (Vec<u8>, i32) {
        let ten = Self::exact(10.0);
        let mut rest = self;
        let mut exponent = 0;
        // Powers of ten up to 1e22 are exact in f64.
        for (power, step) in [(1e22, 22), (1e1, 1)] {
            while rest.high >= power {
                rest /= Self::exact(power);
                exponent += step;
            }
        }
        for (power, step) in [(1e22, 22), (1e1, 1)] {
            while rest.high * power < 10.0 {
                rest *= Self::exact(power);
                exponent -= step;
            }
        }
        // The leading digit of `rest` can still be 0 (0.99.. with high = 1) or, after rounding, 10.
        if rest < Self::one() {
            rest *= ten;
            exponent -= 1;
        }
        let mut digits: Vec<u8> = (0..=count)
            .map(|_| {
                let digit = (0..=9_u8).rev().find(|&d| Self::exact(f64::from(d)) <= rest).unwrap_or(0);
                rest = (rest - Self::exact(f64::from(digit))) * ten;
                digit
            })
            .collect();
        let mut carry = digits.pop().is_some_and(|last| last >= 5);
        for digit in digits.iter_mut().rev() {
            if !carry {
                break;
            }
            carry = *digit == 9;
            *digit = if carry { 0 } else { *digit + 1 };
        }
        if carry {
            digits.insert(0, 1);
            digits.truncate(count);
            exponent += 1;
        }
        (digits, exponent)
    }
}

/// `a + b` rounded, and the exact rounding error (Knuth; for any order of magnitudes).
#[inline]
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let b_seen = sum - a;
    let a_seen = sum - b_seen;
    (sum, (a - a_seen) + (b - b_seen))
}

/// `a * b` rounded, and the exact rounding error (unless it underflows).
#[inline]
fn two_prod(a: f64, b: f64) -> (f64, f64) {
    let product = a * b;
    (product, a.mul_add(b, -product))
}

// Sums, products and quotients are not inlined: the recursions are inlined as a whole, and with about ten operations
// for each they would grow to half a megabyte of rarely executed code.

super::operators! {
    impl [] for DoubleDouble, ;
    /// Accurate addition: relative error below 3 u^2, also if the high parts cancel.
    #[inline(never)] a + b => {
        let (high, high_error) = two_sum(a.high, b.high);
        let (low, low_error) = two_sum(a.low, b.low);
        let partial = Self::renormalized(high, high_error + low);
        Self::renormalized(partial.high, partial.low + low_error)
    }
    a - b => { a + (-b) }
    #[inline(never)] a * b => {
        let (high, error) = two_prod(a.high, b.high);
        let cross = a.low.mul_add(b.high, a.high.mul_add(b.low, a.low * b.low));
        Self::renormalized(high, error + cross)
    }
    /// Long division with three quotient digits of 53 bits each.
    #[inline(never)] a / b => {
        let first = a.high / b.high;
        let rest = a - b * Self::exact(first);
        let second = rest.high / b.high;
        let rest = rest - b * Self::exact(second);
        let third = rest.high / b.high;
        Self::renormalized(first, second) + Self::exact(third)
    }
    -a => { Self { high: -a.high, low: -a.low } }
    0 => Self::exact(0.0); a == 0 => a.high == 0.0 && a.low == 0.0; 1 => Self::exact(1.0)
}

impl Real for DoubleDouble {
    const LANES: usize = 1;

    const GENERAL_JOINTS: bool = true;

    fn from_f64(x: f64) -> Self {
        Self::exact(x)
    }

    super::its_own_parameter!();

    fn lane(self, _index: usize) -> f64 {
        self.high
    }

    #[inline(never)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        self * b + c
    }

    fn recip(self) -> Self {
        Self::one() / self
    }

    /// The square root in f64, corrected by one Newton step with the exact remainder. NaN for negative numbers.
    fn sqrt(self) -> Self {
        if self.is_zero() {
            return self;
        }
        let root = self.high.sqrt();
        let rest = self - Self::product(root, root);
        Self::renormalized(root, rest.high / (2.0 * root))
    }

    /// Sine and cosine with an absolute error below 1e-31 for angles up to 2^40 (1.1e12) radians; NaN beyond.
    ///
    /// The angle is reduced modulo pi/2 in three parts. The Taylor series converges for the remainder of at most pi/4,
    /// without a table. Near a multiple of pi/2, the smaller of the two values has this absolute, not relative,
    /// accuracy.
    fn sin_cos(self) -> (Self, Self) {
        // Written so that NaN fails the test.
        let in_range = self.high.abs() <= LARGEST_ANGLE;
        if !in_range {
            return (Self::exact(f64::NAN), Self::exact(f64::NAN));
        }
        let quarters = (self.high / HALF_PI[0]).round();
        let angle = HALF_PI.iter().fold(self, |angle, &part| angle - Self::product(quarters, part));
        let square = angle * angle;
        let sine = angle - angle * Self::series_tail(square, 2.0);
        let cosine = Self::one() - Self::series_tail(square, 1.0);
        match quarters.rem_euclid(4.0) {
            0.0 => (sine, cosine),
            1.0 => (cosine, -sine),
            2.0 => (-sine, -cosine),
            _ => (-cosine, sine),
        }
    }

    fn abs(self) -> Self {
        if self.high.is_sign_negative() { -self } else { self }
    }

    fn worst(self, other: Self) -> Self {
        if self <= other {
            self
        } else if other <= self {
            other
        } else {
            Self::exact(f64::NAN)
        }
    }

    fn one_if_zero(self) -> Self {
        if self == Self::zero() { Self::one() } else { Self::zero() }
    }

    /// 2^-104, a bound on the relative rounding error of every operation.
    fn epsilon() -> Self {
        Self::exact(f64::EPSILON * f64::EPSILON)
    }
}

impl fmt::Display for DoubleDouble {
    /// Scientific notation with 31 significant digits, or with the number of decimals given by the precision. Digits
    /// beyond the 31st are meaningless; the 31st can be off by one.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.high.is_finite() || self.is_zero() {
            return fmt::Display::fmt(&self.high, f);
        }
        let count = f.precision().map_or(SHOWN_DIGITS, |after_point| after_point + 1);
        let (digits, exponent) = self.abs().decimal_digits(count);
        let text: String = digits.iter().map(|&digit| char::from(b'0' + digit)).collect();
        let (first, others) = text.split_at(1);
        let sign = if self.high < 0.0 { "-" } else { "" };
        let point = if others.is_empty() { "" } else { "." };
        write!(f, "{sign}{first}{point}{others}e{exponent}")
    }
}

#[cfg(test)]
mod tests {
    use super::{DoubleDouble, two_prod, two_sum};

    /// Odd 53-bit integers from a linear congruential generator (Knuth's MMIX constants), identical in every run.
    fn integers() -> impl Iterator<Item = i64> {
        let mut state = 1_u64;
        std::iter::from_fn(move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            i64::try_from(state >> 11 | 1).ok()
        })
    }

    /// The integer value of an f64.
    #[allow(clippy::cast_possible_truncation, reason = "only called on integers below 2^107")]
    fn integer(x: f64) -> i128 {
        assert!(x.fract() == 0.0 && x.abs() < 1e32);
        x as i128
    }

    #[allow(clippy::cast_precision_loss, reason = "53-bit integers are exact in f64")]
    fn float(n: i64) -> f64 {
        n as f64
    }

    #[test]
    fn two_prod_loses_nothing() {
        let mut corrections = 0;
        for (a, b) in integers().zip(integers().skip(1)).take(1000) {
            let (product, error) = two_prod(float(a), float(-b));
            assert_eq!(integer(product) + integer(error), i128::from(a) * i128::from(-b));
            corrections += usize::from(error != 0.0);
        }
        assert!(corrections > 900, "the products of 53-bit integers hardly ever fit 53 bits");
    }

    #[test]
    fn two_sum_loses_nothing() {
        let mut corrections = 0;
        for (i, (a, b)) in integers().zip(integers().skip(1)).take(1000).enumerate() {
            // b is scaled by 1 .. 2^31, so that either addend can be the larger one.
            let scale = 1_i64 << (i % 32);
            let (sum, error) = two_sum(float(a), float(b) * float(scale));
            let (turned, turned_error) = two_sum(float(b) * float(scale), float(a));
            let exact = i128::from(a) + i128::from(b) * i128::from(scale);
            assert_eq!(integer(sum) + integer(error), exact);
            assert_eq!(integer(turned) + integer(turned_error), exact);
            corrections += usize::from(error != 0.0);
        }
        assert!(corrections > 400);
    }

    #[test]
    fn addition_keeps_what_the_sloppy_one_loses() {
        // (1 + a) - (1 + b) with a, b below half an ulp: the result comes from the low parts alone.
        let a = DoubleDouble::from_parts(1.0, 2f64.powi(-55));
        let b = DoubleDouble::from_parts(1.0, 2f64.powi(-107));
        assert_eq!(a - b, DoubleDouble::from_parts(2f64.powi(-55), -2f64.powi(-107)));
    }
}
