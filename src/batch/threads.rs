//! The threads of this process, and how many they are.
//!
//! rayon's global pool does not survive a fork: the child has the pool but none of its threads, and waits for ever.
//! Python's multiprocessing forks, so the pool here remembers its process and is made anew in another.

use crate::error::Error;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, RwLock};

/// How many threads are wanted; 0 for as many as the machine has.
static WANTED: AtomicUsize = AtomicUsize::new(0);

static POOL: RwLock<Option<Kept>> = RwLock::new(None);

/// A pool, for how many it was made, and whose threads it has.
struct Kept {
    process: u32,
    wanted: usize,
    pool: Arc<ThreadPool>,
}

impl Kept {
    /// Whether its threads are there, and as many as are wanted.
    fn serves(&self, process: u32, wanted: usize) -> bool {
        (self.process, self.wanted) == (process, wanted)
    }
}

/// Where a batch can run.
pub(super) enum Place {
    /// The caller is already a thread of a pool.
    Inside,
    /// On our own threads.
    Ours(Arc<ThreadPool>),
    /// One thread is wanted, or there are none to be had.
    Alone,
}

/// The threads to use; never waits for a lock that a fork may have left held.
pub(super) fn pool() -> Place {
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
        return Place::Ours(Arc::clone(&kept.pool));
    }
    let Ok(mut guard) = POOL.try_write() else { return Place::Alone };
    if let Some(kept) = guard.as_ref()
        && kept.serves(process, wanted)
    {
        return Place::Ours(Arc::clone(&kept.pool));
    }
    let Ok(pool) = make(wanted) else { return Place::Alone };
    replace(&mut guard, Some(Kept { process, wanted, pool: Arc::clone(&pool) }));
    Place::Ours(pool)
}

fn make(wanted: usize) -> Result<Arc<ThreadPool>, rayon::ThreadPoolBuildError> {
    let named = ThreadPoolBuilder::new().num_threads(wanted).thread_name(|i| format!("phipsi-{i}"));
    named.build().map(Arc::new)
}

/// Puts `new` in the place of what was kept, whose threads end when the batches that use them have.
fn replace(kept: &mut Option<Kept>, new: Option<Kept>) {
    if let Some(old) = std::mem::replace(kept, new)
        && old.process != std::process::id()
    {
        // Its threads are not in this process: nothing there can be waited for or joined.
        std::mem::forget(old.pool);
    }
}

/// Sets how many threads batches use from now on, in this process and those that it forks; batches under way keep theirs.
///
/// `threads`: 1 for none beside the caller; 0 for what the environment variable `RAYON_NUM_THREADS` says, or as many as the machine
/// has, which is what a process begins with. Results have the same bits for any number. A batch that is run inside a rayon pool uses
/// that pool, whatever was set. The threads are started here.
///
/// # Errors
///
/// [`Error::Argument`] for more threads than rayon has names for (65,535 on machines of 64 bits), or than the system gives; what was
/// set before then stays.
pub fn set_threads(threads: usize) -> Result<(), Error> {
    let refused = |found, expected| Error::argument("threads", found, expected);
    let most = rayon::max_num_threads();
    if threads > most {
        return Err(refused(threads.to_string(), format!("0 for those of the machine, or 1 to {most}")));
    }
    let kept = if threads == 1 {
        None
    } else {
        let pool = make(threads).map_err(|error| {
            refused(format!("{threads}, which the system does not give ({error})"), "fewer threads".to_owned())
        })?;
        Some(Kept { process: std::process::id(), wanted: threads, pool })
    };
    WANTED.store(threads, Ordering::Relaxed);
    // Where another thread has the lock, the next batch makes the pool.
    if let Ok(mut guard) = POOL.try_write() {
        replace(&mut guard, kept);
    }
    Ok(())
}

/// How many threads the next batch uses, the caller's not counted unless it is the only one; starts them where they are not there yet.
#[must_use]
pub fn threads() -> usize {
    match pool() {
        Place::Inside => rayon::current_num_threads(),
        Place::Ours(pool) => pool.current_num_threads(),
        Place::Alone => 1,
    }
}
