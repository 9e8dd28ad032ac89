//! Rows of forces along paths: the innovations W of a unit force along each row, and the Gram matrix G = W* W / D.

use super::model::SweepModel;
use super::paths::{Forces, Path, innovations_along};
use super::scratch::SweepScratch;
use crate::model::Model;
use crate::scalar::Real;
use std::ops::Range;

/// Adjacent rows whose forces act on the bodies of one path.
#[derive(Debug)]
pub(crate) struct PathRows {
    pub path: Path,
    /// Their indices among all rows.
    pub rows: Range<usize>,
    /// For this path and each later one, the joint rows that both share.
    shared: Vec<Vec<Range<usize>>>,
}

/// The innovations of all rows and their Gram matrix; initialized with NaN or zero.
#[derive(Debug)]
pub(crate) struct WhitenedRows<T> {
    pub paths: Vec<PathRows>,
    nv: usize,
    /// w, (m x nv), and w / D.
    innovations: Vec<T>,
    weighted: Vec<T>,
    /// The squares of the rows of w / sqrt(D) without cancellation.
    pub sizes: Vec<T>,
    /// G, in the lower triangle, (m x m).
    pub gram: Vec<T>,
}

impl<T: Real> WhitenedRows<T> {
    /// The rows of these paths, in increasing order.
    pub fn new(model: &Model<T>, paths: Vec<(Path, Range<usize>)>) -> Self {
        let (nan, zero, nv) = (T::from_f64(f64::NAN), T::zero(), model.nv());
        let m = paths.last().map_or(0, |(_, rows)| rows.end);
        let shared = |at: usize| paths[at..].iter().map(|(other, _)| paths[at].0.rows_shared(other, model)).collect();
        let all: Vec<Vec<Vec<Range<usize>>>> = (0..paths.len()).map(shared).collect();
        let paths = paths.into_iter().zip(all).map(|((path, rows), shared)| PathRows { path, rows, shared });
        Self {
            paths: paths.collect(),
            nv,
            innovations: vec![zero; m * nv],
            weighted: vec![zero; m * nv],
            sizes: vec![nan; m],
            gram: vec![nan; m * m],
        }
    }

    /// The length of the longest path.
    pub fn longest(&self) -> usize {
        self.paths.iter().map(|of| of.path.len()).max().unwrap_or_default()
    }

    /// w and w / D of one path, from the unit forces of its rows and their torques.
    #[inline(always)]
    pub fn innovations_of(
        &mut self,
        at: usize,
        scene: (&Model<T>, &SweepModel<T>),
        scratch: &SweepScratch<T>,
        (forces, torque): (&mut [Forces<T>], &[T]),
    ) {
        let Self { paths, innovations, weighted, sizes, nv, .. } = self;
        let PathRows { path, rows, shared } = &paths[at];
        let out = &mut innovations[rows.start * *nv..rows.end * *nv];
        let sizes = &mut sizes[rows.clone()];
        innovations_along(scene, scratch, (path, rows.len()), (forces, torque), (out, sizes));
        let width = (*nv).max(1);
        for (own, weighted) in out.chunks_exact(width).zip(weighted[rows.start * *nv..].chunks_exact_mut(width)) {
            for range in &shared[0] {
                for row in range.start..range.end {
                    weighted[row] = own[row] * scratch.pivot_inverse(row);
                }
            }
        }
    }

    /// The lower triangle of G: sums over the joints that both paths share.
    #[inline(always)]
    pub fn multiply(&mut self, zero: T) {
        let Self { paths, innovations, weighted, gram, nv, sizes, .. } = self;
        let (m, nv) = (sizes.len(), *nv);
        for (at, first) in paths.iter().enumerate() {
            for (second, shared) in paths[at..].iter().zip(&first.shared) {
                for j in second.rows.start..second.rows.end {
                    let second = &innovations[j * nv..(j + 1) * nv];
                    for i in first.rows.start..first.rows.end.min(j + 1) {
                        let first = &weighted[i * nv..(i + 1) * nv];
                        let mut sum = zero;
                        for range in shared {
                            for (&a, &b) in first[range.clone()].iter().zip(&second[range.clone()]) {
                                sum = a.mul_add(b, sum);
                            }
                        }
                        gram[j * m + i] = sum;
                    }
                }
            }
        }
    }

    /// Adds the innovations of forces along the rows.
    #[inline(always)]
    pub fn add(&self, forces: &[T], innovations: &mut [T]) {
        let Self { paths, innovations: w, nv, .. } = self;
        for PathRows { rows, shared, .. } in paths {
            for i in rows.clone() {
                let own = &w[i * *nv..(i + 1) * *nv];
                for range in &shared[0] {
                    for (e, &own) in innovations[range.clone()].iter_mut().zip(&own[range.clone()]) {
                        *e = own.mul_add(forces[i], *e);
                    }
                }
            }
        }
    }

    /// The sum of w e / D of row `i` of a path, and of the absolute values of its terms.
    #[inline(always)]
    pub fn times(&self, of: &PathRows, i: usize, innovations: &[T], (mut sum, mut size): (T, T)) -> (T, T) {
        let own = &self.weighted[i * self.nv..(i + 1) * self.nv];
        for range in &of.shared[0] {
            for (&own, &e) in own[range.clone()].iter().zip(&innovations[range.clone()]) {
                let term = own * e;
                sum += term;
                size += term.abs();
            }
        }
        (sum, size)
    }
}
