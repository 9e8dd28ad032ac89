//! Long calls without the GIL, in which Ctrl-C is seen: the one place where the GIL is given up for work that may take long.
//!
//! Signals are the main thread's matter. It takes the GIL back some twenty times a second, between pieces of the work, and has Python handle what
//! came; if a handler raises, the work ends on all threads, and the call raises that. Other threads are not looked after, nor held up.

use crate::interrupt;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use std::cell::{Cell, RefCell};

thread_local! {
    /// What a signal handler raised, on its way to the call that it ended.
    static RAISED: RefCell<Option<PyErr>> = const { RefCell::new(None) };

    /// The process that this thread was last asked in whether it is Python's main thread, and the answer.
    static IS_MAIN: Cell<Option<(u32, bool)>> = const { Cell::new(None) };
}

/// Does `work` without the GIL; on the main thread under a [`interrupt`].
///
/// Raises what a signal handler raised meanwhile, `KeyboardInterrupt` if not told otherwise, whatever came of the work.
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

/// Takes apart what nobody will have, on a thread of its own: a million of small things take longer than the wait for Ctrl-C may.
pub(super) fn drop_elsewhere(large: impl Send + 'static) {
    // Where there is no thread to be had, it is dropped here.
    let _ = std::thread::Builder::new().name("phipsi-drop".to_owned()).spawn(move || drop(large));
}

/// The same for work that can fail: its error is raised.
pub(super) fn detached_checked<R: Send, E: Send + Into<PyErr>>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<R, E> + Send,
) -> PyResult<R> {
    detached(py, work)?.map_err(Into::into)
}

/// Has Python handle the signals that came; whether a handler raised.
fn look() -> bool {
    Python::attach(|py| match py.check_signals() {
        Ok(()) => false,
        Err(raised) => {
            RAISED.set(Some(raised));
            true
        }
    })
}

/// Whether this is the thread that Python handles signals on.
fn is_main(py: Python<'_>) -> PyResult<bool> {
    static THREADING: PyOnceLock<[Py<PyAny>; 2]> = PyOnceLock::new();
    match IS_MAIN.get() {
        Some((_, true)) => return Ok(true),
        // A process forked from another thread has that one for its main thread.
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
