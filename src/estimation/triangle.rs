//! The information form of linear least squares: the triangle R of a QR factorization of the rows read so far. R* R is
//! the information matrix, which is never formed.

use crate::batch::instruction_set::within_widest;

/// Rows that are rotated into a triangle at once: a column of them stays in the first cache. Not a power of two, for
/// which the entries of a row would be in few sets of the cache.
const BLOCK: usize = 104;
/// Columns that a reflection is applied to at once, and partial sums of a product.
const COLUMNS: usize = 4;
const LANES: usize = 8;
/// The square of a column that counts as zero.
const NOTHING: f64 = 1e-280;

/// Rotates `rows` (m x width, row by row) into the upper triangle of `triangle` (width x width, row by row): triangle*
/// triangle grows by rows* rows, by Householder's reflections.
///
/// The result has the same bits on all processors.
///
/// # Panics
///
/// Where the lengths are not those of whole rows and of a square.
pub fn rotate_in(triangle: &mut [f64], rows: &[f64], width: usize) {
    assert!(triangle.len() == width * width && rows.len().is_multiple_of(width.max(1)), "triangle: (width, width)");
    if width > 0 {
        rotate(triangle, (width, rows.len() / width), |i| rows[i * width..(i + 1) * width].iter().copied());
    }
}

/// The same for rows whose first entries are chosen ones of wider rows, and whose last are given: row i is
/// `wide[i][chosen]`, then `last[i]`.
///
/// # Panics
///
/// Where the lengths are not those of as many rows each and of a square, or a chosen entry is none of a row.
pub fn rotate_chosen(
    triangle: &mut [f64],
    (wide, stride): (&[f64], usize),
    chosen: &[usize],
    (last, lasts): (&[f64], usize),
) {
    let (width, height) = (chosen.len() + lasts, last.len() / lasts.max(1));
    assert!(triangle.len() == width * width && wide.len() == height * stride, "triangle: (width, width)");
    if width > 0 {
        rotate(triangle, (width, height), |i| {
            let (row, given) = (&wide[i * stride..(i + 1) * stride], &last[i * lasts..(i + 1) * lasts]);
            chosen.iter().map(|&at| row[at]).chain(given.iter().copied())
        });
    }
}

/// Rotates rows in blocks that are stored column by column.
fn rotate<R: Iterator<Item = f64>>(triangle: &mut [f64], (width, height): (usize, usize), row: impl Fn(usize) -> R) {
    let mut columns = vec![0.0; BLOCK * width];
    for first in (0..height).step_by(BLOCK) {
        let block = (height - first).min(BLOCK);
        // Padded with zeros to whole lanes.
        let padded = block.next_multiple_of(LANES);
        columns.fill(0.0);
        for i in 0..block {
            for (j, entry) in row(first + i).enumerate() {
                columns[j * padded + i] = entry;
            }
        }
        let columns = &mut columns[..padded * width];
        reflections(triangle, columns, (width, padded));
    }
}

within_widest! {
    /// The reflections of one block.
    fn reflections<'a>(triangle: &'a mut [f64], columns: &'a mut [f64], size: (usize, usize)) {
        reflect(triangle, columns, size);
    }
}

#[inline(always)]
fn reflect(triangle: &mut [f64], columns: &mut [f64], (width, height): (usize, usize)) {
    for j in 0..width {
        let (before, rest) = columns.split_at_mut((j + 1) * height);
        let axis = &before[j * height..];
        let below = dot(axis, axis);
        // Not zeros alone: the inverse of smaller squares overflows. What stays below the diagonal is read no more.
        if below < NOTHING {
            continue;
        }
        let row = &mut triangle[j * width..(j + 1) * width];
        let diagonal = row[j];
        let norm = diagonal.mul_add(diagonal, below).sqrt();
        let lead = diagonal + norm.copysign(diagonal);
        let factor = 2.0 / (lead * lead + below);
        row[j] = -norm.copysign(diagonal);
        let mut others = row[j + 1..].chunks_exact_mut(COLUMNS);
        let mut parts = rest.chunks_exact_mut(COLUMNS * height);
        for (heads, part) in others.by_ref().zip(parts.by_ref()) {
            let (a, b) = part.split_at_mut(2 * height);
            let ((a0, a1), (b0, b1)) = (a.split_at_mut(height), b.split_at_mut(height));
            let sums = dots(axis, [a0, a1, b0, b1]);
            let along: [f64; COLUMNS] = std::array::from_fn(|c| factor * (lead * heads[c] + sums[c]));
            for (head, along) in heads.iter_mut().zip(along) {
                *head -= along * lead;
            }
            subtract(axis, along, [a0, a1, b0, b1]);
        }
        for (head, column) in others.into_remainder().iter_mut().zip(parts.into_remainder().chunks_exact_mut(height)) {
            let along = factor * (lead * *head + dot(axis, column));
            *head -= along * lead;
            for (entry, of_axis) in column.iter_mut().zip(axis) {
                *entry -= along * of_axis;
            }
        }
    }
}

