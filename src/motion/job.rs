//! What a rollout asks of a stepper: torques, states, steps, rows to record, and the fault that may come back.

use super::contact::RECORD;
use super::step::Law;
use crate::batch::Broadcast;
use crate::error::Error;
use crate::scene::Scene;
use std::ops::Range;

/// The torques that are given, (nv), held over each step; springs, damping, friction and control law come to them.
#[derive(Debug, Clone)]
pub enum Torque<'a> {
    /// None.
    Zero,
    /// The same in every step: (nv) a state.
    Constant(Broadcast<'a>),
    /// Their own in every step: (steps, nv) a state.
    Steps {
        /// The torques.
        torque: Broadcast<'a>,
        /// The step of the run that the first are for.
        first: usize,
    },
}

/// The earliest step that failed, and in it the lowest state of those that are known to have.
#[derive(Debug, Clone, PartialEq)]
pub struct StepFault {
    /// Index of the step, from zero: so many were finished in every state.
    pub step: usize,
    /// Index of the state in the batch.
    pub state: usize,
    /// The joint at fault.
    pub joint: String,
    /// What was wrong.
    pub error: Error,
}

/// Where the recorded rows of a few neighbouring states go: (state, row, coordinate).
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
    /// Where a row of the contacts of a state goes, if they are recorded.
    pub fn of_contacts(&mut self, state: usize, row: usize, contacts: usize) -> Option<&mut [f64]> {
        let at = ((state - self.first) * self.of_state + row) * contacts * RECORD;
        self.contacts.get_mut(at..at + contacts * RECORD).filter(|row| !row.is_empty())
    }
}

/// Some steps of neighbouring states, as many as there are lanes or fewer.
pub(super) struct Job<'a, 'r> {
    pub scene: &'a Scene,
    pub law: &'a Law,
    /// The steps, counted from the start of the run.
    pub steps: Range<usize>,
    /// Which states of the batch.
    pub states: Range<usize>,
    /// The step that each of them began at.
    pub begun: &'a [usize],
    /// (q, qd) of each, one after another, and where momentum is kept what is kept and the largest corrections; in and out.
    pub current: &'a mut [f64],
    pub torque: &'a Torque<'a>,
    pub rows: Option<&'a mut Rows<'r>>,
}
