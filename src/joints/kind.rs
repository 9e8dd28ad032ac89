//! The joint types of scene descriptions.

use super::frames::{axis_onto_z, turn};
use super::parts::Parts;
use super::{Motion, free, planar, spherical, universal};
use crate::spatial::RigidShift;
use nalgebra::Vector3;
use std::ops::Range;

/// The type of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum JointKind {
    /// No motion: the child link is merged into its parent.
    Fixed,
    /// Rotation about the axis, rad; usually with limits.
    Revolute,
    /// Rotation about the axis, rad, without limits. The dynamics are those of a revolute joint.
    Continuous,
    /// Translation along the axis, m.
    Prismatic,
    /// Rotation about the axis with a proportional translation along it.
    Screw {
        /// Pitch: translation per rotation, m/rad.
        pitch: f64,
    },
    /// Motion in the plane perpendicular to the axis: (u, v, theta), m, m, rad.
    Planar,
    /// Universal (Cardan) joint: two angles about perpendicular axes, rad, about x and then about y of the rotated
    /// frame.
    Universal,
    /// Quaternion (x, y, z, w); joint velocities are the angular velocity in the child frame.
    Spherical,
    /// Position and quaternion; joint velocities are the linear, then the angular velocity in the child frame.
    Floating,
}

impl JointKind {
    /// The types without a parameter, that is, all except the screw.
    #[doc(hidden)]
    pub const PLAIN: [Self; 8] = [
        Self::Fixed,
        Self::Revolute,
        Self::Continuous,
        Self::Prismatic,
        Self::Planar,
        Self::Universal,
        Self::Spherical,
        Self::Floating,
    ];

    /// Number of coordinates in q.
    #[must_use]
    pub fn nq(self) -> usize {
        match self {
            Self::Fixed => 0,
            Self::Revolute | Self::Continuous | Self::Prismatic | Self::Screw { .. } => 1,
            Self::Universal => 2,
            Self::Planar => 3,
            Self::Spherical => 4,
            Self::Floating => 7,
        }
    }

    /// Number of degrees of freedom.
    #[must_use]
    pub fn nv(self) -> usize {
        match self {
            Self::Spherical => 3,
            Self::Floating => 6,
            other => other.nq(),
        }
    }

    /// The neutral coordinates: zero, and the identity for quaternions.
    #[must_use]
    pub fn neutral(self) -> Vec<f64> {
        let mut neutral = vec![0.0; self.nq()];
        if let (Self::Spherical | Self::Floating, Some(scalar)) = (self, neutral.last_mut()) {
            *scalar = 1.0;
        }
        neutral
    }

    /// True if the axis of the joint has a meaning.
    #[must_use]
    pub(crate) fn has_axis(self) -> bool {
        !matches!(self, Self::Fixed | Self::Universal | Self::Spherical | Self::Floating)
    }

    /// The name used in URDF, in Python and in messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Fixed => "fixed",
            Self::Revolute => "revolute",
            Self::Continuous => "continuous",
            Self::Prismatic => "prismatic",
            Self::Screw { .. } => "screw",
            Self::Planar => "planar",
            Self::Universal => "universal",
            Self::Spherical => "spherical",
            Self::Floating => "floating",
        }
    }

    /// The range of its quaternion among its coordinates, if it has one.
    #[must_use]
    pub fn quaternion(self) -> Option<Range<usize>> {
        match self {
            Self::Spherical => Some(0..4),
            Self::Floating => Some(3..7),
            _ => None,
        }
    }

    /// The elementary motions that compose the joint, for the given axis.
    #[must_use]
    #[doc(hidden)]
    pub fn parts(self, axis: &Vector3<f64>) -> Parts {
        let one = |motion| {
            let align = axis_onto_z(axis);
            Parts { motions: vec![(turn(align), motion)], end: turn(align.transpose()) }
        };
        let as_it_is = |motion| Parts { motions: vec![(RigidShift::identity(), motion)], end: RigidShift::identity() };
        match self {
            Self::Fixed => Parts { motions: Vec::new(), end: RigidShift::identity() },
            Self::Revolute | Self::Continuous => one(Motion::Revolute),
            Self::Prismatic => one(Motion::Prismatic),
            Self::Screw { pitch } => one(Motion::Screw(pitch)),
            Self::Planar => planar::parts(axis),
            Self::Universal => universal::parts(),
            Self::Spherical => as_it_is(Motion::Spherical),
            Self::Floating => as_it_is(Motion::Free),
        }
    }

    /// Integrates the joint velocity `v` from `q` over unit time, for a checked configuration; quaternions are
    /// normalized.
    pub(crate) fn integrate(self, q: &[f64], v: &[f64], out: &mut [f64]) {
        match self {
            Self::Spherical => spherical::integrate(q, v, out),
            Self::Floating => free::integrate(q, v, out),
            _ => out.iter_mut().zip(q.iter().zip(v)).for_each(|(out, (q, v))| *out = q + v),
        }
    }

    /// The joint velocity that moves `q0` to `q1` in unit time: the inverse of [`integrate`](Self::integrate).
    pub(crate) fn difference(self, q0: &[f64], q1: &[f64], out: &mut [f64]) {
        match self {
            Self::Spherical => spherical::difference(q0, q1, out),
            Self::Floating => free::difference(q0, q1, out),
            _ => out.iter_mut().zip(q0.iter().zip(q1)).for_each(|(out, (q0, q1))| *out = q1 - q0),
        }
    }
}
