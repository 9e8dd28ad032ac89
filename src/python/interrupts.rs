//! Long calls without the GIL that respond to Ctrl-C; no other file releases the GIL for long work.
//!
//! Python handles signals on the main thread. About twenty times per second, between pieces of the work, that thread
//! acquires the GIL and lets Python handle pending signals. If a handler raises, the work ends on all threads and the
//! call raises that exception. Calls from other threads do not check for signals.

use crate::interrupt;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use std::cell::{Cell, RefCell};

thread_local! {
    /// Exception of a signal handler, until the interrupted call raises it.
    static RAISED: RefCell<Option<PyErr>> = const { RefCell::new(None) };

    /// Process in which this thread last checked whether it is the main thread of Python, and the result.
    static IS_MAIN: Cell<Option<(u32, bool)>> = const { Cell::new(None) };
}

/// Runs `work` without the GIL; on the main thread with checks for signals ([`interrupt`]).
///
/// Raises the exception of a signal handler, by default `KeyboardInterrupt`, also if the work failed with another
/// error.
pub(super) fn detached<R: Send>(py: Python<'_>, work: impl FnOnce() -> R + Send) -> PyResult<R> {
    if !is_main(py)? {
        return Ok(py.detach(work));
    }
    let result = py.detach(|| interrupt::during(look, work));
    match RAISED.take() {
        None => Ok(result),
        Some(raised) => Err(raised),
    }
}

/// Drops a large discarded result on a separate thread: dropping a million small objects would delay the response to
/// Ctrl-C.
pub(super) fn drop_elsewhere(large: impl Send + 'static) {
    // If no thread can be started, the result is dropped here.
    let _ = std::thread::Builder::new().name("phipsi-drop".to_owned()).spawn(move || drop(large));
}

/// The same for work that can fail; its error is raised.
pub(super) fn detached_checked<R: Send, E: Send + Into<PyErr>>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<R, E> + Send,
) -> PyResult<R> {
    detached(py, work)?.map_err(Into::into)
}

/// Lets Python handle pending signals; returns whether a handler raised.
fn look() -> bool {
    Python::attach(|py| match py.check_signals() {
        Ok(()) => false,
        Err(raised) => {
            RAISED.set(Some(raised));
            true
        }
    })
}

/// True on the thread on which Python handles signals.
fn is_main(py: Python<'_>) -> PyResult<bool> {
    static THREADING: PyOnceLock<[Py<PyAny>; 2]> = PyOnceLock::new();
    match IS_MAIN.get() {
        Some((_, true)) => return Ok(true),
        // In a forked process, the thread that called fork is the main thread.
        Some((process, false)) if process == std::process::id() => return Ok(false),
        _ => {}
    }
    let [main_thread, get_ident] = THREADING.get_or_try_init(py, || {
        let threading = py.import("threading")?;
        Ok::<_, PyErr>([threading.getattr("main_thread")?.unbind(), threading.getattr("get_ident")?.unbind()])
    })?;
    let main = main_thread.bind(py).call0()?.getattr("ident")?;
    let answer = main.eq(get_ident.bind(py).call0()?)?;
    IS_MAIN.set(Some((std::process::id(), answer)));
    Ok(answer)
}
