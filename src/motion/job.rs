//! Some steps of neighbouring states, and where their rows go.

use super::contact::RECORD;
use super::step::Law;
use super::torque::Torque;
use crate::scene::Scene;
use std::ops::Range;

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
