//! Objects of Python.

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;

/// Any object: what arguments are before they are read, and results once they are made.
pub(super) type Object<'py> = Bound<'py, PyAny>;

/// The class of that name in `phipsi._results`: results of several parts.
pub(super) fn result_class<'py>(py: Python<'py>, name: &str) -> PyResult<Object<'py>> {
    static MODULE: PyOnceLock<Py<PyModule>> = PyOnceLock::new();
    let module = MODULE.get_or_try_init(py, || Ok::<_, PyErr>(py.import("phipsi._results")?.unbind()))?;
    module.bind(py).getattr(name)
}
