//! Evaluation of many states per call, vectorized (SIMD) over states, with results bit-identical to single states.
//!
//! An [`Evaluator`] holds the kernels of one scene for the instruction set of this processor ([`InstructionSet`]) and
//! their scratch memory; [`Scene::evaluate`](crate::Scene::evaluate) runs them on one thread. [`motion`](crate::motion)
//! runs its batches on the number of threads given by `set_threads` (feature `parallel`). It reads broadcast arguments
//! with strides ([`Broadcast`]), so that a state shared by the batch is not copied.
//!
//! ```
//! use phipsi::{Algorithm, Arguments, Form};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(7)?;
//! let (q, qd, tau) = ([0.3; 7], [0.1; 7], [1.0; 7]);
//! let states = [Arguments { q: &q, qd: &qd, u: &tau, ..Arguments::default() }; 100];
//! let mut qdd = [f64::NAN; 700];
//! let mut evaluator = scene.evaluator(); // scratch memory: one evaluator per thread
//! // `Fault::state` is the index of a failed state.
//! scene.evaluate(&mut evaluator, Algorithm::ForwardDynamics(Form::Auto), &states, &mut qdd)?;
//! assert_eq!(qdd[..7], qdd[693..]);
//! # Ok(())
//! # }
//! ```

pub(crate) mod accelerations;
mod accuracy;
pub(crate) mod chunk;
mod compiled;
pub(crate) mod connected;
mod coupled;
#[cfg(feature = "derivatives")]
pub(crate) mod derivatives;
pub(crate) mod evaluator;
pub(crate) mod factor;
mod finite;
#[cfg(feature = "derivatives")]
pub(crate) mod gradients;
pub(crate) mod independent;
pub(crate) mod instruction_set;
pub(crate) mod own_model;
#[cfg(feature = "derivatives")]
pub(crate) mod products;
mod quantities;
#[cfg(feature = "derivatives")]
pub(crate) mod row_products;
#[cfg(feature = "parallel")]
mod threads;
#[cfg(feature = "parallel")]
mod work_queue;

#[cfg(feature = "parallel")]
pub use threads::{set_threads, threads};

/// The number of threads of a batch without the feature `parallel`.
#[cfg(all(not(feature = "parallel"), feature = "estimation"))]
pub(crate) fn threads() -> usize {
    1
}

pub use evaluator::Evaluator;
pub use instruction_set::{INSTRUCTION_SETS, InstructionSet};
#[doc(hidden)]
pub use instruction_set::{Target, Vectorized, Work};

use crate::error::Error;
pub use crate::error::Fault;
use crate::interrupt;
use std::ops::Range;
use std::sync::Mutex;

/// Approximate run time between two interruption checks, ns on one thread; a check takes a thousandth of that.
pub(crate) const SLICE: usize = 100_000;

/// A further thread is woken for each such portion of a batch, ns on one thread: twice the cost of waking a thread.
#[cfg(feature = "parallel")]
const WORTH_A_THREAD: usize = 50_000;

/// One argument of a batch: `width` values per state, with leading axes that broadcast to those of the batch.
#[derive(Debug, Clone)]
pub struct Broadcast<'a, P = f64> {
    data: &'a [P],
    width: usize,
    steps: Steps,
    /// Number of states of the batch; `usize::MAX` for a single state that is broadcast.
    states: usize,
}

/// The map from the index of a state in the batch to the index of a state in the argument.
#[derive(Debug, Clone)]
enum Steps {
    /// One state is broadcast to the whole batch.
    Shared,
    /// One state for each state of the batch.
    Own,
    /// Per axis, last axis first: length of the axis in the batch, and stride in states of the argument (0 if it
    /// broadcasts).
    Axes(Vec<(usize, usize)>),
}

