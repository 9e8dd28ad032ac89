//! The argument `wrenches`: a dict from link names to (..., 6), converted to forces on bodies, or to the wrenches of a
//! simulation.

use super::choice::items;
use super::errors::refuse;
use super::input::{Input, wrong_shape};
use super::object::Object;
use crate::batch::Broadcast;
use crate::error::{Error, check_finite};
use crate::memory;
use crate::motion::{WrenchFrame, Wrenches};
use crate::scene::Scene;
use crate::spatial::{RigidShift, SpatialVector};
use nalgebra::Vector6;
use pyo3::prelude::*;
use pyo3::types::PyMapping;

/// Wrench (moment, force) on one link, at its origin and in its frame.
pub(super) struct Wrench<'py> {
    /// Name of the link.
    link: String,
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
            return refuse(argument, found, "a dict from link names to arrays (..., 6)");
        };
        let mut read = Vec::with_capacity(mapping.len()?);
        for (name, value) in items(argument, mapping, "names of links")? {
            let link = scene.link(&name).map_err(|error| error.of_argument(argument))?;
            let input = Input::new(format!("{argument}[{name:?}]"), &value, 6)?;
            read.push(Self { link: name, input, body: link.body, placement: link.placement });
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

/// The wrenches of a simulation, as given, and their axes.
pub(super) struct LinkWrenches<'py> {
    given: Vec<Wrench<'py>>,
    /// The number of steps if arguments of two or more axes have one of steps, (..., steps, 6) or (..., 1, 6); None if
    /// all leading axes are those of the batch.
    steps: Option<usize>,
    frame: WrenchFrame,
}

impl<'py> LinkWrenches<'py> {
    /// Reads the arguments `wrenches` and `frame`.
    pub fn read(
        scene: &Scene,
        wrenches: Option<&Object<'py>>,
        frame: Option<&str>,
        steps: Option<usize>,
    ) -> PyResult<Option<Self>> {
        let frame = frame.map_or(Ok(WrenchFrame::default()), str::parse)?;
        let given = Wrench::read(scene, wrenches)?;
        for Wrench { input, .. } in &given {
            check_finite(&input.name, input.data()?)?;
            if let (Some(steps), Some(&axis)) = (steps, input.leading().last())
                && axis != steps
                && axis != 1
            {
                let found = [input.leading(), &[6]].concat();
                return Err(wrong_shape(
                    &input.name,
                    &found,
                    format!("(6,), (..., {steps}, 6), or (..., 1, 6) for all steps"),
                ));
            }
        }
        Ok(if given.is_empty() { None } else { Some(Self { given, steps, frame }) })
    }

    /// The axis of steps of an argument, if it has one, and its other leading axes.
    fn axes<'a>(&self, input: &'a Input<'py>) -> (Option<usize>, &'a [usize]) {
        match (self.steps, input.leading().split_last()) {
            (Some(_), Some((&axis, batch))) => (Some(axis), batch),
            _ => (None, input.leading()),
        }
    }

    /// Leading axes of the arguments, to which the batch must broadcast.
    pub fn leading(&self) -> Vec<(&str, &[usize])> {
        self.given.iter().map(|Wrench { input, .. }| (&*input.name, self.axes(input).1)).collect()
    }

    /// The shapes of one state, in the order of the links: (6,), (steps, 6) or (1, 6).
    pub fn shapes(&self) -> Vec<(String, Vec<usize>)> {
        let shape = |input| self.axes(input).0.into_iter().chain([6]).collect();
        self.given.iter().map(|Wrench { link, input, .. }| (link.clone(), shape(input))).collect()
    }

    /// The wrenches of all states, with those of each step if one of them changes.
    pub fn over(&self, batch: &[usize], states: usize) -> PyResult<Wrenches> {
        let (links, wanted) = (self.given.len(), self.steps.unwrap_or(1));
        let changes = self.given.iter().any(|wrench| self.axes(&wrench.input).0.is_some_and(|axis| axis == wanted));
        let steps = self.steps.filter(|_| changes);
        let is_shared = self.leading().iter().all(|(_, axes)| axes.is_empty());
        let (states, count) = (if is_shared { 1 } else { states }, steps.unwrap_or(1));
        let of_states = if is_shared { &[][..] } else { batch };
        let width = 6 * links;
        let mut values = memory::filled("wrenches", states.saturating_mul(count).saturating_mul(width), 0.0)?;
        for (at, Wrench { input, .. }) in self.given.iter().enumerate() {
            let (axis, leading) = self.axes(input);
            let each = axis.unwrap_or(1);
            let own = Broadcast::new(&input.name, input.data()?, 6 * each, leading, of_states).map_err(PyErr::from)?;
            for (row, to) in values.chunks_exact_mut(width).enumerate() {
                let (state, step) = (row / count, (row % count).min(each.saturating_sub(1)));
                to[6 * at..6 * at + 6].copy_from_slice(&own.state(state)[6 * step..6 * step + 6]);
            }
        }
        let names: Vec<String> = self.given.iter().map(|wrench| wrench.link.clone()).collect();
        Ok(Wrenches::new(names, values).with_steps(steps).with_frame(self.frame))
    }
}
