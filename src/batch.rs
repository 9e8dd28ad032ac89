//! Many states a call: as many at once as a register holds, with the same bits as one by one.
//!
//! An [`Evaluator`] has the kernels of one scene for the instructions of this processor ([`InstructionSet`]) and
//! their scratch; [`Scene::evaluate`](crate::Scene::evaluate) runs them on one thread. [`motion`](crate::motion) runs
//! its batches on as many threads as `set_threads` says (feature `parallel`), and takes arguments that broadcast by
//! strides ([`Broadcast`]): a state that is shared is not copied.
//!
//! ```
//! use phipsi::{Algorithm, Arguments, Form};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(7)?;
//! let (q, qd, tau) = ([0.3; 7], [0.1; 7], [1.0; 7]);
//! let states = [Arguments { q: &q, qd: &qd, u: &tau, ..Arguments::default() }; 100];
//! let mut qdd = [f64::NAN; 700];
//! let mut evaluator = scene.evaluator(); // scratch: one for each thread
//! let done = scene.evaluate(&mut evaluator, Algorithm::ForwardDynamics(Form::Auto), &states, &mut qdd);
//! done.map_err(|fault| fault.error)?; // `fault.state` is the index of the state at fault
//! assert_eq!(qdd[..7], qdd[693..]);
//! # Ok(())
//! # }
//! ```

pub(crate) mod accelerations;
#[cfg(target_arch = "x86_64")]
mod accuracy;
pub(crate) mod chunk;
mod compiled;
mod connected;
mod coupled;
pub(crate) mod derivatives;
pub(crate) mod evaluator;
pub(crate) mod factor;
mod finite;
pub(crate) mod instruction_set;
pub(crate) mod products;
mod quantities;
#[cfg(feature = "parallel")]
mod threads;
#[cfg(feature = "parallel")]
mod work_queue;

#[cfg(feature = "parallel")]
pub use threads::{set_threads, threads};

pub use evaluator::{Evaluated, Evaluator};
pub use instruction_set::{INSTRUCTION_SETS, InstructionSet};
#[doc(hidden)]
pub use instruction_set::{Target, Vectorised, Work};

use crate::error::Error;
pub use crate::error::Fault;
use crate::watch;
use std::ops::Range;
use std::sync::Mutex;

/// About so long, in ns of one thread, goes by between two questions whether to go on; it takes a thousandth of that
/// to ask.
pub(crate) const SLICE: usize = 100_000;

/// Another thread is woken for so much of a batch, in ns of one thread: it gains what waking costs twice over.
#[cfg(feature = "parallel")]
const WORTH_A_THREAD: usize = 50_000;

/// One argument of a batch: `width` numbers a state, with leading axes that broadcast against those of the batch.
#[derive(Debug, Clone)]
pub struct Broadcast<'a, P = f64> {
    data: &'a [P],
    width: usize,
    steps: Steps,
    /// How many states of a batch there are; all that there can be where one is for all.
    states: usize,
}

/// How the index of a state of the batch becomes the index of a state of the argument.
#[derive(Debug, Clone)]
enum Steps {
    /// One state for all.
    Shared,
    /// Each its own.
    Own,
    /// Axis by axis, the last first: length of the batch's axis, and stride of the argument in states (0 where it
    /// broadcasts).
    Axes(Vec<(usize, usize)>),
}

impl<'a, P> Broadcast<'a, P> {
    /// States of `width` numbers, row-major over the leading axes `leading`, seen over the axes `batch`: broadcast as
    /// arrays of `NumPy` do.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] where the length of `data` is not that of its axes, or the axes do not broadcast to the
    /// batch's.
    pub fn new(argument: &str, data: &'a [P], width: usize, leading: &[usize], batch: &[usize]) -> Result<Self, Error> {
        let own = product(leading);
        if own.and_then(|own| own.checked_mul(width)) != Some(data.len()) {
            return Err(Error::Shape {
                argument: argument.to_owned(),
                found: format!("({},)", data.len()),
                expected: format!("{} states of {width} numbers", leading_text(leading)),
            });
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
                return Err(Error::Shape {
                    argument: argument.to_owned(),
                    found: leading_text(leading),
                    expected: format!("leading axes that broadcast to {}", leading_text(batch)),
                });
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
        // Where an argument of many axes broadcasts, the batch can have more states than memory has addresses.
        let states = if own == 1 { usize::MAX } else { product(batch).unwrap_or(usize::MAX) };
        Ok(Self { data, width, steps, states })
    }

    /// Checks that the argument has a state for each index of a batch of `states` states.
    pub(crate) fn check_states(&self, argument: &str, states: usize) -> Result<(), Error> {
        if states <= self.states {
            return Ok(());
        }
        Err(Error::Shape {
            argument: argument.to_owned(),
            found: format!("{} states", self.states),
            expected: format!("one for all, or {states}"),
        })
    }

    /// The numbers that the argument holds for state `index` of the batch.
    ///
    /// # Panics
    ///
    /// If the batch has no such state, as a slice does; an argument of one state has it for every index.
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

/// The leading axes that several arguments broadcast to, by the rule of numpy: aligned at the end, equal or 1.
///
/// # Errors
///
/// [`Error::Shape`] naming the first argument that does not fit those before it.
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
                return Err(Error::Shape {
                    argument: name.to_owned(),
                    found: leading_text(leading),
                    expected: format!(
                        "leading axes that broadcast with {} of {}",
                        leading_text(&batch),
                        before.join(", ")
                    ),
                });
            }
        }
        batch = merged;
        before.push(name);
    }
    Ok(batch)
}

