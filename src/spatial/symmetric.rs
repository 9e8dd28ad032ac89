//! Packed symmetric matrices: 3x3 in six entries, 6x6 in 21.

use super::vector::{angular, column, from_rows, linear, row, spatial, sum3};
use crate::scalar::Real;
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

/// A symmetric 3x3 matrix, upper triangle by rows: xx, xy, xz, yy, yz, zz.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Symmetric3<T> {
    /// The entries xx, xy, xz, yy, yz, zz.
    pub entries: [T; 6],
}

impl<T: Real> Symmetric3<T> {
    /// The matrix with entries xx, xy, xz, yy, yz, zz.
    #[inline(always)]
    pub fn new(entries: [T; 6]) -> Self {
        Self { entries }
    }

    /// The zero matrix.
    #[inline(always)]
    #[must_use]
    pub fn zero() -> Self {
        Self { entries: [T::zero(); 6] }
    }

    /// The upper triangle of a full matrix; the lower one is not read.
    #[inline(always)]
    #[doc(hidden)]
    pub fn from_upper(m: &Matrix3<T>) -> Self {
        Self { entries: [m[(0, 0)], m[(0, 1)], m[(0, 2)], m[(1, 1)], m[(1, 2)], m[(2, 2)]] }
    }

    /// The full matrix.
    #[inline(always)]
    pub fn to_matrix(&self) -> Matrix3<T> {
        let [xx, xy, xz, yy, yz, zz] = self.entries;
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    }

    /// The product with a vector.
    #[inline(always)]
    pub fn mul_vector(&self, v: &Vector3<T>) -> Vector3<T> {
        let [xx, xy, xz, yy, yz, zz] = self.entries;
        let v = [v[0], v[1], v[2]];
        Vector3::new(sum3([xx, xy, xz], v), sum3([xy, yy, yz], v), sum3([xz, yz, zz], v))
    }

    /// `r * self * r^T`, 45 products.
    #[inline(always)]
    #[must_use]
    pub(crate) fn congruence(&self, r: &Matrix3<T>) -> Self {
        let (t0, t1, t2) = (self.times_row(row(r, 0)), self.times_row(row(r, 1)), self.times_row(row(r, 2)));
        let (r0, r1, r2) = (row(r, 0), row(r, 1), row(r, 2));
        Self { entries: [sum3(t0, r0), sum3(t0, r1), sum3(t0, r2), sum3(t1, r1), sum3(t1, r2), sum3(t2, r2)] }
    }

    /// t times the matrix, for a row t.
    #[inline(always)]
    fn times_row(&self, t: [T; 3]) -> [T; 3] {
        let [xx, xy, xz, yy, yz, zz] = self.entries;
        [sum3(t, [xx, xy, xz]), sum3(t, [xy, yy, yz]), sum3(t, [xz, yz, zz])]
    }

    /// Adds the upper triangle of a b^T.
    #[inline(always)]
    pub(crate) fn add_product(&self, a: [T; 3], b: [T; 3]) -> Self {
        let e = &self.entries;
        Self {
            entries: [
                a[0].mul_add(b[0], e[0]),
                a[0].mul_add(b[1], e[1]),
                a[0].mul_add(b[2], e[2]),
                a[1].mul_add(b[1], e[3]),
                a[1].mul_add(b[2], e[4]),
                a[2].mul_add(b[2], e[5]),
            ],
        }
    }

    /// The sum, entry by entry.
    #[inline(always)]
    #[must_use]
    pub fn add(&self, other: &Self) -> Self {
        let (a, b) = (&self.entries, &other.entries);
        Self { entries: [a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5]] }
    }
}

/// x b + c.
#[inline(always)]
fn row_add<T: Real>(x: T, b: [T; 3], c: [T; 3]) -> [T; 3] {
    [x.mul_add(b[0], c[0]), x.mul_add(b[1], c[1]), x.mul_add(b[2], c[2])]
}

/// A symmetric 6x6 matrix [[angular, coupling], [coupling^T, linear]] of spatial vectors: an inertia P or M, or a
/// co-state covariance Lambda.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Symmetric6<T: Real> {
    /// Upper left block (moment and angular motion).
    pub angular: Symmetric3<T>,
    /// Upper right block, rows angular, columns linear.
    pub coupling: Matrix3<T>,
    /// Lower right block (force and linear motion).
    pub linear: Symmetric3<T>,
}

impl<T: Real> Symmetric6<T> {
    /// The diagonal.
    #[inline(always)]
    #[must_use]
    pub fn diagonal(&self) -> Vector6<T> {
        let (a, b) = (&self.angular.entries, &self.linear.entries);
        Vector6::new(a[0], a[3], a[5], b[0], b[3], b[5])
    }

    /// The zero matrix.
    #[inline(always)]
    #[must_use]
    pub fn zero() -> Self {
        Self { angular: Symmetric3::zero(), coupling: Matrix3::from_element(T::zero()), linear: Symmetric3::zero() }
    }

    /// A matrix with `value` in every entry, for workspaces, which start as NaN.
    #[doc(hidden)]
    pub fn filled(value: T) -> Self {
        Self {
            angular: Symmetric3::new([value; 6]),
            coupling: Matrix3::from_element(value),
            linear: Symmetric3::new([value; 6]),
        }
    }

