//! B(k): how the force that a body needs depends on its velocity.

use super::hinge::{cross_axis, halves, minus, plus, whole};
use crate::filter::HingeMap;
use crate::scalar::Real;
use crate::spatial::transform::Transform;
use crate::spatial::{BodyInertia, RigidShift, cross, cross_add, from_rows, row, sum3};
use nalgebra::{Matrix3, Vector3, Vector6};

/// B = v x* M - M v x + bar(M v), bar(h) x = x x* h: twice the body-level Coriolis matrix of Echeandia and Wensing.
///
/// Its symmetric part is the time derivative of M in fixed axes, its antisymmetric part bar(momentum). For rigid bodies
/// the linear half of a motion does not contribute, and twelve scalars remain: B = [[b, 0], [p~, 0]].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyCoriolis<T> {
    /// b = -2 (w~ Sigma + h~ u~), Sigma = tr(I)/2 - I, with the velocity (w, u) and the first moment h.
    pub angular: Matrix3<T>,
    /// p = -2 times the linear momentum.
    pub linear: Vector3<T>,
}

impl<T: Real> BodyCoriolis<T> {
    /// `value` in every entry; scratch starts as NaN.
    pub(super) fn filled(value: T) -> Self {
        Self { angular: Matrix3::from_element(value), linear: Vector3::from_element(value) }
    }

    /// B of a body that moves with `velocity`.
    #[inline(always)]
    pub fn new(inertia: &BodyInertia<T>, velocity: &Vector6<T>) -> Self {
        let (w, u) = halves(&(*velocity).into());
        let two = w[0].constant(2.0);
        let h = &inertia.first_moment;
        let h = [two * h[0], two * h[1], two * h[2]];
        let mass = two * inertia.mass;
        let [xx, xy, xz, yy, yz, zz] = inertia.rotational.entries;
        let (xy, xz, yz) = (two * xy, two * xz, two * yz);
        // -2 Sigma = 2 I - tr(I), and -2 h~ u~ = 2 (h.u) - 2 u h^T.
        let (x, y, z) = ([xx - yy - zz, xy, xz], [xy, yy - xx - zz, yz], [xz, yz, zz - xx - yy]);
        let along = sum3(h, u);
        let mut b = from_rows(
            row_of((w[1], &z), (w[2], &y), (u[0], &h)),
            row_of((w[2], &x), (w[0], &z), (u[1], &h)),
            row_of((w[0], &y), (w[1], &x), (u[2], &h)),
        );
        for i in 0..3 {
            b[(i, i)] += along;
        }
        // -2 (w x h + m u).
        let pushed = Vector3::new(mass * u[0], mass * u[1], mass * u[2]);
        let momentum = cross_add(&Vector3::from(w), &Vector3::new(h[0], h[1], h[2]), &pushed);
        Self { angular: b, linear: minus(momentum.into()).into() }
    }

    /// The sum for two bodies, about the same origin.
    #[inline(always)]
    #[must_use]
    pub fn add(&self, other: &Self) -> Self {
        let (b, p) = (&other.angular, &other.linear);
        let mut both = *self;
        for i in 0..3 {
            for j in 0..3 {
                both.angular[(i, j)] += b[(i, j)];
            }
            both.linear[i] += p[i];
        }
        both
    }

    /// phi B phi*: about the parent's origin, in the parent's frame.
    #[inline(always)]
    #[must_use]
    pub fn to_parent(&self, shift: &RigidShift<T>) -> Self {
        self.across(shift)
    }

    /// The same across any joint: p' = R p, b' = R b R* + p' l* - (l.p') 1.
    #[inline(always)]
    pub(super) fn across(&self, transform: &impl Transform<T>) -> Self {
        let (l, b) = (transform.offset_at_parent(), &self.angular);
        let p = transform.rotate_to_parent(self.linear.into());
        // R b by columns, then each row of that by R.
        let mut columns = [[l[0]; 3]; 3];
        for (j, column) in columns.iter_mut().enumerate() {
            *column = transform.rotate_to_parent([b[(0, j)], b[(1, j)], b[(2, j)]]);
        }
        let along = sum3(l, p);
        let mut turned = *b;
        for i in 0..3 {
            let row = transform.rotate_to_parent([columns[0][i], columns[1][i], columns[2][i]]);
            for j in 0..3 {
                turned[(i, j)] = p[i].mul_add(l[j], row[j]);
            }
            turned[(i, i)] -= along;
        }
        Self { angular: turned, linear: p.into() }
    }

    /// B/2.
    #[inline(always)]
    pub(super) fn half(&self) -> Self {
        let half = self.linear[0].constant(0.5);
        Self { angular: self.angular * half, linear: self.linear * half }
    }

    /// B x of a motion x, from its angular half.
    #[inline(always)]
    pub(super) fn mul_angular(&self, x: &[T; 3]) -> [T; 6] {
        let b = &self.angular;
        let pushed = cross(&self.linear, &Vector3::from(*x));
        whole([sum3(row(b, 0), *x), sum3(row(b, 1), *x), sum3(row(b, 2), *x)], pushed.into())
    }

    /// B S, S a row of H* as a column.
    #[inline(always)]
    pub(super) fn column(&self, hinge: &HingeMap<T>) -> [T; 6] {
        let i = match *hinge {
            HingeMap::Axis(i) if i < 3 => i,
            HingeMap::Axis(_) => return [self.linear[0].constant(0.0); 6],
            HingeMap::Screw(_) => 2,
        };
        let b = &self.angular;
        whole([b[(0, i)], b[(1, i)], b[(2, i)]], cross_axis(self.linear.into(), i))
    }

    /// B* S, a moment: its other half is zero.
    #[inline(always)]
    pub(super) fn moment(&self, hinge: &HingeMap<T>) -> [T; 3] {
        let p = self.linear.into();
        match *hinge {
            HingeMap::Axis(i) if i < 3 => row(&self.angular, i),
            HingeMap::Axis(i) => minus(cross_axis(p, i - 3)),
            HingeMap::Screw(pitch) => plus(row(&self.angular, 2), -pitch, cross_axis(p, 2)),
        }
    }
}

/// One row of w~ Q - u h^T, the other two rows of Q times their component of w: s a - t b - u h.
#[inline(always)]
fn row_of<T: Real>((s, a): (T, &[T; 3]), (t, b): (T, &[T; 3]), (u, h): (T, &[T; 3])) -> [T; 3] {
    [
        s.mul_add(a[0], -t.mul_add(b[0], u * h[0])),
        s.mul_add(a[1], -t.mul_add(b[1], u * h[1])),
        s.mul_add(a[2], -t.mul_add(b[2], u * h[2])),
    ]
}