impl<'a, P> Broadcast<'a, P> {
    /// States of `width` values, row-major over the leading axes `leading`, broadcast to the axes `batch` by the rules
    /// of `NumPy`.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] if the length of `data` does not match its axes, or if the axes do not broadcast to those of
    /// the batch.
    pub fn new(argument: &str, data: &'a [P], width: usize, leading: &[usize], batch: &[usize]) -> Result<Self, Error> {
        let own = product(leading);
        if own.and_then(|own| own.checked_mul(width)) != Some(data.len()) {
            let expected = format!("{} states of {width} numbers", leading_text(leading));
            return Err(Error::shape(argument, format!("({},)", data.len()), expected));
        }
        let own = own.unwrap_or_default();
        let steps = if own == 1 {
            Steps::Shared
        } else if leading == batch {
            Steps::Own
        } else {
            let fits = leading.len() <= batch.len()
                && leading.iter().rev().zip(batch.iter().rev()).all(|(&a, &b)| a == b || a == 1);
            if !fits {
                let expected = format!("leading axes that broadcast to {}", leading_text(batch));
                return Err(Error::shape(argument, leading_text(leading), expected));
            }
            let mut stride = 1;
            let lengths = leading.iter().rev().copied().chain(std::iter::repeat(1));
            let axes = batch.iter().rev().zip(lengths).map(|(&length, own)| {
                let step = (length, if own == 1 { 0 } else { stride });
                stride *= own;
                step
            });
            Steps::Axes(axes.collect())
        };
        // The number of states can overflow if an argument broadcasts over many axes.
        let states = if own == 1 { usize::MAX } else { product(batch).unwrap_or(usize::MAX) };
        Ok(Self { data, width, steps, states })
    }

    /// One state, `data`, that all states of any batch share.
    #[must_use]
    pub fn shared(data: &'a [P]) -> Self {
        Self { data, width: data.len(), steps: Steps::Shared, states: usize::MAX }
    }

    /// Checks that the argument has a state for each index of a batch of `states` states.
    pub(crate) fn check_states(&self, argument: &str, states: usize) -> Result<(), Error> {
        if states <= self.states {
            return Ok(());
        }
        Err(Error::shape(argument, format!("{} states", self.states), format!("one for all, or {states}")))
    }

    /// The values of the argument for state `index` of the batch.
    ///
    /// # Panics
    ///
    /// If the batch has no such state. An argument with a single broadcast state accepts every index.
    #[must_use]
    #[inline]
    pub fn state(&self, index: usize) -> &'a [P] {
        let at = match &self.steps {
            Steps::Shared => 0,
            Steps::Own => index,
            Steps::Axes(axes) => {
                let mut rest = index;
                let mut at = 0;
                for &(length, stride) in axes {
                    at += rest % length * stride;
                    rest /= length;
                }
                at
            }
        };
        &self.data[at * self.width..(at + 1) * self.width]
    }
}

/// The leading axes to which several arguments broadcast, by the rules of NumPy: aligned at the last axis, equal or 1.
///
/// # Errors
///
/// [`Error::Shape`], naming the first argument that does not broadcast with the preceding ones.
#[doc(hidden)]
pub fn broadcast_axes<'a>(arguments: impl IntoIterator<Item = (&'a str, &'a [usize])>) -> Result<Vec<usize>, Error> {
    let mut batch: Vec<usize> = Vec::new();
    let mut before: Vec<&str> = Vec::new();
    for (name, leading) in arguments {
        let mut merged = batch.clone();
        if leading.len() > merged.len() {
            let missing = leading.len() - merged.len();
            merged.splice(0..0, std::iter::repeat_n(1, missing));
        }
        for (total, &own) in merged.iter_mut().rev().zip(leading.iter().rev()) {
            if *total == 1 {
                *total = own;
            } else if own != 1 && own != *total {
                let (axes, names) = (leading_text(&batch), before.join(", "));
                let expected = format!("leading axes that broadcast with {axes} of {names}");
                return Err(Error::shape(name, leading_text(leading), expected));
            }
        }
        batch = merged;
        before.push(name);
    }
    Ok(batch)
}

/// A shape in Python notation.
#[must_use]
#[doc(hidden)]
pub fn shape_text(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        _ => format!("({})", shape.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")),
    }
}

/// The number of states of some axes; `None` if it overflows.
fn product(axes: &[usize]) -> Option<usize> {
    if axes.contains(&0) {
        return Some(0);
    }
    axes.iter().try_fold(1_usize, |product, &length| product.checked_mul(length))
}

/// The leading axes of a shape in Python notation, with `...` for the remaining axes.
fn leading_text(leading: &[usize]) -> String {
    leading.iter().fold("(".to_owned(), |text, length| text + &format!("{length}, ")) + "...)"
}

/// Scratch memory that is kept between calls and shared by threads.
///
/// No call blocks: a thread that finds the pool locked allocates its own scratch and drops it afterwards. (In a process
/// that was forked while another thread held the lock, a blocking call would never return.)
#[derive(Debug)]
#[doc(hidden)]
pub struct Pool<S> {
    /// Boxed, because scratch is large and would otherwise be moved twice per call.
    idle: Mutex<Vec<Box<S>>>,
}

impl<S> Default for Pool<S> {
    fn default() -> Self {
        Self { idle: Mutex::new(Vec::new()) }
    }
}

