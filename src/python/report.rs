//! Measurements of the report: residuals, reference, error and time of each method, growth.

use super::choice::choose;
use super::counts::count;
use super::errors::{asked_by, refuse};
use super::input::{Input, state};
use super::interrupts::detached_checked;
use super::object::Object;
use super::output::{Output, from_numbers};
use super::scene::PyScene;
use crate::filter::FORMS;
use crate::report::accuracy::{METHODS, States, measure, reference};
use crate::report::{growth, residuals};
use crate::scalar::DoubleDouble;
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Joint accelerations in double-double arithmetic, the reference of a report.
#[pyclass(frozen, name = "Reference", module = "phipsi._core")]
pub(crate) struct PyReference {
    values: Vec<DoubleDouble>,
    nv: usize,
}

#[pymethods]
impl PyReference {
    /// Reference rounded to float64, (n, nv).
    fn toarray<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        let states = self.values.len().checked_div(self.nv).unwrap_or(0);
        let mut output = asked_by(py, "q", Output::new(py, &[states, self.nv]))?;
        for (rounded, value) in output.numbers()?.iter_mut().zip(&self.values) {
            *rounded = value.high;
        }
        output.finish_or_scalar()
    }
}

/// Arguments of a set of states: q (n, nq), qd and tau (n, nv).
struct Arguments<'py> {
    q: Input<'py>,
    qd: Input<'py>,
    tau: Input<'py>,
}

impl<'py> Arguments<'py> {
    fn read(scene: &PyScene, q: &Object<'py>, qd: &Object<'py>, tau: &Object<'py>) -> PyResult<Self> {
        let all = Self { q: scene.configuration("q", q)?, qd: scene.rate("qd", qd)?, tau: scene.rate("tau", tau)? };
        let scene = &scene.scene;
        for state in all.q.data()?.chunks_exact(scene.nq().max(1)) {
            scene.check_configuration("q", state)?;
        }
        for input in [&all.qd, &all.tau] {
            if input.leading() != all.q.leading() {
                return refuse(&*input.name, format!("leading axes {:?}", input.leading()), "those of q");
            }
            for state in input.data()?.chunks_exact(scene.nv().max(1)) {
                scene.check_rates(&input.name, state)?;
            }
        }
        Ok(all)
    }

    fn states(&self) -> PyResult<States<'_>> {
        Ok(States { q: self.q.data()?, qd: self.qd.data()?, tau: self.tau.data()? })
    }
}

#[pymethods]
impl PyScene {
    /// Relative residuals of the identities of the paper at q, by name.
    #[doc = section!(Parameters)]
    /// q : (nq,) array_like
    ///     Joint positions, rad or m.
    #[doc = section!(Returns)]
    /// residuals : dict of str to float
    ///     Name of the identity and its relative residual: rounding is a few eps times nv, or times the condition
    ///     number of M if an inverse is involved.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     A scene of more than 300 degrees of freedom, or an invalid q.
    #[doc = entries!(singular arguments)]
    #[doc = section!(Notes)]
    /// Factorization against faer's LDLT, operators against their definitions, closed forms against each other, and the
    /// dynamics at a fixed velocity and torque.
    #[doc = section!(Examples)]
    /// >>> max(phipsi.scenes.chain(3).check([0.3, 0.2, 0.1]).values()) < 1e-12
    /// True
    fn check<'py>(&self, py: Python<'py>, q: &Object<'py>) -> PyResult<Bound<'py, PyDict>> {
        let scene = &self.scene;
        let q = state("q", q, self.coordinates())?;
        let wave = |phase: f64| -> Vec<f64> {
            #[allow(clippy::cast_precision_loss)] // an index
            (0..scene.nv()).map(|i| (phase + 1.3 * i as f64).sin()).collect()
        };
        let list = detached_checked(py, || residuals::residuals(scene, &q, &wave(0.4), &wave(2.0)))?;
        let all = PyDict::new(py);
        for residual in list {
            all.set_item(residual.name, residual.value)?;
        }
        Ok(all)
    }
}

