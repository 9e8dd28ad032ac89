//! The rigid shift phi: the transition matrix that carries spatial forces from a child's frame to its parent's.

use super::symmetric::{Symmetric3, Symmetric6};
use super::vector::{angular, cross, linear, skew, spatial};
use crate::scalar::Real;
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

/// phi(k,k-1) of the paper's introduction, in body frames: [[R, lever~ R], [0, R]].
///
/// `rotation` R takes child coordinates to parent coordinates; `lever` L is the vector from the parent's origin to the
/// child's, in m, in the parent's frame. Forces go inward with phi, motions outward with its transpose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigidShift<T> {
    /// Child coordinates to parent coordinates.
    pub rotation: Matrix3<T>,
    /// From the parent's origin to the child's, in the parent's frame, m.
    pub lever: Vector3<T>,
}

impl<T: Real> RigidShift<T> {
    /// The shift that changes nothing.
    #[must_use]
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), lever: Vector3::from_element(T::zero()) }
    }

    /// A shift with `value` in every entry; workspaces start as NaN.
    pub fn filled(value: T) -> Self {
        Self { rotation: Matrix3::from_element(value), lever: Vector3::from_element(value) }
    }

    /// phi as a 6x6 matrix.
    pub fn to_matrix(&self) -> Matrix6<T> {
        let mut m = Matrix6::from_element(T::zero());
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.rotation);
        m.fixed_view_mut::<3, 3>(3, 3).copy_from(&self.rotation);
        m.fixed_view_mut::<3, 3>(0, 3).copy_from(&(skew(&self.lever) * self.rotation));
        m
    }

    /// The shift through both: first `inner` (grandchild to child), then `self` (child to parent).
    #[inline]
    #[must_use]
    pub fn compose(&self, inner: &Self) -> Self {
        Self { rotation: self.rotation * inner.rotation, lever: self.rotate(&inner.lever) + self.lever }
    }

    /// The shift the other way, from the parent's frame to the child's. The rotation is transposed, not inverted.
    #[inline]
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self { rotation: self.rotation.transpose(), lever: -self.rotate_back(&self.lever) }
    }

    /// A free vector, child to parent coordinates.
    #[inline(always)]
    pub fn rotate(&self, v: &Vector3<T>) -> Vector3<T> {
        let r = &self.rotation;
        Vector3::new(
            r[(0, 0)] * v[0] + r[(0, 1)] * v[1] + r[(0, 2)] * v[2],
            r[(1, 0)] * v[0] + r[(1, 1)] * v[1] + r[(1, 2)] * v[2],
            r[(2, 0)] * v[0] + r[(2, 1)] * v[1] + r[(2, 2)] * v[2],
        )
    }

    /// A free vector, parent to child coordinates.
    #[inline(always)]
    pub fn rotate_back(&self, v: &Vector3<T>) -> Vector3<T> {
        let r = &self.rotation;
        Vector3::new(
            r[(0, 0)] * v[0] + r[(1, 0)] * v[1] + r[(2, 0)] * v[2],
            r[(0, 1)] * v[0] + r[(1, 1)] * v[1] + r[(2, 1)] * v[2],
            r[(0, 2)] * v[0] + r[(1, 2)] * v[1] + r[(2, 2)] * v[2],
        )
    }

    /// phi f: a force, child to parent. 24 products.
    #[inline(always)]
    pub fn force_to_parent(&self, f: &Vector6<T>) -> Vector6<T> {
        let force = self.rotate(&linear(f));
        let moment = self.rotate(&angular(f)) + cross(&self.lever, &force);
        spatial(&moment, &force)
    }

    /// phi^T v: a motion, parent to child. 24 products.
    #[inline(always)]
    pub fn motion_to_child(&self, v: &Vector6<T>) -> Vector6<T> {
        let w = angular(v);
        let at_child = linear(v) + cross(&w, &self.lever);
        spatial(&self.rotate_back(&w), &self.rotate_back(&at_child))
    }

    /// phi P phi^T: an inertia (covariance of a force), child to parent. About 190 products.
    #[inline(always)]
    pub fn inertia_to_parent(&self, p: &Symmetric6<T>) -> Symmetric6<T> {
        let a = p.angular.congruence(&self.rotation);
        let c = rotate_block(&self.rotation, &p.coupling);
        self.lever_terms(&a, &c, p.linear.congruence(&self.rotation))
    }

    /// phi P phi^T where row and column 2 of P are zero, as after a noise-free measurement of a rotation about z.
    ///
    /// The zeros are not read: 30 products less than [`RigidShift::inertia_to_parent`].
    #[inline(always)]
    pub fn inertia_to_parent_past_z(&self, p: &Symmetric6<T>) -> Symmetric6<T> {
        let r = &self.rotation;
        let [xx, xy, _, yy, ..] = p.angular.entries;
        let c = &p.coupling;
        // Rows of R A and R C, from the first two columns of R.
        let turned_a = |i: usize| [r[(i, 0)] * xx + r[(i, 1)] * xy, r[(i, 0)] * xy + r[(i, 1)] * yy];
        let turned_c = |i: usize| {
            let (x, y) = (r[(i, 0)], r[(i, 1)]);
            [x * c[(0, 0)] + y * c[(1, 0)], x * c[(0, 1)] + y * c[(1, 1)], x * c[(0, 2)] + y * c[(1, 2)]]
        };
        let (a0, a1, a2) = (turned_a(0), turned_a(1), turned_a(2));
        let entry = |t: &[T; 2], j: usize| t[0] * r[(j, 0)] + t[1] * r[(j, 1)];
        let a =
            Symmetric3::new([entry(&a0, 0), entry(&a0, 1), entry(&a0, 2), entry(&a1, 1), entry(&a1, 2), entry(&a2, 2)]);
        let c = times_transpose(&[turned_c(0), turned_c(1), turned_c(2)], r);
        self.lever_terms(&a, &c, p.linear.congruence(r))
    }

    /// [[A, C], [C^T, B]], already turned, moved by the lever: C' = C + l~ B; A' = A + l~ C^T + C' l~^T.
    #[inline(always)]
    fn lever_terms(&self, a: &Symmetric3<T>, c: &Matrix3<T>, b: Symmetric3<T>) -> Symmetric6<T> {
        let l = &self.lever;
        let shifted = c + skew_times(l, &b.to_matrix());
        Symmetric6 {
            angular: Symmetric3::new(add_lever_terms(&a.entries, l, c, &shifted)),
            coupling: shifted,
            linear: b,
        }
    }

    /// phi^T Lambda phi: a covariance of motions, parent to child.
    #[inline(always)]
    pub fn co_covariance_to_child(&self, lambda: &Symmetric6<T>) -> Symmetric6<T> {
        // With the lever first: A' = A + C l~^T... in the parent's frame, then the rotation back.
        let l = -self.lever;
        // (1, 0; l~, 1) Lambda (1, l~^T; 0, 1), l = -lever: the roles of the two halves change places.
        let flipped = lambda.coupling.transpose();
        let shifted = flipped + skew_times(&l, &lambda.angular.to_matrix());
        let linear = Symmetric3::new(add_lever_terms(&lambda.linear.entries, &l, &flipped, &shifted));
        let back = self.rotation.transpose();
        Symmetric6 {
            angular: lambda.angular.congruence(&back),
            coupling: rotate_block(&back, &shifted.transpose()),
            linear: linear.congruence(&back),
        }
    }
}

