//! The kinds of joints that people name.

use super::frames::{axis_onto_z, turn};
use super::parts::Parts;
use super::{Motion, free, planar, spherical, universal};
use crate::spatial::RigidShift;
use nalgebra::Vector3;
use std::ops::Range;

/// The kind of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum JointKind {
    /// No motion: the child is merged into its parent.
    Fixed,
    /// Rotation about the axis, rad; with limits, as a rule.
    Revolute,
    /// Rotation about the axis, rad, without limits. The same dynamics as revolute.
    Continuous,
    /// Translation along the axis, m.
    Prismatic,
    /// Rotation about the axis that advances along it.
    Screw {
        /// Advance, m/rad.
        pitch: f64,
    },
    /// Motion in the plane whose normal is the axis: (u, v, theta), m, m, rad.
    Planar,
    /// Two angles about perpendicular axes, rad: about x, then about y of the frame that has turned so far. A Cardan joint.
    Universal,
    /// Quaternion (x, y, z, w); rates are the angular velocity in the child's frame.
    Spherical,
    /// Position and quaternion; rates are linear, then angular velocity in the child's frame.
    Floating,
}

impl JointKind {
    /// Those that have no number of their own: a screw has its pitch.
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

    /// The neutral coordinates: zero, quaternions the identity.
    #[must_use]
    pub fn neutral(self) -> Vec<f64> {
        let mut neutral = vec![0.0; self.nq()];
        if let (Self::Spherical | Self::Floating, Some(scalar)) = (self, neutral.last_mut()) {
            *scalar = 1.0;
        }
        neutral
    }

    /// Whether the joint's axis means anything.
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

    /// Where its quaternion is among its coordinates, if it has one.
    #[must_use]
    pub fn quaternion(self) -> Option<Range<usize>> {
        match self {
            Self::Spherical => Some(0..4),
            Self::Floating => Some(3..7),
            _ => None,
        }
    }

    /// The motions that it is made of, one after another, about this axis.
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

    /// The coordinates from `q` along the rates `v` for unit time, of a checked configuration; quaternions come out unit.
    pub(crate) fn integrate(self, q: &[f64], v: &[f64], out: &mut [f64]) {
        match self {
            Self::Spherical => spherical::integrate(q, v, out),
            Self::Floating => free::integrate(q, v, out),
            _ => out.iter_mut().zip(q.iter().zip(v)).for_each(|(out, (q, v))| *out = q + v),
        }
    }

    /// The rates that take `q0` to `q1` in unit time: the inverse of [`integrate`](Self::integrate).
    pub(crate) fn difference(self, q0: &[f64], q1: &[f64], out: &mut [f64]) {
        match self {
            Self::Spherical => spherical::difference(q0, q1, out),
            Self::Floating => free::difference(q0, q1, out),
            _ => out.iter_mut().zip(q0.iter().zip(q1)).for_each(|(out, (q0, q1))| *out = q1 - q0),
        }
    }
}