    /// The full matrix.
    pub fn to_matrix(&self) -> Matrix6<T> {
        let mut m = Matrix6::from_element(T::zero());
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.angular.to_matrix());
        m.fixed_view_mut::<3, 3>(0, 3).copy_from(&self.coupling);
        m.fixed_view_mut::<3, 3>(3, 0).copy_from(&self.coupling.transpose());
        m.fixed_view_mut::<3, 3>(3, 3).copy_from(&self.linear.to_matrix());
        m
    }

    /// The product with a spatial vector, 36 products.
    #[inline(always)]
    pub fn mul_vector(&self, x: &Vector6<T>) -> Vector6<T> {
        let (a, l) = (angular(x), linear(x));
        let c = &self.coupling;
        let top = self.angular.mul_vector(&a);
        let bottom = self.linear.mul_vector(&l);
        let (la, aa) = ([l[0], l[1], l[2]], [a[0], a[1], a[2]]);
        spatial(
            &Vector3::new(top[0] + sum3(row(c, 0), la), top[1] + sum3(row(c, 1), la), top[2] + sum3(row(c, 2), la)),
            &Vector3::new(
                bottom[0] + sum3(column(c, 0), aa),
                bottom[1] + sum3(column(c, 1), aa),
                bottom[2] + sum3(column(c, 2), aa),
            ),
        )
    }

    /// One column, equal to the row of the same index; indices 0 to 5, angular first.
    #[inline(always)]
    pub fn column(&self, index: usize) -> Vector6<T> {
        let a = &self.angular.entries;
        let c = &self.coupling;
        let l = &self.linear.entries;
        match index {
            0 => Vector6::new(a[0], a[1], a[2], c[(0, 0)], c[(0, 1)], c[(0, 2)]),
            1 => Vector6::new(a[1], a[3], a[4], c[(1, 0)], c[(1, 1)], c[(1, 2)]),
            2 => Vector6::new(a[2], a[4], a[5], c[(2, 0)], c[(2, 1)], c[(2, 2)]),
            3 => Vector6::new(c[(0, 0)], c[(1, 0)], c[(2, 0)], l[0], l[1], l[2]),
            4 => Vector6::new(c[(0, 1)], c[(1, 1)], c[(2, 1)], l[1], l[3], l[4]),
            _ => Vector6::new(c[(0, 2)], c[(1, 2)], c[(2, 2)], l[2], l[4], l[5]),
        }
    }

    /// The sum, entry by entry.
    #[inline(always)]
    #[must_use]
    pub fn add(&self, other: &Self) -> Self {
        let (c, d) = (&self.coupling, &other.coupling);
        Self {
            angular: self.angular.add(&other.angular),
            coupling: Matrix3::new(
                c[(0, 0)] + d[(0, 0)],
                c[(0, 1)] + d[(0, 1)],
                c[(0, 2)] + d[(0, 2)],
                c[(1, 0)] + d[(1, 0)],
                c[(1, 1)] + d[(1, 1)],
                c[(1, 2)] + d[(1, 2)],
                c[(2, 0)] + d[(2, 0)],
                c[(2, 1)] + d[(2, 1)],
                c[(2, 2)] + d[(2, 2)],
            ),
            linear: self.linear.add(&other.linear),
        }
    }

    /// The matrix times a scalar.
    #[inline(always)]
    #[must_use]
    pub fn scaled(&self, factor: T) -> Self {
        Self {
            angular: Symmetric3::new(self.angular.entries.map(|x| x * factor)),
            coupling: self.coupling * factor,
            linear: Symmetric3::new(self.linear.entries.map(|x| x * factor)),
        }
    }

    /// Adds `a b^T` for parallel `a` and `b`, whose product is symmetric; only the upper triangle is formed.
    #[inline(always)]
    #[must_use]
    pub(crate) fn add_rank_one(&self, a: &Vector6<T>, b: &Vector6<T>) -> Self {
        let c = &self.coupling;
        let (ha, hb) = ([a[0], a[1], a[2]], [b[0], b[1], b[2]]);
        let (la, lb) = ([a[3], a[4], a[5]], [b[3], b[4], b[5]]);
        Self {
            angular: self.angular.add_product(ha, hb),
            coupling: from_rows(
                row_add(a[0], lb, row(c, 0)),
                row_add(a[1], lb, row(c, 1)),
                row_add(a[2], lb, row(c, 2)),
            ),
            linear: self.linear.add_product(la, lb),
        }
    }

    /// Sets one row and column to exact zeros.
    #[inline(always)]
    #[doc(hidden)]
    pub fn clear(&mut self, index: usize) {
        let o = self.linear.entries[0].constant(0.0);
        self.write_column(index, &Vector6::new(o, o, o, o, o, o));
    }

    /// Sets one row and column.
    #[inline(always)]
    pub(crate) fn write_column(&mut self, index: usize, column: &Vector6<T>) {
        const PACKED: [[usize; 3]; 3] = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];
        for (j, packed) in PACKED[index % 3].into_iter().enumerate() {
            if index < 3 {
                self.angular.entries[packed] = column[j];
                self.coupling[(index, j)] = column[j + 3];
            } else {
                self.linear.entries[packed] = column[j + 3];
                self.coupling[(j, index - 3)] = column[j];
            }
        }
    }
}