/// R C R^T for a general 3x3 block.
#[inline(always)]
fn rotate_block<T: Real>(r: &Matrix3<T>, c: &Matrix3<T>) -> Matrix3<T> {
    let row = |i: usize| {
        let (x, y, z) = (r[(i, 0)], r[(i, 1)], r[(i, 2)]);
        [
            x * c[(0, 0)] + y * c[(1, 0)] + z * c[(2, 0)],
            x * c[(0, 1)] + y * c[(1, 1)] + z * c[(2, 1)],
            x * c[(0, 2)] + y * c[(1, 2)] + z * c[(2, 2)],
        ]
    };
    times_transpose(&[row(0), row(1), row(2)], r)
}

/// T R^T, T by rows.
#[inline(always)]
fn times_transpose<T: Real>(t: &[[T; 3]; 3], r: &Matrix3<T>) -> Matrix3<T> {
    let entry = |i: usize, j: usize| t[i][0] * r[(j, 0)] + t[i][1] * r[(j, 1)] + t[i][2] * r[(j, 2)];
    Matrix3::new(
        entry(0, 0),
        entry(0, 1),
        entry(0, 2),
        entry(1, 0),
        entry(1, 1),
        entry(1, 2),
        entry(2, 0),
        entry(2, 1),
        entry(2, 2),
    )
}

/// l~ M, column by column a cross product.
#[inline(always)]
fn skew_times<T: Real>(l: &Vector3<T>, m: &Matrix3<T>) -> Matrix3<T> {
    let column = |j: usize| cross(l, &Vector3::new(m[(0, j)], m[(1, j)], m[(2, j)]));
    Matrix3::from_columns(&[column(0), column(1), column(2)])
}

/// Upper triangle of A + l~ C^T + C' l~^T.
#[inline(always)]
fn add_lever_terms<T: Real>(a: &[T; 6], l: &Vector3<T>, c: &Matrix3<T>, shifted: &Matrix3<T>) -> [T; 6] {
    let s = shifted;
    // (l~ C^T)(i,j) = (l x c_j)_i with c_j row j of C; (C' l~^T)(i,j) = (l x s_i)_j with s_i row i of C'.
    let first = |i: usize, j: usize| match i {
        0 => l[1] * c[(j, 2)] - l[2] * c[(j, 1)],
        1 => l[2] * c[(j, 0)] - l[0] * c[(j, 2)],
        _ => l[0] * c[(j, 1)] - l[1] * c[(j, 0)],
    };
    let second = |i: usize, j: usize| match j {
        0 => l[1] * s[(i, 2)] - l[2] * s[(i, 1)],
        1 => l[2] * s[(i, 0)] - l[0] * s[(i, 2)],
        _ => l[0] * s[(i, 1)] - l[1] * s[(i, 0)],
    };
    [
        a[0] + (first(0, 0) + second(0, 0)),
        a[1] + (first(0, 1) + second(0, 1)),
        a[2] + (first(0, 2) + second(0, 2)),
        a[3] + (first(1, 1) + second(1, 1)),
        a[4] + (first(1, 2) + second(1, 2)),
        a[5] + (first(2, 2) + second(2, 2)),
    ]
}
