//! Elementary joint motions and their operations.

use super::{free, prismatic, revolute, screw, spherical};
use crate::filter::{HingeMap, Rows};
use crate::scalar::Real;
use crate::spatial::{RigidShift, cross_motion, zero};
use nalgebra::Vector6;

/// Motion of a body relative to its parent. Body frames were rotated so that axes are along z when the scene was built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion<T> {
    /// Rotation about z, rad.
    Revolute,
    /// Translation along z, m.
    Prismatic,
    /// Rotation about z with a translation by the pitch, m/rad.
    Screw(T),
    /// Quaternion (x, y, z, w); velocities are the angular velocity in the body frame.
    Spherical,
    /// Position, then quaternion; velocities are the (linear, angular) velocity in the body frame.
    Free,
    /// No motion: a fixed joint that was not merged, or a body fixed to the base that was not removed.
    Fixed,
}

impl<T: Real> Motion<T> {
    /// Number of configuration coordinates.
    pub fn nq(&self) -> usize {
        match self {
            Self::Spherical => 4,
            Self::Free => 7,
            Self::Fixed => 0,
            _ => 1,
        }
    }

    /// The same motion in another scalar.
    pub(crate) fn cast<U>(&self, scalar: impl Fn(T) -> U) -> Motion<U> {
        match *self {
            Self::Revolute => Motion::Revolute,
            Self::Prismatic => Motion::Prismatic,
            Self::Screw(pitch) => Motion::Screw(scalar(pitch)),
            Self::Spherical => Motion::Spherical,
            Self::Free => Motion::Free,
            Self::Fixed => Motion::Fixed,
        }
    }

    /// The place of the quaternion in the coordinates of the joint, and of its angular velocity among the velocities;
    /// None without a quaternion.
    pub(crate) fn quaternion(&self) -> Option<(usize, usize)> {
        match self {
            Self::Spherical => Some((0, 0)),
            Self::Free => Some((3, 3)),
            _ => None,
        }
    }

    /// True if the body moves freely: position and orientation, linear velocity first.
    pub(crate) fn is_free(&self) -> bool {
        matches!(self, Self::Free)
    }

    /// True if the joint rotates about z or translates along z, and nothing else.
    pub(crate) fn has_constant_axis(&self) -> bool {
        matches!(self, Self::Revolute | Self::Prismatic)
    }

    /// Operations of the velocity of a body and of its velocity product, phi* v and v x H* qd: counted on the
    /// counting scalar (docs/leaving-out.md).
    pub(crate) fn operations_of_velocity(&self) -> usize {
        match self {
            Self::Revolute => 58,
            Self::Prismatic => 56,
            Self::Screw(_) => 85,
            Self::Spherical | Self::Free => 84,
            Self::Fixed => 54,
        }
    }

    /// The measurement rows of the joint.
    pub fn rows(&self) -> Rows<T> {
        match *self {
            Self::Revolute => Rows::One(HingeMap::Axis(2)),
            Self::Prismatic => Rows::One(HingeMap::Axis(5)),
            Self::Screw(pitch) => Rows::One(HingeMap::Screw(pitch)),
            Self::Spherical => Rows::Angular,
            Self::Free => Rows::Six,
            Self::Fixed => Rows::None,
        }
    }

    /// phi from the body frame to the parent's, at the joint coordinates: the constant shift, then that of the joint.
    #[inline(always)]
    pub fn shift(&self, tree: &RigidShift<T>, q: &[T]) -> RigidShift<T> {
        match *self {
            Self::Revolute => revolute::shift(tree, q[0]),
            Self::Prismatic => prismatic::shift(tree, q[0]),
            Self::Screw(pitch) => screw::shift(tree, pitch, q[0]),
            Self::Spherical => spherical::shift(tree, &q[..4]),
            Self::Free => free::shift(tree, &q[..7]),
            Self::Fixed => *tree,
        }
    }

    /// H* u in the body frame. `like` only determines the lanes of the zeros for a body that does not move.
    #[inline(always)]
    pub fn velocity(&self, u: &[T], like: T) -> Vector6<T> {
        let o = like.constant(0.0);
        match *self {
            Self::Revolute => Vector6::new(o, o, u[0], o, o, o),
            Self::Prismatic => Vector6::new(o, o, o, o, o, u[0]),
            Self::Screw(pitch) => Vector6::new(o, o, u[0], o, o, pitch * u[0]),
            Self::Spherical => Vector6::new(u[0], u[1], u[2], o, o, o),
            Self::Free => Vector6::new(u[3], u[4], u[5], u[0], u[1], u[2]),
            Self::Fixed => zero(),
        }
    }

    /// v x (H* qd), the velocity product acceleration of the joint.
    #[inline(always)]
    pub fn velocity_product(&self, v: &Vector6<T>, joint: &Vector6<T>) -> Vector6<T> {
        match self {
            Self::Revolute => revolute::velocity_product(v, joint[2]),
            Self::Prismatic => prismatic::velocity_product(v, joint[5]),
            Self::Fixed => zero(),
            _ => cross_motion(v, joint),
        }
    }

    /// dq/dt of the joint coordinates; equal to the joint velocities except for quaternions and the position of a free
    /// joint.
    pub fn coordinate_rates(&self, q: &[T], v: &[T], rates: &mut [T]) {
        match self {
            Self::Spherical => spherical::coordinate_rates(q, v, rates),
            Self::Free => free::coordinate_rates(q, v, rates),
            Self::Fixed => {}
            _ => rates[0] = v[0],
        }
    }

    /// Integrates the joint velocities `v` from `q` over unit time; quaternions are normalized.
    #[inline(always)]
    pub fn advance(&self, q: &[T], v: &[T], out: &mut [T]) {
        match self {
            Self::Spherical => spherical::advance(q, v, out),
            Self::Free => free::advance(q, v, out),
            Self::Fixed => {}
            _ => out[0] = q[0] + v[0],
        }
    }

    /// Replaces the body velocity `v` at q = q0 exp(x) by the time derivative of the increment x.
    ///
    /// This is the inverse of the derivative of the exponential map, v + [x, v]/2 + [x, [x, v]]/12, exact to third
    /// order in x. It is the identity for joints with commuting motions.
    #[inline(always)]
    pub fn carry_back(&self, x: &[T], v: &mut [T]) {
        match self {
            Self::Spherical => spherical::carry_back(x, v),
            Self::Free => free::carry_back(x, v),
            _ => {}
        }
    }

    /// Displacement from the rest position in the child frame: the difference of coordinates; the rotation vector, of
    /// norm at most pi; for a free joint the translation, then the rotation vector. It is the gradient of half its
    /// square.
    #[inline(always)]
    pub fn displacement(&self, rest: &[T], q: &[T], out: &mut [T]) {
        match self {
            Self::Spherical => spherical::displacement(rest, q, out),
            Self::Free => free::displacement(rest, q, out),
            Self::Fixed => {}
            _ => out[0] = q[0] - rest[0],
        }
    }
}
