//! Shapes that touched in the steps of a simulation.

use nalgebra::Vector3;
use std::sync::{Mutex, PoisonError};

/// A point at which two colliders touched in a step.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ShapeContact {
    /// Index of the state.
    pub state: usize,
    /// The step, counted from the start of the run, from one.
    pub step: usize,
    /// The colliders, the first with the lower index.
    pub colliders: [usize; 2],
    /// Where the force acts at the end of the step, in the base frame, m.
    pub point: Vector3<f64>,
    /// Unit normal toward the first collider, in the base frame.
    pub normal: Vector3<f64>,
    /// Distance at the end of the step, m.
    pub gap: f64,
    /// Force on the first collider in the step, in the base frame, N.
    pub force: Vector3<f64>,
    /// Impulse on the first collider in an impact of the step, in the base frame, N s.
    pub impulse: Vector3<f64>,
}

/// The contacts of shapes in every `every`th step, or in the last one of a call without records.
#[derive(Debug, Default)]
pub(super) struct Touches {
    every: usize,
    last: usize,
    list: Mutex<Vec<ShapeContact>>,
}

impl Clone for Touches {
    fn clone(&self) -> Self {
        let list = self.list.lock().unwrap_or_else(PoisonError::into_inner).clone();
        Self { every: self.every, last: self.last, list: Mutex::new(list) }
    }
}

impl Touches {
    /// True if the contacts of step `n` are stored.
    pub fn counts(&self, n: usize) -> bool {
        (n + 1).checked_rem(self.every).map_or(n + 1 == self.last, |rest| rest == 0)
    }

    pub fn add(&self, contacts: impl Iterator<Item = ShapeContact>) {
        self.list.lock().unwrap_or_else(PoisonError::into_inner).extend(contacts);
    }

    /// Prepares for steps up to `last`, of which every `every`th is recorded, or none; forgets those that were not
    /// recorded.
    pub fn begin(&mut self, every: usize, last: usize) {
        let recorded = self.every;
        (self.every, self.last) = (every, last);
        let list = self.list.get_mut().unwrap_or_else(PoisonError::into_inner);
        list.retain(|of| of.step.checked_rem(recorded) == Some(0));
    }

    /// The contacts, sorted by state and step.
    pub fn sorted(&self) -> Vec<ShapeContact> {
        let mut list = self.list.lock().unwrap_or_else(PoisonError::into_inner).clone();
        list.sort_by_key(|of| (of.state, of.step));
        list
    }
}