/// A shape as Python writes it.
#[must_use]
#[doc(hidden)]
pub fn shape_text(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        _ => format!("({})", shape.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")),
    }
}

/// The number of states of some axes; none where no memory has room for them.
fn product(axes: &[usize]) -> Option<usize> {
    if axes.contains(&0) {
        return Some(0);
    }
    axes.iter().try_fold(1_usize, |product, &length| product.checked_mul(length))
}

/// The leading axes of a shape whose last ones are not the matter.
fn leading_text(leading: &[usize]) -> String {
    leading.iter().fold("(".to_owned(), |text, length| text + &format!("{length}, ")) + "...)"
}

/// Scratch kept between calls, shared by threads.
///
/// Taking and giving back never wait: a thread that finds the pool in use makes its own scratch and drops it
/// afterwards. (A process forked while another thread held the lock would wait for ever.)
#[derive(Debug)]
#[doc(hidden)]
pub struct Pool<S> {
    /// Boxed: scratch is large, and would be moved twice a call.
    idle: Mutex<Vec<Box<S>>>,
}

impl<S> Default for Pool<S> {
    fn default() -> Self {
        Self { idle: Mutex::new(Vec::new()) }
    }
}

impl<S> Pool<S> {
    /// How many are kept, that nobody uses now.
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) fn idle(&self) -> usize {
        self.idle.try_lock().map_or(0, |idle| idle.len())
    }

    /// Runs `work` with scratch from the pool, or from `make` where the pool has none.
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

/// A batch to run: how many states, how long each takes, and where scratch comes from.
#[derive(Debug)]
#[doc(hidden)]
pub struct Batch<'a, S, M> {
    /// Number of states.
    pub states: usize,
    /// Rough time of one state on one thread, ns; decides about threads, not about results.
    pub cost: usize,
    /// Scratch between calls.
    pub pool: &'a Pool<S>,
    /// Makes scratch.
    pub make: M,
}

impl<S: Send, M: Fn() -> S + Sync> Batch<'_, S, M> {
    /// Calls `kernel(scratch, i, out)` for every state i, with `out` its part of `results` (equally long for each
    /// state).
    ///
    /// The results have the same bits for any number of threads. The caller's is one of them; the others are those of
    /// the rayon pool that it is in, else our own.
    ///
    /// # Errors
    ///
    /// The [`Fault`] of the lowest state that failed; `results` is then partly written.
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

    /// The same for neighbouring states at once: `kernel(scratch, range, out)`, the range beginning at a multiple of
    /// `grain`.
    ///
    /// # Errors
    ///
    /// As [`Batch::run`]; a kernel's fault is the lowest of its range. [`Error::Interrupted`] under a [`watch`] that
    /// ends the work.
    #[cfg_attr(not(feature = "parallel"), allow(unused_variables))] // pieces are for threads
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

    /// The kernel on one slice after another of a piece, between which it is asked whether to go on; they begin at
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
            watch::check().map_err(|error| Fault { state: first, error })?;
            let count = slice.min(states.end - first);
            let (own, others) = results.split_at_mut(count * width);
            kernel(scratch, first..first + count, own)?;
            (first, results) = (first + count, others);
        }
        Ok(())
    }

    /// On so many threads of a place.
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
                    // Another caller may wait for no more than to hear that its batch is done. Between pieces: one in
                    // hand would wait too.
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
