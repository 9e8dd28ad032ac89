//! How long a state takes, roughly: that decides about threads and the GIL, not about results.

use crate::algorithm::Algorithm;
use crate::batch::arms::Arm;
use crate::dynamics::lean;

/// Rough time of one state on one thread, ns.
#[derive(Clone, Copy)]
pub(super) struct Cost {
    /// Of what lanes do side by side.
    pub arithmetic: usize,
    /// Of writing the results, that many, one by one.
    pub results: usize,
}

impl From<usize> for Cost {
    fn from(arithmetic: usize) -> Self {
        Self { arithmetic, results: 0 }
    }
}

impl Cost {
    /// Of one state by itself.
    pub fn of_one(self) -> usize {
        self.arithmetic.saturating_add(self.results)
    }

    /// Of one of so many states, by `algorithm` in `P` on the arm of this process.
    pub fn of_many<P>(self, states: usize, algorithm: Algorithm) -> usize {
        let lanes = if lean::covers(algorithm) { Arm::of_process().lanes(size_of::<P>()) } else { 1 };
        Self { arithmetic: self.arithmetic / lanes.min(states.max(1)), ..self }.of_one()
    }
}
