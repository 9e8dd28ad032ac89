//! G of the kernel: its factor L D L*, and solutions with it. No root is on the way from one pivot to the next.

use super::super::gram_inverse::{NOTHING, REGULAR};
use super::ConstraintKernel;
use crate::dynamics::sweeps::WhitenedRows;
use crate::scalar::{Real, larger};

/// Rows of G that are eliminated together: their sums are independent and share the rows above.
const TOGETHER: usize = 3;

impl<T: Real> ConstraintKernel<T> {
    /// Adds the compliance to the diagonal of G. Rows that move no joint get a one on the diagonal and zeros elsewhere;
    /// they do not count for the rank.
    #[inline(always)]
    pub(super) fn prepare(&mut self, zero: T) -> T {
        let Self { rows, kept, diagonal, rank, compliance, unsure, .. } = self;
        let WhitenedRows { gram, sizes, .. } = &mut rows.whitened;
        let (m, one, nothing) = (kept.len(), zero.constant(1.0), zero.constant(NOTHING * NOTHING));
        let (mut count, mut finite) = (zero, one);
        for i in 0..m {
            // A negative compliance is rejected like a value that is not finite.
            finite = finite.worst((compliance[i] - compliance[i].abs()).mul_add(zero.constant(f64::MAX), one));
            let square = gram[i * m + i] + compliance[i];
            let left_out = larger(square.minus_product(nothing, sizes[i]), zero).one_if_zero();
            kept[i] = one - left_out;
            diagonal[i] = square.mul_add(kept[i], left_out);
            // A very small row may be a row that moves no joint in the intended linkage.
            let margin = square.minus_product(zero.constant(*unsure), sizes[i]);
            finite = finite.worst(left_out.mul_add(sizes[i] + one, margin));
            count += kept[i];
            gram[i * m + i] = diagonal[i];
        }
        *rank = count;
        if is_below(count, m) {
            for i in 0..m {
                for j in 0..i {
                    gram[i * m + j] *= kept[i] * kept[j];
                }
            }
        }
        finite
    }

    /// Replaces G by its factors. Returns a value that is positive if the smallest pivot, relative to the diagonal, is
    /// above the bound from which G is regular.
    #[inline(always)]
    pub(super) fn factorise(&mut self, zero: T) -> T {
        let Self { rows, pivot_inverses, diagonal, unsure, .. } = self;
        let gram = &mut rows.whitened.gram;
        let m = pivot_inverses.len();
        let bound = zero.constant(REGULAR.max(*unsure));
        let (mut least, mut j) = (zero.constant(1.0), 0);
        while j + TOGETHER <= m {
            let of = (&mut gram[..], &mut pivot_inverses[..], &diagonal[..]);
            least = least.worst(eliminate::<T, TOGETHER>(of, j, bound));
            j += TOGETHER;
        }
        while j < m {
            let of = (&mut gram[..], &mut pivot_inverses[..], &diagonal[..]);
            least = least.worst(eliminate::<T, 1>(of, j, bound));
            j += 1;
        }
        least
    }

    /// step := -G^-1 step.
    #[inline(always)]
    pub(super) fn solve(&mut self) {
        let Self { rows, pivot_inverses, kept, step, .. } = self;
        let gram = &rows.whitened.gram;
        for (step, &kept) in step.iter_mut().zip(&*kept) {
            *step *= kept;
        }
        let (m, mut j) = (step.len(), 0);
        while j + TOGETHER <= m {
            substitute::<T, TOGETHER>(gram, step, j);
            j += TOGETHER;
        }
        let grouped = j;
        while j < m {
            substitute::<T, 1>(gram, step, j);
            j += 1;
        }
        for (step, &inverse) in step.iter_mut().zip(&*pivot_inverses) {
            *step *= -inverse;
        }
        while j > grouped {
            j -= 1;
            substitute_back::<T, 1>(gram, step, j);
        }
        while j > 0 {
            j -= TOGETHER;
            substitute_back::<T, TOGETHER>(gram, step, j);
        }
    }
}

