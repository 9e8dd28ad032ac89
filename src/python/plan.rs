//! What a scene leaves out, as Python objects.

use super::choice::choose;
use super::interrupts::detached;
use super::scene::{PyScene, WORTH_DETACHING, names};
use crate::error::Error;
use crate::plan::{Omission, Plan};
use crate::scene::Omissions;
use pyo3::prelude::*;
use pyo3::types::{PyString, PyTuple};
use std::fmt::Write;

/// One thing that a scene does not need and that was left out.
#[pyclass(frozen, name = "Omission", module = "phipsi._core")]
pub(crate) struct PyOmission {
    omission: Omission,
}

#[pymethods]
impl PyOmission {
    /// What, in a few words.
    #[getter]
    fn what(&self) -> &'static str {
        self.omission.what
    }

    /// The name in leave_out that stands for it; None where there is one way to compute only.
    #[getter]
    fn switch(&self) -> Option<&'static str> {
        self.omission.switch
    }

    /// Floating-point operations (a product with a sum is two) that forward dynamics of one state in covariance form does less.
    ///
    /// In a call that needs nothing of this; 0 where nothing was counted. In 6-vectors, of a planar scene too, but for the item
    /// "planar"; items of calls on the factor say beside what they count.
    #[getter]
    fn operations(&self) -> usize {
        self.omission.operations
    }

    /// How many.
    #[getter]
    fn count(&self) -> usize {
        self.omission.count
    }

    /// The joints or links, where they have names.
    #[getter]
    fn names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, &self.omission.names)
    }

    /// Why the results are the same without it.
    #[getter]
    fn why(&self) -> &'static str {
        self.omission.why
    }

    /// What that saved.
    #[getter]
    fn saved(&self) -> &str {
        &self.omission.saved
    }

    fn __repr__(&self) -> String {
        format!("<{} {}>", self.omission.count, self.omission.what)
    }
}

/// What a scene does not need, and what leaving it out saved; printed, it is a list.
#[pyclass(frozen, name = "Plan", module = "phipsi._core")]
pub(crate) struct PyPlan {
    plan: Plan,
}

#[pymethods]
impl PyPlan {
    /// Moving bodies that the sweeps visit.
    #[getter]
    fn bodies(&self) -> usize {
        self.plan.bodies
    }

    /// Links that the scene was built from.
    #[getter]
    fn links(&self) -> usize {
        self.plan.links
    }

    /// What was left out; only what this scene had.
    #[getter]
    fn items<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.plan.items.iter().map(|omission| PyOmission { omission: omission.clone() }))
    }

    fn __repr__(&self) -> String {
        let mut text = format!("{} bodies from {} links; left out:", self.plan.bodies, self.plan.links);
        for item in &self.plan.items {
            let _ = write!(text, "\n  {} {}: {}; saved {}", item.count, item.what, item.why, item.saved);
            if item.operations > 0 {
                let _ = write!(text, ", {} operations a call", item.operations);
            }
        }
        text
    }
}

/// What is left out, by name; everything where nothing is said.
pub(super) fn left_out(leave_out: Option<&Bound<'_, PyAny>>) -> PyResult<Omissions> {
    let Some(given) = leave_out else { return Ok(Omissions::all()) };
    let Some(named) = (!given.is_instance_of::<PyString>()).then(|| names(given)).flatten() else {
        return Err(Error::argument("leave_out", given.repr()?.to_string(), "a collection of names, or None").into());
    };
    let named: Vec<&str> = named.iter().map(String::as_str).collect();
    Ok(of_names("leave_out", &named)?)
}

/// The switches of these names on, the others off.
pub(super) fn of_names(argument: &str, names: &[&str]) -> Result<Omissions, Error> {
    let mut omissions = Omissions::none();
    for name in names {
        *choose(argument, name, &Omissions::SWITCHES)?(&mut omissions) = true;
    }
    Ok(omissions)
}

/// The names of the switches that are on.
pub(super) fn names_of(mut omissions: Omissions) -> Vec<String> {
    let on = Omissions::SWITCHES.iter().filter(|(_, switch)| *switch(&mut omissions));
    on.map(|&(name, _)| name.to_owned()).collect()
}

#[pymethods]
impl PyScene {
    /// What this scene does not need and was left out when it was built, why, and what that saved.
    fn plan(&self, py: Python<'_>) -> PyResult<PyPlan> {
        let short = self.size() < WORTH_DETACHING;
        Ok(PyPlan { plan: if short { self.scene.plan() } else { detached(py, || self.scene.plan())? } })
    }
}
