//! The models of states, from the keywords `inertias`, `armature` and, in simulations, other properties of joints.

use super::axis::Axis;
use super::control::everyone;
use super::description::body_names;
use super::input::Input;
use super::object::Object;
use crate::batch::Broadcast;
use crate::model::StateModel;
use crate::motion::Properties;
use crate::scene::Scene;
use pyo3::prelude::*;

/// Inertias and armature of the states of a call; None: those of the scene.
#[derive(Default)]
pub(super) struct Models<'py> {
    inertias: Option<Input<'py>>,
    armature: Option<Input<'py>>,
}

impl<'py> Models<'py> {
    /// Reads `inertias`, (..., bodies, 10), and `armature`, (..., nv).
    pub fn read(scene: &Scene, inertias: Option<&Object<'py>>, armature: Option<&Object<'py>>) -> PyResult<Self> {
        let inertias = inertias.map(|given| Input::table("inertias", given, body_names(scene).len(), 10));
        let armature = armature.map(|given| Input::spread("armature", given, Axis::Rates(scene)));
        Ok(Self { inertias: inertias.transpose()?, armature: armature.transpose()? })
    }

    pub fn inputs(&self) -> impl Iterator<Item = &Input<'py>> {
        [&self.inertias, &self.armature].into_iter().flatten()
    }

    /// Views for threads without access to Python.
    pub fn over(&self, batch: &[usize]) -> PyResult<States<'_>> {
        Ok(States { inertias: over(self.inertias.as_ref(), batch)?, armature: over(self.armature.as_ref(), batch)? })
    }
}

fn over<'a>(given: Option<&'a Input<'_>>, batch: &[usize]) -> PyResult<Option<Broadcast<'a>>> {
    given.map(|input| input.over(batch)).transpose()
}

/// The models of the states of a batch.
pub(super) struct States<'a> {
    inertias: Option<Broadcast<'a>>,
    armature: Option<Broadcast<'a>>,
}

impl<'a> States<'a> {
    /// True if all states have the model of the scene.
    pub fn is_empty(&self) -> bool {
        self.inertias.is_none() && self.armature.is_none()
    }

    pub fn of(&self, state: usize) -> StateModel<'a> {
        let of = |given: &Option<Broadcast<'a>>| given.as_ref().map_or(&[][..], |given| given.state(state));
        StateModel { inertias: of(&self.inertias), armature: of(&self.armature) }
    }
}

/// The numbers of a simulation in which its states differ: place in the properties, and values.
pub(super) type OfStates<'py> = Vec<(Place, Input<'py>)>;

/// A field of the properties.
pub(super) type Place = fn(&mut Properties) -> &mut Vec<f64>;

/// Leading axes of these numbers, to which the batch must broadcast.
pub(super) fn leading<'a>(given: &'a OfStates<'_>) -> impl Iterator<Item = (&'a str, &'a [usize])> {
    given.iter().map(|(_, input)| (&*input.name, input.leading()))
}

/// Writes the numbers of all states.
pub(super) fn fill(given: &OfStates<'_>, properties: &mut Properties, batch: &[usize], states: usize) -> PyResult<()> {
    for (place, input) in given {
        *place(properties) = everyone(input, batch, states)?;
    }
    Ok(())
}
