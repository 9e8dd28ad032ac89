//! Memory of large results, kept for results to come.
//!
//! The system gives the memory of a new large array zeroed, page by page as it is written to: for matrices of robots that takes as long as
//! computing them, and longer on several threads. So what a large result was written to is kept, and given to another one when nobody
//! has it any more.

use super::arrays::empty;
use crate::error::Error;
use crate::scalar::Precision;
use numpy::{Element, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Smaller results are left to the system's allocator, which keeps such itself.
const LEAST: usize = 4 << 20;

/// Bytes that are kept at most, unless told otherwise.
const USUAL: usize = 128 << 20;

/// One array of one dimension, which results are views of.
struct Block {
    bytes: usize,
    array: Py<PyAny>,
}

/// Those that are kept, the one used last at the end.
struct Kept {
    limit: usize,
    blocks: Vec<Block>,
}

static KEPT: Mutex<Kept> = Mutex::new(Kept { limit: USUAL, blocks: Vec::new() });

/// Nothing of Python's runs while this is held, or it could come here again.
fn kept() -> MutexGuard<'static, Kept> {
    KEPT.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Kept {
    fn bytes(&self) -> usize {
        self.blocks.iter().map(|block| block.bytes).sum()
    }

    /// Takes out what is over the limit, what was used longest ago first. It is for the caller to drop.
    fn shrink(&mut self) -> Vec<Block> {
        let (mut total, mut count) = (self.bytes(), 0);
        while total > self.limit {
            total -= self.blocks[count].bytes;
            count += 1;
        }
        self.blocks.drain(..count).collect()
    }
}

/// Changes what is kept, and drops what is over the limit then, nothing being held any more.
fn change(with: impl FnOnce(&mut Kept)) {
    let mut kept = kept();
    with(&mut kept);
    let over = kept.shrink();
    drop(kept);
    drop(over);
}

/// Whether an array of so many numbers is made here.
pub(super) fn is_for<P>(entries: usize) -> bool {
    entries.checked_mul(size_of::<P>()).is_some_and(|bytes| bytes >= LEAST)
}

/// An array of this shape with whatever was there before: in memory that is kept and that nobody else has, or in new.
pub(super) fn array<'py, P: Precision + Element>(
    py: Python<'py>,
    (entries, shape): (usize, &[usize]),
) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    if !has_lock(py)? {
        return empty(py, shape);
    }
    let whole = if let Some(free) = free::<P>(py, entries) {
        free
    } else {
        let made = empty::<P>(py, &[entries])?;
        let block = Block { bytes: entries * size_of::<P>(), array: made.clone().into_any().unbind() };
        change(|kept| {
            // One that is too large by itself would drive out all others.
            if block.bytes <= kept.limit {
                kept.blocks.push(block);
            }
        });
        made
    };
    // A view: whoever has one, or one of that, has the array itself as its base.
    whole.reshape(shape)
}

/// One that has so many numbers, and that nothing but this file refers to.
fn free<P: Precision + Element>(py: Python<'_>, entries: usize) -> Option<Bound<'_, PyArrayDyn<P>>> {
    let mut kept = kept();
    let as_wanted = |block: &Block| {
        let array = block.array.bind(py).cast::<PyArrayDyn<P>>().ok()?;
        let fits = PyUntypedArrayMethods::len(array) == entries && is_free(&block.array, py);
        // Somebody may have frozen it, by way of a view's base.
        (fits && array.is_c_contiguous() && array.try_readwrite().is_ok()).then(|| array.clone())
    };
    let (at, array) = kept.blocks.iter().enumerate().find_map(|(at, block)| Some((at, as_wanted(block)?)))?;
    let block = kept.blocks.remove(at);
    kept.blocks.push(block);
    Some(array)
}

/// Whether this interpreter has a lock that is held here: without it others could make a reference while they are counted.
fn has_lock(py: Python<'_>) -> PyResult<bool> {
    static HAS_LOCK: PyOnceLock<bool> = PyOnceLock::new();
    // Python 3.13 and later know; those before have it. It can come later, but does not go.
    let asked = HAS_LOCK.get_or_try_init(py, || match py.import("sys")?.getattr_opt("_is_gil_enabled")? {
        Some(is_enabled) => is_enabled.call0()?.extract(),
        None => Ok::<_, PyErr>(true),
    });
    asked.copied()
}

/// Whether nothing else refers to it. That is asked with the interpreter's lock held, and another reference takes one to be made from.
#[allow(deprecated)] // for interpreters without that lock, where nothing is kept
fn is_free(array: &Py<PyAny>, py: Python<'_>) -> bool {
    array.get_refcnt(py) == 1
}

/// Sets how many bytes of memory of large results are kept at most for results to come: 134217728 when a process begins, 0 for none.
///
/// A result of four megabytes or more is a view of such memory, which goes to another result of as many numbers once no array refers to it any more;
/// NumPy's `resize` refuses views. Nothing is kept where Python runs without its global lock.
///
/// Raises `ArgumentError` for what is no whole number.
#[pyfunction]
#[pyo3(signature = (bytes))]
pub(super) fn set_kept_memory(bytes: &Bound<'_, PyAny>) -> PyResult<()> {
    let limit = bytes
        .extract::<usize>()
        .map_err(|_| Error::argument("bytes", bytes.to_string(), "a whole number of bytes, 0 to keep none"))?;
    change(|kept| kept.limit = limit);
    Ok(())
}

/// How many bytes of memory of large results are kept now, in use or not.
#[pyfunction]
#[pyo3(signature = ())]
pub(super) fn get_kept_memory() -> usize {
    kept().bytes()
}
