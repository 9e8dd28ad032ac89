//! A frame on a body, and the frame that its motion is written in.

use crate::scalar::Real;
use crate::spatial::{RigidShift, angular, linear, spatial, zero};
use nalgebra::{Vector3, Vector6};

/// A frame that moves with a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame<T> {
    /// Index of the body; none on the base, which does not move.
    pub body: Option<usize>,
    /// From the frame to the body's frame.
    pub placement: RigidShift<T>,
}

impl Frame<f64> {
    /// The same in another scalar, in every lane.
    #[inline(always)]
    pub(crate) fn cast<T: Real>(&self) -> Frame<T> {
        Frame { body: self.body, placement: self.placement.cast() }
    }
}

/// The frame in which the motion (angular, linear) of a frame on a link is expressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ReferenceFrame {
    /// The frame itself: at its origin, in its axes.
    #[default]
    Local,
    /// The base: of the point of the link that passes the base's origin, in the base's axes.
    World,
    /// At the frame's origin, in the base's axes.
    LocalWorldAligned,
}

/// The three by the names of Python.
pub const REFERENCE_FRAMES: [(&str, ReferenceFrame); 3] = [
    ("local", ReferenceFrame::Local),
    ("world", ReferenceFrame::World),
    ("local-world-aligned", ReferenceFrame::LocalWorldAligned),
];

impl ReferenceFrame {
    /// Its name among [`REFERENCE_FRAMES`].
    pub(crate) fn name(self) -> &'static str {
        REFERENCE_FRAMES.iter().find(|(_, known)| *known == self).map_or("local", |(name, _)| name)
    }

    /// A motion of the frame at `placement` on the base, given in its own axes at its origin, in this frame.
    #[inline(always)]
    pub fn express<T: Real>(self, placement: &RigidShift<T>, motion: &Vector6<T>) -> Vector6<T> {
        match self {
            Self::Local => *motion,
            Self::World => placement.motion_to_parent(motion),
            Self::LocalWorldAligned => spatial(&placement.rotate(&angular(motion)), &placement.rotate(&linear(motion))),
        }
    }

    /// How the frame on the link moves against this one, where it moves with `velocity` against the base: all in the
    /// former's axes. What is constant in the former changes in this one at the rate of this motion x it.
    #[inline(always)]
    pub(super) fn seen_from<T: Real>(self, velocity: &Vector6<T>) -> Vector6<T> {
        match self {
            Self::Local => zero(),
            Self::World => *velocity,
            Self::LocalWorldAligned => spatial(&angular(velocity), &Vector3::from_element(velocity[0].constant(0.0))),
        }
    }
}

/// Which acceleration of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AccelerationKind {
    /// The rate of the spatial velocity (w, v), as in the equations of motion: v is that of whatever point passes by.
    #[default]
    Spatial,
    /// The linear half is that of one point, the second derivative of where it is: w x v more.
    Classical,
}

/// Both by the names of Python.
pub const ACCELERATION_KINDS: [(&str, AccelerationKind); 2] =
    [("spatial", AccelerationKind::Spatial), ("classical", AccelerationKind::Classical)];