/// Residuals at one state, as (name, relative residual, whether rounding grows with the condition number of M).
#[pyfunction(name = "residuals")]
pub(super) fn residuals_at(
    py: Python<'_>,
    scene: &PyScene,
    q: &Object<'_>,
    qd: &Object<'_>,
    tau: &Object<'_>,
) -> PyResult<Vec<(&'static str, f64, bool)>> {
    let q = state("q", q, scene.coordinates())?;
    let [qd, tau] = [state("qd", qd, scene.rates())?, state("tau", tau, scene.rates())?];
    let list = detached_checked(py, || residuals::residuals(&scene.scene, &q, &qd, &tau))?;
    Ok(list.into_iter().map(|r| (r.name, r.value, r.through_inverse)).collect())
}

/// Accelerations of n states in double-double arithmetic, about 31 digits; q: (n, nq), qd and tau: (n, nv).
#[pyfunction(name = "reference")]
pub(super) fn reference_of(
    py: Python<'_>,
    scene: &PyScene,
    q: &Object<'_>,
    qd: &Object<'_>,
    tau: &Object<'_>,
) -> PyResult<PyReference> {
    let arguments = Arguments::read(scene, q, qd, tau)?;
    let states = arguments.states()?;
    let values = detached_checked(py, || reference(&scene.scene, states))?;
    Ok(PyReference { values, nv: scene.scene.nv() })
}

/// Median time per state (ns) of a method, and the error of each state compared with the reference.
///
/// Times `Scene::evaluate` in Rust, one state per call; the error is that of the same calls, the largest over the
/// joints relative to the largest acceleration, or NaN after an invalid pivot. method: one of METHODS; repeats: passes over
/// the states.
#[pyfunction(name = "measure")]
pub(super) fn measure_method<'py>(
    py: Python<'py>,
    scene: &PyScene,
    method: &str,
    q: &Object<'py>,
    qd: &Object<'py>,
    tau: &Object<'py>,
    reference: &PyReference,
    repeats: &Object<'py>,
) -> PyResult<(f64, Bound<'py, PyArrayDyn<f64>>)> {
    let method = choose("method", method, METHODS)?;
    let repeats = count("repeats", repeats, 1)?;
    let arguments = Arguments::read(scene, q, qd, tau)?;
    let states = arguments.states()?;
    if reference.values.len() != states.tau.len() {
        return refuse("reference", format!("{} numbers", reference.values.len()), "the reference of these states");
    }
    let values = &reference.values;
    let measurement = detached_checked(py, || measure(&scene.scene, method, states, values, repeats))?;
    let errors = from_numbers(py, &measurement.errors, &[measurement.errors.len()])?;
    Ok((measurement.ns, errors.cast_into()?))
}

/// Median time per body (ns) on a chain: forward dynamics in the forms "auto" and "covariance", inverse dynamics.
///
/// Times `Scene::evaluate` in Rust, one state per call, over repeats passes.
#[pyfunction(name = "growth")]
pub(super) fn growth_of(py: Python<'_>, bodies: &Object<'_>, repeats: &Object<'_>) -> PyResult<(f64, f64, f64)> {
    let (bodies, repeats) = (count("bodies", bodies, 0)?, count("repeats", repeats, 1)?);
    let growth = detached_checked(py, || growth::growth(bodies, repeats))?;
    Ok((growth.forward, growth.covariance, growth.inverse))
}

/// Rust function of a method of METHODS, and its form; None if its calls have no form.
#[pyfunction(name = "method_call")]
pub(super) fn call_of_method(method: &str) -> PyResult<(&'static str, Option<&'static str>)> {
    let method = choose("method", method, METHODS)?;
    let name = |form| FORMS.iter().find(|(_, known)| *known == form).map(|&(name, _)| name);
    Ok((method.call(), method.form().and_then(name)))
}

/// Median time per body (ns) of each operator, and with a star of its transpose, on a chain: (name, ns).
#[pyfunction(name = "operator_growth")]
pub(super) fn operator_growth_of(
    py: Python<'_>,
    bodies: &Object<'_>,
    repeats: &Object<'_>,
) -> PyResult<Vec<(String, f64)>> {
    let (bodies, repeats) = (count("bodies", bodies, 0)?, count("repeats", repeats, 1)?);
    detached_checked(py, || growth::operator_growth(bodies, repeats))
}
