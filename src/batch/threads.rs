//! The pool of threads of this process, and parallel calls on the pool and the calling thread.
//!
//! The calling thread takes part and starts at once. Waking another thread takes 20 to 40 microseconds on a virtual
//! machine, 13 of which are spent by the thread that wakes it. The pool therefore has one thread fewer than requested.
//!
//! The global pool of rayon does not survive a fork: the child process has the pool without its threads and waits
//! forever. Python's multiprocessing forks, so this pool stores its process and is rebuilt in another process.

use crate::error::Error;
use crate::interrupt::{self, StopSignal};
use rayon::{Scope, ThreadPool, ThreadPoolBuilder};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, RwLock};
use std::thread::Thread;
use std::time::{Duration, Instant};

/// The time that the caller spins while it waits for the other threads. Waking a sleeping thread takes as long as a
/// small piece of work.
const AWAKE: Duration = Duration::from_micros(100);

/// The requested number of threads; 0 for the number of threads of the machine.
static WANTED: AtomicUsize = AtomicUsize::new(0);

static POOL: RwLock<Option<ThreadPoolState>> = RwLock::new(None);

/// The pool, the requested number of threads, the number of threads in use including the caller, and the process that
/// owns the threads. There is no pool until more than one thread is requested.
///
/// The pool is kept if fewer threads are requested later, because threads that end leak memory. It can therefore have
/// more threads than are in use.
struct ThreadPoolState {
    process: u32,
    wanted: usize,
    threads: usize,
    pool: Option<Arc<ThreadPool>>,
}

impl ThreadPoolState {
    /// True if its threads exist, in the requested number.
    fn serves(&self, process: u32, wanted: usize) -> bool {
        (self.process, self.wanted) == (process, wanted)
    }

    fn place(&self) -> Place {
        match &self.pool {
            Some(pool) if self.threads > 1 => Place::Ours(Arc::clone(pool), self.threads),
            _ => Place::Alone,
        }
    }
}

/// The threads on which a batch can run.
pub(super) enum Place {
    /// The caller is already a thread of a pool.
    Inside,
    /// The caller and the threads of this pool; the number includes the caller.
    Ours(Arc<ThreadPool>, usize),
    /// One thread is requested, or no others are available.
    Alone,
}

impl Place {
    /// The number of threads, including the caller.
    pub(super) fn threads(&self) -> usize {
        match self {
            Self::Inside => rayon::current_num_threads(),
            Self::Ours(_, threads) => *threads,
            Self::Alone => 1,
        }
    }

    /// Calls `work` on this thread and concurrently on `helpers` other threads, which must exist. Returns when all
    /// calls have returned. The threads of this module's own pool also serve other callers whenever `work` calls
    /// [`rayon::yield_now`].
    ///
    /// All calls run under the caller's [`interrupt`], which the caller checks while it waits for the other threads.
    /// Calls `stop` if the interrupt ends the work.
    pub(super) fn together(&self, helpers: usize, stop: &dyn Fn(Error), work: &(dyn Fn() + Sync)) {
        let signal = StopSignal::here();
        let helping = AtomicUsize::new(helpers);
        let waiting = signal.exists().then(std::thread::current);
        let company = Company { helping: &helping, waiting: waiting.as_ref(), signal: &signal, work };
        match self {
            Self::Alone => work(),
            Self::Inside => rayon::in_place_scope(|scope| company.all_at_once(scope, helpers, stop)),
            Self::Ours(pool, _) => pool.in_place_scope(|scope| company.all_at_once(scope, helpers, stop)),
        }
    }
}

/// The threads that run one call together.
#[derive(Clone, Copy)]
struct Company<'scope> {
    /// Number of calls on other threads that have not returned.
    helping: &'scope AtomicUsize,
    /// The caller, if the last of the other threads has to wake it.
    waiting: Option<&'scope Thread>,
    signal: &'scope StopSignal,
    work: &'scope (dyn Fn() + Sync),
}

impl<'scope> Company<'scope> {
    /// Runs the work on this thread and on `helpers` other threads.
    fn all_at_once(self, scope: &Scope<'scope>, helpers: usize, stop: &dyn Fn(Error)) {
        self.wake(scope, helpers);
        (self.work)();
        let since = Instant::now();
        while self.helping.load(Ordering::Acquire) > 0 && since.elapsed() < AWAKE {
            std::hint::spin_loop();
        }
        if self.waiting.is_some() {
            while self.helping.load(Ordering::Acquire) > 0 {
                if let Err(error) = interrupt::check() {
                    // The other threads notice it at their next check.
                    return stop(error);
                }
                std::thread::park_timeout(interrupt::PERIOD);
            }
        }
    }

    /// Runs the work on `helpers` threads. Wakes two of them, which wake the others.
    fn wake(self, scope: &Scope<'scope>, helpers: usize) {
        for helpers in [helpers.div_ceil(2), helpers / 2] {
            if helpers > 0 {
                scope.spawn(move |scope| {
                    let _helper = Helper(self);
                    self.wake(scope, helpers - 1);
                    self.signal.help(self.work);
                });
            }
        }
    }
}

