//! Number of threads for batches.

use super::object::Object;
use crate::batch;
use crate::error::Error;
use pyo3::prelude::*;
use pyo3::types::PyBool;
use std::sync::{Mutex, MutexGuard, TryLockError};

/// Set the number of threads for batches in this process and its forks; running calls keep theirs.
#[doc = section!(Parameters)]
/// threads : int or None
///     Number of threads, including that of the caller; 1: only that. None or 0: RAYON_NUM_THREADS, or one per
///     core, which is the initial setting.
#[doc = section!(Raises)]
/// ArgumentError
///     An invalid number, or more threads than the system provides. The previous setting remains.
#[doc = section!(Notes)]
/// Results are bit-identical for any number of threads.
#[doc = section!(Examples)]
/// >>> phipsi.set_num_threads(1)
/// >>> phipsi.get_num_threads()
/// 1
/// >>> phipsi.set_num_threads(None)
#[pyfunction]
pub(super) fn set_num_threads(py: Python<'_>, threads: Option<&Object<'_>>) -> PyResult<()> {
    let wanted = match threads {
        None => 0,
        Some(given) => {
            let number = if given.is_instance_of::<PyBool>() { None } else { given.extract::<usize>().ok() };
            let expected = "a whole number, or None or 0 for the default";
            number.ok_or_else(|| Error::argument("threads", given.to_string(), expected))?
        }
    };
    Ok(py.detach(|| batch::set_threads(wanted))?)
}

/// Number of threads that the next batch uses; 1 if it runs on that of the caller. Starts the threads if necessary.
#[doc = section!(Returns)]
/// threads : int
///     Number of threads, including that of the caller.
#[doc = section!(Examples)]
/// >>> phipsi.get_num_threads() >= 1
/// True
#[pyfunction]
pub(super) fn get_num_threads(py: Python<'_>) -> usize {
    py.detach(batch::threads)
}

/// Locks what one call at a time can use; an error during another call.
pub(super) fn free<'a, T>(mutex: &'a Mutex<T>, what: &str, expected: &str) -> Result<MutexGuard<'a, T>, Error> {
    match mutex.try_lock() {
        Ok(guard) => Ok(guard),
        Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner()),
        Err(TryLockError::WouldBlock) => {
            Err(Error::argument(what, format!("a call during another call on the same {what}"), expected))
        }
    }
}
