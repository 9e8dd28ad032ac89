//! Packed symmetric matrices: 3x3 in six numbers, 6x6 in 21.

use super::vector::{angular, linear, spatial};
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
        Vector3::new(
            xx * v[0] + xy * v[1] + xz * v[2],
            xy * v[0] + yy * v[1] + yz * v[2],
            xz * v[0] + yz * v[1] + zz * v[2],
        )
    }

    /// `r * self * r^T`, 45 products.
    #[inline(always)]
    #[must_use]
    pub fn congruence(&self, r: &Matrix3<T>) -> Self {
        let [xx, xy, xz, yy, yz, zz] = self.entries;
        let row = |i: usize| {
            let (a, b, c) = (r[(i, 0)], r[(i, 1)], r[(i, 2)]);
            [a * xx + b * xy + c * xz, a * xy + b * yy + c * yz, a * xz + b * yz + c * zz]
        };
        let (t0, t1, t2) = (row(0), row(1), row(2));
        let entry = |t: &[T; 3], j: usize| t[0] * r[(j, 0)] + t[1] * r[(j, 1)] + t[2] * r[(j, 2)];
        Self { entries: [entry(&t0, 0), entry(&t0, 1), entry(&t0, 2), entry(&t1, 1), entry(&t1, 2), entry(&t2, 2)] }
    }

    /// The sum, entry by entry.
    #[inline(always)]
    #[must_use]
    pub fn add(&self, other: &Self) -> Self {
        let (a, b) = (&self.entries, &other.entries);
        Self { entries: [a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5]] }
    }
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
    /// The zero matrix.
    #[inline(always)]
    #[must_use]
    pub fn zero() -> Self {
        Self { angular: Symmetric3::zero(), coupling: Matrix3::from_element(T::zero()), linear: Symmetric3::zero() }
    }

    /// A matrix with `value` in every entry; workspaces start as NaN.
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
        let row = |i: usize| c[(i, 0)] * l[0] + c[(i, 1)] * l[1] + c[(i, 2)] * l[2];
        let column = |j: usize| c[(0, j)] * a[0] + c[(1, j)] * a[1] + c[(2, j)] * a[2];
        spatial(
            &Vector3::new(top[0] + row(0), top[1] + row(1), top[2] + row(2)),
            &Vector3::new(bottom[0] + column(0), bottom[1] + column(1), bottom[2] + column(2)),
        )
    }

    /// One column (the same as that row); the index is 0 to 5, angular first.
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

    /// The matrix times a number.
    #[inline(always)]
    #[must_use]
    pub fn scaled(&self, factor: T) -> Self {
        Self {
            angular: Symmetric3::new(self.angular.entries.map(|x| x * factor)),
            coupling: self.coupling * factor,
            linear: Symmetric3::new(self.linear.entries.map(|x| x * factor)),
        }
    }

    /// Adds `a b^T`, of which only the upper triangle is formed; `a` and `b` are parallel, so the result is symmetric.
    #[inline(always)]
    #[must_use]
    pub fn add_rank_one(&self, a: &Vector6<T>, b: &Vector6<T>) -> Self {
        let p = &self.angular.entries;
        let c = &self.coupling;
        let l = &self.linear.entries;
        Self {
            angular: Symmetric3::new([
                p[0] + a[0] * b[0],
                p[1] + a[0] * b[1],
                p[2] + a[0] * b[2],
                p[3] + a[1] * b[1],
                p[4] + a[1] * b[2],
                p[5] + a[2] * b[2],
            ]),
            coupling: Matrix3::new(
                c[(0, 0)] + a[0] * b[3],
                c[(0, 1)] + a[0] * b[4],
                c[(0, 2)] + a[0] * b[5],
                c[(1, 0)] + a[1] * b[3],
                c[(1, 1)] + a[1] * b[4],
                c[(1, 2)] + a[1] * b[5],
                c[(2, 0)] + a[2] * b[3],
                c[(2, 1)] + a[2] * b[4],
                c[(2, 2)] + a[2] * b[5],
            ),
            linear: Symmetric3::new([
                l[0] + a[3] * b[3],
                l[1] + a[3] * b[4],
                l[2] + a[3] * b[5],
                l[3] + a[4] * b[4],
                l[4] + a[4] * b[5],
                l[5] + a[5] * b[5],
            ]),
        }
    }

    /// Sets one row and column to exact zeros.
    #[inline(always)]
    pub fn clear(&mut self, index: usize) {
        self.write_column(index, &Vector6::from_element(T::zero()));
    }

    /// Sets one row and column.
    #[inline(always)]
    pub fn write_column(&mut self, index: usize, column: &Vector6<T>) {
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