/// A clone has its own scratch, and begins without any.
impl<S> Clone for Pool<S> {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl<S> Pool<S> {
    /// Number of scratch objects in the pool that are not in use.
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) fn idle(&self) -> usize {
        self.idle.try_lock().map_or(0, |idle| idle.len())
    }

    /// Runs `work` with scratch from the pool, or from `make` if the pool is empty.
    pub fn with<R>(&self, make: impl FnOnce() -> S, work: impl FnOnce(&mut S) -> R) -> R {
        let kept = self.idle.try_lock().ok().and_then(|mut idle| idle.pop());
        let mut scratch = kept.unwrap_or_else(|| Box::new(make()));
        let result = work(&mut scratch);
        if let Ok(mut idle) = self.idle.try_lock() {
            idle.push(scratch);
        }
        result
    }
}

/// A batch to run: number of states, time per state, and source of scratch memory.
#[derive(Debug)]
#[doc(hidden)]
pub struct Batch<'a, S, M> {
    /// Number of states.
    pub states: usize,
    /// Approximate time per state on one thread, ns. It determines the number of threads, not the results.
    pub cost: usize,
    /// Scratch memory of previous calls.
    pub pool: &'a Pool<S>,
    /// Allocates scratch memory.
    pub make: M,
}

impl<S: Send, M: Fn() -> S + Sync> Batch<'_, S, M> {
    /// Calls `kernel(scratch, i, out)` for every state i, where `out` is the part of `results` for that state. All
    /// parts have the same length.
    ///
    /// The results are bit-identical for any number of threads. The calling thread takes part; the other threads are
    /// those of the rayon pool in which the caller runs, or of the pool of this crate.
    ///
    /// # Errors
    ///
    /// The [`Fault`] of the failed state of lowest index; `results` is then partly written.
    pub fn run<K>(&self, results: &mut [f64], kernel: K) -> Result<(), Fault>
    where
        K: Fn(&mut S, usize, &mut [f64]) -> Result<(), Error> + Sync,
    {
        let width = results.len().checked_div(self.states).unwrap_or(0);
        self.run_pieces(1, results, |scratch, states, results| {
            for (i, state) in states.enumerate() {
                kernel(scratch, state, &mut results[i * width..(i + 1) * width])
                    .map_err(|error| Fault { state, error })?;
            }
            Ok(())
        })
    }

    /// As [`Batch::run`], with one call per range of adjacent states: `kernel(scratch, range, out)`, where each range
    /// begins at a multiple of `grain`.
    ///
    /// # Errors
    ///
    /// As [`Batch::run`], where the kernel reports the lowest failed state of its range; [`Error::Interrupted`] if
    /// [`interrupt`] stops the work.
    #[cfg_attr(not(feature = "parallel"), allow(unused_variables))] // threads divide the batch into pieces
    pub fn run_pieces<P, K>(&self, grain: usize, results: &mut [P], kernel: K) -> Result<(), Fault>
    where
        P: Send,
        K: Fn(&mut S, Range<usize>, &mut [P]) -> Result<(), Fault> + Sync,
    {
        debug_assert_eq!(results.len(), results.len().checked_div(self.states).unwrap_or(0) * self.states);
        if self.states == 0 {
            return Ok(());
        }
        #[cfg(feature = "parallel")]
        {
            let worth = (self.states.saturating_mul(self.cost) / WORTH_A_THREAD).min(self.states.div_ceil(grain));
            if worth > 1 {
                let place = threads::place();
                let threads = place.threads().min(worth);
                if threads > 1 {
                    return self.on_threads(&place, threads, grain, results, &kernel);
                }
            }
        }
        self.pool.with(&self.make, |scratch| self.in_slices(grain, scratch, (0..self.states, results), &kernel))
    }

    /// Runs the kernel on consecutive slices of a piece, with an interruption check between them. Slices begin at
    /// multiples of the grain.
    fn in_slices<P, K>(
        &self,
        grain: usize,
        scratch: &mut S,
        (states, mut results): (Range<usize>, &mut [P]),
        kernel: &K,
    ) -> Result<(), Fault>
    where
        K: Fn(&mut S, Range<usize>, &mut [P]) -> Result<(), Fault>,
    {
        if states.len().saturating_mul(self.cost) <= SLICE {
            return kernel(scratch, states, results);
        }
        let width = results.len().checked_div(states.len()).unwrap_or(0);
        let slice = (SLICE / self.cost.max(1)).max(1).next_multiple_of(grain);
        let mut first = states.start;
        while first < states.end {
            interrupt::check().map_err(|error| Fault { state: first, error })?;
            let count = slice.min(states.end - first);
            let (own, others) = results.split_at_mut(count * width);
            kernel(scratch, first..first + count, own)?;
            (first, results) = (first + count, others);
        }
        Ok(())
    }

    /// Runs the batch on several threads of the pool `place`.
    #[cfg(feature = "parallel")]
    fn on_threads<P, K>(
        &self,
        place: &threads::Place,
        threads: usize,
        grain: usize,
        results: &mut [P],
        kernel: &K,
    ) -> Result<(), Fault>
    where
        P: Send,
        K: Fn(&mut S, Range<usize>, &mut [P]) -> Result<(), Fault> + Sync,
    {
        let batch = work_queue::WorkQueue::new((self.states, self.cost), (threads, grain), results);
        let stop = |error| batch.end_with(Fault { state: 0, error });
        place.together(threads - 1, &stop, &|| {
            let mut piece = batch.next();
            if piece.is_none() {
                return;
            }
            self.pool.with(&self.make, |scratch| {
                while let Some(own) = piece.take() {
                    if let Err(fault) = self.in_slices(grain, scratch, own, kernel) {
                        batch.end_with(fault);
                    }
                    // Yields between pieces, because another caller may wait for this thread only to learn that its
                    // batch is complete.
                    if matches!(place, threads::Place::Ours(..)) {
                        rayon::yield_now();
                    }
                    piece = batch.next();
                }
            });
        });
        batch.outcome()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(states: usize, cost: usize, bad: &[usize]) -> (Vec<f64>, Result<(), Fault>) {
        let pool = Pool::default();
        let mut results = vec![f64::NAN; 2 * states];
        let outcome = Batch { states, cost, pool: &pool, make: || 0.5_f64 }.run(&mut results, |scratch, i, out| {
            if bad.contains(&i) {
                return Err(Error::argument("q", "it", "another"));
            }
            let x = f64::from(u32::try_from(i).unwrap_or(0));
            out.copy_from_slice(&[(x * *scratch).sin(), x]);
            Ok(())
        });
        (results, outcome)
    }

    #[test]
    fn same_bits_on_one_thread_and_on_many() {
        let (serial, outcome) = run(1000, 0, &[]);
        assert_eq!(outcome, Ok(()));
        let (threaded, outcome) = run(1000, 10_000, &[]);
        assert_eq!(outcome, Ok(()));
        assert_eq!(serial, threaded);
    }

    #[test]
    fn the_lowest_fault_is_told() {
        for cost in [0, 10_000] {
            let (_, outcome) = run(1000, cost, &[911, 17, 400]);
            let fault = outcome.expect_err("three states are bad");
            assert_eq!(fault.state, 17);
            assert!(Error::from(fault).to_string().contains("in state 17"));
        }
    }

    #[test]
    fn no_states_and_no_width() {
        assert_eq!(run(0, 1, &[]).1, Ok(()));
        let pool: Pool<()> = Pool::default();
        let seen = std::sync::atomic::AtomicUsize::new(0);
        let batch = Batch { states: 5, cost: 1_000_000, pool: &pool, make: || () };
        let outcome = batch.run(&mut [], |(), _, _| {
            seen.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Ok(())
        });
        assert_eq!(outcome, Ok(()));
        assert_eq!(seen.into_inner(), 5);
    }

    #[test]
    fn axes_broadcast_as_in_numpy() -> Result<(), Error> {
        assert_eq!(broadcast_axes([("a", &[3, 1][..]), ("b", &[4]), ("c", &[])])?, [3, 4]);
        assert_eq!(broadcast_axes([("a", &[0][..]), ("b", &[1])])?, [0]);
        let message = broadcast_axes([("a", &[3][..]), ("b", &[4])]).expect_err("3 and 4").to_string();
        assert!(
            message.contains('b') && message.contains("(4, ...)") && message.contains("(3, ...) of a"),
            "{message}"
        );

        let data: Vec<f64> = (0..6_u8).map(f64::from).collect();
        let rows = Broadcast::new("a", &data, 2, &[3, 1], &[3, 4])?;
        let columns = Broadcast::new("b", &data, 2, &[3], &[2, 3])?;
        assert_eq!(rows.state(7), [2.0, 3.0]);
        assert_eq!(columns.state(4), [2.0, 3.0]);
        assert_eq!(Broadcast::new("c", &data, 6, &[], &[9])?.state(8), &data[..]);
        assert!(Broadcast::new("d", &data, 2, &[3], &[4]).is_err());
        Ok(())
    }
}
