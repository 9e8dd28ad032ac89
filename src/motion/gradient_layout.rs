//! The layout of the gradients of a rollout, and the recorded rows that they are computed from.

use super::backward::{ACTING, INPUTS};
use std::ops::Range;

/// The recorded rows of a rollout (see [`Records`](super::Records)), and the gradients of a scalar by them.
#[derive(Debug, Clone, Copy)]
pub struct RecordedRows<'a> {
    /// Configurations, (states, rows, nq); the first row is the start.
    pub q: &'a [f64],
    /// Joint velocities, (states, rows, nv).
    pub qd: &'a [f64],
    /// Number of steps between rows.
    pub every: usize,
    /// Gradients by `q`, in the tangent space of each row, (states, rows, nv).
    pub by_q: &'a [f64],
    /// Gradients by `qd`, (states, rows, nv).
    pub by_qd: &'a [f64],
}

/// Layout of the gradients of one state: the number of vectors of each part, and their length.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    /// By q, qd, armature, damping, stiffness and friction, (nv) each; then by torques, targets and target velocities,
    /// one vector, or one per step, none without a control law; then by the wrenches on all links, one vector, or one
    /// per step; then by contacts; then by the parameters of bodies, none if they are not requested.
    pub parts: [[usize; 2]; 4 + INPUTS],
}

/// The indices of the parts; the inputs begin at `INPUT`.
pub(super) const ROWS: usize = 0;
pub(super) const INPUT: usize = 1;
pub(super) const WRENCHES: usize = INPUT + INPUTS;
pub(super) const CONTACTS: usize = WRENCHES + 1;
pub(super) const PARAMETERS: usize = CONTACTS + 1;

impl Layout {
    /// Number of gradients with (nv) entries.
    pub const OF_ROWS: usize = ACTING - INPUTS + 2;

    pub fn width(&self) -> usize {
        self.parts.iter().fold(0, |sum: usize, [count, length]| sum.saturating_add(count.saturating_mul(*length)))
    }

    /// Number of vectors of a part.
    pub fn count(&self, part: usize) -> usize {
        self.parts[part][0]
    }

    /// A vector of a part.
    pub fn one(&self, part: usize, index: usize) -> Range<usize> {
        let [_, length] = self.parts[part];
        let first = self.parts[..part].iter().map(|[count, length]| count * length).sum::<usize>() + index * length;
        first..first + length
    }

    /// All vectors of a part.
    pub fn all(&self, part: usize) -> Range<usize> {
        let (first, [count, length]) = (self.one(part, 0).start, self.parts[part]);
        first..first + count * length
    }
}
