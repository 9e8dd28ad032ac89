//! Errors and warnings of the crate as the classes of `phipsi.errors`.

use crate::batch::{Fault, shape_text};
use crate::error::Error;
use crate::scene::{Scene, SceneWarning};
use pyo3::exceptions::{PyKeyboardInterrupt, PyMemoryError, PyUserWarning};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyTuple, PyType};
use std::ffi::CString;

/// The module of the Python classes, imported once.
pub(super) fn classes(py: Python<'_>) -> PyResult<&Bound<'_, PyModule>> {
    static MODULE: PyOnceLock<Py<PyModule>> = PyOnceLock::new();
    MODULE.get_or_try_init(py, || Ok(py.import("phipsi.errors")?.unbind())).map(|module| module.bind(py))
}

impl From<Error> for PyErr {
    fn from(error: Error) -> Self {
        Python::attach(|py| to_python(py, &error, &[]).unwrap_or_else(|failed| failed))
    }
}

/// The error of one state of a batch with the given leading axes; of the only state where there are none.
pub(super) fn fault(py: Python<'_>, fault: Fault, batch: &[usize]) -> PyErr {
    let error = if batch.is_empty() { fault.error } else { fault.into() };
    to_python(py, &error, batch).unwrap_or_else(|failed| failed)
}

/// The error of a call over a batch with the given leading axes; it may name a state of it.
pub(super) fn of_batch(py: Python<'_>, error: &Error, batch: &[usize]) -> PyErr {
    to_python(py, error, batch).unwrap_or_else(|failed| failed)
}

/// The instance of the class that belongs to `error`, with its attributes.
fn to_python(py: Python<'_>, error: &Error, batch: &[usize]) -> PyResult<PyErr> {
    let mut message = error.to_string();
    let state = match error {
        Error::NotFinite { state, .. } | Error::SingularJoint { state, .. } | Error::SingularTask { state, .. } => {
            *state
        }
        _ => None,
    };
    let index = state.map(|state| batch_index(py, state, batch)).transpose()?;
    if let (Some(index), true) = (&index, batch.len() > 1) {
        message = format!("{message} (index {index} of the batch {})", shape_text(batch));
    }
    let instance = |class: &str| classes(py)?.getattr(class)?.call1((message,));
    let instance = match error {
        Error::Scene { .. } => instance("SceneError")?,
        Error::Shape { argument, .. } => {
            let instance = instance("ShapeError")?;
            instance.setattr("argument", argument)?;
            instance
        }
        Error::Argument { argument, .. } => {
            let instance = instance("ArgumentError")?;
            instance.setattr("argument", argument)?;
            instance
        }
        Error::NotFinite { argument, index: entry, .. } => {
            let instance = instance("NotFiniteError")?;
            instance.setattr("argument", argument)?;
            instance.setattr("index", entry)?;
            instance.setattr("state", index)?;
            instance
        }
        Error::SingularJoint { joint, link, pivot, .. } => {
            let instance = instance("SingularJointError")?;
            instance.setattr("joint", joint)?;
            instance.setattr("link", link)?;
            instance.setattr("pivot", pivot)?;
            instance.setattr("state", index)?;
            instance
        }
        Error::SingularTask { links, rank, directions, .. } => {
            let instance = instance("SingularTaskError")?;
            instance.setattr("links", PyTuple::new(py, links)?)?;
            instance.setattr("rank", rank)?;
            instance.setattr("directions", directions)?;
            instance.setattr("state", index)?;
            instance
        }
        Error::Memory { argument, shortage } => {
            let instance = instance("OutOfMemoryError")?;
            instance.setattr("argument", argument)?;
            instance.setattr("bytes", shortage.bytes)?;
            instance.setattr("free", shortage.free)?;
            instance
        }
        // What a handler raised is raised where the work was begun; this is for work that nobody looked after.
        Error::Interrupted => return Ok(PyKeyboardInterrupt::new_err(())),
    };
    Ok(PyErr::from_value(instance))
}

/// The same result; an `OutOfMemoryError` said of the argument that chose the size.
pub(super) fn asked_by<R>(py: Python<'_>, argument: &str, result: PyResult<R>) -> PyResult<R> {
    result.map_err(|error| {
        let value = error.value(py);
        let sizes = || -> PyResult<(u128, Option<u128>)> {
            Ok((value.getattr("bytes")?.extract()?, value.getattr("free")?.extract()?))
        };
        match (error.is_instance_of::<PyMemoryError>(py), sizes()) {
            (true, Ok((bytes, free))) => Error::memory(argument, bytes, free).into(),
            _ => error,
        }
    })
}

/// What indexes a state in Python: a number for one leading axis, a tuple for several.
pub(super) fn batch_index<'py>(py: Python<'py>, state: usize, batch: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    if batch.len() < 2 {
        return Ok(state.into_pyobject(py)?.into_any());
    }
    let mut rest = state;
    let mut index: Vec<usize> = Vec::with_capacity(batch.len());
    for &length in batch.iter().rev() {
        index.push(rest.checked_rem(length).unwrap_or(0));
        rest = rest.checked_div(length).unwrap_or(0);
    }
    index.reverse();
    Ok(PyTuple::new(py, index)?.into_any())
}

/// Issues the warnings of a scene, at the line of Python that built it.
pub(super) fn warn(py: Python<'_>, scene: &Scene) -> PyResult<()> {
    warn_beyond(py, scene, &[])
}

/// The same but for those that are known.
pub(super) fn warn_beyond(py: Python<'_>, scene: &Scene, known: &[SceneWarning]) -> PyResult<()> {
    for warning in scene.warnings().iter().filter(|warning| !known.contains(warning)) {
        let class = match warning {
            SceneWarning::Inertia { .. } | SceneWarning::NoMass { .. } => "InertiaWarning",
            SceneWarning::Mimic { .. } => "MimicWarning",
            SceneWarning::NotUnderstood { .. } => "UnknownTagWarning",
            SceneWarning::Limits { .. } => "LimitWarning",
        };
        let text = CString::new(warning.to_string().replace('\0', "\\0")).unwrap_or_default();
        let class = classes(py)?.getattr(class)?;
        let class = class.cast_into::<PyType>().unwrap_or_else(|_| py.get_type::<PyUserWarning>());
        // Functions of a compiled module have no Python frame of their own: level 1 is the caller's line.
        PyErr::warn(py, &class, &text, 1)?;
    }
    Ok(())
}
