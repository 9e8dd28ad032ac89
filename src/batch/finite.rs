//! Checks that values are finite, without a branch for each.

use crate::scalar::Real;

/// Zero if `x` is finite, otherwise NaN; without a branch.
#[inline(always)]
#[allow(clippy::eq_op)] // that is the point
pub(super) fn not_finite<T: Real>(x: T) -> T {
    x - x
}

/// Zero if all values are finite, otherwise NaN. In lanes it uses four independent sums, because there can be thousands
/// of values.
#[inline(always)]
pub(super) fn any_not_finite<T: Real>(numbers: &[T]) -> T {
    if T::LANES == 1 {
        let mut are_finite = true;
        for number in numbers {
            are_finite &= number.lane(0).is_finite();
        }
        return T::from_f64(if are_finite { 0.0 } else { f64::NAN });
    }
    let (mut sums, zero) = ([T::zero(); 4], T::zero());
    let (fours, rest) = numbers.as_chunks::<4>();
    for four in fours {
        for (sum, &number) in sums.iter_mut().zip(four) {
            *sum = number.mul_add(zero, *sum);
        }
    }
    for &number in rest {
        sums[0] = number.mul_add(zero, sums[0]);
    }
    let [a, b, c, d] = sums;
    (a + b) + (c + d)
}
