//! Interruption of long computations, for instance by Ctrl-C.
//!
//! [`during`] runs a computation. The computation calls [`check`] between pieces of work, and about 20 times a second
//! `check` calls the `stop` function of the caller. Once that returns true, the next check on every thread of the
//! computation returns [`Error::Interrupted`]. A check costs one load outside [`during`] and one clock read inside, so
//! that pieces of work should take at least a few microseconds.
//!
//! ```
//! use phipsi::{Error, interrupt};
//! use std::sync::Arc;
//! use std::sync::atomic::{AtomicBool, Ordering};
//!
//! let stop = Arc::new(AtomicBool::new(false));
//! let seen = Arc::clone(&stop);
//! stop.store(true, Ordering::Relaxed); // by another thread or a signal handler
//! let outcome = interrupt::during(move || seen.load(Ordering::Relaxed), || loop {
//!     // Rollouts, sampling and batches call `check` themselves.
//!     if let Err(error) = interrupt::check() {
//!         break error;
//!     }
//! });
//! assert_eq!(outcome, Error::Interrupted);
//! ```

use crate::error::Error;
use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time between two calls of the stop function.
pub(crate) const PERIOD: Duration = Duration::from_millis(50);

/// The stop function of a caller.
type Stop = Rc<dyn Fn() -> bool>;

/// The interruption state of a thread inside [`during`].
struct Interruption {
    stopped: Arc<AtomicBool>,
    /// The stop function: set only on the thread that called [`during`].
    stop: Option<Stop>,
    last: Option<Instant>,
}

thread_local! {
    static CURRENT: RefCell<Option<Interruption>> = const { RefCell::new(None) };
}

/// Restores the previous state of the thread when dropped, also when the work panics.
struct Before(Option<Interruption>);

impl Before {
    fn replaced_by(current: Option<Interruption>) -> Self {
        Self(CURRENT.replace(current))
    }
}

impl Drop for Before {
    fn drop(&mut self) {
        CURRENT.set(self.0.take());
    }
}

/// Runs `work`. This thread calls `stop` about every 50 ms; once it returns true, [`check`] fails on all threads of the
/// work.
///
/// Calls can be nested: the inner `stop` replaces the outer one until the inner work ends. `stop` owns what it reads,
/// for instance an `Arc<AtomicBool>`.
pub fn during<R>(stop: impl Fn() -> bool + 'static, work: impl FnOnce() -> R) -> R {
    let current = Interruption { stopped: Arc::new(AtomicBool::new(false)), stop: Some(Rc::new(stop)), last: None };
    let _before = Before::replaced_by(Some(current));
    work()
}

/// Returns an error if the work must stop. Call it between pieces of work of at least a few microseconds.
///
/// # Errors
///
/// [`Error::Interrupted`], once the stop function of [`during`] has returned true.
pub fn check() -> Result<(), Error> {
    let Some(stop) = CURRENT.with_borrow_mut(|current| current.as_mut().map_or(Ok(None), Interruption::due))? else {
        return Ok(());
    };
    // The stop function can run arbitrary code, including work under another `during`.
    let stopped = {
        let _before = Before::replaced_by(None);
        stop()
    };
    CURRENT.with_borrow_mut(|current| {
        let Some(current) = current else { return Ok(()) };
        current.last = Some(Instant::now());
        if stopped {
            current.stopped.store(true, Ordering::Relaxed);
            return Err(Error::Interrupted);
        }
        Ok(())
    })
}

impl Interruption {
    /// The stop function, if its next call is due.
    fn due(&mut self) -> Result<Option<Stop>, Error> {
        if self.stopped.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        let Some(stop) = &self.stop else { return Ok(None) };
        let now = Instant::now();
        let last = *self.last.get_or_insert(now);
        Ok((now.duration_since(last) >= PERIOD).then(|| Rc::clone(stop)))
    }
}

/// Calls [`check`] at every multiple of `every`, for loops with short iterations.
///
/// # Errors
///
/// As [`check`].
#[inline]
pub(crate) fn check_at(index: usize, every: usize) -> Result<(), Error> {
    if index.is_multiple_of(every) { check() } else { Ok(()) }
}

/// The stop flag of this thread, to share with other threads that work for it.
#[cfg(feature = "parallel")]
#[derive(Debug, Clone)]
pub(crate) struct StopSignal(Option<Arc<AtomicBool>>);

#[cfg(feature = "parallel")]
impl StopSignal {
    /// The flag of this thread, if it runs inside [`during`].
    pub(crate) fn here() -> Self {
        Self(CURRENT.with_borrow(|current| current.as_ref().map(|current| Arc::clone(&current.stopped))))
    }

    /// True if this thread runs inside [`during`].
    pub(crate) fn exists(&self) -> bool {
        self.0.is_some()
    }

    /// Runs `work` on another thread, where [`check`] reads the shared flag and never calls the stop function.
    pub(crate) fn help<R>(&self, work: impl FnOnce() -> R) -> R {
        let current =
            self.0.as_ref().map(|stopped| Interruption { stopped: Arc::clone(stopped), stop: None, last: None });
        let _before = Before::replaced_by(current);
        work()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    /// Checks until interrupted, for at most one second.
    fn work() -> Result<(), Error> {
        let since = Instant::now();
        while since.elapsed() < Duration::from_secs(1) {
            check()?;
        }
        Ok(())
    }

    #[test]
    fn the_stop_function_ends_the_work_and_nothing_after_it() {
        let calls = Rc::new(Cell::new(0));
        let counted = Rc::clone(&calls);
        let third = move || counted.replace(counted.get() + 1) == 2;
        assert_eq!(during(third, work), Err(Error::Interrupted));
        assert_eq!(calls.get(), 3);
        assert_eq!(check(), Ok(()));
    }

    #[test]
    fn an_inner_call_leaves_the_outer_one_unchanged() {
        let outcome = during(
            || false,
            || {
                assert_eq!(during(|| true, work), Err(Error::Interrupted));
                check()
            },
        );
        assert_eq!(outcome, Ok(()));
    }

    #[cfg(feature = "parallel")]
    #[test]
    fn helpers_stop_and_do_not_call_the_stop_function() {
        let outcome = during(
            || true,
            || {
                let signal = StopSignal::here();
                std::thread::scope(|scope| {
                    let helper = scope.spawn(|| signal.help(work));
                    let own = work();
                    (own, helper.join().expect("no panic"))
                })
            },
        );
        assert_eq!(outcome, (Err(Error::Interrupted), Err(Error::Interrupted)));
    }
}
