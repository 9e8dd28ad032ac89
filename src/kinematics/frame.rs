//! A frame on a body, and the frame in which its motion is expressed.

use crate::error::{by_name, name_in, named};
use crate::scalar::Real;
use crate::spatial::{RigidShift, angular, linear, spatial, zero};
use nalgebra::{Vector3, Vector6};

/// A frame that moves with a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame<T> {
    /// Index of the body; None on the base, which does not move.
    pub body: Option<usize>,
    /// From the frame to the body's frame.
    pub placement: RigidShift<T>,
}

impl Frame<f64> {
    /// The same frame in another scalar, in every lane.
    #[inline(always)]
    pub(crate) fn cast<T: Real>(&self) -> Frame<T> {
        Frame { body: self.body, placement: self.placement.cast() }
    }
}

/// A link of a scene: the body that it is part of, and its pose on that body.
#[derive(Debug, Clone, PartialEq)]
pub struct Link {
    /// Name.
    pub name: String,
    /// Index of the moving body that carries it; `None` for the base.
    pub body: Option<usize>,
    /// Pose of the link frame in the body frame (or base frame).
    pub placement: RigidShift<f64>,
}

impl From<&Link> for Frame<f64> {
    fn from(link: &Link) -> Self {
        Self { body: link.body, placement: link.placement }
    }
}

named! {
    /// The frame in which the motion (angular, linear) of a frame on a link is expressed.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    #[non_exhaustive]
    enum ReferenceFrame;
    /// The reference frames with their names in Python.
    const REFERENCE_FRAMES {
        /// The frame itself: at its origin, in its axes.
        #[default]
        Local = "local",
        /// The base: the motion of the point of the link at the origin of the base, in the axes of the base.
        World = "world",
        /// At the origin of the frame, in the axes of the base.
        LocalWorldAligned = "local-world-aligned",
    }
}

by_name!(ReferenceFrame, "frame", REFERENCE_FRAMES);

impl ReferenceFrame {
    /// Its name among [`REFERENCE_FRAMES`].
    pub(crate) fn name(self) -> &'static str {
        name_in(&self, REFERENCE_FRAMES)
    }

    /// Expresses a motion of the frame at `placement`, given at its origin and in its axes, in this reference frame.
    #[inline(always)]
    pub fn express<T: Real>(self, placement: &RigidShift<T>, motion: &Vector6<T>) -> Vector6<T> {
        match self {
            Self::Local => *motion,
            Self::World => placement.motion_to_parent(motion),
            Self::LocalWorldAligned => spatial(&placement.rotate(&angular(motion)), &placement.rotate(&linear(motion))),
        }
    }

    /// The motion of the frame on the link relative to this reference frame, for its `velocity` relative to the base,
    /// in the axes of the former. The derivative in this frame of a vector that is constant in the former is this
    /// motion x the vector.
    #[inline(always)]
    pub(super) fn seen_from<T: Real>(self, velocity: &Vector6<T>) -> Vector6<T> {
        match self {
            Self::Local => zero(),
            Self::World => *velocity,
            Self::LocalWorldAligned => spatial(&angular(velocity), &Vector3::from_element(velocity[0].constant(0.0))),
        }
    }
}

named! {
    /// The kind of acceleration of a link.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    #[non_exhaustive]
    enum AccelerationKind;
    /// The kinds with their names in Python.
    const ACCELERATION_KINDS {
        /// The time derivative of the spatial velocity (w, v), as in the equations of motion; v belongs to the point of
        /// the body that is currently at the origin.
        #[default]
        Spatial = "spatial",
        /// The linear half is that of a material point, the second derivative of its position: w x v is added.
        Classical = "classical",
    }
}

by_name!(AccelerationKind, "kind", ACCELERATION_KINDS);
