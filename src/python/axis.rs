//! What the entries along the last axis of an argument belong to.

use crate::scene::{JointKind, Scene};

/// The owner of each entry: arguments with names are matched by it.
#[derive(Clone, Copy)]
pub(super) enum Axis<'a> {
    /// So many numbers that no name of ours stands for.
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
    /// How many entries.
    pub fn width(self) -> usize {
        match self {
            Self::Plain(width) => width,
            Self::Coordinates(scene) => scene.nq(),
            Self::Rates(scene) => scene.nv(),
            Self::Joints(scene) => scene.joints().len(),
        }
    }

    /// Every joint with the number of its entries, in their order; none where no joint has any.
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
