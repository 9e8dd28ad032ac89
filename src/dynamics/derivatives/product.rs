//! -M^-1 times dtau/dq and dtau/dqd, both at once, their zeros between branches left out.

use crate::dynamics::sweeps::SweepModel;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real, larger};
use std::ops::Range;

/// Rows of the result that are done at once.
const ROWS: usize = 4;

/// Where the largest entry of dqdd/dq or dqdd/dqd may be off by more than this, relative to itself, form `auto` goes another way.
///
/// The estimate is eps times the terms that the largest column is the sum of. Over 2,200 random scenes, ordinary and extreme, the error is as a rule
/// half of it, and in 99 of 100 less than seven times; robots stay far below (docs/derivatives.md).
pub(super) const MOST_LOST: f64 = 1e-9;

/// Scratch of the product; made when it is first needed.
#[derive(Debug)]
pub(crate) struct Product<T: Real, C: ColumnsOf<T>> {
    /// dtau/dq and dtau/dqd; behind them as many numbers as a block holds.
    right: Vec<C::Entry>,
    /// The largest entry of each row of M^-1.
    largest: Vec<T>,
    /// By blocks of columns the rows that hold anything.
    rows: Vec<Vec<Range<usize>>>,
}

impl<T: Real, C: ColumnsOf<T>> Product<T, C> {
    /// None yet.
    pub fn new() -> Self {
        Self { right: Vec::new(), largest: Vec::new(), rows: Vec::new() }
    }

    #[cold]
    fn make(&mut self, model: &Model<T>, sweeps: &SweepModel<T>) {
        let nv = model.nv();
        self.right = vec![C::kept(T::zero()); 2 * nv * nv + C::COLUMNS];
        self.largest = vec![T::from_f64(f64::NAN); nv];
        let mut holds = vec![vec![false; nv]; nv.div_ceil(C::COLUMNS)];
        sweeps.each_pair(model, |row, column| {
            holds[column / C::COLUMNS][row] = true;
            holds[row / C::COLUMNS][column] = true;
        });
        self.rows = holds.iter().map(|holds| runs(holds)).collect();
    }

    /// -M^-1 times both, in their places: `out` holds dtau/dq, dtau/dqd and M^-1, one after another. The lanes, as bits, in which digits cancel.
    #[inline(always)]
    pub fn in_place(&mut self, scene: (&Model<T>, &SweepModel<T>), like: C, out: &mut [C::Entry]) -> u64 {
        let nv = scene.0.nv();
        if self.rows.is_empty() {
            self.make(scene.0, scene.1);
        }
        let Self { right, largest, rows } = self;
        let (both, inverse) = out.split_at_mut(2 * nv * nv);
        right[..both.len()].copy_from_slice(both);
        let right = &right[..];
        for (i, largest) in largest.iter_mut().enumerate() {
            *largest = T::zero();
            for &entry in &inverse[i * nv..(i + 1) * nv] {
                *largest = larger(*largest, C::taken(entry).abs());
            }
        }
        let (of_q, of_qd) = both.split_at_mut(nv * nv);
        // Of all columns, lane by lane: the most terms, and the largest result.
        let (mut terms, mut size) = ([like; 2], [like; 2]);
        for (at, rows) in rows.iter().enumerate() {
            let first = at * C::COLUMNS;
            let width = C::COLUMNS.min(nv - first);
            let mut of_column = [like; 2];
            for i in rows.iter().flat_map(Clone::clone) {
                for (matrix, terms) in of_column.iter_mut().enumerate() {
                    let entry = like.load(&right[(matrix * nv + i) * nv + first..]);
                    *terms = like.spread(largest[i]).mul_add(entry.abs(), *terms);
                }
            }
            for matrix in 0..2 {
                terms[matrix] = larger(terms[matrix], only(like, of_column[matrix], width));
            }
            for row in (0..nv).step_by(ROWS) {
                let count = ROWS.min(nv - row);
                let mut sums = [[like; 2]; ROWS];
                let of_row = |r: usize| &inverse[(row + r.min(count - 1)) * nv..][..nv];
                let of_rows = [of_row(0), of_row(1), of_row(2), of_row(3)];
                for i in rows.iter().flat_map(Clone::clone) {
                    let entries = [like.load(&right[i * nv + first..]), like.load(&right[(nv + i) * nv + first..])];
                    for (sums, of_row) in sums.iter_mut().zip(of_rows) {
                        let factor = like.spread(C::taken(of_row[i]));
                        for (sum, entry) in sums.iter_mut().zip(entries) {
                            *sum = sum.minus_product(factor, entry);
                        }
                    }
                }
                for (r, &[by_q, by_qd]) in sums[..count].iter().enumerate() {
                    size = [
                        larger(size[0], only(like, by_q, width).abs()),
                        larger(size[1], only(like, by_qd, width).abs()),
                    ];
                    let to = (row + r) * nv + first;
                    put::<T, C>(by_q, &mut of_q[to..to + width]);
                    put::<T, C>(by_qd, &mut of_qd[to..to + width]);
                }
            }
        }
        lost(terms, size)
    }
}

/// Runs of true.
fn runs(holds: &[bool]) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for i in (0..holds.len()).filter(|&i| holds[i]) {
        match runs.last_mut() {
            Some(run) if run.end == i => run.end = i + 1,
            _ => runs.push(i..i + 1),
        }
    }
    runs
}

/// The first columns of a block, zero in the others.
#[inline(always)]
fn only<T: Real, C: ColumnsOf<T>>(like: C, mut block: C, width: usize) -> C {
    if width < C::COLUMNS {
        for column in width..C::COLUMNS {
            block.set_column(column, like.column(0));
        }
    }
    block
}

/// As many columns of a block as there is room for.
#[inline(always)]
fn put<T: Real, C: ColumnsOf<T>>(block: C, to: &mut [C::Entry]) {
    if to.len() == C::COLUMNS {
        block.store(to);
        return;
    }
    for (column, to) in to.iter_mut().enumerate() {
        *to = C::kept(block.column(column));
    }
}

/// The lanes in which rounding of the terms may be more than is let pass.
#[inline(always)]
fn lost<T: Real, C: ColumnsOf<T>>(terms: [C; 2], size: [C; 2]) -> u64 {
    let rounding = T::epsilon().lane(0) / MOST_LOST;
    let mut lanes = 0;
    for matrix in 0..2 {
        let (mut terms_of, mut size_of) = (terms[matrix].column(0), size[matrix].column(0));
        for column in 1..C::COLUMNS {
            terms_of = larger(terms_of, terms[matrix].column(column));
            size_of = larger(size_of, size[matrix].column(column));
        }
        for lane in 0..T::LANES {
            lanes |= u64::from(!(terms_of.lane(lane) * rounding <= size_of.lane(lane))) << lane;
        }
    }
    lanes
}
