//! Meaning of the entries along the last axis of an argument.

use crate::scene::{JointKind, Scene};

/// Meaning of each entry; labeled arguments are matched by it.
#[derive(Clone, Copy)]
pub(super) enum Axis<'a> {
    /// Entries without names.
    Plain(usize),
    /// Coordinates, as in q.
    Coordinates(&'a Scene),
    /// Degrees of freedom, as in qd and tau.
    Rates(&'a Scene),
    /// Movable joints.
    Joints(&'a Scene),
}

impl From<usize> for Axis<'_> {
    fn from(width: usize) -> Self {
        Self::Plain(width)
    }
}

impl<'a> Axis<'a> {
    /// Number of entries.
    pub fn width(self) -> usize {
        match self {
            Self::Plain(width) => width,
            Self::Coordinates(scene) => scene.nq(),
            Self::Rates(scene) => scene.nv(),
            Self::Joints(scene) => scene.joints().len(),
        }
    }

    /// Joints with their numbers of entries, in order; None if the entries do not belong to joints.
    pub fn joints(self) -> Option<Vec<(&'a str, usize)>> {
        let (scene, count): (&Scene, fn(JointKind) -> usize) = match self {
            Self::Plain(_) => return None,
            Self::Coordinates(scene) => (scene, JointKind::nq),
            Self::Rates(scene) => (scene, JointKind::nv),
            Self::Joints(scene) => (scene, |_| 1),
        };
        Some(scene.joints().iter().map(|joint| (joint.name.as_str(), count(joint.kind))).collect())
    }
}
