//! The threads of this process, how many they are, and work that they do together with the caller.
//!
//! The caller is one of them, and begins at once: to wake another takes 20 to 40 microseconds on a virtual machine,
//! and 13 of the time of the thread that wakes it. So the pool has one thread fewer than are wanted.
//!
//! rayon's global pool does not survive a fork: the child has the pool but none of its threads, and waits for ever.
//! Python's multiprocessing forks, so the pool here remembers its process and is made anew in another.

use crate::error::Error;
use crate::interrupt::{self, StopSignal};
use rayon::{Scope, ThreadPool, ThreadPoolBuilder};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, RwLock};
use std::thread::Thread;
use std::time::{Duration, Instant};

/// The caller waits so long for its helpers without going to sleep, from which waking takes as long as a small piece
/// of work.
const AWAKE: Duration = Duration::from_micros(100);

/// How many threads are wanted; 0 for as many as the machine has.
static WANTED: AtomicUsize = AtomicUsize::new(0);

static POOL: RwLock<Option<ThreadPoolState>> = RwLock::new(None);

/// A pool, how many threads were wanted and are used with the caller, and whose threads it has; none before more than
/// one was wanted.
///
/// A pool is kept when fewer threads are wanted, for threads that end leave memory behind: it can have more than are
/// used.
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

/// Where a batch can run.
pub(super) enum Place {
    /// The caller is already a thread of a pool.
    Inside,
    /// The caller and our own threads: so many of them with the caller.
    Ours(Arc<ThreadPool>, usize),
    /// One thread is wanted, or there are no others to be had.
    Alone,
}

impl Place {
    /// How many threads that is, the caller one of them.
    pub(super) fn threads(&self) -> usize {
        match self {
            Self::Inside => rayon::current_num_threads(),
            Self::Ours(_, threads) => *threads,
            Self::Alone => 1,
        }
    }

    /// Calls `work` here and, at the same time, on `helpers` other threads, of which there are as many; returns when
    /// all have returned. Those of a pool of ours lend themselves to other callers wherever `work` calls
    /// [`rayon::yield_now`].
    ///
    /// All work under the caller's [`interrupt`], which it keeps while it waits for the others: `stop` is set when that
    /// ends the work.
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

/// The threads that do some work together.
#[derive(Clone, Copy)]
struct Company<'scope> {
    /// How many beside the caller have not returned.
    helping: &'scope AtomicUsize,
    /// The caller, where it is to be woken by the last of them.
    waiting: Option<&'scope Thread>,
    signal: &'scope StopSignal,
    work: &'scope (dyn Fn() + Sync),
}

impl<'scope> Company<'scope> {
    /// The work here and on `helpers` other threads.
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

    /// Has `helpers` threads do the work, of which two are woken here and wake the others.
    fn wake(self, scope: &Scope<'scope>, helpers: usize) {
        for helpers in [helpers.div_ceil(2), helpers / 2] {
            if helpers > 0 {
                scope.spawn(move |scope| {
                    self.wake(scope, helpers - 1);
                    self.signal.help(self.work);
                    if self.helping.fetch_sub(1, Ordering::AcqRel) == 1
                        && let Some(waiting) = self.waiting
                    {
                        waiting.unpark();
                    }
                });
            }
        }
    }
}

/// The threads to use; never waits for a lock that a fork may have left held.
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

/// The pool that there is, if its threads are those of this process.
fn pool_of(process: u32, kept: Option<&ThreadPoolState>) -> Option<Arc<ThreadPool>> {
    kept.filter(|kept| kept.process == process).and_then(|kept| kept.pool.clone())
}

/// The threads beside the caller: those of the pool that there is, if they are as many; `wanted` is 0 for those of
/// the machine.
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

/// What `RAYON_NUM_THREADS` says, or as many threads as run at once here.
fn of_the_machine() -> usize {
    let said = std::env::var("RAYON_NUM_THREADS").ok().and_then(|text| text.parse().ok()).filter(|&said| said > 0);
    let threads = said.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    threads.min(rayon::max_num_threads())
}

/// Puts `new` in the place of what was kept, whose threads end when the batches that use them have.
fn replace(kept: &mut Option<ThreadPoolState>, new: Option<ThreadPoolState>) {
    if let Some(old) = std::mem::replace(kept, new)
        && old.process != std::process::id()
    {
        // Its threads are not in this process: nothing there can be waited for or joined.
        std::mem::forget(old.pool);
    }
}

/// Sets how many threads batches use from now on, in this process and those that it forks; batches under way keep
/// theirs.
///
/// `threads`: the caller's and others, 1 for none beside the caller's; 0 for what the environment variable
/// `RAYON_NUM_THREADS` says, or as many as the machine has, which is what a process begins with. Results have the
/// same bits for any number. A batch that is run inside a rayon pool uses that pool, whatever was set. The threads
/// are started here; where fewer are wanted than before, the others stay and wait.
///
/// # Errors
///
/// [`Error::Argument`] for more threads than rayon has names for (65,535 on machines of 64 bits), or than the system
/// gives; what was set before then stays.
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
    // Where another thread has the lock, the next batch makes the pool.
    if let Ok(mut guard) = POOL.try_write() {
        replace(&mut guard, kept);
    }
    Ok(())
}

/// How many threads the next batch uses, the caller's one of them; starts the others where they are not there yet.
#[must_use]
pub fn threads() -> usize {
    place().threads()
}
