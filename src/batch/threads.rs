//! The threads of this process.
//!
//! rayon's global pool does not survive a fork: the child has the pool but none of its threads, and waits for ever.
//! Python's multiprocessing forks, so the pool here remembers its process and is made anew in another.

use rayon::ThreadPool;
use std::sync::{Arc, RwLock};

static POOL: RwLock<Option<(u32, Arc<ThreadPool>)>> = RwLock::new(None);

/// Where a batch can run.
pub(super) enum Place {
    /// The caller is already a thread of a pool.
    Inside,
    /// On our own threads.
    Ours(Arc<ThreadPool>),
    /// There are no threads to be had.
    Alone,
}

/// The threads to use; never waits for a lock that a fork may have left held.
pub(super) fn pool() -> Place {
    if rayon::current_thread_index().is_some() {
        return Place::Inside;
    }
    let process = std::process::id();
    if let Ok(guard) = POOL.try_read()
        && let Some((owner, pool)) = guard.as_ref()
        && *owner == process
    {
        return Place::Ours(Arc::clone(pool));
    }
    let Ok(mut guard) = POOL.try_write() else { return Place::Alone };
    if let Some((owner, pool)) = guard.as_ref()
        && *owner == process
    {
        return Place::Ours(Arc::clone(pool));
    }
    let named = rayon::ThreadPoolBuilder::new().thread_name(|i| format!("phipsi-{i}"));
    let Ok(pool) = named.build() else { return Place::Alone };
    let pool = Arc::new(pool);
    if let Some(of_the_parent) = guard.replace((process, Arc::clone(&pool))) {
        // Its threads are not in this process: nothing there can be waited for or joined.
        std::mem::forget(of_the_parent);
    }
    Place::Ours(pool)
}