/// One of the other threads. The waiting caller is woken when the last one returns or panics.
struct Helper<'scope>(Company<'scope>);

impl Drop for Helper<'_> {
    fn drop(&mut self) {
        if self.0.helping.fetch_sub(1, Ordering::AcqRel) == 1
            && let Some(waiting) = self.0.waiting
        {
            waiting.unpark();
        }
    }
}

/// The threads to use. Never waits for a lock, which a fork may have left locked.
pub(super) fn place() -> Place {
    if rayon::current_thread_index().is_some() {
        return Place::Inside;
    }
    let (process, wanted) = (std::process::id(), WANTED.load(Ordering::Relaxed));
    if wanted == 1 {
        return Place::Alone;
    }
    if let Ok(guard) = POOL.try_read()
        && let Some(kept) = guard.as_ref()
        && kept.serves(process, wanted)
    {
        return kept.place();
    }
    let Ok(mut guard) = POOL.try_write() else { return Place::Alone };
    if let Some(kept) = guard.as_ref()
        && kept.serves(process, wanted)
    {
        return kept.place();
    }
    let Ok(kept) = make(wanted, pool_of(process, guard.as_ref())) else { return Place::Alone };
    let place = kept.place();
    replace(&mut guard, Some(kept));
    place
}

/// The existing pool, if its threads belong to this process.
fn pool_of(process: u32, kept: Option<&ThreadPoolState>) -> Option<Arc<ThreadPool>> {
    kept.filter(|kept| kept.process == process).and_then(|kept| kept.pool.clone())
}

/// The threads in addition to the caller: those of the existing pool if it has enough. `wanted` is 0 for the number of
/// threads of the machine.
fn make(wanted: usize, before: Option<Arc<ThreadPool>>) -> Result<ThreadPoolState, rayon::ThreadPoolBuildError> {
    let threads = if wanted == 0 { of_the_machine() } else { wanted };
    let suffices = before.as_ref().map_or(0, |pool| pool.current_num_threads()) + 1 >= threads;
    let pool = if suffices {
        before
    } else {
        let named = ThreadPoolBuilder::new().num_threads(threads - 1).thread_name(|i| format!("phipsi-{i}"));
        Some(Arc::new(named.build()?))
    };
    Ok(ThreadPoolState { process: std::process::id(), wanted, threads, pool })
}

/// The value of `RAYON_NUM_THREADS`, or else the parallelism that is available to this process.
fn of_the_machine() -> usize {
    let said = std::env::var("RAYON_NUM_THREADS").ok().and_then(|text| text.parse().ok()).filter(|&said| said > 0);
    let threads = said.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    threads.min(rayon::max_num_threads())
}

/// Replaces the stored pool by `new`. The old threads end when the batches that use them have finished.
fn replace(kept: &mut Option<ThreadPoolState>, new: Option<ThreadPoolState>) {
    if let Some(old) = std::mem::replace(kept, new)
        && old.process != std::process::id()
    {
        // Its threads do not exist in this process and cannot be joined.
        std::mem::forget(old.pool);
    }
}

/// Sets the number of threads for later batches in this process and in processes forked from it. Running batches are
/// not affected.
///
/// `threads` includes the caller: 1 uses the caller only. 0, the initial value, uses the environment variable
/// `RAYON_NUM_THREADS`, or else the number of threads of the machine. The bits of results do not depend on the number
/// of threads. A batch that runs inside a rayon pool uses that pool regardless of this setting. This function starts
/// the threads; if the number decreases, the remaining threads stay idle.
///
/// # Errors
///
/// [`Error::Argument`] if there are more threads than rayon supports (65,535 on 64-bit machines) or than the system
/// provides; the previous setting is then kept.
pub fn set_threads(threads: usize) -> Result<(), Error> {
    let refused = |found, expected| Error::argument("threads", found, expected);
    let most = rayon::max_num_threads();
    if threads > most {
        return Err(refused(threads.to_string(), format!("0 for those of the machine, or 1 to {most}")));
    }
    let before = POOL.try_read().ok().and_then(|guard| pool_of(std::process::id(), guard.as_ref()));
    let kept = make(threads, before).map_err(|error| {
        refused(format!("{threads}, which the system does not give ({error})"), "fewer threads".to_owned())
    })?;
    let kept = Some(kept);
    WANTED.store(threads, Ordering::Relaxed);
    // If another thread holds the lock, the next batch creates the pool.
    if let Ok(mut guard) = POOL.try_write() {
        replace(&mut guard, kept);
    }
    Ok(())
}

/// The number of threads of the next batch, including the caller. Starts threads that do not exist yet.
#[must_use]
pub fn threads() -> usize {
    place().threads()
}