/// Entries `j` to `j + R` of L^-1 x, from those before.
#[inline(always)]
fn substitute<T: Real, const R: usize>(gram: &[T], x: &mut [T], j: usize) {
    let m = x.len();
    let (before, to) = x.split_at_mut(j);
    let (rows, mut own) = (&gram[j * m..(j + R) * m], [to[0]; R]);
    own.copy_from_slice(&to[..R]);
    for (k, &x) in before.iter().enumerate() {
        for (r, own) in own.iter_mut().enumerate() {
            *own = own.minus_product(rows[r * m + k], x);
        }
    }
    for r in 1..R {
        for s in 0..r {
            own[r] = own[r].minus_product(rows[r * m + j + s], own[s]);
        }
    }
    to[..R].copy_from_slice(&own);
}

/// Entries `j` to `j + R` of L^-* x, and their effect on those before.
#[inline(always)]
fn substitute_back<T: Real, const R: usize>(gram: &[T], x: &mut [T], j: usize) {
    let m = x.len();
    let (before, to) = x.split_at_mut(j);
    let (rows, mut own) = (&gram[j * m..(j + R) * m], [to[0]; R]);
    own.copy_from_slice(&to[..R]);
    for r in (1..R).rev() {
        for s in 0..r {
            own[s] = own[s].minus_product(rows[r * m + j + s], own[r]);
        }
    }
    to[..R].copy_from_slice(&own);
    for (k, x) in before.iter_mut().enumerate() {
        for (r, &own) in own.iter().enumerate() {
            *x = x.minus_product(rows[r * m + k], own);
        }
    }
}

/// True if a lane is below `m`, or can be.
#[inline(always)]
fn is_below<T: Real>(count: T, m: usize) -> bool {
    #[allow(clippy::cast_precision_loss)] // a small count
    let all = m as f64;
    let mut is_below = !T::IS_KNOWN;
    for lane in 0..T::LANES {
        is_below |= count.lane(lane) < all;
    }
    is_below
}

/// Rows `j` to `j + R` of the factors, from those above: L, and the inverses of D. Returns the smallest difference of a
/// pivot and its bound, which is relative to the diagonal of G.
#[inline(always)]
fn eliminate<T: Real, const R: usize>(
    (gram, pivot_inverses, diagonal): (&mut [T], &mut [T], &[T]),
    j: usize,
    bound: T,
) -> T {
    let m = pivot_inverses.len();
    let (before, own) = gram.split_at_mut(j * m);
    let own = &mut own[..R * m];
    // L D of these rows.
    for i in 1..j {
        let other = &before[i * m..i * m + i];
        let mut sums = [bound; R];
        for (r, sum) in sums.iter_mut().enumerate() {
            *sum = own[r * m + i];
        }
        for (k, &entry) in other.iter().enumerate() {
            for (r, sum) in sums.iter_mut().enumerate() {
                *sum = sum.minus_product(own[r * m + k], entry);
            }
        }
        for (r, &sum) in sums.iter().enumerate() {
            own[r * m + i] = sum;
        }
    }
    let mut rest = [[bound; R]; R];
    for (r, rest) in rest.iter_mut().enumerate() {
        for (s, rest) in rest.iter_mut().enumerate().take(r + 1) {
            *rest = own[r * m + j + s];
        }
    }
    for k in 0..j {
        let mut divided = [bound; R];
        for r in 0..R {
            divided[r] = own[r * m + k] * pivot_inverses[k];
            for s in 0..=r {
                rest[r][s] = rest[r][s].minus_product(own[r * m + k], divided[s]);
            }
        }
        for (r, &divided) in divided.iter().enumerate() {
            own[r * m + k] = divided;
        }
    }
    let mut least = bound.constant(1.0);
    for k in 0..R {
        let pivot = rest[k][k];
        least = least.worst(pivot.minus_product(bound, diagonal[j + k]));
        let inverse = pivot.recip();
        pivot_inverses[j + k] = inverse;
        let mut divided = [bound; R];
        for r in k + 1..R {
            divided[r] = rest[r][k] * inverse;
            for s in k + 1..=r {
                rest[r][s] = rest[r][s].minus_product(rest[r][k], divided[s]);
            }
            own[r * m + j + k] = divided[r];
        }
    }
    least
}
