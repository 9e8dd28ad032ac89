//! What `simulate` and `simulator` have in common: their keywords, how many steps go by between two looks at signals, and how they end early.

use super::choice::read_form;
use super::control::Pd;
use super::errors::{batch_index, fault};
use super::input;
use super::object::{Object, imported};
use super::output::from_numbers;
use super::scene::PyScene;
use crate::batch::Fault;
use crate::motion::{Correction, Method, Properties, Settings, Stabilisation, StepFault};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::time::{Duration, Instant};

/// Between reports of progress, and between looks at signals.
pub(super) const BLOCK: Duration = Duration::from_millis(50);

/// How states move, as given.
pub(super) struct Keywords<'a, 'py> {
    pub dt: f64,
    pub method: Option<&'a str>,
    pub pd: Option<&'a Object<'py>>,
    pub armature: Option<&'a Object<'py>>,
    pub damping: Option<&'a Object<'py>>,
    pub stiffness: Option<&'a Object<'py>>,
    pub rest: Option<&'a Object<'py>>,
    pub friction: Option<&'a Object<'py>>,
    pub friction_speed: f64,
    pub form: &'a str,
    pub conserve_momentum: bool,
    pub baumgarte: Option<f64>,
}

impl<'py> Keywords<'_, 'py> {
    /// The settings that they are, but for the control law, whose targets may be those of a batch.
    pub fn read(&self, own: &PyScene) -> PyResult<(Settings, Option<Pd<'py>>)> {
        let mut settings = Settings::new(&own.scene, self.dt);
        match self.method {
            Some(method) => settings.method = Method::named(method)?,
            None if own.scene.contacts().is_empty() => settings.method = Method::RungeKutta4,
            None => {}
        }
        settings.conserve_momentum = self.conserve_momentum;
        settings.stabilisation = self.baumgarte.map_or(Stabilisation::Projection, Stabilisation::Baumgarte);
        settings.form = read_form(self.form)?;
        let properties = &mut settings.properties;
        for (name, given, place) in [
            ("armature", self.armature, &mut properties.armature),
            ("damping", self.damping, &mut properties.damping),
            ("stiffness", self.stiffness, &mut properties.stiffness),
            ("friction", self.friction, &mut properties.friction),
        ] {
            if let Some(given) = given {
                *place = input::spread(name, given, own.rates())?;
            }
        }
        if let Some(rest) = self.rest {
            properties.rest = input::state("rest", rest, own.coordinates())?;
        }
        properties.friction_speed = self.friction_speed;
        let pd = self.pd.map(|pd| Pd::read(pd, own)).transpose()?;
        Ok((settings, pd))
    }

    /// The keywords and torques that say, beside a trajectory's own fields, how it was made.
    pub fn given(
        &self,
        py: Python<'py>,
        (tau, tau_steps): (Option<&Object<'py>>, Option<&Object<'py>>),
    ) -> PyResult<Bound<'py, PyDict>> {
        let given = PyDict::new(py);
        for (name, value) in [
            ("tau", tau),
            ("tau_steps", tau_steps),
            ("pd", self.pd),
            ("damping", self.damping),
            ("friction", self.friction),
        ] {
            if let Some(value) = value {
                given.set_item(name, value)?;
            }
        }
        given.set_item("friction_speed", self.friction_speed)?;
        given.set_item("form", self.form)?;
        given.set_item("conserve_momentum", self.conserve_momentum)?;
        given.set_item("baumgarte", self.baumgarte)?;
        Ok(given)
    }
}

/// The fields of a trajectory that say how it was made.
pub(super) fn about<'py>(scene: &Bound<'py, PyScene>, settings: &Settings) -> PyResult<Bound<'py, PyDict>> {
    let py = scene.py();
    let fields = PyDict::new(py);
    fields.set_item("scene", scene)?;
    fields.set_item("dt", settings.dt)?;
    fields.set_item("method", settings.method.name())?;
    let Properties { armature, stiffness, rest, .. } = &settings.properties;
    for (name, numbers) in [("armature", armature), ("stiffness", stiffness), ("rest", rest)] {
        fields.set_item(name, from_numbers(py, numbers, &[numbers.len()])?)?;
    }
    Ok(fields)
}

/// The largest corrections of each state of a batch, which keep its momentum, as a MomentumCorrection.
pub(super) fn largest_corrections<'py>(
    py: Python<'py>,
    batch: &[usize],
    of: impl Fn(usize) -> Option<Correction>,
) -> PyResult<Object<'py>> {
    let each = || (0..batch.iter().product()).filter_map(&of);
    let velocity: Vec<f64> = each().map(|largest| largest.velocity).collect();
    let position: Vec<f64> = each().map(|largest| largest.position).collect();
    let largest = (from_numbers(py, &velocity, batch)?, from_numbers(py, &position, batch)?);
    imported!(py, "phipsi._motion", "MomentumCorrection")?.call1(largest)
}

/// How many steps to make at once: doubled or halved until they take as long as they should. Where steps are cut changes nothing in them.
pub(super) struct Blocks {
    steps: usize,
}

impl Blocks {
    pub fn new() -> Self {
        Self { steps: 1 }
    }

    /// The next of so many steps.
    pub fn next(&self, remaining: usize) -> usize {
        self.steps.min(remaining)
    }

    /// The block was begun then, and is done.
    pub fn done(&mut self, began: Instant) {
        let elapsed = began.elapsed();
        if elapsed < BLOCK / 2 {
            self.steps = self.steps.saturating_mul(2);
        } else if elapsed > BLOCK {
            self.steps = (self.steps / 2).max(1);
        }
    }
}

/// Why a run ended early.
pub(super) enum Stopped {
    Fault(StepFault),
    Raised(PyErr),
}

impl From<PyErr> for Stopped {
    fn from(error: PyErr) -> Self {
        Self::Raised(error)
    }
}

impl Stopped {
    /// The exception, with what was computed.
    pub fn raise(self, py: Python<'_>, trajectory: &Object<'_>, batch: &[usize]) -> PyResult<PyErr> {
        let (cause, joint, state) = match self {
            Self::Raised(error) => (error, None, None),
            Self::Fault(StepFault { state, joint, error, .. }) => {
                let index = (!batch.is_empty()).then(|| batch_index(py, state, batch)).transpose()?;
                (fault(py, Fault { state, error }, batch), Some(joint), index)
            }
        };
        let made = imported!(py, "phipsi._motion", "stopped")?.call1((trajectory, cause.value(py), joint, state))?;
        Ok(PyErr::from_value(made))
    }
}
