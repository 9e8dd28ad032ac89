//! G of the kernel: its scaled Cholesky factor, and solutions with it.

use super::super::gram_inverse::{NOTHING, REGULAR};
use super::ConstraintKernel;
use crate::dynamics::sweeps::WhitenedRows;
use crate::scalar::{Real, larger};

impl<T: Real> ConstraintKernel<T> {
    /// Scales the diagonal of G to one. Rows that move no joint get a one on the diagonal and zeros elsewhere; they do
    /// not count for the rank.
    #[inline(always)]
    pub(super) fn scaled(&mut self, zero: T) -> T {
        let Self { whitened: WhitenedRows { gram, sizes, .. }, scale, rank, compliance, unsure, .. } = self;
        let (m, one, nothing) = (scale.len(), zero.constant(1.0), zero.constant(NOTHING * NOTHING));
        let mut count = zero;
        let mut finite = one;
        for i in 0..m {
            // A negative compliance is rejected like a value that is not finite.
            finite = finite.worst((compliance[i] - compliance[i].abs()).mul_add(zero.constant(f64::MAX), one));
            let square = gram[i * m + i] + compliance[i];
            let left_out = larger(square.minus_product(nothing, sizes[i]), zero).one_if_zero();
            scale[i] = (one - left_out) * (square + left_out).sqrt().recip();
            // A very small row may be a row that moves no joint in the intended linkage.
            let margin = square.minus_product(zero.constant(*unsure), sizes[i]);
            finite = finite.worst(left_out.mul_add(sizes[i] + one, margin));
            count += one - left_out;
            finite = finite.worst(scale[i] + one);
        }
        for i in 0..m {
            for j in 0..i {
                gram[i * m + j] *= scale[i] * scale[j];
            }
            gram[i * m + i] = one;
        }
        *rank = count;
        finite
    }

    /// Replaces G by its Cholesky factor. Returns the difference of its smallest pivot and the bound above which G is
    /// regular.
    #[inline(always)]
    pub(super) fn factorise(&mut self, zero: T) -> T {
        let Self { whitened: WhitenedRows { gram, .. }, pivot_inverses, unsure, .. } = self;
        let m = pivot_inverses.len();
        let mut least = zero.constant(1.0);
        for j in 0..m {
            let (before, own) = gram.split_at_mut(j * m);
            let own = &mut own[..m];
            for i in 0..j {
                let other = &before[i * m..i * m + i];
                let mut sum = own[i];
                for (&a, &b) in own[..i].iter().zip(other) {
                    sum = sum.minus_product(a, b);
                }
                own[i] = sum * pivot_inverses[i];
            }
            let mut pivot = own[j];
            for &entry in &own[..j] {
                pivot = pivot.minus_product(entry, entry);
            }
            least = least.worst(pivot);
            pivot_inverses[j] = pivot.sqrt().recip();
        }
        least - zero.constant(REGULAR.max(*unsure))
    }

    /// step := -G^-1 step.
    #[inline(always)]
    pub(super) fn solve(&mut self) {
        let Self { whitened: WhitenedRows { gram, .. }, pivot_inverses, scale, step, .. } = self;
        let m = step.len();
        for i in 0..m {
            let mut sum = step[i] * scale[i];
            for (&entry, &x) in gram[i * m..i * m + i].iter().zip(&step[..i]) {
                sum = sum.minus_product(entry, x);
            }
            step[i] = sum * pivot_inverses[i];
        }
        for i in (0..m).rev() {
            let own = step[i] * pivot_inverses[i];
            for (&entry, x) in gram[i * m..i * m + i].iter().zip(&mut step[..i]) {
                *x = x.minus_product(entry, own);
            }
            step[i] = -(own * scale[i]);
        }
    }
}
