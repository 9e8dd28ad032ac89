//! Inputs of a simulation: joint torques (constant, one per step, or from a function) and the control law.

use super::coupling::Expand;
use super::errors::refuse;
use super::input::{self, Input, wrong_shape};
use super::object::Object;
use super::output::from_numbers;
use super::scene::PyScene;
use crate::batch::Broadcast;
use crate::error::{Error, check_finite};
use crate::joints::JointKind;
use crate::memory;
use crate::motion::{Gains, Torque};
use crate::scene::Coupling;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyTuple};

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
            (Some(_), Some(_)) => refuse("tau_steps", "tau and tau_steps", "either tau or tau_steps"),
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
    pub fn leading(&self) -> Option<(&str, &[usize])> {
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
    gains: [Input<'py>; 2],
    target: Option<Input<'py>>,
    rate: Input<'py>,
    effort: Option<Input<'py>>,
    /// Stall torques and no-load speeds.
    motors: [Option<Input<'py>>; 2],
    limits_sum: bool,
    /// Targets and target velocities of each step, and the number of steps.
    changing: [Option<Input<'py>>; 2],
    steps: usize,
    neutral: Vec<f64>,
}

impl<'py> Pd<'py> {
    pub fn read(pd: &Object<'py>, scene: &PyScene) -> PyResult<Self> {
        let expected = "PD(kp, kd, target, target_rate=None, effort=None, stall=None, no_load_speed=None)";
        let refuse = |found: String| PyErr::from(Error::argument("pd", found, expected));
        let Ok(parts) = pd.cast::<PyTuple>() else {
            return Err(refuse(format!("an object of type {}", pd.get_type().name()?)));
        };
        if !(2..=7).contains(&parts.len()) {
            return Err(refuse(format!("{} parts", parts.len())));
        }
        let py = pd.py();
        let part = |at: usize| parts.get_item(at).ok().filter(|part| !part.is_none());
        let rate = match part(3) {
            Some(rate) => scene.rate("pd.target_rate", &rate)?,
            None => Input::filled(py, "pd.target_rate", 0.0, scene.scene.nv())?,
        };
        let [kp, kd] = [("pd.kp", 0), ("pd.kd", 1)].map(|(name, at)| of_joints(scene, name, &parts.get_item(at)?, 0.0));
        let target = part(2)
            .map(|target| scene.on_tree(py, scene.configuration("pd.target", &target)?, Coupling::configuration));
        let effort = match part(4) {
            Some(effort) if effort.is_instance_of::<PyBool>() && !effort.is_truthy()? => None,
            effort => effort,
        };
        let motor = |name: &'static str, at: usize| part(at).map(|given| bounds(scene, name, &given)).transpose();
        let motors = [motor("pd.stall", 5)?, motor("pd.no_load_speed", 6)?];
        if motors[0].is_some() && motors[1].is_none() {
            let error = Error::argument("pd.no_load_speed", "None", "a speed at which the torque from stall is zero");
            return Err(error.into());
        }
        let (gains, target) = ([kp?, kd?], target.transpose()?);
        let law = Self::of(gains, scene.on_tree(py, rate, Coupling::rates)?, scene);
        let effort = effort.map(|effort| limits(scene, &effort)).transpose()?;
        Ok(Self { target, effort, motors, ..law })
    }

    /// The law without gains, whose limits are those of the applied torque.
    fn without_gains(py: Python<'py>, scene: &PyScene) -> PyResult<Self> {
        let zero = |name| scene.on_tree(py, Input::filled(py, name, 0.0, scene.scene.nv())?, Coupling::torques);
        Ok(Self::of([zero("pd.kp")?, zero("pd.kd")?], zero("pd.target_rate")?, scene))
    }

    /// A law of gains and target velocity alone.
    fn of(gains: [Input<'py>; 2], rate: Input<'py>, scene: &PyScene) -> Self {
        let neutral = scene.expanded(scene.scene.neutral(), Coupling::configuration);
        let (motors, changing) = ([None, None], [None, None]);
        Self { gains, target: None, rate, effort: None, motors, limits_sum: false, changing, steps: 0, neutral }
    }

    /// Limits the sum of the law, which may not be given, and of the applied torque to the limits of the scene, and to
    /// those of the law.
    pub fn clipped(py: Python<'py>, pd: Option<Self>, scene: &PyScene) -> PyResult<Self> {
        let mut pd = pd.map_or_else(|| Self::without_gains(py, scene), Ok)?;
        let own = limits(scene, &true.into_pyobject(py)?.to_owned().into_any())?;
        pd.effort = Some(match pd.effort {
            None => own,
            Some(given) => {
                let own = own.data()?.to_vec();
                let least = |given: &[f64]| given.iter().zip(&own).map(|(a, b)| a.min(*b)).collect();
                given.mapped(py, least)?
            }
        });
        pd.limits_sum = true;
        Ok(pd)
    }

    /// The same law with targets and target velocities of each step.
    pub fn with_targets(
        self,
        [targets, rates]: [Option<&Object<'py>>; 2],
        steps: usize,
        scene: &PyScene,
    ) -> PyResult<Self> {
        let py = self.rate.py();
        let read = |name: &'static str, given: &Object<'py>, is_rate: bool| -> PyResult<Input<'py>> {
            let (input, expand): (_, Expand) = if is_rate {
                (scene.rate(name, given)?, Coupling::rates)
            } else {
                (scene.configuration(name, given)?, Coupling::configuration)
            };
            if input.leading().last() != Some(&steps) {
                let found = [input.leading(), &[input.width()]].concat();
                return Err(wrong_shape(name, &found, format!("(..., {steps}, {})", input.width())));
            }
            scene.on_tree(py, input, expand)
        };
        let changing = [
            targets.map(|given| read("targets", given, false)).transpose()?,
            rates.map(|given| read("target_rates", given, true)).transpose()?,
        ];
        Ok(Self { changing, steps, ..self })
    }

    /// Leading axes of the argument, to which the batch must broadcast.
    pub fn leading(&self) -> Vec<(&str, &[usize])> {
        let [kp, kd] = &self.gains;
        let [stall, speed] = self.motors.each_ref().map(Option::as_ref);
        let whole = [Some(kp), Some(kd), self.target.as_ref(), Some(&self.rate), self.effort.as_ref(), stall, speed];
        let names = ["pd.kp", "pd.kd", "pd.target", "pd.target_rate", "pd.effort", "pd.stall", "pd.no_load_speed"];
        let whole = names.into_iter().zip(whole).filter_map(|(name, input)| Some((name, input?.leading())));
        let steps = ["targets", "target_rates"].into_iter().zip(&self.changing);
        let steps = steps.filter_map(|(name, input)| {
            let axes = input.as_ref()?.leading();
            Some((name, &axes[..axes.len() - 1]))
        });
        whole.chain(steps).collect()
    }

    pub fn over(self, batch: &[usize], states: usize) -> PyResult<Gains> {
        let each = |input: &Input<'_>| {
            if input.leading().is_empty() {
                Ok(memory::copied(&input.name, input.data()?)?)
            } else {
                everyone(input, batch, states)
            }
        };
        let of_steps = |input: &Option<Input<'_>>| -> PyResult<Vec<f64>> {
            let Some(input) = input else { return Ok(Vec::new()) };
            let (axes, width) = (input.leading(), self.steps * input.width());
            let leading = &axes[..axes.len() - 1];
            if leading.is_empty() {
                return Ok(memory::copied(&input.name, input.data()?)?);
            }
            let own = Broadcast::new(&input.name, input.data()?, width, leading, batch).map_err(PyErr::from)?;
            let mut all = memory::with_capacity(&input.name, states.saturating_mul(width))?;
            (0..states).for_each(|state| all.extend_from_slice(own.state(state)));
            Ok(all)
        };
        let [proportional, derivative] = [each(&self.gains[0])?, each(&self.gains[1])?];
        let target = match &self.target {
            Some(target) => each(target)?,
            None if self.changing[0].is_some() || proportional.iter().all(|&kp| kp == 0.0) => self.neutral.clone(),
            None => return refuse("pd.target", "None", "a target configuration, or targets"),
        };
        let effort_upper = self.effort.as_ref().map(each).transpose()?.unwrap_or_default();
        let (stall, decline) = self.motors_over(each, &effort_upper)?;
        Ok(Gains {
            proportional,
            derivative,
            target,
            target_rate: each(&self.rate)?,
            targets: of_steps(&self.changing[0])?,
            target_rates: of_steps(&self.changing[1])?,
            steps: self.steps,
            effort_lower: effort_upper.iter().map(|limit| -limit).collect(),
            effort_upper,
            stall,
            decline,
            limits_sum: self.limits_sum,
        })
    }
}

impl Pd<'_> {
    /// Stall torques and the declines of torque with speed. Without stall torques, those are the limits of effort.
    fn motors_over(
        &self,
        each: impl Fn(&Input<'_>) -> PyResult<Vec<f64>>,
        effort: &[f64],
    ) -> PyResult<(Vec<f64>, Vec<f64>)> {
        let [stall, Some(speed)] = &self.motors else { return Ok((Vec::new(), Vec::new())) };
        let (speed, stall) = (each(speed)?, stall.as_ref().map(&each).transpose()?);
        let stall = match stall {
            Some(stall) => stall,
            None if effort.is_empty() => {
                let expected = "stall torques, or limits of effort, which are those at rest too";
                return refuse("pd.stall", "None without pd.effort", expected);
            }
            None => memory::copied("pd.effort", effort)?,
        };
        // One for all states, or one per state.
        let count = speed.len().max(stall.len());
        let of = |values: &[f64], at: usize| values[at % values.len().max(1)];
        // Joints that follow others have neither.
        if (0..count).any(|at| of(&speed, at) == 0.0 && of(&stall, at) > 0.0) {
            return refuse("pd.no_load_speed", "0", "speeds that are positive, infinite for none");
        }
        let decline = |at: usize| {
            let (stall, speed) = (of(&stall, at), of(&speed, at));
            if stall.is_finite() && stall > 0.0 { stall / speed } else { 0.0 }
        };
        let all = (0..count).map(|at| of(&stall, at)).collect();
        Ok((all, (0..count).map(decline).collect()))
    }
}

/// Values of the joints: one number for all that have a motor, which free joints have not, or (..., nv).
fn of_joints<'py>(scene: &PyScene, name: &'static str, given: &Object<'py>, free: f64) -> PyResult<Input<'py>> {
    let (py, nv) = (given.py(), scene.scene.nv());
    let input = if input::is_one_number(given) {
        let mut numbers = input::spread(name, given, scene.rates())?;
        for joint in scene.scene.joints().iter().filter(|joint| joint.kind == JointKind::Floating) {
            numbers[joint.v.clone()].fill(free);
        }
        Input::new(name, &from_numbers(py, &numbers, &[nv])?, nv)?
    } else {
        scene.rate(name, given)?
    };
    scene.on_tree(py, input, Coupling::torques)
}

/// Limits of effort: those of the scene, or given ones.
fn limits<'py>(scene: &PyScene, given: &Object<'py>) -> PyResult<Input<'py>> {
    let (py, nv) = (given.py(), scene.scene.nv());
    if given.is_instance_of::<PyBool>() {
        let joints = scene.scene.joints().iter();
        let numbers: Vec<f64> =
            joints.flat_map(|joint| std::iter::repeat_n(joint.limits.effort, joint.v.len())).collect();
        if numbers.iter().all(|limit| limit.is_infinite()) {
            let found = "a scene without limits of effort";
            return refuse("effort", found, "joints with limits, or an array of limits, (nv,)");
        }
        return scene.on_tree(py, Input::new("pd.effort", &from_numbers(py, &numbers, &[nv])?, nv)?, Coupling::torques);
    }
    bounds(scene, "pd.effort", given)
}

/// Bounds of torques or speeds, zero or positive, infinite for none.
fn bounds<'py>(scene: &PyScene, name: &'static str, given: &Object<'py>) -> PyResult<Input<'py>> {
    let bounds = of_joints(scene, name, given, f64::INFINITY)?;
    if let Some(bound) = bounds.data()?.iter().find(|bound| !(**bound >= 0.0)) {
        let flag = if name == "pd.effort" { "True, or " } else { "" };
        return refuse(name, bound.to_string(), format!("{flag}limits that are zero or positive, infinite for none"));
    }
    Ok(bounds)
}
