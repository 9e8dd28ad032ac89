//! Approximate time per state, which determines the use of threads and the release of the GIL, but not the results.

use crate::algorithm::Algorithm;
use crate::batch::instruction_set::InstructionSet;
use crate::dynamics::sweeps;

/// Calls shorter than this (ns on one thread) keep the GIL, as in `NumPy`: releasing it takes a tenth of a microsecond
/// if no other thread waits for it, and acquiring it again takes up to five milliseconds if one does.
pub(super) const WORTH_RELEASING: usize = 5_000;

/// Smallest number of links for which work on all links releases the GIL.
pub(super) const WORTH_DETACHING: usize = 1_000;

/// Approximate time per state on one thread, ns.
#[derive(Clone, Copy)]
pub(super) struct Cost {
    /// Vectorized (SIMD) arithmetic.
    pub arithmetic: usize,
    /// Number of results, which are written one at a time.
    pub results: usize,
}

impl Cost {
    /// The cost of states that are evaluated one at a time.
    pub fn of(ns: usize) -> Self {
        Self { arithmetic: ns, results: 0 }
    }

    /// Time of a single state.
    pub fn of_one(self) -> usize {
        self.arithmetic.saturating_add(self.results)
    }

    /// Time per state in a batch of `states`, with `algorithm` on the instruction set of this process.
    pub fn of_many(self, states: usize, algorithm: Algorithm) -> usize {
        let lanes = if sweeps::covers(algorithm) { InstructionSet::of_process().lanes() } else { 1 };
        Self { arithmetic: self.arithmetic / lanes.min(states.max(1)), ..self }.of_one()
    }
}
