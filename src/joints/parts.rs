//! A joint as the motions that it is made of.

use super::Motion;
use crate::spatial::RigidShift;

/// A joint as motions one after another: of each the shift from its frame at zero to that of the one before (of the first to the joint's), and
/// last that from the child's frame to the last one's.
#[derive(Debug, Clone, PartialEq)]
pub struct Parts {
    /// Shifts and motions, from the parent on.
    pub motions: Vec<(RigidShift<f64>, Motion<f64>)>,
    /// From the child's frame to that of the last motion.
    pub end: RigidShift<f64>,
}
