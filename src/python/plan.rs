//! What a scene leaves out, as Python objects.

use super::scene::PyScene;
use crate::plan::{Omission, Plan};
use pyo3::prelude::*;
use pyo3::types::PyTuple;
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
        }
        text
    }
}

#[pymethods]
impl PyScene {
    /// What this scene does not need and was left out when it was built, why, and what that saved.
    fn plan(&self) -> PyPlan {
        PyPlan { plan: self.scene.plan() }
    }
}
