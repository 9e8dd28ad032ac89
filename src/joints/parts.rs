//! A joint as a sequence of elementary motions.

use super::Motion;
use crate::spatial::RigidShift;

/// A joint as a sequence of elementary motions. Each has the constant pose of its frame in that of the preceding motion
/// (for the first, in the joint frame); the last pose is that of the child frame in the frame of the last motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Parts {
    /// Constant poses and motions, beginning at the parent.
    pub motions: Vec<(RigidShift<f64>, Motion<f64>)>,
    /// Pose of the child frame in the frame of the last motion.
    pub end: RigidShift<f64>,
}
