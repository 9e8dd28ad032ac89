//! A range of steps of adjacent states, and the destination of their rows.

use super::contact::RECORD;
use super::events::StopImpact;
use super::population::Population;
use super::step_settings::StepSettings;
use super::torque::Torque;
use super::touches::Touches;
use crate::scene::Scene;
use crate::setters::setters;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Destination of the recorded rows of adjacent states: (state, row, coordinate).
pub(super) struct Rows<'a> {
    pub q: &'a mut [f64],
    pub qd: &'a mut [f64],
    /// (state, row, contact, values); empty if contacts are not recorded.
    pub contacts: &'a mut [f64],
    /// Index of the first state.
    pub first: usize,
    /// Number of rows per state.
    pub of_state: usize,
    /// The step before which row 0 is written; further rows follow every `every` steps.
    pub from: usize,
    pub every: usize,
}

impl Rows<'_> {
    /// Writes row 0, the states at the start. `current` has `width` values per state, beginning with q (nq) and qd
    /// (nv).
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

    /// Destination of a row of contacts of a state, if contacts are recorded.
    pub fn of_contacts(&mut self, state: usize, row: usize, contacts: usize) -> Option<&mut [f64]> {
        let at = ((state - self.first) * self.of_state + row) * contacts * RECORD;
        self.contacts.get_mut(at..at + contacts * RECORD).filter(|row| !row.is_empty())
    }
}

/// The states of a job, by their indices in the batch.
#[derive(Debug, Clone)]
pub(super) enum States<'a> {
    Adjacent(Range<usize>),
    Listed(&'a [usize]),
}

impl States<'_> {
    pub fn len(&self) -> usize {
        match self {
            Self::Adjacent(range) => range.len(),
            Self::Listed(list) => list.len(),
        }
    }

    /// The index of the state of a lane.
    pub fn at(&self, lane: usize) -> usize {
        match self {
            Self::Adjacent(range) => range.start + lane,
            Self::Listed(list) => list[lane],
        }
    }
}

/// The starts of the substeps of steps that were divided.
#[derive(Debug, Default)]
pub(super) struct Divisions {
    /// The lane and the length of each substep, in order.
    pub of: Vec<(usize, f64)>,
    /// q and v at the start of each substep.
    pub starts: Vec<f64>,
}

impl Divisions {
    pub fn clear(&mut self) {
        self.of.clear();
        self.starts.clear();
    }

    pub fn add(&mut self, lane: usize, length: f64, (q, v): (&[f64], &[f64])) {
        self.of.push((lane, length));
        self.starts.extend(q.iter().chain(v));
    }
}

/// The models of states that differ, and the scene that they vary.
pub(super) type Models<'a> = (&'a Population, &'a Scene);

/// A range of steps of some states, at most one state per lane.
pub(super) struct Job<'a, 'r> {
    pub scene: &'a Scene,
    pub settings: &'a StepSettings,
    /// The models of the states, if they differ.
    pub models: Option<Models<'a>>,
    /// The steps, counted from the start of the run.
    pub steps: Range<usize>,
    pub states: States<'a>,
    /// The step at which each state began.
    pub begun: &'a [usize],
    /// The [`StepSettings::width`] values of each state, one state after another; input and output.
    pub current: &'a mut [f64],
    pub torque: &'a Torque<'a>,
    pub rows: Option<&'a mut Rows<'r>>,
    /// Destination of the impacts on stops.
    pub impacts: Option<&'a Impacts>,
    /// Destination of the contacts of shapes.
    pub touches: Option<&'a Touches>,
    /// Destination of the substeps of a step without contacts.
    pub divisions: Option<&'a mut Divisions>,
}

impl<'a> Job<'a, '_> {
    /// Steps of states of a scene from their `current` values, of which nothing else is stored.
    pub fn of(
        (scene, settings): (&'a Scene, &'a StepSettings),
        (steps, states): (Range<usize>, States<'a>),
        (current, torque): (&'a mut [f64], &'a Torque<'a>),
    ) -> Self {
        Self {
            scene,
            settings,
            models: None,
            steps,
            states,
            begun: &[],
            current,
            torque,
            rows: None,
            impacts: None,
            touches: None,
            divisions: None,
        }
    }
}

/// Destination of recorded rows: (states, rows, nq) and (states, rows, nv). Row 0 is the state at the start, row i the
/// state after i * every steps.
#[derive(Debug)]
#[non_exhaustive]
pub struct Records<'a> {
    /// Configurations.
    pub q: &'a mut [f64],
    /// Joint velocities.
    pub qd: &'a mut [f64],
    /// For a scene with contacts, (states, rows, contacts, 11) in the base frame: gap (m), slip velocity (3, m/s),
    /// force on the first link during the step that ends at the row (3, N), sum of the impulses of impacts since the
    /// previous row (3, N s), and the index of the [`ContactState`](super::ContactState) during that step, open in the
    /// first row. Empty if contacts are not recorded.
    pub contacts: &'a mut [f64],
    /// Number of steps between rows.
    pub every: usize,
}

impl<'a> Records<'a> {
    /// A row per step, without contacts.
    #[must_use]
    pub fn new(q: &'a mut [f64], qd: &'a mut [f64]) -> Self {
        Self { q, qd, contacts: &mut [], every: 1 }
    }
}

setters!(Records<'a> { with_contacts: contacts: &'a mut [f64], with_every: every: usize });

/// Impacts on stops, collected from all threads.
#[derive(Debug, Default)]
pub(super) struct Impacts {
    found: Mutex<Vec<StopImpact>>,
}

/// The largest number of impacts that a run reports.
const MOST_IMPACTS: usize = 1 << 20;

impl Clone for Impacts {
    fn clone(&self) -> Self {
        Self { found: Mutex::new(self.found.lock().unwrap_or_else(PoisonError::into_inner).clone()) }
    }
}

impl Impacts {
    /// Adds the impacts of one step of a state that begins at `time`.
    pub fn add(&self, impacts: &[StopImpact], state: usize, time: f64) {
        let mut found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
        if found.len() < MOST_IMPACTS {
            found.extend(impacts.iter().map(|impact| StopImpact { state, time: time + impact.time, ..*impact }));
        }
    }

    /// Returns all impacts sorted by state and time, and clears the list.
    pub fn take(&self) -> Vec<StopImpact> {
        let mut all = std::mem::take(&mut *self.found.lock().unwrap_or_else(PoisonError::into_inner));
        all.sort_by(|a, b| a.state.cmp(&b.state).then(a.time.total_cmp(&b.time)).then(a.row.cmp(&b.row)));
        all
    }
}
