//! The table of functions, which the tables of `phipsi._functions` are made of.

use crate::algorithm::FUNCTIONS;
use crate::algorithm::table::{Array, Axis, CompiledFor};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyTuple};

/// Every function: a dict of its name, a summary, its arguments and results with their axes, and what is known of it.
///
/// Axes are "nq", "nv", "links", "rows" (of connections), "contacts" or numbers. state: the number of arguments that
/// are a state.
/// few: the number of states below which the scene is faster than compiled code; None: no code is generated for it.
/// `watched`: the function that also returns a margin. scenes: those with code.
#[pyfunction(name = "_function_table")]
pub(super) fn function_table(py: Python<'_>) -> PyResult<Bound<'_, PyList>> {
    let all = PyList::empty(py);
    for entry in FUNCTIONS {
        let row = PyDict::new(py);
        row.set_item("name", entry.name)?;
        row.set_item("summary", entry.summary)?;
        row.set_item("arguments", arrays(py, entry.arguments)?)?;
        row.set_item("state", entry.state)?;
        row.set_item("results", arrays(py, entry.results)?)?;
        row.set_item("derivative_of", entry.derivative_of)?;
        row.set_item("has_form", entry.has_form)?;
        row.set_item("has_dtype", entry.has_dtype)?;
        row.set_item("of_link", entry.of_link)?;
        row.set_item("few", entry.compiled.map(|compiled| compiled.few))?;
        row.set_item("watched", entry.compiled.and_then(|compiled| compiled.watched))?;
        let scenes = entry.compiled.map(|compiled| match compiled.scenes {
            CompiledFor::Every => "every",
            CompiledFor::Trees => "trees",
            CompiledFor::Loops => "loops",
            CompiledFor::Contacts => "contacts",
            CompiledFor::TreesWithContacts => "trees with contacts",
        });
        row.set_item("scenes", scenes)?;
        all.append(row)?;
    }
    Ok(all)
}

/// Names and axes.
fn arrays<'py>(py: Python<'py>, arrays: &[Array]) -> PyResult<Bound<'py, PyDict>> {
    let all = PyDict::new(py);
    for (name, axes) in arrays {
        let axes = axes.iter().map(|axis| match axis {
            Axis::Coordinates => "nq".into_pyobject(py).map(Bound::into_any),
            Axis::Velocities => "nv".into_pyobject(py).map(Bound::into_any),
            Axis::Links => "links".into_pyobject(py).map(Bound::into_any),
            Axis::ConnectionRows => "rows".into_pyobject(py).map(Bound::into_any),
            Axis::Contacts => "contacts".into_pyobject(py).map(Bound::into_any),
            Axis::Fixed(length) => length.into_pyobject(py).map(Bound::into_any),
        });
        all.set_item(name, PyTuple::new(py, axes.collect::<Result<Vec<_>, _>>()?)?)?;
    }
    Ok(all)
}
