//! How a body hangs on its parent.

use super::constant_rotation::JointAxis;

/// What carries forces, motions and inertias across a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Carrier {
    /// A revolute joint.
    Axial(JointAxis),
    /// Any other, and what is left of those: index among them.
    Shift(usize),
}
