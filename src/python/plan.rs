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
#[pyclass(frozen, eq, hash, name = "Omission", module = "phipsi._core")]
#[derive(Clone, PartialEq, Eq, Hash)]
pub(crate) struct PyOmission {
    what: String,
    switch: Option<String>,
    operations: usize,
    count: usize,
    names: Vec<String>,
    why: String,
    saved: String,
}

/// The fields of an omission, in their order.
type OmissionTuple = (String, Option<String>, usize, usize, Vec<String>, String, String);

impl From<Omission> for PyOmission {
    fn from(omission: Omission) -> Self {
        let Omission { what, switch, count, names, why, saved, operations } = omission;
        let switch = switch.map(str::to_owned);
        Self { what: what.to_owned(), switch, operations, count, names, why: why.to_owned(), saved }
    }
}

impl From<OmissionTuple> for PyOmission {
    fn from((what, switch, operations, count, names, why, saved): OmissionTuple) -> Self {
        Self { what, switch, operations, count, names, why, saved }
    }
}

impl From<PyOmission> for OmissionTuple {
    fn from(omission: PyOmission) -> Self {
        let PyOmission { what, switch, operations, count, names, why, saved } = omission;
        (what, switch, operations, count, names, why, saved)
    }
}

#[pymethods]
impl PyOmission {
    /// What, in a few words.
    #[getter]
    fn what(&self) -> &str {
        &self.what
    }

    /// The name in leave_out that stands for it; None where there is one way to compute only.
    #[getter]
    fn switch(&self) -> Option<&str> {
        self.switch.as_deref()
    }

    /// Floating-point operations (a product with a sum is two) that forward dynamics of one state in covariance form does less.
    ///
    /// In a call that needs nothing of this; 0 where nothing was counted. In 6-vectors, of a planar scene too, but for the item
    /// "planar"; items of calls on the factor say beside what they count.
    #[getter]
    fn operations(&self) -> usize {
        self.operations
    }

    /// How many.
    #[getter]
    fn count(&self) -> usize {
        self.count
    }

    /// The joints or links, where they have names.
    #[getter]
    fn names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, &self.names)
    }

    /// Why the results are the same without it.
    #[getter]
    fn why(&self) -> &str {
        &self.why
    }

    /// What that saved.
    #[getter]
    fn saved(&self) -> &str {
        &self.saved
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (OmissionTuple,))> {
        Ok((py.import("phipsi._core")?.getattr("_rebuild_omission")?, (self.clone().into(),)))
    }

    fn __repr__(&self) -> String {
        format!("<{} {}>", self.count, self.what)
    }
}

/// What a scene does not need, and what leaving it out saved; printed, it is a list.
#[pyclass(frozen, eq, hash, name = "Plan", module = "phipsi._core")]
#[derive(PartialEq, Eq, Hash)]
pub(crate) struct PyPlan {
    bodies: usize,
    links: usize,
    items: Vec<PyOmission>,
}

/// Bodies, links, items.
type PlanTuple = (usize, usize, Vec<OmissionTuple>);

impl From<Plan> for PyPlan {
    fn from(plan: Plan) -> Self {
        let Plan { bodies, links, items } = plan;
        Self { bodies, links, items: items.into_iter().map(PyOmission::from).collect() }
    }
}

#[pymethods]
impl PyPlan {
    /// Moving bodies that the sweeps visit.
    #[getter]
    fn bodies(&self) -> usize {
        self.bodies
    }

    /// Links that the scene was built from.
    #[getter]
    fn links(&self) -> usize {
        self.links
    }

    /// What was left out; only what this scene had.
    #[getter]
    fn items<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.items.iter().cloned())
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (PlanTuple,))> {
        let items = self.items.iter().cloned().map(OmissionTuple::from).collect();
        Ok((py.import("phipsi._core")?.getattr("_rebuild_plan")?, ((self.bodies, self.links, items),)))
    }

    fn __repr__(&self) -> String {
        let mut text = format!("{} bodies from {} links; left out:", self.bodies, self.links);
        for item in &self.items {
            let _ = write!(text, "\n  {} {}: {}; saved {}", item.count, item.what, item.why, item.saved);
            if item.operations > 0 {
                let _ = write!(text, ", {} operations a call", item.operations);
            }
        }
        text
    }
}

/// The omission of what `Omission.__reduce__` gave.
#[pyfunction]
#[pyo3(name = "_rebuild_omission", signature = (fields, /))]
pub(super) fn rebuild_omission(fields: OmissionTuple) -> PyOmission {
    fields.into()
}

/// The plan of what `Plan.__reduce__` gave.
#[pyfunction]
#[pyo3(name = "_rebuild_plan", signature = (fields, /))]
pub(super) fn rebuild_plan(fields: PlanTuple) -> PyPlan {
    let (bodies, links, items) = fields;
    PyPlan { bodies, links, items: items.into_iter().map(PyOmission::from).collect() }
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
        Ok(if short { self.scene.plan() } else { detached(py, || self.scene.plan())? }.into())
    }
}
