//! Objects of Python.

use pyo3::prelude::*;

/// Any object: what arguments are before they are read, and results once they are made.
pub(super) type Object<'py> = Bound<'py, PyAny>;

/// What a module has by that name; each place that asks looks it up once.
macro_rules! imported {
    ($py:expr, $module:literal, $name:literal) => {{
        static FOUND: pyo3::sync::PyOnceLock<pyo3::Py<pyo3::PyAny>> = pyo3::sync::PyOnceLock::new();
        FOUND.import($py, $module, $name)
    }};
}

pub(super) use imported;