#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    for (a, b) in a.as_chunks::<LANES>().0.iter().zip(b.as_chunks::<LANES>().0) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    sums.iter().sum()
}

#[inline(always)]
fn dots(axis: &[f64], columns: [&mut [f64]; COLUMNS]) -> [f64; COLUMNS] {
    let mut sums = [[0.0; LANES]; COLUMNS];
    let parts = columns.map(|column| &*column.as_chunks_mut::<LANES>().0);
    for (i, a) in axis.as_chunks::<LANES>().0.iter().enumerate() {
        for (sums, part) in sums.iter_mut().zip(parts) {
            for ((sum, a), b) in sums.iter_mut().zip(a).zip(&part[i]) {
                *sum += a * b;
            }
        }
    }
    sums.map(|sums| sums.iter().sum())
}

#[inline(always)]
fn subtract(axis: &[f64], along: [f64; COLUMNS], columns: [&mut [f64]; COLUMNS]) {
    let mut parts = columns.map(|column| column.as_chunks_mut::<LANES>().0);
    for (i, a) in axis.as_chunks::<LANES>().0.iter().enumerate() {
        for (part, along) in parts.iter_mut().zip(along) {
            for (entry, a) in part[i].iter_mut().zip(a) {
                *entry -= along * a;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{rotate_chosen, rotate_in};

    /// Columns that depend on others leave rounding, and rounding of rounding, whose squares are below all numbers.
    #[test]
    fn dependent_columns_leave_finite_numbers() {
        let entry = |i: u32, j: u32| f64::from(i * (j % 3 + 1)).sin() * if j > 8 { 1e-170 } else { 1.0 };
        let rows: Vec<f64> = (0..480).map(|at| entry(at / 12, at % 12)).collect();
        let mut triangle = vec![0.0; 144];
        for _ in 0..30 {
            rotate_in(&mut triangle, &rows, 12);
        }
        assert!(triangle.iter().all(|entry| entry.is_finite()));
    }

    fn lasts(rows: &[f64], width: usize) -> Vec<f64> {
        rows.chunks_exact(width).map(|row| row[width - 1]).collect()
    }

    /// R* R is the sum of the rows' outer products.
    #[test]
    fn the_information_is_that_of_all_rows() {
        for (width, height) in [(1, 3), (5, 2), (6, 300), (13, 131)] {
            let entries = (0..4000).map(|i| (f64::from(i) * f64::from(i) * 0.7).sin() + 0.1);
            let rows: Vec<f64> = entries.take(width * height).collect();
            let mut triangle = vec![0.0; width * width];
            let mut same = triangle.clone();
            rotate_chosen(&mut same, (&rows, width), &(0..width - 1).collect::<Vec<_>>(), (&lasts(&rows, width), 1));
            let (some, others) = rows.split_at(width * (height / 3));
            rotate_in(&mut triangle, some, width);
            rotate_in(&mut triangle, others, width);
            assert!(same.iter().zip(&triangle).all(|(a, b)| (a.abs() - b.abs()).abs() <= 1e-10));
            for i in 0..width {
                assert!(triangle[i * width..i * width + i].iter().all(|&below| below == 0.0));
                for j in 0..width {
                    let sum = |m: &[f64]| m.chunks_exact(width).map(|row| row[i] * row[j]).sum::<f64>();
                    let (found, expected) = (sum(&triangle), sum(&rows));
                    assert!((found - expected).abs() <= 1e-10, "{found} {expected}");
                }
            }
        }
    }
}
