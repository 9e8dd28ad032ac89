//! The rotations of the array form, on matrices that are stored column by column with padded columns.
//!
//! Readings: [[r, H L], [0, L]] is rotated from the right to [[S, 0], [K', L']], one reading after another. Givens
//! rotations from the last column to the first keep L lower triangular. With the sums a(j)^2 = r^2 + f(j)^2 + ... of a
//! row f, the pivot column times a is a sum of columns (Carlson's form of the rotations), which needs no square root
//! per column. Prediction: Householder reflections from the right.

use super::settings::LANES;
use std::hint::black_box;

/// Readings to process: rows H, errors and standard deviations, (count) of them.
pub(super) struct Readings<'a> {
    /// H L by columns, then rotated; columns of length `stride`.
    pub rows: &'a mut [f64],
    pub stride: usize,
    pub count: usize,
    pub errors: &'a mut [f64],
    pub deviations: &'a [f64],
}

/// Scratch of a reading, one entry per column.
#[derive(Debug, Clone)]
pub(super) struct RotationScratch {
    /// A row f, the sums a^2, a and 1/a, and the factors of a column and of the pivot.
    f: Vec<f64>,
    squares: Vec<f64>,
    roots: Vec<f64>,
    inverses: Vec<f64>,
    kept: Vec<f64>,
    mixed: Vec<f64>,
}

impl RotationScratch {
    pub fn new(columns: usize) -> Self {
        let zeros = || vec![0.0; columns + 1];
        Self { f: zeros(), squares: zeros(), roots: zeros(), inverses: zeros(), kept: zeros(), mixed: zeros() }
    }
}

/// The sum of columns of a matrix times the entries of a vector, in the block of rows that begins at `block`.
#[inline(always)]
pub(super) fn combine(entries: &[f64], (columns, stride, block): (&[f64], usize, usize)) -> [f64; LANES] {
    // Independent sums, because each addition waits for the one before it.
    let mut sums = [[0.0; LANES]; 4];
    let mut many = entries.as_chunks::<4>().0.iter().zip(columns.chunks_exact(4 * stride));
    for (entries, columns) in many.by_ref() {
        for (m, sums) in sums.iter_mut().enumerate() {
            let column = &columns[m * stride + block..][..LANES];
            for (sum, x) in sums.iter_mut().zip(column) {
                *sum = entries[m].mul_add(*x, *sum);
            }
        }
    }
    let [mut sum, b, c, d] = sums;
    for i in 0..LANES {
        sum[i] = (sum[i] + b[i]) + (c[i] + d[i]);
    }
    let done = entries.len() / 4 * 4;
    for (entry, column) in entries[done..].iter().zip(columns[done * stride..].chunks_exact(stride)) {
        for (sum, x) in sum.iter_mut().zip(&column[block..block + LANES]) {
            *sum = entry.mul_add(*x, *sum);
        }
    }
    sum
}

/// H L into `rows`, for H by columns and a lower triangular L.
#[inline(always)]
pub(super) fn project(h: &[f64], stride: usize, (root, column, width): (&[f64], usize, usize), rows: &mut [f64]) {
    for (j, (row, own)) in rows.chunks_exact_mut(stride).zip(root.chunks_exact(column)).enumerate() {
        for (block, to) in row.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
            *to = combine(&own[j..width], (&h[j * stride..], stride, block * LANES));
        }
    }
}

/// Rotates all readings into the lower triangular root L, (width) columns of length `column`. Adds the correction of
/// the state to `change`; returns the normalized innovation squared, and replaces the errors by its terms.
#[inline(always)]
pub(super) fn measure(
    readings: &mut Readings<'_>,
    (root, column): (&mut [f64], usize),
    scratch: &mut RotationScratch,
    change: &mut [f64],
) -> f64 {
    let (stride, count) = (readings.stride, readings.count);
    let mut squares = 0.0;
    for i in 0..count {
        let mut last = 0;
        for (j, (f, row)) in scratch.f.iter_mut().zip(readings.rows.chunks_exact(stride)).enumerate() {
            *f = row[i];
            // A NaN counts.
            last = if *f == 0.0 { last } else { j + 1 };
        }
        let total = scratch.prepare(readings.deviations[i], last);
        let gain = readings.errors[i] / total;
        let square = readings.errors[i] * gain;
        squares += square;
        readings.errors[i] = square;
        let factors = (&scratch.f[..last], &scratch.kept[..last], &scratch.mixed[..last]);
        for block in ((i + 1) / LANES * LANES..count).step_by(LANES) {
            let pivot = rotate((readings.rows, stride, block), factors);
            for (k, (later, pivot)) in readings.errors[block..].iter_mut().zip(pivot).enumerate() {
                if block + k > i {
                    *later = (-gain).mul_add(pivot, *later);
                }
            }
        }
        for (block, change) in change.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
            // Columns further on are zero in these rows.
            let end = last.min((block + 1) * LANES);
            let factors = (&factors.0[..end], &factors.1[..end], &factors.2[..end]);
            let pivot = rotate((root, column, block * LANES), factors);
            for (change, pivot) in change.iter_mut().zip(pivot) {
                *change = gain.mul_add(pivot, *change);
            }
        }
    }
    squares
}

