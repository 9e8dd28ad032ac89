//! Screw joint: rotation about z with a translation along it by the pitch, m/rad.

use super::{prismatic, revolute};
use crate::scalar::Real;
use crate::spatial::RigidShift;

/// phi at this angle. 16 products.
#[inline(always)]
pub(super) fn shift<T: Real>(tree: &RigidShift<T>, pitch: T, angle: T) -> RigidShift<T> {
    RigidShift {
        rotation: revolute::turned_about_z(&tree.rotation, angle),
        lever: prismatic::along_z(tree, pitch * angle),
    }
}
