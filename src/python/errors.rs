//! Errors and warnings of the crate as the classes of `phipsi.errors`.

use super::object::Object;
use crate::batch::{Fault, shape_text};
use crate::error::Error;
use crate::scene::{Scene, SceneWarning};
use pyo3::exceptions::{PyKeyboardInterrupt, PyMemoryError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyString, PyTuple};

/// The module of the Python classes, imported once.
pub(super) fn classes(py: Python<'_>) -> PyResult<&Bound<'_, PyModule>> {
    static MODULE: PyOnceLock<Py<PyModule>> = PyOnceLock::new();
    MODULE.get_or_try_init(py, || Ok(py.import("phipsi.errors")?.unbind())).map(|module| module.bind(py))
}

/// The error of an argument, as the result of a function.
pub(super) fn refuse<T>(
    argument: impl Into<String>,
    found: impl Into<String>,
    expected: impl Into<String>,
) -> PyResult<T> {
    Err(Error::argument(argument, found, expected).into())
}

impl From<Error> for PyErr {
    fn from(error: Error) -> Self {
        Python::attach(|py| to_python(py, &error, &[]).unwrap_or_else(|failed| failed))
    }
}

/// The exception for a fault of one state of a batch with these leading axes; () for a single state.
pub(super) fn fault(py: Python<'_>, fault: Fault, batch: &[usize]) -> PyErr {
    let error = if batch.is_empty() { fault.error } else { fault.into() };
    to_python(py, &error, batch).unwrap_or_else(|failed| failed)
}

/// The exception for an error of a call over a batch with these leading axes.
pub(super) fn of_batch(py: Python<'_>, error: &Error, batch: &[usize]) -> PyErr {
    to_python(py, error, batch).unwrap_or_else(|failed| failed)
}

/// Creates the exception of the class that belongs to `error`, with its attributes.
fn to_python(py: Python<'_>, error: &Error, batch: &[usize]) -> PyResult<PyErr> {
    let mut message = error.to_string();
    let attributes = PyDict::new(py);
    let error = if let Error::Step { error, .. } = error { &**error } else { error };
    if let Error::NotFinite { state, .. }
    | Error::SingularJoint { state, .. }
    | Error::SingularTask { state, .. }
    | Error::Constraint { state, .. } = error
    {
        let index = state.map(|state| batch_index(py, state, batch)).transpose()?;
        if let (Some(index), true) = (&index, batch.len() > 1) {
            message = format!("{message} (index {index} of the batch {})", shape_text(batch));
        }
        attributes.set_item("state", index)?;
    }
    // The class, and attributes of the exception.
    macro_rules! with {
        ($class:literal, $($name:ident),+) => {{
            $(attributes.set_item(stringify!($name), $name)?;)+
            $class
        }};
    }
    let class = match error {
        Error::Scene { .. } => "SceneError",
        Error::Shape { argument, .. } => with!("ShapeError", argument),
        Error::Argument { argument, .. } => with!("ArgumentError", argument),
        Error::NotFinite { argument, index, .. } => with!("NotFiniteError", argument, index),
        Error::SingularJoint { joint, link, pivot, .. } => with!("SingularJointError", joint, link, pivot),
        Error::SingularTask { links, rank, directions, .. } => {
            let links = PyTuple::new(py, links)?;
            with!("SingularTaskError", links, rank, directions)
        }
        Error::Constraint { violation, .. } => {
            attributes.set_item("connections", PyTuple::new(py, &violation.connections)?)?;
            attributes.set_item("residual", violation.residual)?;
            "ConstraintError"
        }
        Error::Memory { argument, request } => {
            attributes.set_item("argument", argument)?;
            attributes.set_item("bytes", request.bytes)?;
            attributes.set_item("free", request.free)?;
            "OutOfMemoryError"
        }
        Error::Step { .. } => "SimulationError",
        // The exception of a signal handler is raised where the work was started; this is for work without such a
        // check.
        Error::Interrupted => return Ok(PyKeyboardInterrupt::new_err(())),
    };
    let instance = classes(py)?.getattr(class)?.call1((message,))?;
    for (name, value) in attributes {
        instance.setattr(name.cast::<PyString>()?, value)?;
    }
    Ok(PyErr::from_value(instance))
}

/// Converts a MemoryError of NumPy to an `OutOfMemoryError` with the size, known or from NumPy; other errors are
/// returned.
pub(super) fn no_room(py: Python<'_>, name: &str, cause: &PyErr, bytes: Option<u128>) -> PyErr {
    // A shape that overflows is a ValueError in NumPy.
    if !(cause.is_instance_of::<PyMemoryError>(py) || bytes.is_some() && cause.is_instance_of::<PyValueError>(py)) {
        return cause.clone_ref(py);
    }
    let bytes = bytes.or_else(|| cause.value(py).getattr("_total_size").ok()?.extract().ok());
    match bytes {
        Some(bytes) => Error::memory(name, bytes, None).into(),
        None => PyMemoryError::new_err(format!("{name}: {}", cause.value(py))),
    }
}

/// Returns the result; an `OutOfMemoryError` then names the argument that determines the size.
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

/// Index of a state in Python: an int for one leading axis, a tuple for several.
pub(super) fn batch_index<'py>(py: Python<'py>, state: usize, batch: &[usize]) -> PyResult<Object<'py>> {
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

/// Issues the warnings of a scene, at the Python line that built it.
pub(super) fn warn(py: Python<'_>, scene: &Scene) -> PyResult<()> {
    warn_beyond(py, scene, &[])
}

/// The same without the `known` ones.
pub(super) fn warn_beyond(py: Python<'_>, scene: &Scene, known: &[SceneWarning]) -> PyResult<()> {
    for warning in scene.warnings().iter().filter(|warning| !known.contains(warning)) {
        let class = match warning {
            SceneWarning::Inertia { .. } | SceneWarning::LargeInertia { .. } | SceneWarning::NoMass { .. } => {
                "InertiaWarning"
            }
            SceneWarning::Mimic { .. } => "MimicWarning",
            SceneWarning::NotUnderstood { .. } => "UnknownTagWarning",
            SceneWarning::Degrees { .. } => "UnitsWarning",
            SceneWarning::Limits { .. } | SceneWarning::Locked { .. } => "LimitWarning",
        };
        warn_as(py, class, &warning.to_string())?;
    }
    Ok(())
}

/// Issues a warning of a class of phipsi.errors, at the line of the user's code.
pub(super) fn warn_as(py: Python<'_>, class: &str, text: &str) -> PyResult<()> {
    let classes = classes(py)?;
    classes.getattr("warn")?.call1((text, classes.getattr(class)?)).map(drop)
}
