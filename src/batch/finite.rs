//! Checks that values are finite, without a branch for each.

use super::instruction_set::{Entry, Vectorized};
use crate::scalar::{ColumnsOf, Real};

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

/// The check for the entries of matrices, one block at a time.
#[inline(always)]
pub(super) fn entries_not_finite<T: Vectorized>(like: T::Columns, entries: &[Entry<T>]) -> T {
    let (mut sums, zero, width) = ([like; 4], like.constant(0.0), T::Columns::COLUMNS);
    let (whole, mut fault) = (entries.chunks_exact(width), T::zero());
    for &entry in whole.remainder() {
        fault = T::Columns::taken(entry).mul_add(T::zero(), fault);
    }
    for (i, block) in whole.enumerate() {
        sums[i % 4] = like.load(block).mul_add(zero, sums[i % 4]);
    }
    let [a, b, c, d] = sums;
    let all = (a + b) + (c + d);
    for column in 0..width {
        fault += all.column(column);
    }
    fault
}
