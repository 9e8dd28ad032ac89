//! The rigid shift phi: the transition matrix that transforms spatial forces from a child frame to its parent frame.

use super::symmetric::{Symmetric3, Symmetric6};
use super::vector::{angular, column, cross_add, from_rows, linear, product, row, skew, spatial, sum3, times};
use crate::scalar::{DoubleDouble, Real};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

/// phi(k,k-1) of the introduction of the paper, in body frames: [[R, lever~ R], [0, R]].
///
/// `rotation` R transforms child coordinates to parent coordinates; `lever` is the vector from the parent origin to the
/// child origin, m, in the parent frame. phi transforms forces from child to parent, and its transpose motions from
/// parent to child.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigidShift<T> {
    /// Rotation from child coordinates to parent coordinates.
    pub rotation: Matrix3<T>,
    /// Vector from the parent origin to the child origin, in the parent frame, m.
    pub lever: Vector3<T>,
}

impl<T: Real> RigidShift<T> {
    /// The identity.
    #[must_use]
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), lever: Vector3::from_element(T::zero()) }
    }

    /// A shift with `value` in every entry, for workspaces, which start as NaN.
    #[doc(hidden)]
    pub fn filled(value: T) -> Self {
        Self { rotation: Matrix3::from_element(value), lever: Vector3::from_element(value) }
    }

    /// Writes the homogeneous matrix [[R, p], [0, 1]], (4 x 4), row-major: the pose of the child frame in the parent
    /// frame.
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

    /// The composition: `inner` (grandchild to child), then `self` (child to parent).
    #[inline(always)]
    #[must_use]
    pub fn compose(&self, inner: &Self) -> Self {
        let (inner_lever, own) = (self.rotate(&inner.lever), &self.lever);
        Self {
            rotation: product(&self.rotation, &inner.rotation),
            lever: Vector3::new(inner_lever[0] + own[0], inner_lever[1] + own[1], inner_lever[2] + own[2]),
        }
    }

    /// The inverse, from the parent frame to the child frame. The rotation is transposed.
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

    /// The squared norm of the lever.
    #[inline(always)]
    #[must_use]
    pub(crate) fn lever_square(&self) -> T {
        let l = &self.lever;
        l[0].mul_add(l[0], l[1].mul_add(l[1], l[2] * l[2]))
    }

    /// A free vector from child to parent coordinates.
    #[inline(always)]
    pub fn rotate(&self, v: &Vector3<T>) -> Vector3<T> {
        let r = &self.rotation;
        let v = [v[0], v[1], v[2]];
        Vector3::new(sum3(row(r, 0), v), sum3(row(r, 1), v), sum3(row(r, 2), v))
    }

    /// A free vector from parent to child coordinates.
    #[inline(always)]
    pub fn rotate_back(&self, v: &Vector3<T>) -> Vector3<T> {
        let r = &self.rotation;
        let v = [v[0], v[1], v[2]];
        Vector3::new(sum3(column(r, 0), v), sum3(column(r, 1), v), sum3(column(r, 2), v))
    }

    /// phi f: a force from child to parent. 24 products.
    #[inline(always)]
    pub fn force_to_parent(&self, f: &Vector6<T>) -> Vector6<T> {
        let force = self.rotate(&linear(f));
        let moment = cross_add(&self.lever, &force, &self.rotate(&angular(f)));
        spatial(&moment, &force)
    }

    /// phi^T v: a motion from parent to child. 24 products.
    #[inline(always)]
    pub fn motion_to_child(&self, v: &Vector6<T>) -> Vector6<T> {
        let w = angular(v);
        let at_child = cross_add(&w, &self.lever, &linear(v));
        spatial(&self.rotate_back(&w), &self.rotate_back(&at_child))
    }

    /// phi^-T v: a motion from child to parent. 24 products.
    #[inline(always)]
    pub fn motion_to_parent(&self, v: &Vector6<T>) -> Vector6<T> {
        let w = self.rotate(&angular(v));
        spatial(&w, &cross_add(&self.lever, &w, &self.rotate(&linear(v))))
    }

    /// phi P phi^T: an inertia (covariance of a force) from child to parent. About 190 products.
    #[inline(always)]
    #[doc(hidden)]
    pub fn inertia_to_parent(&self, p: &Symmetric6<T>) -> Symmetric6<T> {
        let a = p.angular.congruence(&self.rotation);
        let c = rotate_block(&self.rotation, &p.coupling);
        self.lever_terms(&a, &c, p.linear.congruence(&self.rotation))
    }

    /// [[A, C], [C^T, B]], already rotated, shifted by the lever: C' = C + l~ B; A' = A + l~ C^T + C' l~^T.
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

    /// phi^T Lambda phi: a covariance of motions from parent to child.
    #[inline(always)]
    pub(crate) fn co_covariance_to_child(&self, lambda: &Symmetric6<T>) -> Symmetric6<T> {
        // The lever is applied first, in the parent frame: A' = A + C l~^T...; then the rotation.
        let l = -self.lever;
        // (1, 0; l~, 1) Lambda (1, l~^T; 0, 1) with l = -lever: the angular and linear blocks exchange roles.
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

/// T R^T, with T given by rows.
#[inline(always)]
fn times_transpose<T: Real>(t: &[[T; 3]; 3], r: &Matrix3<T>) -> Matrix3<T> {
    from_rows(turned_back(t[0], r), turned_back(t[1], r), turned_back(t[2], r))
}

/// t R^T for a row t.
#[inline(always)]
fn turned_back<T: Real>(t: [T; 3], r: &Matrix3<T>) -> [T; 3] {
    [sum3(t, row(r, 0)), sum3(t, row(r, 1)), sum3(t, row(r, 2))]
}

/// l~ M + C, by cross products of the columns.
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

/// The rotation nearest to a matrix that is orthonormal to rounding: one step of Newton's iteration for the polar
/// factor, R (3 - R* R)/2, which squares the deviation.
pub(crate) fn orthonormalized<T: Real>(r: &Matrix3<T>) -> Matrix3<T> {
    let half = r[(0, 0)].constant(0.5);
    let gram = product(&r.transpose(), r);
    let step = Matrix3::from_fn(|i, j| half * (half.constant(if i == j { 3.0 } else { 0.0 }) - gram[(i, j)]));
    product(r, &step)
}

impl RigidShift<f64> {
    /// The same shift in another scalar type; in a wider type the rotation is orthonormalized.
    ///
    /// Nine rounded entries are orthonormal only to f64. Unchanged, they would scale vectors by half a unit of
    /// rounding, consistently for every joint, and the result of a long chain would be less accurate in double-double
    /// than in f64.
    pub(crate) fn cast<T: Real>(&self) -> RigidShift<T> {
        let rotation = Matrix3::from_fn(|i, j| T::from_f64(self.rotation[(i, j)]));
        let is_wider = T::epsilon().lane(0) < f64::EPSILON;
        RigidShift {
            rotation: if is_wider { orthonormalized(&rotation) } else { rotation },
            lever: Vector3::new(T::from_f64(self.lever[0]), T::from_f64(self.lever[1]), T::from_f64(self.lever[2])),
        }
    }

    /// [`compose`](Self::compose) with a single rounding: the composed rotation is orthonormalized before each entry is
    /// rounded to f64, so that lengths do not change on average.
    #[must_use]
    pub(crate) fn compose_rounded(&self, inner: &Self) -> Self {
        let (outer, inner) = (self.cast::<DoubleDouble>(), inner.cast());
        let RigidShift { rotation, lever } = outer.compose(&inner);
        let rotation = orthonormalized(&rotation);
        Self { rotation: rotation.map(|x| x.high), lever: lever.map(|x| x.high) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    /// Mean of the squared column norms minus one, in eps, computed in double-double arithmetic.
    fn defect(rotation: &Matrix3<f64>) -> f64 {
        let wide = rotation.map(DoubleDouble::from_f64);
        let sum = wide.iter().fold(DoubleDouble::from_f64(-3.0), |sum, &x| sum + x * x);
        sum.high / (3.0 * f64::EPSILON)
    }

    #[test]
    fn composed_rotations_are_neither_long_nor_short_on_average() {
        let angles = |k: f64| Rotation3::from_euler_angles(1.3 * k, 0.7 - k, 2.9 * k * k).into_inner();
        let shift = |rotation| RigidShift { rotation, lever: Vector3::new(0.1, -0.2, 0.3) };
        let mut total = 0.0;
        for k in 0..300 {
            let k = f64::from(k);
            // An input rotation that is too long by half a unit of rounding does not affect the result.
            let long = angles(k) * (1.0 + f64::EPSILON);
            total += defect(&shift(long).compose_rounded(&shift(angles(0.1 + k))).rotation);
        }
        assert!((total / 300.0).abs() <= 0.2, "{}", total / 300.0);
    }

    #[test]
    fn a_rotation_in_more_digits_is_orthonormal_to_these() {
        let rotation = Rotation3::from_euler_angles(0.3, -1.1, 2.0).into_inner();
        let lever = Vector3::new(0.1, -0.2, 0.3);
        for scale in [1.0 - 0.5 * f64::EPSILON, 1.0, 1.0 + f64::EPSILON] {
            let wide = RigidShift { rotation: rotation * scale, lever }.cast::<DoubleDouble>();
            let gram = product(&wide.rotation.transpose(), &wide.rotation) - Matrix3::<DoubleDouble>::identity();
            assert!(gram.iter().all(|x| x.high.abs() <= 1e-30), "{gram:?}");
        }
        let same = RigidShift { rotation, lever }.cast::<f64>();
        assert_eq!(same.rotation, rotation);
    }

    #[test]
    fn what_renames_axes_stays_exact() {
        let quarter = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0);
        let shift = RigidShift { rotation: quarter, lever: Vector3::new(0.1, 0.2, 0.3) };
        assert_eq!(shift.compose_rounded(&RigidShift::identity()), shift);
        assert_eq!(shift.compose_rounded(&shift).rotation, quarter * quarter);
    }
}
