//! Inputs of a simulation: joint torques (constant, one per step, or from a function) and the control law.

use super::input::{self, Input, wrong_shape};
use super::object::Object;
use super::scene::PyScene;
use crate::batch::Broadcast;
use crate::error::{Error, check_finite};
use crate::joints::JointKind;
use crate::memory;
use crate::motion::{Gains, Torque};
use crate::scene::Coupling;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// Values of all states of the batch, consecutively.
pub(super) fn everyone(input: &Input<'_>, batch: &[usize], states: usize) -> PyResult<Vec<f64>> {
    let own = input.over(batch)?;
    let width = if states == 0 { 0 } else { own.state(0).len() };
    let mut all = memory::with_capacity(&input.name, states.saturating_mul(width))?;
    for state in 0..states {
        all.extend_from_slice(own.state(state));
    }
    Ok(all)
}

/// Joint torques of a call, as given.
pub(super) enum Given<'py> {
    Nothing,
    Constant(Input<'py>),
    Steps(Input<'py>),
    Function(Object<'py>),
}

impl<'py> Given<'py> {
    pub fn read(
        tau: Option<&Object<'py>>,
        tau_steps: Option<&Object<'py>>,
        steps: usize,
        scene: &PyScene,
    ) -> PyResult<Self> {
        let rates = scene.rates();
        match (tau, tau_steps) {
            (None, None) => Ok(Self::Nothing),
            (Some(_), Some(_)) => {
                Err(Error::argument("tau_steps", "tau and tau_steps", "either tau or tau_steps").into())
            }
            (Some(tau), None) if tau.is_callable() => Ok(Self::Function(tau.clone())),
            (Some(given), None) => {
                let tau = Input::new("tau", given, rates)?;
                check_finite("tau", tau.data()?)?;
                Ok(Self::Constant(scene.on_tree(given.py(), tau, Coupling::torques)?))
            }
            (None, Some(given)) => {
                let tau = Input::new("tau_steps", given, rates)?;
                if tau.leading().last() != Some(&steps) {
                    let found = [tau.leading(), &[rates.width()]].concat();
                    return Err(wrong_shape("tau_steps", &found, format!("(..., {steps}, {})", rates.width())));
                }
                check_finite("tau_steps", tau.data()?)?;
                Ok(Self::Steps(scene.on_tree(given.py(), tau, Coupling::torques)?))
            }
        }
    }

    /// Refuses constant torques of shape (steps, nv) for one state: most callers mean the torques of each step, and not
    /// a batch with one robot per row.
    pub fn check_not_steps(&self, steps: usize, is_one_state: bool) -> Result<(), Error> {
        let Self::Constant(tau) = self else { return Ok(()) };
        if !is_one_state || tau.leading() != [steps] {
            return Ok(());
        }
        let found = format!("one row for each of {steps} steps, of one state");
        let expected = format!("tau_steps=... for these torques, or q of {steps} states for a batch");
        Err(Error::argument("tau", found, expected))
    }

    /// Leading axes of the argument, to which the batch must broadcast.
    pub fn leading(&self) -> Option<(&'static str, &[usize])> {
        match self {
            Self::Nothing | Self::Function(_) => None,
            Self::Constant(tau) => Some(("tau", tau.leading())),
            Self::Steps(tau) => {
                let axes = tau.leading();
                Some(("tau_steps", &axes[..axes.len() - 1]))
            }
        }
    }

    /// Torques of all steps; None if a function returns them.
    pub fn torque<'a>(&'a self, batch: &[usize], (steps, nv): (usize, usize)) -> PyResult<Torque<'a>> {
        Ok(match self {
            Self::Constant(tau) => Torque::Constant(tau.over(batch)?),
            Self::Steps(tau) => {
                let axes = tau.leading();
                let torque = Broadcast::new("tau_steps", tau.data()?, steps * nv, &axes[..axes.len() - 1], batch);
                Torque::Steps { torque: torque.map_err(PyErr::from)?, first: 0 }
            }
            Self::Nothing | Self::Function(_) => Torque::Zero,
        })
    }
}

/// Control law of a call, as given.
pub(super) struct Pd<'py> {
    gains: [Vec<f64>; 2],
    target: Input<'py>,
    rate: Input<'py>,
}

impl<'py> Pd<'py> {
    pub fn read(pd: &Object<'py>, scene: &PyScene) -> PyResult<Self> {
        let expected = "PD(kp, kd, target) or PD(kp, kd, target, target_rate)";
        let refuse = |found: String| PyErr::from(Error::argument("pd", found, expected));
        let Ok(parts) = pd.cast::<PyTuple>() else {
            return Err(refuse(format!("an object of type {}", pd.get_type().name()?)));
        };
        if !(3..=4).contains(&parts.len()) {
            return Err(refuse(format!("{} parts", parts.len())));
        }
        let rate = match parts.get_item(3) {
            Ok(rate) if !rate.is_none() => scene.rate("pd.target_rate", &rate)?,
            _ => Input::filled(pd.py(), "pd.target_rate", 0.0, scene.scene.nv())?,
        };
        let gain = |name: &str, at: usize| -> PyResult<Vec<f64>> {
            let given = parts.get_item(at)?;
            if let Some(free) = scene.scene.joints().iter().find(|joint| joint.kind == JointKind::Floating)
                && input::is_one_number(&given)
            {
                let found = format!("one number for all joints, which would also hold {:?} in the air", free.name);
                let (nv, rows) = (scene.scene.nv(), &free.v);
                let expected = format!(
                    "{nv} gains, those of {:?} at {}:{} explicitly, for instance 0",
                    free.name, rows.start, rows.end
                );
                return Err(Error::argument(name, found, expected).into());
            }
            let gains = input::spread(name, &given, scene.rates())?;
            Ok(scene.expanded(gains, Coupling::torques))
        };
        let (py, target) = (pd.py(), scene.configuration("pd.target", &parts.get_item(2)?)?);
        Ok(Self {
            gains: [gain("pd.kp", 0)?, gain("pd.kd", 1)?],
            target: scene.on_tree(py, target, Coupling::configuration)?,
            rate: scene.on_tree(py, rate, Coupling::rates)?,
        })
    }

    /// Leading axes of the argument, to which the batch must broadcast.
    pub fn leading(&self) -> [(&'static str, &[usize]); 2] {
        [("pd.target", self.target.leading()), ("pd.target_rate", self.rate.leading())]
    }

    pub fn over(self, batch: &[usize], states: usize) -> PyResult<Gains> {
        let each = |input: &Input<'_>| {
            if input.leading().is_empty() {
                Ok(memory::copied(&input.name, input.data()?)?)
            } else {
                everyone(input, batch, states)
            }
        };
        let (target, target_rate) = (each(&self.target)?, each(&self.rate)?);
        let [proportional, derivative] = self.gains;
        Ok(Gains { proportional, derivative, target, target_rate })
    }
}
