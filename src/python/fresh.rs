//! New arrays for results; the memory of very large ones is reused.

use super::dtype::Dtype;
use super::errors::no_room;
use super::input::MANY;
use super::object::{Object, imported};
use crate::error::Error;
use crate::memory;
use numpy::{IxDyn, PyArray, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Name in an `OutOfMemoryError` until the argument that determines the size is known.
const RESULT: &str = "result";

/// Results of at least this size (bytes) reuse the memory of earlier results.
///
/// The allocator requests such memory from the system each time, which clears it page by page. M of a chain of 35 in
/// 4096 states (40 MB) took 2.1 us per state in new memory and 1.2 us in reused memory. Smaller blocks are cached by
/// the allocator.
const LARGE: usize = 32 << 20;

/// Largest total size of reusable memory, bytes.
const MOST: usize = 128 << 20;

/// Reusable memory: one-dimensional arrays of which results are views, with their sizes in bytes, the last used at the
/// end.
static KEPT: Mutex<Vec<(usize, Py<PyAny>)>> = Mutex::new(Vec::new());

/// New array of zeros.
pub(super) fn zeros<'py, P: Dtype>(py: Python<'py>, shape: &[usize]) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    if entries(shape).is_some_and(|entries| entries <= MANY) {
        return Ok(PyArray::zeros(py, IxDyn(shape), false));
    }
    made_by(py, imported!(py, "numpy", "zeros")?, shape)
}

/// New uninitialized array: setting megabytes to zero takes a tenth of the time of computing M.
pub(super) fn unwritten<'py, P: Dtype>(py: Python<'py>, shape: &[usize]) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    match entries(shape) {
        Some(entries) if entries <= MANY => zeros(py, shape),
        Some(entries) if entries.saturating_mul(size_of::<P>()) >= LARGE => used_again(py, entries)?.reshape(shape),
        _ => empty(py, shape),
    }
}

/// New uninitialized array of `count` numbers, for results of methods written in Python.
#[pyfunction]
#[pyo3(name = "_unwritten", signature = (count, /))]
pub(super) fn unwritten_numbers(py: Python<'_>, count: usize) -> PyResult<Bound<'_, PyArrayDyn<f64>>> {
    unwritten(py, &[count])
}

/// Number of entries of an array of this shape; None if it overflows.
pub(super) fn entries(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1, |product: usize, &length| product.checked_mul(length))
}

/// The number of states of a batch with these axes.
pub(super) fn states_of(batch: &[usize]) -> Result<usize, Error> {
    entries(batch).ok_or_else(|| Error::argument("batch", "more states than memory can address", "fewer states"))
}

fn empty<'py, P: Dtype>(py: Python<'py>, shape: &[usize]) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    made_by(py, imported!(py, "numpy", "empty")?, shape)
}

/// Calls a function of NumPy with a shape.
fn made_by<'py, P: Dtype>(
    py: Python<'py>,
    function: &Object<'py>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    let bytes = memory::bytes_of::<P>(shape);
    memory::room(RESULT, bytes)?;
    let made = function.call1((shape.to_vec(), P::NAME));
    Ok(made.map_err(|cause| no_room(py, RESULT, &cause, Some(bytes)))?.cast_into()?)
}

/// Array of `entries` numbers without other references, reused or added to the reusable memory.
fn used_again<P: Dtype>(py: Python<'_>, entries: usize) -> PyResult<Bound<'_, PyArrayDyn<P>>> {
    // Without the GIL, another thread could create a reference during the count.
    let has_lock = match py.import("sys")?.getattr_opt("_is_gil_enabled")? {
        Some(is_enabled) => is_enabled.call0()?.extract()?,
        None => true,
    };
    let bytes = entries * size_of::<P>();
    if !has_lock || bytes > MOST {
        return empty(py, &[entries]);
    }
    if let Some(free) = free(py, entries) {
        return Ok(free);
    }
    let made = empty(py, &[entries])?;
    // No Python code runs while the lock is held, because it could call this function again; dropped arrays are
    // released later.
    let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    kept.push((bytes, made.clone().into_any().unbind()));
    let mut total: usize = kept.iter().map(|(bytes, _)| bytes).sum();
    let mut dropped = Vec::new();
    while total > MOST {
        let oldest = kept.remove(0);
        total -= oldest.0;
        dropped.push(oldest);
    }
    drop(kept);
    Ok(made)
}

/// Reusable array of `entries` numbers without references outside of this file. Views are references, and read-only
/// memory is not reused.
#[allow(deprecated)] // the count of references is right where the interpreter's lock is held
fn free<P: Dtype>(py: Python<'_>, entries: usize) -> Option<Bound<'_, PyArrayDyn<P>>> {
    let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    let (at, array) = kept.iter().enumerate().find_map(|(at, (_, array))| {
        let is_alone = array.get_refcnt(py) == 1;
        let array = array.bind(py).cast::<PyArrayDyn<P>>().ok()?;
        let is_free = is_alone && array.shape() == [entries] && array.try_readwrite().is_ok();
        is_free.then(|| (at, array.clone()))
    })?;
    let block = kept.remove(at);
    kept.push(block);
    Some(array)
}
