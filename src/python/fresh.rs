//! New arrays for results; the memory of very large ones is used again.

use super::errors::no_room;
use super::input::MANY;
use super::object::{Object, imported};
use crate::memory;
use crate::scalar::Precision;
use numpy::{Element, IxDyn, PyArray, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};

/// What is said to ask for the memory of a result, until it is known which argument did.
const RESULT: &str = "result";

/// Results of so many bytes are written to memory that results before them had.
///
/// The allocator takes such from the system each time, which clears it page by page as it is written to. M of a chain of 35 in 4096 states (40 MB)
/// took 2.1 us a state in new memory and 1.2 us in used memory; below this size the allocator itself keeps it.
const LARGE: usize = 32 << 20;

/// So many bytes are kept at most.
const MOST: usize = 128 << 20;

/// Memory of large results, as arrays of one dimension that results are views of, and its bytes; what was used last is at the end.
static KEPT: Mutex<Vec<(usize, Py<PyAny>)>> = Mutex::new(Vec::new());

/// A new array of zeros.
pub(super) fn zeros<'py, P: Precision + Element>(
    py: Python<'py>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    if entries(shape).is_some_and(|entries| entries <= MANY) {
        return Ok(PyArray::zeros(py, IxDyn(shape), false));
    }
    made_by(py, imported!(py, "numpy", "zeros")?, shape)
}

/// A new array of whatever was there: to zero megabytes takes a tenth of computing M.
pub(super) fn unwritten<'py, P: Precision + Element>(
    py: Python<'py>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    match entries(shape) {
        Some(entries) if entries <= MANY => zeros(py, shape),
        Some(entries) if entries.saturating_mul(size_of::<P>()) >= LARGE => used_again(py, entries)?.reshape(shape),
        _ => empty(py, shape),
    }
}

/// So many numbers of whatever was there, for results of methods written in Python.
#[pyfunction]
#[pyo3(name = "_unwritten", signature = (count, /))]
pub(super) fn unwritten_numbers(py: Python<'_>, count: usize) -> PyResult<Bound<'_, PyArrayDyn<f64>>> {
    unwritten(py, &[count])
}

/// How many numbers an array of this shape has; none where that is no number.
pub(super) fn entries(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1, |product: usize, &length| product.checked_mul(length))
}

fn empty<'py, P: Precision + Element>(py: Python<'py>, shape: &[usize]) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    made_by(py, imported!(py, "numpy", "empty")?, shape)
}

/// What a function of NumPy makes of a shape.
fn made_by<'py, P: Precision + Element>(
    py: Python<'py>,
    function: &Object<'py>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    let bytes = memory::bytes_of::<P>(shape);
    memory::room(RESULT, bytes)?;
    let made = function.call1((shape.to_vec(), P::NAME));
    Ok(made.map_err(|cause| no_room(py, RESULT, &cause, Some(bytes)))?.cast_into()?)
}

/// An array of so many numbers that nothing else refers to, kept before or kept from now on.
fn used_again<P: Precision + Element>(py: Python<'_>, entries: usize) -> PyResult<Bound<'_, PyArrayDyn<P>>> {
    // Without the interpreter's lock others could make a reference while they are counted.
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
    // Nothing of Python's runs while this is held, or it could come here again: what is no longer kept is dropped afterwards.
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

/// A kept array of so many numbers that nothing but this file refers to. Views of it do, and memory that somebody froze stays as it is.
#[allow(deprecated)] // the count of references is right where the interpreter's lock is held
fn free<P: Precision + Element>(py: Python<'_>, entries: usize) -> Option<Bound<'_, PyArrayDyn<P>>> {
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
