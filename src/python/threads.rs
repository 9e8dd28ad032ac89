//! How many threads batches use.

use super::object::Object;
use crate::batch;
use crate::error::Error;
use pyo3::prelude::*;
use pyo3::types::PyBool;

/// Sets how many threads batches use from now on, in this process and those that it forks; calls under way keep theirs.
///
/// threads: the caller's and others, 1 for none beside the caller's; None or 0 for what the environment variable
/// RAYON_NUM_THREADS says, or as many as the machine has, which is what a process begins with. Results have the same bits for any number.
///
/// Raises ArgumentError for what is no number of threads, or for more than the system gives; what was set before then stays.
#[pyfunction]
#[pyo3(signature = (threads))]
pub(super) fn set_num_threads(py: Python<'_>, threads: Option<&Object<'_>>) -> PyResult<()> {
    let wanted = match threads {
        None => 0,
        Some(given) => {
            let number = if given.is_instance_of::<PyBool>() { None } else { given.extract::<usize>().ok() };
            let expected = "a whole number, 0 or None for those of the machine";
            number.ok_or_else(|| Error::argument("threads", given.to_string(), expected))?
        }
    };
    Ok(py.detach(|| batch::set_threads(wanted))?)
}

/// How many threads the next batch uses; 1 where it runs on the caller's alone. Starts them where they are not there yet.
#[pyfunction]
#[pyo3(signature = ())]
pub(super) fn get_num_threads(py: Python<'_>) -> usize {
    py.detach(batch::threads)
}
