//! The scenes of the library, for `phipsi.scenes`.

use super::counts::{count, number};
use super::interrupts::detached_checked;
use super::object::Object;
use super::output;
use super::scene::PyScene;
use crate::scenes;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// Scene, q, qd, tau, name, value, parameter, values.
type Case<'py> = (PyScene, Object<'py>, Object<'py>, Object<'py>, &'static str, f64, &'static str, Bound<'py, PyTuple>);

/// Extreme case as (scene, q, qd, tau, name, value, parameter, values); see phipsi.scenes.extreme.
#[pyfunction(name = "extreme")]
pub(super) fn extreme_case<'py>(
    py: Python<'py>,
    name: &str,
    value: Option<f64>,
    bodies: Option<&Object<'py>>,
    seed: &Object<'py>,
) -> PyResult<Case<'py>> {
    let bodies = bodies.map(|bodies| count("bodies", bodies, 0)).transpose()?;
    let seed = number("seed", seed)?;
    let case = detached_checked(py, || scenes::extreme(name, value, bodies, seed))?;
    let array = |numbers: &[f64]| output::from_numbers(py, numbers, &[numbers.len()]);
    let (q, qd, tau) = (array(&case.q)?, array(&case.qd)?, array(&case.tau)?);
    let values = PyTuple::new(py, case.values)?;
    Ok((PyScene::new(case.scene), q, qd, tau, case.name, case.value, case.parameter, values))
}

/// Names of the extreme cases; see phipsi.scenes.names.
#[pyfunction(name = "extreme_names")]
pub(super) fn extreme_names(py: Python<'_>) -> PyResult<Bound<'_, PyTuple>> {
    PyTuple::new(py, scenes::names())
}

/// Chain of n equal links; see phipsi.scenes.chain.
#[pyfunction(name = "chain")]
pub(super) fn chain_of(py: Python<'_>, n: &Object<'_>) -> PyResult<PyScene> {
    let n = count("n", n, 0)?;
    Ok(PyScene::new(detached_checked(py, || scenes::chain(n))?))
}