impl RotationScratch {
    /// The factors of the first `last` columns for the row f; returns r^2 + f* f.
    #[inline(always)]
    fn prepare(&mut self, deviation: f64, last: usize) -> f64 {
        let Self { f, squares, roots, inverses, kept, mixed } = self;
        let mut total = deviation * deviation;
        squares[last] = total;
        for j in (0..last).rev() {
            total = f[j].mul_add(f[j], total);
            squares[j] = total;
        }
        for ((square, root), inverse) in squares[..=last].iter().zip(&mut roots[..=last]).zip(&mut inverses[..=last]) {
            *root = square.sqrt();
            *inverse = 1.0 / *root;
        }
        let (before, after) = (&roots[1..=last], &inverses[..last]);
        for ((kept, before), after) in kept[..last].iter_mut().zip(before).zip(after) {
            *kept = before * after;
        }
        let before = &inverses[1..=last];
        for (((mixed, before), after), f) in mixed[..last].iter_mut().zip(before).zip(after).zip(&f[..last]) {
            *mixed = f * before * after;
        }
        total
    }
}

/// The rotations of some columns, from the last to the first, in the block of rows that begins at `block`: a column
/// becomes kept * column - mixed * pivot, and f * column is added to the pivot, which is returned.
#[inline(always)]
fn rotate(
    (columns, stride, block): (&mut [f64], usize, usize),
    (f, kept, mixed): (&[f64], &[f64], &[f64]),
) -> [f64; LANES] {
    let mut pivot = [0.0; LANES];
    let factors = f.iter().zip(kept).zip(mixed);
    for (column, ((f, kept), mixed)) in columns.chunks_exact_mut(stride).zip(factors).rev() {
        for (x, sum) in column[block..block + LANES].iter_mut().zip(&mut pivot) {
            let old = *x;
            *x = (-mixed).mul_add(*sum, kept * old);
            *sum = f.mul_add(old, *sum);
        }
    }
    pivot
}

/// Norms of rows below which they count as zero: their squares underflow.
const NOTHING: f64 = 1e-140;

/// Rotates a matrix from the right to a lower triangle, in its first `rows` columns.
///
/// Its first `width` columns are lower triangular in the first `rest` rows. Of the columns that follow, number t has
/// zeros above row `walks[t]`. Entries above the diagonal of the result are undefined. `axis` has an entry per column.
#[inline(always)]
pub(super) fn triangularize(
    matrix: &mut [f64],
    column: usize,
    (rows, rest, width): (usize, usize, usize),
    walks: &[usize],
    axis: &mut [f64],
) {
    for i in 0..rows {
        let (heads, tails) = matrix.split_at_mut((i + 1) * column);
        let pivot = &mut heads[i * column..];
        let skipped = if i < rest { width - i - 1 } else { 0 };
        let grown = if i < rest { walks.partition_point(|&row| row <= i) } else { walks.len() };
        let others = &mut tails[skipped * column..(width - i - 1 + grown) * column];
        let mut below = 0.0;
        let axis = &mut axis[..others.len() / column];
        for (entry, other) in axis.iter_mut().zip(others.chunks_exact(column)) {
            *entry = other[i];
            below = entry.mul_add(*entry, below);
        }
        if below == 0.0 {
            continue;
        }
        let norm = pivot[i].mul_add(pivot[i], below).sqrt();
        if norm < NOTHING {
            pivot[i] = 0.0;
            others.chunks_exact_mut(column).for_each(|other| other[i] = 0.0);
            continue;
        }
        let diagonal = -norm.copysign(pivot[i]);
        let lead = pivot[i] - diagonal;
        let factor = 1.0 / (norm * lead.abs());
        // Whole blocks: entries above the diagonal may change.
        for block in (i / LANES * LANES..column).step_by(LANES) {
            let mut along = [0.0; LANES];
            for (along, x) in along.iter_mut().zip(&pivot[block..block + LANES]) {
                *along = lead * x;
            }
            for (entry, other) in axis.iter().zip(others.chunks_exact(column)) {
                for (along, x) in along.iter_mut().zip(&other[block..block + LANES]) {
                    *along = entry.mul_add(*x, *along);
                }
            }
            for (along, x) in along.iter_mut().zip(&mut pivot[block..block + LANES]) {
                *along *= factor;
                *x = (-lead).mul_add(*along, *x);
            }
            for (entry, other) in axis.iter().zip(others.chunks_exact_mut(column)) {
                // Otherwise this loop is vectorized over columns, with gathers and scatters.
                let entry = black_box(*entry);
                for (along, x) in along.iter().zip(&mut other[block..block + LANES]) {
                    *x = (-entry).mul_add(*along, *x);
                }
            }
        }
        pivot[i] = diagonal;
    }
}
