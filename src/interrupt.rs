//! Long work that can be told to stop: by Ctrl-C, or by whatever else the caller looks at.
//!
//! [`during`] does some work and has the calling thread look around, some twenty times a second, whether to go on. The work asks by
//! [`check`] between its pieces; once the answer is no, every thread that works for it gets [`Error::Interrupted`] from its next check.
//! Without a watch a check costs a load; with one it reads the clock, so that pieces are of some microseconds or more.
//!
//! ```
//! use phipsi::{Error, interrupt};
//! use std::sync::atomic::{AtomicBool, Ordering};
//!
//! static STOP: AtomicBool = AtomicBool::new(false);
//!
//! STOP.store(true, Ordering::Relaxed); // by another thread, or a signal
//! let outcome = interrupt::during(|| STOP.load(Ordering::Relaxed), || loop {
//!     // A rollout, samples, a batch: they ask by themselves.
//!     if let Err(error) = interrupt::check() {
//!         break error;
//!     }
//! });
//! assert_eq!(outcome, Error::Interrupted);
//! ```

use crate::error::Error;
use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Between two looks.
pub(crate) const PERIOD: Duration = Duration::from_millis(50);

/// What a thread knows of the watch that it works under.
#[derive(Debug, Clone)]
struct Watch {
    stopped: Arc<AtomicBool>,
    /// Only the thread that began the work looks; and when it did last, none where it has not read the clock yet.
    look: Option<fn() -> bool>,
    last: Option<Instant>,
}

thread_local! {
    static WATCH: RefCell<Option<Watch>> = const { RefCell::new(None) };
}

/// Puts back what was there before, when work ends in whatever way.
struct Before(Option<Watch>);

impl Before {
    fn replaced_by(watch: Option<Watch>) -> Self {
        Self(WATCH.replace(watch))
    }
}

impl Drop for Before {
    fn drop(&mut self) {
        WATCH.set(self.0.take());
    }
}

/// Does `work`, in which this thread calls `look` every 50 ms or so; from when that gives true on, [`check`] fails on all threads of the work.
///
/// Watches nest: the inner one alone counts meanwhile.
pub fn during<R>(look: fn() -> bool, work: impl FnOnce() -> R) -> R {
    let watch = Watch { stopped: Arc::new(AtomicBool::new(false)), look: Some(look), last: None };
    let _before = Before::replaced_by(Some(watch));
    work()
}

/// Whether to go on; to be asked between pieces of work, of some microseconds or more.
///
/// # Errors
///
/// [`Error::Interrupted`], from when the look of [`during`] said so.
pub fn check() -> Result<(), Error> {
    let Some(look) = WATCH.with_borrow_mut(|watch| watch.as_mut().map_or(Ok(None), Watch::due))? else { return Ok(()) };
    // What looks may run anything, work under another watch too.
    let stop = {
        let _before = Before::replaced_by(None);
        look()
    };
    WATCH.with_borrow_mut(|watch| {
        let Some(watch) = watch else { return Ok(()) };
        watch.last = Some(Instant::now());
        if stop {
            watch.stopped.store(true, Ordering::Relaxed);
            return Err(Error::Interrupted);
        }
        Ok(())
    })
}

impl Watch {
    /// The look to take now, if one is due.
    fn due(&mut self) -> Result<Option<fn() -> bool>, Error> {
        if self.stopped.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        let Some(look) = self.look else { return Ok(None) };
        let now = Instant::now();
        let last = *self.last.get_or_insert(now);
        Ok((now.duration_since(last) >= PERIOD).then_some(look))
    }
}

/// [`check`], for loops of short rounds: at one index in `every`.
///
/// # Errors
///
/// As [`check`].
#[inline]
pub(crate) fn check_at(index: usize, every: usize) -> Result<(), Error> {
    if index.is_multiple_of(every) { check() } else { Ok(()) }
}

/// What other threads that work for this one are told: when to stop.
#[cfg(feature = "parallel")]
#[derive(Debug, Clone)]
pub(crate) struct StopSignal(Option<Arc<AtomicBool>>);

#[cfg(feature = "parallel")]
impl StopSignal {
    /// By the watch of this thread, if it has one.
    pub(crate) fn here() -> Self {
        Self(WATCH.with_borrow(|watch| watch.as_ref().map(|watch| Arc::clone(&watch.stopped))))
    }

    /// Whether there is a watch at all.
    pub(crate) fn exists(&self) -> bool {
        self.0.is_some()
    }

    /// Does `work` on another thread, told to stop when the first one is.
    pub(crate) fn help<R>(&self, work: impl FnOnce() -> R) -> R {
        let watch = self.0.as_ref().map(|stopped| Watch { stopped: Arc::clone(stopped), look: None, last: None });
        let _before = Before::replaced_by(watch);
        work()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicUsize;

    static LOOKS: AtomicUsize = AtomicUsize::new(0);

    /// Checks until told to stop, or for a second.
    fn work() -> Result<(), Error> {
        let since = Instant::now();
        while since.elapsed() < Duration::from_secs(1) {
            check()?;
        }
        Ok(())
    }

    #[test]
    fn a_look_ends_the_work_and_nothing_after_it() {
        let third = || LOOKS.fetch_add(1, Ordering::Relaxed) == 2;
        assert_eq!(during(third, work), Err(Error::Interrupted));
        assert_eq!(LOOKS.load(Ordering::Relaxed), 3);
        assert_eq!(check(), Ok(()));
    }

    #[test]
    fn an_inner_watch_leaves_the_outer_one_as_it_was() {
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
    fn helpers_stop_and_do_not_look() {
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
