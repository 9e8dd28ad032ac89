//! B(k): how the force that a body needs depends on its velocity.

use super::hinge::{cross_axis, minus, plus};
use crate::filter::HingeMap;
use crate::scalar::Real;
use crate::spatial::{BodyInertia, RigidShift, angular, cross, cross_add, linear, product, row, spatial};
use nalgebra::{Matrix3, Vector3, Vector6};

/// B = v x* M - M v x + bar(M v), bar(h) x = x x* h: twice the body-level Coriolis matrix of Echeandia and Wensing.
///
/// Its symmetric part is the rate of M in fixed axes, its antisymmetric part bar(momentum). Written out, a motion's linear half is not asked for,
/// and twelve numbers are left: B = [[b, 0], [p~, 0]]. So it is for bodies that move as one.
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
        let (w, u) = (angular(velocity), linear(velocity));
        let two = w[0].constant(2.0);
        let h = &inertia.first_moment;
        let h = Vector3::new(two * h[0], two * h[1], two * h[2]);
        let mass = two * inertia.mass;
        let [xx, xy, xz, yy, yz, zz] = inertia.rotational.entries;
        // -2 Sigma = 2 I - tr(I), and -2 h~ u~ = 2 (h.u) - 2 u h^T.
        let (xy, xz, yz) = (two * xy, two * xz, two * yz);
        let column = |x: T, y: T, z: T, i: usize| {
            let turned = cross(&w, &Vector3::new(x, y, z));
            Vector3::new(
                turned[0].minus_product(u[0], h[i]),
                turned[1].minus_product(u[1], h[i]),
                turned[2].minus_product(u[2], h[i]),
            )
        };
        let mut b = Matrix3::from_columns(&[
            column(xx - yy - zz, xy, xz, 0),
            column(xy, yy - xx - zz, yz, 1),
            column(xz, yz, zz - xx - yy, 2),
        ]);
        let along = h[0].mul_add(u[0], h[1].mul_add(u[1], h[2] * u[2]));
        for i in 0..3 {
            b[(i, i)] += along;
        }
        // w x h + m u, twice; with the sign turned.
        let momentum = cross_add(&w, &h, &Vector3::new(mass * u[0], mass * u[1], mass * u[2]));
        Self { angular: b, linear: minus(&momentum) }
    }

    /// Both bodies' together, about the same origin.
    #[inline(always)]
    #[must_use]
    pub fn add(&self, other: &Self) -> Self {
        let (b, c) = (&self.angular, &other.angular);
        let sum = |i: usize| Vector3::new(b[(0, i)] + c[(0, i)], b[(1, i)] + c[(1, i)], b[(2, i)] + c[(2, i)]);
        let (p, r) = (&self.linear, &other.linear);
        Self {
            angular: Matrix3::from_columns(&[sum(0), sum(1), sum(2)]),
            linear: Vector3::new(p[0] + r[0], p[1] + r[1], p[2] + r[2]),
        }
    }

    /// phi B phi*: about the parent's origin, in the parent's frame.
    #[inline(always)]
    #[must_use]
    pub fn to_parent(&self, shift: &RigidShift<T>) -> Self {
        let (r, l) = (&shift.rotation, &shift.lever);
        let p = shift.rotate(&self.linear);
        let mut b = product(&product(r, &self.angular), &r.transpose());
        // l~ p~ = p l^T - l.p
        let along = l[0].mul_add(p[0], l[1].mul_add(p[1], l[2] * p[2]));
        for i in 0..3 {
            for j in 0..3 {
                b[(i, j)] = p[i].mul_add(l[j], b[(i, j)]);
            }
            b[(i, i)] -= along;
        }
        Self { angular: b, linear: p }
    }

    /// B x of a motion x, of which the angular half is given.
    #[inline(always)]
    pub fn mul_angular(&self, x: &Vector3<T>) -> Vector6<T> {
        let b = &self.angular;
        let part = |i: usize| {
            let [s, t, u] = row(b, i);
            s.mul_add(x[0], t.mul_add(x[1], u * x[2]))
        };
        spatial(&Vector3::new(part(0), part(1), part(2)), &cross(&self.linear, x))
    }

    /// B S, S a row of H* as a column.
    #[inline(always)]
    pub(super) fn column(&self, hinge: &HingeMap<T>) -> Vector6<T> {
        let i = match *hinge {
            HingeMap::Axis(i) if i < 3 => i,
            HingeMap::Axis(_) => return crate::spatial::zero(),
            HingeMap::Screw(_) => 2,
        };
        let b = &self.angular;
        spatial(&Vector3::new(b[(0, i)], b[(1, i)], b[(2, i)]), &cross_axis(&self.linear, i))
    }

    /// B* S, a moment: its other half is zero.
    #[inline(always)]
    pub(super) fn moment(&self, hinge: &HingeMap<T>) -> Vector3<T> {
        let turned = |i: usize| {
            let [x, y, z] = row(&self.angular, i);
            Vector3::new(x, y, z)
        };
        match *hinge {
            HingeMap::Axis(i) if i < 3 => turned(i),
            HingeMap::Axis(i) => minus(&cross_axis(&self.linear, i - 3)),
            HingeMap::Screw(pitch) => plus(&turned(2), -pitch, &cross_axis(&self.linear, 2)),
        }
    }
}
