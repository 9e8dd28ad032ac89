//! The rotations of the array form, on matrices that are stored column by column with padded columns.
//!
//! Readings: [[r, H L], [0, L]] is rotated from the right to [[S, 0], [K', L']], one reading after another. Givens
//! rotations from the last column to the first keep L lower triangular. With the sums a(j)^2 = r^2 + f(j)^2 + ... of a
//! row f, the pivot column times a is a sum of columns (Carlson's form of the rotations), which needs no square root per
//! column. Prediction: Householder reflections from the right.

use super::settings::LANES;

/// Readings to process: rows H, errors and standard deviations, (count) of them.
pub(super) struct Readings<'a> {
    /// H L by columns, then rotated; columns of length `stride`.
    pub rows: &'a mut [f64],
    pub stride: usize,
    pub count: usize,
    pub errors: &'a mut [f64],
    pub deviations: &'a [f64],
}

/// Scratch of one column per entry.
#[derive(Debug, Clone)]
pub(super) struct RotationScratch {
    factors: [Vec<f64>; 4],
    pivot: Vec<f64>,
    pivot_rows: Vec<f64>,
}

impl RotationScratch {
    pub fn new(columns: usize, column: usize, readings: usize) -> Self {
        let factors = std::array::from_fn(|_| vec![0.0; columns.next_multiple_of(LANES)]);
        Self { factors, pivot: vec![0.0; column], pivot_rows: vec![0.0; readings] }
    }
}

/// H L into `rows`, for H by columns and a lower triangular L.
#[inline(always)]
pub(super) fn project(h: &[f64], stride: usize, (root, column, width): (&[f64], usize, usize), rows: &mut [f64]) {
    for (j, (row, own)) in rows.chunks_exact_mut(stride).zip(root.chunks_exact(column)).enumerate() {
        for (block, to) in row.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
            let mut sums = [0.0; LANES];
            for (i, &entry) in own[j..width].iter().enumerate() {
                let from = &h[(j + i) * stride + block * LANES..][..LANES];
                for (sum, &x) in sums.iter_mut().zip(from) {
                    *sum = entry.mul_add(x, *sum);
                }
            }
            *to = sums;
        }
    }
}

/// Rotates all readings into the lower triangular root L, (width) columns of length `column`. Adds the correction of
/// the state to `change`; returns the normalized innovation squared.
#[inline(always)]
pub(super) fn measure(
    readings: &mut Readings<'_>,
    (root, column): (&mut [f64], usize),
    scratch: &mut RotationScratch,
    change: &mut [f64],
) -> f64 {
    let (stride, count) = (readings.stride, readings.count);
    let padded = count.next_multiple_of(LANES);
    let RotationScratch { factors: [f, inner, outer, mixed], pivot, pivot_rows } = scratch;
    let mut squares = 0.0;
    for i in 0..count {
        let mut last = 0;
        for (j, (f, row)) in f.iter_mut().zip(readings.rows.chunks_exact(stride)).enumerate() {
            *f = row[i];
            // A NaN counts.
            last = if *f == 0.0 { last } else { j + 1 };
        }
        let deviation = readings.deviations[i];
        let mut total = deviation * deviation;
        for j in (0..last).rev() {
            inner[j] = total;
            total = f[j].mul_add(f[j], total);
            outer[j] = total;
        }
        for ((f, inner), (outer, mixed)) in
            f[..last].iter().zip(&mut inner[..last]).zip(outer[..last].iter().zip(&mut mixed[..last]))
        {
            let (before, after) = (inner.sqrt(), outer.sqrt());
            *mixed = f / (before * after);
            *inner = before / after;
        }
        pivot.fill(0.0);
        pivot_rows.fill(0.0);
        let first_row = (i + 1) / LANES * LANES;
        for j in (0..last).rev() {
            let factors = (inner[j], mixed[j], f[j]);
            let own = &mut readings.rows[j * stride + first_row..j * stride + padded.max(first_row)];
            rotate(own, &mut pivot_rows[first_row..], factors);
            let first = j / LANES * LANES;
            rotate(&mut root[j * column + first..(j + 1) * column], &mut pivot[first..], factors);
        }
        let error = readings.errors[i];
        let gain = error / total;
        squares = error.mul_add(gain, squares);
        for (later, pivot) in readings.errors[..count].iter_mut().zip(&*pivot_rows).skip(i + 1) {
            *later = (-gain).mul_add(*pivot, *later);
        }
        for (change, pivot) in change.iter_mut().zip(&*pivot) {
            *change = gain.mul_add(*pivot, *change);
        }
    }
    squares
}

/// One rotation: the column becomes kept * column - mixed * pivot, and f * column is added to the pivot.
#[inline(always)]
fn rotate(column: &mut [f64], pivot: &mut [f64], (kept, mixed, f): (f64, f64, f64)) {
    for (column, pivot) in column.as_chunks_mut::<LANES>().0.iter_mut().zip(pivot.as_chunks_mut::<LANES>().0) {
        for (x, p) in column.iter_mut().zip(pivot) {
            let (old, sum) = (*x, *p);
            *x = (-mixed).mul_add(sum, kept * old);
            *p = f.mul_add(old, sum);
        }
    }
}

/// Norms of rows below which they count as zero: their squares underflow.
const NOTHING: f64 = 1e-140;

/// Rotates a matrix from the right to a lower triangle, in its first `rows` columns.
///
/// Its first `width` columns are lower triangular in the first `rest` rows. Of the columns that follow, number t has
/// zeros above row `walks[t]`. Entries above the diagonal of the result are undefined.
#[inline(always)]
pub(super) fn triangularize(
    matrix: &mut [f64],
    column: usize,
    (rows, rest, width): (usize, usize, usize),
    walks: &[usize],
    along: &mut [f64],
) {
    for i in 0..rows {
        let (heads, tails) = matrix.split_at_mut((i + 1) * column);
        let pivot = &mut heads[i * column..];
        let skipped = if i < rest { width - i - 1 } else { 0 };
        let grown = if i < rest { walks.partition_point(|&row| row <= i) } else { walks.len() };
        let others = &mut tails[skipped * column..(width - i - 1 + grown) * column];
        let below: f64 = others.chunks_exact(column).map(|other| other[i] * other[i]).sum();
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
        let first = i / LANES * LANES;
        let along = &mut along[first..column];
        for (sum, x) in along.iter_mut().zip(&pivot[first..]) {
            *sum = lead * x;
        }
        for other in others.chunks_exact(column) {
            add(along, other[i], &other[first..]);
        }
        for sum in along.iter_mut() {
            *sum *= factor;
        }
        add(&mut pivot[first..], -lead, along);
        pivot[i] = diagonal;
        for other in others.chunks_exact_mut(column) {
            let entry = -other[i];
            add(&mut other[first..], entry, along);
        }
    }
}

/// sum += factor * x.
#[inline(always)]
fn add(sum: &mut [f64], factor: f64, x: &[f64]) {
    for (sum, x) in sum.as_chunks_mut::<LANES>().0.iter_mut().zip(x.as_chunks::<LANES>().0) {
        for (sum, x) in sum.iter_mut().zip(x) {
            *sum = factor.mul_add(*x, *sum);
        }
    }
}
