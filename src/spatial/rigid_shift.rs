//! The rigid shift phi: the transition matrix that carries spatial forces from a child's frame to its parent's.

use super::symmetric::{Symmetric3, Symmetric6};
use super::vector::{angular, column, cross_add, from_rows, linear, product, row, skew, spatial, sum3, times};
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
    #[doc(hidden)]
    pub fn filled(value: T) -> Self {
        Self { rotation: Matrix3::from_element(value), lever: Vector3::from_element(value) }
    }

    /// Writes [[R, p], [0, 1]], (4 x 4) row by row: the place of the child's frame in the parent's.
    #[inline(always)]
    pub fn homogeneous(&self, out: &mut [T]) {
        let zero = self.lever[0].constant(0.0);
        for i in 0..3 {
            for j in 0..3 {
                out[4 * i + j] = self.rotation[(i, j)];
            }
            out[4 * i + 3] = self.lever[i];
        }
        out[12..16].copy_from_slice(&[zero, zero, zero, zero.constant(1.0)]);
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
    #[inline(always)]
    #[must_use]
    pub fn compose(&self, inner: &Self) -> Self {
        let (inner_lever, own) = (self.rotate(&inner.lever), &self.lever);
        Self {
            rotation: product(&self.rotation, &inner.rotation),
            lever: Vector3::new(inner_lever[0] + own[0], inner_lever[1] + own[1], inner_lever[2] + own[2]),
        }
    }

    /// The shift the other way, from the parent's frame to the child's. The rotation is transposed, not inverted.
    #[inline(always)]
    #[must_use]
    pub fn inverse(&self) -> Self {
        let (r, l) = (&self.rotation, self.rotate_back(&self.lever));
        Self {
            rotation: Matrix3::new(
                r[(0, 0)],
                r[(1, 0)],
                r[(2, 0)],
                r[(0, 1)],
                r[(1, 1)],
                r[(2, 1)],
                r[(0, 2)],
                r[(1, 2)],
                r[(2, 2)],
            ),
            lever: Vector3::new(-l[0], -l[1], -l[2]),
        }
    }

    /// The square of the lever.
    #[inline(always)]
    #[must_use]
    pub(crate) fn lever_square(&self) -> T {
        let l = &self.lever;
        l[0].mul_add(l[0], l[1].mul_add(l[1], l[2] * l[2]))
    }

    /// A free vector, child to parent coordinates.
    #[inline(always)]
    pub fn rotate(&self, v: &Vector3<T>) -> Vector3<T> {
        let r = &self.rotation;
        let v = [v[0], v[1], v[2]];
        Vector3::new(sum3(row(r, 0), v), sum3(row(r, 1), v), sum3(row(r, 2), v))
    }

    /// A free vector, parent to child coordinates.
    #[inline(always)]
    pub fn rotate_back(&self, v: &Vector3<T>) -> Vector3<T> {
        let r = &self.rotation;
        let v = [v[0], v[1], v[2]];
        Vector3::new(sum3(column(r, 0), v), sum3(column(r, 1), v), sum3(column(r, 2), v))
    }

    /// phi f: a force, child to parent. 24 products.
    #[inline(always)]
    pub fn force_to_parent(&self, f: &Vector6<T>) -> Vector6<T> {
        let force = self.rotate(&linear(f));
        let moment = cross_add(&self.lever, &force, &self.rotate(&angular(f)));
        spatial(&moment, &force)
    }

    /// phi^T v: a motion, parent to child. 24 products.
    #[inline(always)]
    pub fn motion_to_child(&self, v: &Vector6<T>) -> Vector6<T> {
        let w = angular(v);
        let at_child = cross_add(&w, &self.lever, &linear(v));
        spatial(&self.rotate_back(&w), &self.rotate_back(&at_child))
    }

    /// phi^-T v: a motion, child to parent. 24 products.
    #[inline(always)]
    pub fn motion_to_parent(&self, v: &Vector6<T>) -> Vector6<T> {
        let w = self.rotate(&angular(v));
        spatial(&w, &cross_add(&self.lever, &w, &self.rotate(&linear(v))))
    }

    /// phi P phi^T: an inertia (covariance of a force), child to parent. About 190 products.
    #[inline(always)]
    #[doc(hidden)]
    pub fn inertia_to_parent(&self, p: &Symmetric6<T>) -> Symmetric6<T> {
        let a = p.angular.congruence(&self.rotation);
        let c = rotate_block(&self.rotation, &p.coupling);
        self.lever_terms(&a, &c, p.linear.congruence(&self.rotation))
    }

    /// [[A, C], [C^T, B]], already turned, moved by the lever: C' = C + l~ B; A' = A + l~ C^T + C' l~^T.
    #[inline(always)]
    fn lever_terms(&self, a: &Symmetric3<T>, c: &Matrix3<T>, b: Symmetric3<T>) -> Symmetric6<T> {
        let l = &self.lever;
        let shifted = skew_times_add(l, &b.to_matrix(), c);
        Symmetric6 {
            angular: Symmetric3::new(add_lever_terms(&a.entries, l, c, &shifted)),
            coupling: shifted,
            linear: b,
        }
    }

    /// phi^T Lambda phi: a covariance of motions, parent to child.
    #[inline(always)]
    pub(crate) fn co_covariance_to_child(&self, lambda: &Symmetric6<T>) -> Symmetric6<T> {
        // With the lever first: A' = A + C l~^T... in the parent's frame, then the rotation back.
        let l = -self.lever;
        // (1, 0; l~, 1) Lambda (1, l~^T; 0, 1), l = -lever: the roles of the two halves change places.
        let flipped = lambda.coupling.transpose();
        let shifted = skew_times_add(&l, &lambda.angular.to_matrix(), &flipped);
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
pub(crate) fn rotate_block<T: Real>(r: &Matrix3<T>, c: &Matrix3<T>) -> Matrix3<T> {
    times_transpose(&[times(row(r, 0), c), times(row(r, 1), c), times(row(r, 2), c)], r)
}

/// T R^T, T by rows.
#[inline(always)]
fn times_transpose<T: Real>(t: &[[T; 3]; 3], r: &Matrix3<T>) -> Matrix3<T> {
    from_rows(turned_back(t[0], r), turned_back(t[1], r), turned_back(t[2], r))
}

/// t R^T, t a row.
#[inline(always)]
fn turned_back<T: Real>(t: [T; 3], r: &Matrix3<T>) -> [T; 3] {
    [sum3(t, row(r, 0)), sum3(t, row(r, 1)), sum3(t, row(r, 2))]
}

/// l~ M + C, column by column a cross product.
#[inline(always)]
fn skew_times_add<T: Real>(l: &Vector3<T>, m: &Matrix3<T>, c: &Matrix3<T>) -> Matrix3<T> {
    Matrix3::from_columns(&[column_add(l, m, c, 0), column_add(l, m, c, 1), column_add(l, m, c, 2)])
}

#[inline(always)]
fn column_add<T: Real>(l: &Vector3<T>, m: &Matrix3<T>, c: &Matrix3<T>, j: usize) -> Vector3<T> {
    let (m, c) = (column(m, j), column(c, j));
    cross_add(l, &Vector3::new(m[0], m[1], m[2]), &Vector3::new(c[0], c[1], c[2]))
}

/// Upper triangle of A + l~ C^T + C' l~^T.
#[inline(always)]
fn add_lever_terms<T: Real>(a: &[T; 6], l: &Vector3<T>, c: &Matrix3<T>, shifted: &Matrix3<T>) -> [T; 6] {
    let s = shifted;
    [
        lever_entry(a[0], l, c, s, (0, 0)),
        lever_entry(a[1], l, c, s, (0, 1)),
        lever_entry(a[2], l, c, s, (0, 2)),
        lever_entry(a[3], l, c, s, (1, 1)),
        lever_entry(a[4], l, c, s, (1, 2)),
        lever_entry(a[5], l, c, s, (2, 2)),
    ]
}

/// Entry (i, j): a + (`l` x row j of C, which is `l~ C^T`) at i + (`l` x row i of C', which is `C' l~^T`) at j.
#[inline(always)]
fn lever_entry<T: Real>(a: T, l: &Vector3<T>, c: &Matrix3<T>, s: &Matrix3<T>, (i, j): (usize, usize)) -> T {
    let (y, z) = ((i + 1) % 3, (i + 2) % 3);
    let (u, v) = ((j + 1) % 3, (j + 2) % 3);
    let first = l[y].mul_add(c[(j, z)], a.minus_product(l[z], c[(j, y)]));
    l[u].mul_add(s[(i, v)], first.minus_product(l[v], s[(i, u)]))
}
impl RigidShift<f64> {
    /// The same in another scalar.
    pub(crate) fn cast<T: Real>(&self) -> RigidShift<T> {
        RigidShift {
            rotation: Matrix3::from_fn(|i, j| T::from_f64(self.rotation[(i, j)])),
            lever: Vector3::new(T::from_f64(self.lever[0]), T::from_f64(self.lever[1]), T::from_f64(self.lever[2])),
        }
    }
}
