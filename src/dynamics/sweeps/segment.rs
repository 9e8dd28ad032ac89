//! What motions, forces and co-states need of a body.
//!
//! It is apart from the rest, and in the order of the sweeps: scenes that no cache holds take as long as it takes to read them.

use super::body::SweepBody;
use super::carrier::Carrier;
use super::lever::Lever;
use super::slots::bodies_inward;
use super::spin::Load;

/// One body.
#[allow(clippy::struct_excessive_bools)] // facts, each by itself
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Segment<N> {
    pub carrier: Carrier,
    /// As [`SweepBody`] has them.
    pub sense: N,
    pub index: usize,
    pub row: usize,
    pub is_about_z: bool,
    pub is_free_joint: bool,
    pub is_leaf: bool,
    /// Whether it hangs on the base.
    pub is_on_base: bool,
    /// Of a revolute joint, from the parent's origin to the body's, in the parent's frame.
    pub arm: Lever<N>,
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
    /// Whether its co-state comes right after its parent's, with nothing to do meanwhile: no other body is at its depth.
    pub waits_for_parent: bool,
}

/// What a body has here and nowhere else, but for what follows from the others.
#[derive(Debug, Clone)]
pub(super) struct OfSegment<N> {
    pub arm: Lever<N>,
    pub load: Load<N>,
    pub waits_for_parent: bool,
}

/// Of each body whether no other is at its depth.
pub(super) fn alone_at_depth(parents: &[Option<usize>]) -> Vec<bool> {
    let (depths, mut bodies_at) = (bodies_inward(parents), vec![0; parents.len()]);
    for &depth in &depths {
        bodies_at[depth] += 1;
    }
    depths.into_iter().map(|depth| bodies_at[depth] == 1).collect()
}

impl<N: Copy> Segment<N> {
    /// Of a body in the order of the sweeps, that nothing hangs on yet.
    fn new(body: &SweepBody<N>, own: OfSegment<N>) -> Self {
        let OfSegment { arm, load, waits_for_parent } = own;
        Self {
            carrier: body.carrier,
            sense: body.sense,
            index: body.index,
            row: body.row,
            is_about_z: body.is_about_z,
            is_free_joint: body.is_free_joint,
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
            waits_for_parent,
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
        if let Carrier::Axial(_) = segments[place].carrier {
            segments[place].next_turn = segments[parent].first_turn;
            segments[parent].first_turn = place + 1;
        } else {
            segments[parent].carries_shifts = true;
        }
    }
    segments
}
