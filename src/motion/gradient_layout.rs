//! The layout of the gradients of a rollout, and the recorded rows that they are computed from.

use super::backward::{ACTING, INPUTS};
use super::contact::ContactReverse;
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

/// Layout of the gradients of one state: by q, qd, armature, damping, stiffness and friction, then torques, targets and
/// target velocities, then wrenches, then contacts, then parameters.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    pub nv: usize,
    /// Number of vectors of torques, of targets and of target velocities: one, or one per step; none without a control
    /// law.
    pub inputs: [usize; INPUTS],
    /// Number of links with wrenches, and number of wrenches of each: one, or one per step.
    pub links: usize,
    pub wrenches: usize,
    /// Zero if parameters are not requested.
    pub bodies: usize,
    pub contacts: usize,
}

impl Layout {
    /// Number of gradients with (nv) entries.
    const OF_ROWS: usize = ACTING - INPUTS + 2;

    pub fn width(&self) -> usize {
        let inputs = self.inputs.iter().fold(Self::OF_ROWS, |sum, count| sum.saturating_add(*count));
        inputs.saturating_mul(self.nv).saturating_add(self.beyond())
    }

    /// Number of gradients by wrenches, contacts and parameters.
    fn beyond(&self) -> usize {
        let wrenches = self.wrenches.saturating_mul(6 * self.links);
        wrenches.saturating_add(ContactReverse::WIDTH * self.contacts + 10 * self.bodies)
    }

    /// The wrenches on all links in one step, or in all.
    pub fn wrench(&self, index: usize) -> Range<usize> {
        let width = 6 * self.links;
        let first = self.width() - self.beyond() + index * width;
        first..first + width
    }

    /// The wrenches in all steps.
    pub fn all_wrenches(&self) -> Range<usize> {
        let first = self.wrench(0).start;
        first..first + self.wrenches * 6 * self.links
    }

    pub fn contacts(&self) -> Range<usize> {
        let first = self.all_wrenches().end;
        first..first + ContactReverse::WIDTH * self.contacts
    }

    /// An input in one step, or in all.
    pub fn input(&self, which: usize, index: usize) -> Range<usize> {
        let first = (Self::OF_ROWS + self.inputs[..which].iter().sum::<usize>() + index) * self.nv;
        first..first + self.nv
    }

    /// An input in all steps.
    pub fn all(&self, which: usize) -> Range<usize> {
        let first = self.input(which, 0).start;
        first..first + self.inputs[which] * self.nv
    }

    pub fn parameters(&self) -> Range<usize> {
        let width = self.width();
        width - 10 * self.bodies..width
    }
}
