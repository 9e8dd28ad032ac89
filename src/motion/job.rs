//! Some steps of neighboring states, and where their rows go.

use super::contact::RECORD;
use super::step_settings::StepSettings;
use super::substeps::StopImpact;
use super::torque::Torque;
use crate::scene::Scene;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Where the recorded rows of a few neighboring states go: (state, row, coordinate).
pub(super) struct Rows<'a> {
    pub q: &'a mut [f64],
    pub qd: &'a mut [f64],
    /// (state, row, contact, numbers); empty where they are not recorded.
    pub contacts: &'a mut [f64],
    /// Index of the first of the states.
    pub first: usize,
    /// How many rows a state has room for.
    pub of_state: usize,
    /// The step that the first row is before; a row is written after every so many steps from there on.
    pub from: usize,
    pub every: usize,
}

impl Rows<'_> {
    /// Row 0: the states at the start, of values of so many coordinates, joint velocities and values in all per state.
    pub fn record_start(&mut self, states: Range<usize>, current: &[f64], (nq, nv, width): (usize, usize, usize)) {
        if nq == 0 {
            return;
        }
        for (state, values) in states.zip(current.chunks_exact(width)) {
            let at = (state - self.first) * self.of_state;
            let (q, qd) = values[..nq + nv].split_at(nq);
            self.q[at * nq..(at + 1) * nq].copy_from_slice(q);
            self.qd[at * nv..(at + 1) * nv].copy_from_slice(qd);
        }
    }

    /// Where a row of the contacts of a state goes, if they are recorded.
    pub fn of_contacts(&mut self, state: usize, row: usize, contacts: usize) -> Option<&mut [f64]> {
        let at = ((state - self.first) * self.of_state + row) * contacts * RECORD;
        self.contacts.get_mut(at..at + contacts * RECORD).filter(|row| !row.is_empty())
    }
}

/// Some steps of neighboring states, as many as there are lanes or fewer.
pub(super) struct Job<'a, 'r> {
    pub scene: &'a Scene,
    pub settings: &'a StepSettings,
    /// The steps, counted from the start of the run.
    pub steps: Range<usize>,
    /// Which states of the batch.
    pub states: Range<usize>,
    /// The step that each of them began at.
    pub begun: &'a [usize],
    /// The values of [`StepSettings::width`] of each, one after another; in and out.
    pub current: &'a mut [f64],
    pub torque: &'a Torque<'a>,
    pub rows: Option<&'a mut Rows<'r>>,
    /// Where impacts on stops go.
    pub impacts: Option<&'a Impacts>,
}

/// Impacts on stops, from all threads.
#[derive(Debug, Default)]
pub(super) struct Impacts {
    found: Mutex<Vec<StopImpact>>,
}

/// The largest number of impacts that a run reports.
const MOST_IMPACTS: usize = 1 << 20;

impl Impacts {
    /// Those of one step of a state, which begins at `time`.
    pub fn add(&self, impacts: &[StopImpact], state: usize, time: f64) {
        let mut found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
        if found.len() < MOST_IMPACTS {
            found.extend(impacts.iter().map(|impact| StopImpact { state, time: time + impact.time, ..*impact }));
        }
    }

    /// All of them, by state and time, and none afterwards.
    pub fn take(&self) -> Vec<StopImpact> {
        let mut all = std::mem::take(&mut *self.found.lock().unwrap_or_else(PoisonError::into_inner));
        all.sort_by(|a, b| a.state.cmp(&b.state).then(a.time.total_cmp(&b.time)).then(a.row.cmp(&b.row)));
        all
    }
}
