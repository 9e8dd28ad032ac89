//! A batch of states that free threads take piece by piece.
//!
//! Pieces start large and become smaller toward the end, so that all threads finish at about the same time even if some
//! start late. Pieces begin at multiples of a grain: states are vectorized in the same groups for any number of
//! threads.

use super::Fault;
use crate::error::Error;
use std::ops::Range;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The minimum time of a piece, ns: a hundred times the time to hand it out.
const WORTH_A_PIECE: usize = 5_000;

/// States, and the slice for their results.
type Part<'r, P> = (Range<usize>, &'r mut [P]);

/// The remaining states of a batch, and the faults of the pieces that were taken.
pub(super) struct WorkQueue<'r, P> {
    rest: Mutex<Part<'r, P>>,
    width: usize,
    grain: usize,
    /// The minimum number of states of a piece.
    least: usize,
    threads: usize,
    lowest: Mutex<Option<Fault>>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<'r, P> WorkQueue<'r, P> {
    /// A queue of `states` states of `cost` ns each, for `threads` threads. `results` has the same length per state.
    pub(super) fn new((states, cost): (usize, usize), (threads, grain): (usize, usize), results: &'r mut [P]) -> Self {
        let width = results.len().checked_div(states).unwrap_or(0);
        let least = (WORTH_A_PIECE / cost.max(1)).max(1).next_multiple_of(grain);
        Self { rest: Mutex::new((0..states, results)), width, grain, least, threads, lowest: Mutex::new(None) }
    }

    /// The next piece: half of a thread's share of the remaining states.
    pub(super) fn next(&self) -> Option<Part<'r, P>> {
        let mut rest = locked(&self.rest);
        let left = rest.0.len();
        if left == 0 {
            return None;
        }
        let share = left / (2 * self.threads) / self.grain * self.grain;
        let states = share.max(self.least).min(left);
        let (results, others) = std::mem::take(&mut rest.1).split_at_mut(states * self.width);
        let first = rest.0.start;
        *rest = (first + states..rest.0.end, others);
        Some((first..first + states, results))
    }

    /// Ends the queue; pieces before the failed one are already taken. An interruption takes precedence over other
    /// faults.
    pub(super) fn end_with(&self, fault: Fault) {
        *locked(&self.rest) = (0..0, &mut []);
        let mut lowest = locked(&self.lowest);
        let rank = |fault: &Fault| (fault.error != Error::Interrupted, fault.state);
        if lowest.as_ref().is_none_or(|known| rank(&fault) < rank(known)) {
            *lowest = Some(fault);
        }
    }

    /// The fault of the lowest state that failed.
    pub(super) fn outcome(self) -> Result<(), Fault> {
        self.lowest.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_are_all_there_is_in_order_and_become_smaller() {
        for (states, cost, threads, grain) in [(4096, 80, 2, 16), (1001, 5_000, 3, 4), (7, 1, 2, 16), (1000, 0, 8, 1)] {
            let mut results = vec![0_usize; 3 * states];
            let batch = WorkQueue::new((states, cost), (threads, grain), &mut results);
            let (mut expected, mut before) = (0, usize::MAX);
            while let Some((piece, results)) = batch.next() {
                assert_eq!((piece.start, results.len()), (expected, 3 * piece.len()));
                assert!(piece.start.is_multiple_of(grain) && piece.len() <= before, "{piece:?} after {before}");
                assert!(piece.end == states || piece.len() * cost.max(1) >= WORTH_A_PIECE / 2, "{piece:?}");
                results.fill(1 + expected);
                (expected, before) = (piece.end, piece.len());
            }
            assert_eq!((expected, batch.outcome()), (states, Ok(())));
            assert!(results.is_sorted() && !results.contains(&0));
        }
    }

    #[test]
    fn nothing_is_handed_out_after_a_fault_and_the_lowest_is_told() {
        let fault = |state| Fault { state, error: Error::argument("q", "it", "another") };
        let mut results = [0.0; 100];
        let batch = WorkQueue::new((100, 5_000), (2, 1), &mut results);
        assert_eq!(batch.next().map(|(piece, _)| piece), Some(0..25));
        for state in [20, 3, 11] {
            batch.end_with(fault(state));
            assert!(batch.next().is_none());
        }
        batch.end_with(Fault { state: 50, error: Error::Interrupted });
        batch.end_with(fault(1));
        assert_eq!(batch.outcome(), Err(Fault { state: 50, error: Error::Interrupted }));
    }
}
