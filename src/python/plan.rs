//! The simplifications of a scene, as Python objects.

use super::cost::WORTH_DETACHING;
use super::interrupts::detached;
use super::object::{Object, imported};
use super::scene::PyScene;
use crate::plan::Omission;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

#[pymethods]
impl PyScene {
    /// Simplifications of this scene: which computations are skipped, why, and how many operations that saves.
    #[doc = section!(Returns)]
    /// plan : Plan
    ///     Its items are Omission objects; printed, it is a list.
    #[doc = section!(Examples)]
    /// >>> plan = phipsi.scenes.chain(3).plan()
    /// >>> plan.bodies, plan.links
    /// (3, 4)
    fn plan<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        let short = self.size() < WORTH_DETACHING;
        let plan = if short { self.scene.plan() } else { detached(py, || self.scene.plan())? };
        let class = imported!(py, "phipsi._results", "Omission")?;
        let items = plan.items.into_iter().map(|item| {
            let Omission { what, switch, count, names, why, saved, operations } = item;
            class.call1((what, switch, operations, count, PyTuple::new(py, names)?, why, saved))
        });
        let items = PyTuple::new(py, items.collect::<PyResult<Vec<_>>>()?)?;
        imported!(py, "phipsi._results", "Plan")?.call1((plan.bodies, plan.links, items))
    }
}
