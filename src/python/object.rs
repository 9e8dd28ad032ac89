//! Python objects.

use pyo3::prelude::*;

/// Any object: an argument before it is read, or a result.
pub(super) type Object<'py> = Bound<'py, PyAny>;

/// Attribute of a module; each call site looks it up once.
macro_rules! imported {
    ($py:expr, $module:literal, $name:literal) => {{
        static FOUND: pyo3::sync::PyOnceLock<pyo3::Py<pyo3::PyAny>> = pyo3::sync::PyOnceLock::new();
        FOUND.import($py, $module, $name)
    }};
}

pub(super) use imported;
