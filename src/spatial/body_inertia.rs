//! The spatial inertia M(k) of a rigid body, by its ten inertial parameters.

use super::rigid_shift::RigidShift;
use super::symmetric::{Symmetric3, Symmetric6};
use super::vector::{angular, cross, cross_add, linear, skew, spatial, sum3};
use crate::scalar::Real;
use nalgebra::{Matrix3, Vector3, Vector6};

/// M(k) = [[I, m p~], [-m p~, m 1]] about the origin of the body frame (the lower right block in the paper is
/// misprinted as 1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyInertia<T> {
    /// Mass m, kg.
    pub mass: T,
    /// First moment m p, kg m, with p from the frame origin to the center of mass.
    pub first_moment: Vector3<T>,
    /// Rotational inertia I about the frame origin, kg m^2.
    pub rotational: Symmetric3<T>,
}

/// Mass and first moment: the part of an inertia that determines the center of mass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FirstMoment<T> {
    /// Mass m, kg.
    pub mass: T,
    /// First moment m p, kg m.
    pub moment: Vector3<T>,
}

// Entry by entry: operators of nalgebra are not inlined for lanes.
impl<T: Real> FirstMoment<T> {
    /// The same about the parent origin, in the parent frame, as part of [`BodyInertia::to_parent`].
    #[inline(always)]
    pub fn at_parent(&self, shift: &RigidShift<T>) -> Self {
        let (h, l, m) = (shift.rotate(&self.moment), &shift.lever, self.mass);
        let moment = Vector3::new(m.mul_add(l[0], h[0]), m.mul_add(l[1], h[1]), m.mul_add(l[2], h[2]));
        Self { mass: m, moment }
    }

    /// The linear momentum of a motion, N s.
    #[inline(always)]
    pub fn momentum_of(&self, v: &Vector6<T>) -> Vector3<T> {
        let (u, m) = (linear(v), self.mass);
        cross_add(&angular(v), &self.moment, &Vector3::new(m * u[0], m * u[1], m * u[2]))
    }

    /// The sum of two bodies, about the same origin.
    #[inline(always)]
    pub fn add(&self, other: &Self) -> Self {
        let (a, b) = (&self.moment, &other.moment);
        Self { mass: self.mass + other.mass, moment: Vector3::new(a[0] + b[0], a[1] + b[1], a[2] + b[2]) }
    }
}

impl<T: Real> BodyInertia<T> {
    /// A massless body.
    #[inline(always)]
    #[must_use]
    pub fn zero() -> Self {
        Self { mass: T::zero(), first_moment: Vector3::from_element(T::zero()), rotational: Symmetric3::zero() }
    }

    /// From mass (kg), center of mass (m) and inertia about the center of mass (kg m^2), all in one frame: I = `I_c` +
    /// m (p.p 1 - p p^T).
    pub fn from_central(mass: T, center: &Vector3<T>, central: &Symmetric3<T>) -> Self {
        let h = center * mass;
        let [x, y, z] = [center[0], center[1], center[2]];
        let [xx, xy, xz, yy, yz, zz] = central.entries;
        Self {
            mass,
            first_moment: h,
            rotational: Symmetric3::new([
                xx + (h[1] * y + h[2] * z),
                xy - h[0] * y,
                xz - h[0] * z,
                yy + (h[0] * x + h[2] * z),
                yz - h[1] * z,
                zz + (h[0] * x + h[1] * y),
            ]),
        }
    }

    /// M v: the momentum (N m s, N s) of a motion, or the force of an acceleration. 24 products.
    #[inline(always)]
    pub fn mul_motion(&self, v: &Vector6<T>) -> Vector6<T> {
        let (w, u) = (angular(v), linear(v));
        let h = &self.first_moment;
        let moment = cross_add(h, &u, &self.rotational.mul_vector(&w));
        spatial(&moment, &self.first().momentum_of(v))
    }

    /// M a + v x* (M v): the force on a body of velocity `v` and spatial acceleration `a`.
    ///
    /// v x* (M v) is evaluated as (w x I w + p~ m (w x u), m w x u + w x (w x m p)). The term u x m u, which vanishes,
    /// is not formed; for a body that rotates about a distant axis its rounding error would dominate. 57 products.
    #[inline(always)]
    pub fn bias_force(&self, velocity: &Vector6<T>, acceleration: &Vector6<T>) -> Vector6<T> {
        let (w, u) = (angular(velocity), linear(velocity));
        let needed = self.mul_motion(&spatial(&angular(acceleration), &cross_add(&w, &u, &linear(acceleration))));
        let momentum = self.rotational.mul_vector(&w);
        let centripetal = cross(&w, &self.first_moment);
        spatial(&cross_add(&w, &momentum, &angular(&needed)), &cross_add(&w, &centripetal, &linear(&needed)))
    }

