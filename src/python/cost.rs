//! How long a state takes, roughly: that decides about threads and the GIL, not about results.

use crate::algorithm::Algorithm;
use crate::batch::instruction_set::InstructionSet;
use crate::dynamics::sweeps;

/// The GIL is kept for calls shorter than this (ns of one thread), as `NumPy` does: giving it up takes a tenth of a
/// microsecond where nobody wants it, and up to five milliseconds to get back where somebody does.
pub(super) const WORTH_RELEASING: usize = 5_000;

/// Work on all links at once is done without the GIL from so many on.
pub(super) const WORTH_DETACHING: usize = 1_000;

/// Rough time of one state on one thread, ns.
#[derive(Clone, Copy)]
pub(super) struct Cost {
    /// Of what lanes do side by side.
    pub arithmetic: usize,
    /// Of writing the results, that many, one by one.
    pub results: usize,
}

impl Cost {
    /// Of states that are evaluated one by one.
    pub fn of(ns: usize) -> Self {
        Self { arithmetic: ns, results: 0 }
    }

    /// Of one state by itself.
    pub fn of_one(self) -> usize {
        self.arithmetic.saturating_add(self.results)
    }

    /// Of one of so many states, by `algorithm` in `P` on the arm of this process.
    pub fn of_many<P>(self, states: usize, algorithm: Algorithm) -> usize {
        let lanes = if sweeps::covers(algorithm) { InstructionSet::of_process().lanes(size_of::<P>()) } else { 1 };
        Self { arithmetic: self.arithmetic / lanes.min(states.max(1)), ..self }.of_one()
    }
}
