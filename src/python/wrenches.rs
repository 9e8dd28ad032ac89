//! The argument `wrenches`: a dict from link names to (..., 6), converted to forces on bodies.

use super::choice::items;
use super::input::Input;
use super::object::Object;
use crate::batch::Broadcast;
use crate::error::{Error, check_finite};
use crate::scene::Scene;
use crate::spatial::{RigidShift, SpatialVector};
use nalgebra::Vector6;
use pyo3::prelude::*;
use pyo3::types::PyMapping;

/// Wrench (moment, force) on one link, at its origin and in its frame.
pub(super) struct Wrench<'py> {
    /// Values for the states.
    pub input: Input<'py>,
    /// Moving body that carries the link; None for links on the base, where a wrench has no effect.
    body: Option<usize>,
    placement: RigidShift<f64>,
}

impl<'py> Wrench<'py> {
    /// Reads the argument `wrenches`: None or a mapping.
    pub fn read(scene: &Scene, wrenches: Option<&Object<'py>>) -> PyResult<Vec<Self>> {
        Self::named("wrenches", scene, wrenches)
    }

    /// The same for an argument of another name.
    pub fn named(argument: &'static str, scene: &Scene, wrenches: Option<&Object<'py>>) -> PyResult<Vec<Self>> {
        let Some(wrenches) = wrenches else { return Ok(Vec::new()) };
        let Ok(mapping) = wrenches.cast::<PyMapping>() else {
            let found = format!("an object of type {}", wrenches.get_type().name()?);
            return Err(Error::argument(argument, found, "a dict from link names to arrays (..., 6)").into());
        };
        let mut read = Vec::with_capacity(mapping.len()?);
        for (name, value) in items(argument, mapping, "names of links")? {
            let link = scene.link(&name).map_err(|error| error.of_argument(argument))?;
            let input = Input::new(format!("{argument}[{name:?}]"), &value, 6)?;
            read.push(Self { input, body: link.body, placement: link.placement });
        }
        Ok(read)
    }

    /// The values, the moving body that carries the link, and the pose of the link on it.
    pub fn apart(self) -> (Input<'py>, (Option<usize>, RigidShift<f64>)) {
        (self.input, (self.body, self.placement))
    }

    /// View for threads without access to Python.
    pub fn over<'a>(&'a self, batch: &[usize]) -> PyResult<States<'a>> {
        let numbers = self.input.over(batch)?;
        Ok(States { name: &self.input.name, numbers, body: self.body, placement: &self.placement })
    }
}

/// One wrench, broadcast over the states of a batch.
pub(super) struct States<'a> {
    name: &'a str,
    numbers: Broadcast<'a>,
    body: Option<usize>,
    placement: &'a RigidShift<f64>,
}

/// Sums the wrenches of one state as forces on bodies; empty without wrenches.
pub(super) fn on_bodies(
    wrenches: &[States<'_>],
    bodies: usize,
    state: usize,
    forces: &mut Vec<SpatialVector<f64>>,
) -> Result<(), Error> {
    forces.clear();
    if wrenches.is_empty() {
        return Ok(());
    }
    forces.resize(bodies, Vector6::zeros());
    for wrench in wrenches {
        let numbers = wrench.numbers.state(state);
        check_finite(wrench.name, numbers)?;
        if let Some(body) = wrench.body {
            forces[body] += wrench.placement.force_to_parent(&Vector6::from_column_slice(numbers));
        }
    }
    Ok(())
}
