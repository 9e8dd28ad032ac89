//! Products and triangles of small dense matrices, row by row.
//!
//! The order of all sums is fixed, and products are fused where the crate has lanes: results have the same bits on all
//! processors.

use crate::batch::instruction_set::within_widest;

/// a b + c.
#[inline(always)]
pub fn fused(a: f64, b: f64, c: f64) -> f64 {
    if cfg!(feature = "lanes") { a.mul_add(b, c) } else { a * b + c }
}

/// Partial sums of a product.
const SUMS: usize = 8;

/// The product of two vectors, in [`SUMS`] partial sums. No closure: it would be compiled for the baseline.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let length = a.len().min(b.len());
    let whole = length - length % SUMS;
    let mut sums = [0.0; SUMS];
    let mut at = 0;
    while at < whole {
        let (a, b) = (&a[at..at + SUMS], &b[at..at + SUMS]);
        for i in 0..SUMS {
            sums[i] = fused(a[i], b[i], sums[i]);
        }
        at += SUMS;
    }
    for i in whole..length {
        sums[i - whole] = fused(a[i], b[i], sums[i - whole]);
    }
    ((sums[0] + sums[4]) + (sums[1] + sums[5])) + ((sums[2] + sums[6]) + (sums[3] + sums[7]))
}

/// A matrix that is read: its entry (i, k) is `numbers[i * row + k * column]`.
#[derive(Clone, Copy)]
pub struct Read<'a> {
    pub numbers: &'a [f64],
    pub row: usize,
    pub column: usize,
}

impl<'a> Read<'a> {
    /// A matrix with `width` columns.
    #[inline(always)]
    pub fn rows(numbers: &'a [f64], width: usize) -> Self {
        Self { numbers, row: width, column: 1 }
    }

    /// The transpose of a matrix with `width` columns.
    #[inline(always)]
    pub fn transposed(numbers: &'a [f64], width: usize) -> Self {
        Self { numbers, row: 1, column: width }
    }

    #[inline(always)]
    fn at(&self, i: usize, k: usize) -> f64 {
        self.numbers[i * self.row + k * self.column]
    }
}

within_widest! {
    /// Adds `sign` A B to C: `size` rows, inner length and columns; B and C begin at their first entries and have
    /// `widths` columns. With `upper`, entries of C left of the diagonal are not complete.
    pub fn add_product<'a>(
        c: &'a mut [f64],
        factors: (Read<'a>, &'a [f64]),
        size: (usize, usize, usize),
        widths: (usize, usize),
        kind: (f64, bool),
    ) {
        let (rows, inner, columns) = size;
        let mut i = 0;
        while i < rows {
            let at = (i, if kind.1 { (i & !3).min(columns) } else { 0 }, inner);
            i += match rows - i {
                4.. => add_strip::<4>(c, factors, (at, columns), widths, kind.0),
                3 => add_strip::<3>(c, factors, (at, columns), widths, kind.0),
                2 => add_strip::<2>(c, factors, (at, columns), widths, kind.0),
                _ => add_strip::<1>(c, factors, (at, columns), widths, kind.0),
            };
        }
    }
}

/// Adds R rows of a product from column j on; returns R.
#[inline(always)]
fn add_strip<const R: usize>(
    c: &mut [f64],
    factors: (Read<'_>, &[f64]),
    ((i, mut j, inner), columns): ((usize, usize, usize), usize),
    widths: (usize, usize),
    sign: f64,
) -> usize {
    while j < columns {
        let at = (i, j, inner);
        j += match columns - j {
            8.. => add_tile::<R, 8>(c, factors, at, widths, sign),
            4.. => add_tile::<R, 4>(c, factors, at, widths, sign),
            2.. => add_tile::<R, 2>(c, factors, at, widths, sign),
            _ => add_tile::<R, 1>(c, factors, at, widths, sign),
        };
    }
    R
}

/// Adds a tile of R rows and W columns of a product, whose sums stay in registers; returns W.
#[inline(always)]
fn add_tile<const R: usize, const W: usize>(
    c: &mut [f64],
    (a, b): (Read<'_>, &[f64]),
    (i, j, inner): (usize, usize, usize),
    (width_b, width_c): (usize, usize),
    sign: f64,
) -> usize {
    let mut sums = [[0.0; W]; R];
    for k in 0..inner {
        let Some(row) = b[k * width_b + j..].first_chunk::<W>() else { return W };
        for (r, sums) in sums.iter_mut().enumerate() {
            let x = a.at(i + r, k);
            for (sum, b) in sums.iter_mut().zip(row) {
                *sum = fused(x, *b, *sum);
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        for (c, sum) in c[(i + r) * width_c + j..][..W].iter_mut().zip(sums) {
            *c = fused(sign, *sum, *c);
        }
    }
    W
}

/// Adds `sign` A x to `y`.
#[inline(always)]
pub fn add_times(y: &mut [f64], a: Read<'_>, x: &[f64], sign: f64) {
    if a.column == 1 {
        for (i, y) in y.iter_mut().enumerate() {
            *y += sign * dot(&a.numbers[i * a.row..][..x.len()], x);
        }
        return;
    }
    for k in 0..x.len() {
        let x = sign * x[k];
        let from = &a.numbers[k * a.column..];
        for (y, a) in y.iter_mut().zip(from) {
            *y = fused(*a, x, *y);
        }
    }
}

/// Copies the entries above the diagonal below it.
#[inline(always)]
pub fn mirror(a: &mut [f64], n: usize) {
    for i in 0..n {
        for j in 0..i {
            a[i * n + j] = a[j * n + i];
        }
    }
}

/// L^-1 B in place, with the factor L (n x n), whose rows have a given width, and B (n x columns).
#[inline(always)]
pub fn solve_lower((l, width): (&[f64], usize), n: usize, b: &mut [f64], columns: usize) {
    for i in 0..n {
        let (above, from) = b.split_at_mut(i * columns);
        add_product(
            &mut *from,
            (Read::rows(&l[i * width..], width), above),
            (1, i, columns),
            (columns, columns),
            (-1.0, false),
        );
        let share = 1.0 / l[i * width + i];
        from[..columns].iter_mut().for_each(|b| *b *= share);
    }
}

/// L^-T B in place.
#[inline(always)]
pub fn solve_upper((l, width): (&[f64], usize), n: usize, b: &mut [f64], columns: usize) {
    for i in (0..n).rev() {
        let (to, below) = b.split_at_mut((i + 1) * columns);
        let to = &mut to[i * columns..];
        let column = Read { numbers: &l[((i + 1) * width + i).min(l.len())..], row: 0, column: width };
        add_product(to, (column, below), (1, n - 1 - i, columns), (columns, columns), (-1.0, false));
        let share = 1.0 / l[i * width + i];
        for b in to.iter_mut() {
            *b *= share;
        }
    }
}
