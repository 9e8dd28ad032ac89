//! Rows of forces along paths: the innovations W of a unit force along each row, and the Gram matrix G = W* W / D.

use super::model::SweepModel;
use super::paths::{Forces, Path, innovations_along};
use super::scratch::SweepScratch;
use crate::filter::riccati::Measured;
use crate::model::Model;
use crate::scalar::Real;
use std::ops::Range;

/// Adjacent rows whose forces act on the bodies of one path.
#[derive(Debug, Clone)]
pub(crate) struct PathRows {
    pub path: Path,
    /// Their indices among all rows.
    pub rows: Range<usize>,
    /// For this path and each later one, the joint rows that both share; only those of this path without G.
    shared: Vec<Vec<Range<usize>>>,
    /// Joint row r of the first of its rows is at `start` + r, and that of the next one `width` later: the number of
    /// joint rows from the first to the last on the path.
    start: usize,
    width: usize,
}

impl PathRows {
    /// The place of joint row zero of row `i`.
    #[inline(always)]
    fn at(&self, i: usize) -> usize {
        self.start + (i - self.rows.start) * self.width
    }
}

/// The innovations of all rows and their Gram matrix; initialized with NaN or zero.
#[derive(Debug, Clone)]
pub(crate) struct WhitenedRows<T> {
    pub paths: Vec<PathRows>,
    /// w and w / D.
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
        Self::with_gram(model, paths, true)
    }

    /// The rows of these paths, with room for G or without.
    pub fn with_gram(model: &Model<T>, paths: Vec<(Path, Range<usize>)>, has_gram: bool) -> Self {
        let (nan, zero) = (T::from_f64(f64::NAN), T::zero());
        let m = paths.last().map_or(0, |(_, rows)| rows.end);
        let shared = |at: usize| {
            let others = &paths[at..if has_gram { paths.len() } else { at + 1 }];
            others.iter().map(|(other, _)| paths[at].0.rows_shared(other, model)).collect()
        };
        let all: Vec<Vec<Vec<Range<usize>>>> = (0..paths.len()).map(shared).collect();
        let bounds = |shared: &[Vec<Range<usize>>]| {
            let first = shared[0].iter().map(|range| range.start).min().unwrap_or_default();
            (first, shared[0].iter().map(|range| range.end).max().unwrap_or(first))
        };
        // No place is before the first one.
        let mut end = all.iter().map(|shared| bounds(shared).0).max().unwrap_or_default();
        let placed = paths.into_iter().zip(all).map(|((path, rows), shared)| {
            let (first, last) = bounds(&shared);
            let (start, width) = (end - first, last - first);
            end += rows.len() * width;
            PathRows { path, rows, shared, start, width }
        });
        let paths = placed.collect();
        Self {
            paths,
            innovations: vec![zero; end],
            weighted: vec![zero; end],
            sizes: vec![nan; m],
            gram: vec![nan; if has_gram { m * m } else { 0 }],
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
        let Self { paths, innovations, weighted, sizes, .. } = self;
        let of @ PathRows { path, rows, shared, start, width } = &paths[at];
        let (out, sizes) = (&mut innovations[*start..], &mut sizes[rows.clone()]);
        innovations_along(scene, scratch, (path, rows.len()), (forces, torque), ((out, *width), sizes));
        for i in rows.clone() {
            let (own, weighted) = (&innovations[of.at(i)..], &mut weighted[of.at(i)..]);
            for range in &shared[0] {
                let measured = &scratch.measured[range.clone()];
                for ((to, &own), m) in weighted[range.clone()].iter_mut().zip(&own[range.clone()]).zip(measured) {
                    *to = own * m.pivot_inverse;
                }
            }
        }
    }

    /// The lower triangle of G: sums over the joints that both paths share, in blocks of three rows by three while they
    /// last. A scalar that records its operations gets no entry above the diagonal.
    #[inline(always)]
    pub fn multiply(&mut self, zero: T) {
        let Self { paths, innovations, weighted, gram, sizes, .. } = self;
        let m = sizes.len();
        for (at, first) in paths.iter().enumerate() {
            for (second, shared) in paths[at..].iter().zip(&first.shared) {
                let (mut j, widths) = (second.rows.start, [first.width, second.width]);
                while j < second.rows.end {
                    let mut i = first.rows.start;
                    let is_three = T::IS_KNOWN && j + 3 <= second.rows.end;
                    let end = first.rows.end.min(j + if is_three { 3 } else { 1 });
                    while i < end {
                        let (of_first, of_second) = (&weighted[first.at(i)..], &innovations[second.at(j)..]);
                        let (both, to) = ((of_first, of_second), (&mut gram[j * m + i..], m));
                        if is_three && i + 3 <= end {
                            block::<T, 3, 3>(both, (widths, shared), to, zero);
                            i += 3;
                        } else if is_three {
                            block::<T, 1, 3>(both, (widths, shared), to, zero);
                            i += 1;
                        } else {
                            block::<T, 1, 1>(both, (widths, shared), to, zero);
                            i += 1;
                        }
                    }
                    j += if is_three { 3 } else { 1 };
                }
            }
        }
    }

    /// Adds the innovations of forces along the rows.
    #[inline(always)]
    pub fn add(&self, forces: &[T], innovations: &mut [T]) {
        for of in &self.paths {
            for i in of.rows.clone() {
                let own = &self.innovations[of.at(i)..];
                for range in &of.shared[0] {
                    for (e, &own) in innovations[range.clone()].iter_mut().zip(&own[range.clone()]) {
                        *e = own.mul_add(forces[i], *e);
                    }
                }
            }
        }
    }

    /// w / sqrt(D) of row `i` of a path: its joint rows and their entries.
    pub fn scaled_row(&self, of: &PathRows, i: usize, measured: &[Measured<T>]) -> impl Iterator<Item = (usize, T)> {
        let own = &self.innovations[of.at(i)..];
        let entry = move |row: usize| own[row] * measured[row].pivot_inverse.sqrt();
        of.shared[0].iter().cloned().flatten().map(move |row| (row, entry(row)))
    }

    /// w / sqrt(D) of all rows into `out`, (m x nv), which holds zeros.
    pub fn scaled(&self, measured: &[Measured<T>], out: &mut [T]) {
        for of in &self.paths {
            for i in of.rows.clone() {
                for (row, entry) in self.scaled_row(of, i, measured) {
                    out[i * measured.len() + row] = entry;
                }
            }
        }
    }

    /// The sum of w e / D of row `i` of a path.
    #[inline(always)]
    pub fn product(&self, of: &PathRows, i: usize, innovations: &[T], mut sum: T) -> T {
        let own = &self.weighted[of.at(i)..];
        for range in &of.shared[0] {
            for (&own, &e) in own[range.clone()].iter().zip(&innovations[range.clone()]) {
                sum = own.mul_add(e, sum);
            }
        }
        sum
    }

    /// The sum of w e / D of row `i` of a path, and of the absolute values of its terms.
    #[inline(always)]
    pub fn times(&self, of: &PathRows, i: usize, innovations: &[T], (mut sum, mut size): (T, T)) -> (T, T) {
        let own = &self.weighted[of.at(i)..];
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

/// The products of `A` adjacent rows of one array and `B` of another, of these widths, over ranges of columns, into the
/// matrix with this stride: a row per row of the second. Loops, because a closure that is not inlined is compiled for
/// the baseline.
#[inline(always)]
fn block<T: Real, const A: usize, const B: usize>(
    (first, second): (&[T], &[T]),
    ([of_first, of_second], ranges): ([usize; 2], &[Range<usize>]),
    (gram, stride): (&mut [T], usize),
    zero: T,
) {
    let mut sums = [[zero; A]; B];
    for range in ranges {
        let (mut firsts, mut seconds): ([&[T]; A], [&[T]; B]) = ([&[]; A], [&[]; B]);
        for (i, to) in firsts.iter_mut().enumerate() {
            *to = &first[i * of_first..][range.clone()];
        }
        for (i, to) in seconds.iter_mut().enumerate() {
            *to = &second[i * of_second..][range.clone()];
        }
        for k in 0..range.len() {
            for (sums, second) in sums.iter_mut().zip(&seconds) {
                for (sum, first) in sums.iter_mut().zip(&firsts) {
                    *sum = first[k].mul_add(second[k], *sum);
                }
            }
        }
    }
    for (j, sums) in sums.iter().enumerate() {
        for (i, &sum) in sums.iter().enumerate() {
            gram[j * stride + i] = sum;
        }
    }
}
