//! What motions, forces and co-states need of a body.
//!
//! It is apart from the rest, and in the order of the sweeps: scenes that no cache holds take as long as it takes to read them.

use super::body::SweepBody;
use super::joint::Joint;
use super::spin::Load;
use crate::spatial::transform::Offset;

/// One body.
#[allow(clippy::struct_excessive_bools)] // facts, each by itself
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Segment<N> {
    pub joint: Joint,
    /// As [`SweepBody`] has them.
    pub sense: N,
    pub index: usize,
    pub row: usize,
    pub is_leaf: bool,
    /// Whether it hangs on the base.
    pub is_on_base: bool,
    /// Of a revolute joint, from the parent's origin to the body's, in the parent's frame.
    pub arm: Offset<N>,
    /// The body as its force sees it.
    pub load: Load<N>,
    /// Where its motion and its co-state are, and its parent's; one past its parent.
    pub outward: usize,
    pub parent_outward: usize,
    pub parent: usize,
    /// One past the place of the first turn that hangs on it, and of the next one on its own parent; 0 where there is none.
    pub first_turn: usize,
    pub next_turn: usize,
    /// Whether anything but turns hangs on it.
    pub carries_shifts: bool,
}

/// What a body has here and nowhere else, but for what follows from the others.
#[derive(Debug, Clone)]
pub(super) struct OfSegment<N> {
    pub arm: Offset<N>,
    pub load: Load<N>,
}

impl<N: Copy> Segment<N> {
    /// Of a body in the order of the sweeps, that nothing hangs on yet.
    fn new(body: &SweepBody<N>, own: OfSegment<N>) -> Self {
        let OfSegment { arm, load } = own;
        Self {
            joint: body.joint,
            sense: body.sense,
            index: body.index,
            row: body.row,
            is_leaf: body.is_leaf,
            is_on_base: body.parent.is_none(),
            arm,
            load,
            outward: body.places.outward,
            parent_outward: body.places.parent_outward,
            parent: body.places.parent,
            first_turn: 0,
            next_turn: 0,
            carries_shifts: false,
        }
    }
}

/// Those of all bodies in the order of the sweeps.
pub(super) fn segments<N: Copy>(swept: &[SweepBody<N>], own: impl Fn(usize) -> OfSegment<N>) -> Vec<Segment<N>> {
    let of = |body: &SweepBody<N>| Segment::new(body, own(body.index));
    let mut segments: Vec<_> = swept.iter().map(of).collect();
    // Of each which turns hang on it.
    for place in (0..segments.len()).rev() {
        let Some(parent) = segments[place].parent.checked_sub(1) else { continue };
        if let Joint::Axial(_) = segments[place].joint {
            segments[place].next_turn = segments[parent].first_turn;
            segments[parent].first_turn = place + 1;
        } else {
            segments[parent].carries_shifts = true;
        }
    }
    segments
}
