//! The constants of the bodies as the passes read them: one number for all lanes, in the [frames](super::frames) of the
//! passes. Their inertias are [`Load`](super::load::Load)s.

use super::frames::AxisPermutation;
use super::joint::Joint;
use super::slots::Places;
use crate::spatial::transform::Offset;

/// One body.
#[allow(clippy::struct_excessive_bools)] // independent facts
#[derive(Debug, Clone, PartialEq)]
pub(in crate::dynamics) struct SweepBody<N> {
    pub joint: Joint,
    /// For a revolute joint 1, or -1 if its z axis is reversed: velocity, acceleration and torque are those about z,
    /// times this.
    pub sense: N,
    /// From its frame in the model to its frame in the passes.
    pub frame: AxisPermutation<N>,
    /// Its index in the model, and that of its parent.
    pub index: usize,
    pub parent: Option<usize>,
    /// Its first row.
    pub row: usize,
    /// For a revolute joint, from the origin of the parent to that of the body, in the frame of the joint: that of the
    /// body at angle zero, or of the parent for an oblique axis.
    pub offset: Offset<N>,
    /// The same in the frame of the parent, for the acceleration of the origin.
    pub offset_at_parent: Offset<N>,
    /// True if the weights of its root are positive, and those of its parent's root.
    pub is_definite: bool,
    pub hangs_on_definite: bool,
    pub places: Places,
    /// True if it has no children.
    pub is_leaf: bool,
    /// One past the place of its first child on a revolute joint, and of the next such child of its parent; 0 if there
    /// is none.
    pub first_axial: usize,
    pub next_axial: usize,
    /// True if it has a child on another kind of joint.
    pub carries_others: bool,
    /// The number of rows between the base and its own.
    pub depth: usize,
    /// One past the last row outboard of it.
    pub end_row: usize,
}

/// Links each of the bodies, in the order of the passes, with its children.
pub(in crate::dynamics) fn link_children<N>(swept: &mut [SweepBody<N>]) {
    for place in (0..swept.len()).rev() {
        let Some(parent) = swept[place].places.parent.checked_sub(1) else { continue };
        if let Joint::Axial(_) = swept[place].joint {
            swept[place].next_axial = swept[parent].first_axial;
            swept[parent].first_axial = place + 1;
        } else {
            swept[parent].carries_others = true;
        }
    }
}

/// The angle of a revolute joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::dynamics) struct Turning<N> {
    /// The joint's coordinate.
    pub q: usize,
    /// The body's place in the order of the passes.
    pub place: usize,
    /// 1, or -1 if the z axis is reversed.
    pub sense: N,
    /// Sine and cosine of the constant angle that is added, if there is one.
    pub offset: Option<[N; 2]>,
}
