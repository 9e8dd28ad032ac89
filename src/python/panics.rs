//! Panics as exceptions that `except Exception` catches: the class `phipsi.errors.InternalError`, with the place.
//!
//! PyO3 converts a panic below any entry point, on any thread, into its `PanicException`, which is not an `Exception`.
//! This class is private to this module, so that all panics become errors in one place: where it is instantiated.
//! `phipsi.errors.adopt_panics` changes that.

use super::errors::classes;
use super::interrupts::detached;
use crate::batch::{Batch, Pool};
use pyo3::panic::PanicException;
use pyo3::prelude::*;
use std::collections::VecDeque;
use std::panic::{PanicHookInfo, set_hook, take_hook};
use std::sync::{Mutex, PoisonError};

/// The number of panics whose places are known. Several threads can panic before the first is reported.
const KNOWN: usize = 16;

/// Messages and places of the last panics.
static PLACES: Mutex<VecDeque<(String, String)>> = Mutex::new(VecDeque::new());

/// Makes panics exceptions of the class `InternalError`. They are then printed only where the exception is, or also
/// with a backtrace if `RUST_BACKTRACE` is set.
pub(super) fn adopt(py: Python<'_>) -> PyResult<()> {
    classes(py)?.getattr("adopt_panics")?.call1((py.get_type::<PanicException>(),))?;
    let print = take_hook();
    set_hook(Box::new(move |panic| {
        note(panic);
        if std::env::var_os("RUST_BACKTRACE").is_some() {
            print(panic);
        }
    }));
    Ok(())
}

/// Stores the place of a panic under its message.
fn note(panic: &PanicHookInfo<'_>) {
    let text = panic.payload().downcast_ref::<String>().map(String::as_str);
    let message = text.or_else(|| panic.payload().downcast_ref::<&str>().copied()).unwrap_or_default();
    let place = panic.location().map(ToString::to_string).unwrap_or_default();
    let mut places = PLACES.lock().unwrap_or_else(PoisonError::into_inner);
    places.truncate(KNOWN - 1);
    places.push_front((message.to_owned(), place));
}

/// File and line of the last panic with a message; empty if there was none.
#[pyfunction]
#[pyo3(name = "_panic_place", signature = (message, /))]
pub(super) fn panic_place(message: &str) -> String {
    let places = PLACES.lock().unwrap_or_else(PoisonError::into_inner);
    places.iter().find(|(of, _)| of == message).map_or_else(String::new, |(_, place)| place.clone())
}

/// Panics, for tests: "attached" with the GIL, "detached" without it, "batch" on one of several threads.
#[pyfunction]
#[pyo3(name = "_panic_for_tests", signature = (place, /))]
pub(super) fn panic_for_tests(py: Python<'_>, place: &str) -> PyResult<()> {
    match place {
        "detached" => detached(py, || panic!("a panic without the GIL")),
        "batch" => detached(py, || {
            let pool = Pool::default();
            let batch = Batch { states: 64, cost: 1_000_000, pool: &pool, make: || () };
            let slow = |(): &mut (), state: usize, _: &mut [f64]| {
                std::thread::sleep(std::time::Duration::from_millis(1));
                assert!(state != 40, "a panic of a batch");
                Ok(())
            };
            let _ = batch.run(&mut [0.0; 64], slow);
        }),
        _ => panic!("a panic with the GIL"),
    }
}
