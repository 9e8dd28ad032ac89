//! Backpropagation through the steps of some states.

use crate::error::Error;
use crate::motion::contact::{ModeChange, ShapeGradients};
use crate::motion::gradient_layout::{Layout, RecordedRows};
use crate::motion::step_settings::StepSettings;
use crate::motion::torque::{StepFault, Torque};
use crate::scene::Scene;
use std::ops::Range;
use std::sync::Mutex;

/// Backpropagation for adjacent states, at most one per lane.
pub(in crate::motion) struct Job<'a> {
    pub scene: &'a Scene,
    pub settings: &'a StepSettings,
    pub torque: &'a Torque<'a>,
    pub rows: &'a RecordedRows<'a>,
    /// Number of rows per state.
    pub count: usize,
    pub states: Range<usize>,
    pub layout: Layout,
    /// Destination of the changes of contacts.
    pub changes: &'a Mutex<Vec<ModeChange>>,
    /// Destination of the gradients by pairs of shapes.
    pub shapes: &'a Mutex<Vec<ShapeGradients>>,
}

impl Job<'_> {
    /// Reads (q, qd) of a recorded row of each state, one state after another.
    pub fn row(&self, row: usize, into: &mut Vec<f64>) {
        let (nq, nv) = (self.scene.nq(), self.scene.nv());
        into.clear();
        for state in self.states.clone() {
            let at = state * self.count + row;
            into.extend_from_slice(&self.rows.q[at * nq..(at + 1) * nq]);
            into.extend_from_slice(&self.rows.qd[at * nv..(at + 1) * nv]);
        }
    }

    pub fn refuse(&self, error: Error) -> StepFault {
        StepFault { step: 0, state: self.states.start, joint: String::new(), error }
    }
}