    /// v x* M - M v x: the time derivative of M in fixed axes about a fixed point while the body moves with `velocity`
    /// (w, u). In the ten parameters, m' = 0, h' = w x h + m u, I' = w~ I - I w~ - (u~ h~ + h~ u~).
    #[inline(always)]
    #[must_use]
    pub fn rate(&self, velocity: &Vector6<T>) -> Self {
        let (w, u) = (angular(velocity), linear(velocity));
        let (h, m) = (&self.first_moment, self.mass);
        let two = m.constant(2.0);
        let turned = skew(&w) * self.rotational.to_matrix();
        // -(u~ h~ + h~ u~) = 2 u.h 1 - (u h^T + h u^T)
        let along = two * sum3([u[0], u[1], u[2]], [h[0], h[1], h[2]]);
        let entry = |i: usize, j: usize| turned[(i, j)] + turned[(j, i)] - (u[i] * h[j] + h[i] * u[j]);
        Self {
            mass: m.constant(0.0),
            first_moment: cross_add(&w, h, &Vector3::new(m * u[0], m * u[1], m * u[2])),
            rotational: Symmetric3::new([
                entry(0, 0) + along,
                entry(0, 1),
                entry(0, 2),
                entry(1, 1) + along,
                entry(1, 2),
                entry(2, 2) + along,
            ]),
        }
    }

    /// M as a packed symmetric matrix.
    #[inline(always)]
    pub fn to_symmetric(&self) -> Symmetric6<T> {
        let (o, m) = (self.mass.constant(0.0), self.mass);
        Symmetric6 {
            angular: self.rotational,
            coupling: skew(&self.first_moment),
            linear: Symmetric3::new([m, o, o, m, o, m]),
        }
    }

    /// The sum of two rigidly connected bodies, about the same origin.
    #[inline(always)]
    #[must_use]
    pub fn add(&self, other: &Self) -> Self {
        let first = self.first().add(&other.first());
        let (a, b) = (&self.rotational.entries, &other.rotational.entries);
        let rotational = [a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5]];
        Self { mass: first.mass, first_moment: first.moment, rotational: Symmetric3::new(rotational) }
    }

    /// Mass and first moment.
    #[inline(always)]
    pub(crate) fn first(&self) -> FirstMoment<T> {
        FirstMoment { mass: self.mass, moment: self.first_moment }
    }

    /// The inertia about the same origin in another frame; `rotation` rotates from this frame to that one.
    #[inline(always)]
    pub(crate) fn rotated(&self, rotation: &Matrix3<T>) -> Self {
        Self {
            mass: self.mass,
            first_moment: Vector3::from(
                [0, 1, 2].map(|i| sum3(rotation.row(i).transpose().into(), self.first_moment.into())),
            ),
            rotational: self.rotational.congruence(rotation),
        }
    }

    /// phi M phi^T, the inertia about the parent origin, in the parent frame.
    #[inline(always)]
    #[must_use]
    pub fn to_parent(&self, shift: &RigidShift<T>) -> Self {
        let h = shift.rotate(&self.first_moment);
        let l = &shift.lever;
        let m = self.mass;
        let [xx, xy, xz, yy, yz, zz] = self.rotational.congruence(&shift.rotation).entries;
        // I' = I - l~ h~ - h~ l~ - m l~ l~ = I + 2 (l.h) 1 - (l h^T + h l^T) + m (l.l 1 - l l^T). With s = h + m l this
        // is I + (l.h + l.s) 1 - (h l^T + l s^T), which is symmetric because s - h is parallel to l.
        let s = Vector3::new(m.mul_add(l[0], h[0]), m.mul_add(l[1], h[1]), m.mul_add(l[2], h[2]));
        let d = |i: usize| l[i].mul_add(h[i], l[i] * s[i]);
        let off = |i: usize, j: usize| h[i].mul_add(l[j], l[i] * s[j]);
        Self {
            mass: m,
            first_moment: s,
            rotational: Symmetric3::new([
                xx + (d(1) + d(2)),
                xy - off(0, 1),
                xz - off(0, 2),
                yy + (d(0) + d(2)),
                yz - off(1, 2),
                zz + (d(0) + d(1)),
            ]),
        }
    }
}
