//! Actuators: the method of `SceneBuilder` that adds them, and `Scene.actuators`.

use super::builder::{Added, PySceneBuilder, optional_triple};
use super::choice::refuse_unknown;
use super::description::{ActuatorTuple, actuator_of, actuator_tuple};
use super::errors::refuse;
use super::input;
use super::object::{Object, imported};
use super::scene::PyScene;
use crate::scene::Actuator;
use pyo3::prelude::*;
use pyo3::types::PyDict;

typed_methods! {
    in PySceneBuilder;

    /// Add an actuator of a joint with one degree of freedom, or replace the one with the same name.
    #[doc = section!(Parameters)]
    /// name : str
    ///     Name of the actuator.
    /// joint : str
    ///     Name of the joint, which may be added later.
    /// gear : float, default 1
    ///     Joint torque per force of the actuator, and its length and velocity per joint position and velocity.
    /// kp : float, optional
    ///     Gain of a position servo, whose force is kp (control - length) - kv velocity.
    /// kv : float, optional
    ///     Gain of the velocity; without kp that of a velocity servo, whose force is kv (control - velocity).
    /// gain : (3,) array_like, optional
    ///     Coefficients of the control (constant, by length, by velocity), instead of kp and kv; (1, 0, 0) without
    ///     both: a motor. (0, 0, -kv) is a damper.
    /// bias : (3,) array_like, optional
    ///     Force without control (constant, by length, by velocity), instead of kp and kv.
    /// ctrlrange : (2,) array_like, optional
    ///     Smallest and largest control, to which controls are clipped.
    /// forcerange : (2,) array_like, optional
    ///     Smallest and largest force, to which the force is clipped before the gear.
    /// timeconst : float, optional
    ///     Time constant of a first-order filter of the control, s; inf: the input is the time integral of the control.
    /// actrange : (2,) array_like, optional
    ///     Smallest and largest output of the filter or integral.
    #[doc = returns!(builder)]
    #[doc = section!(Raises)]
    /// ShapeError, ArgumentError
    ///     kp or kv together with gain or bias, or invalid arrays. The message names the actuator; build() checks the
    ///     rest.
    #[doc = section!(Notes)]
    /// The torques of all actuators of a joint together are clipped to its effort limit.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.scenes.chain(2).to_builder()
    /// >>> builder = builder.actuator("shoulder", "j0", kp=100.0, kv=10.0).actuator("elbow", "j1", gear=50.0)
    /// >>> builder.build().actuators.names
    /// ('shoulder', 'elbow')
    fn actuator[slf: PyRefMut<'py, Self>](
        name: String, joint: String; gear: f64 = 1.0, kp: Option<f64> = None, kv: Option<f64> = None,
        gain: Option<&Object<'py>> = None, bias: Option<&Object<'py>> = None, ctrlrange: Option<&Object<'py>> = None,
        forcerange: Option<&Object<'py>> = None, timeconst: Option<f64> = None, actrange: Option<&Object<'py>> = None,
        **unknown
    ) -> Added<'py> {
        refuse_unknown(slf.py(), "SceneBuilder.actuator", unknown)?;
        let of = |argument: &str| format!("{argument} of actuator {name:?}");
        if (kp.is_some() || kv.is_some()) && (gain.is_some() || bias.is_some()) {
            return refuse(of("gain"), "kp or kv, and gain or bias", "one of the two pairs");
        }
        let range = |argument: &str, value: Option<&Object<'py>>| -> PyResult<[f64; 2]> {
            let Some(value) = value else { return Ok([f64::NEG_INFINITY, f64::INFINITY]) };
            let ends = input::fixed(&of(argument), value, &[2])?;
            Ok([ends[0], ends[1]])
        };
        let servo = |p: f64, v: f64| [0.0, -p, -v];
        let (factor, rest) = match (kp, kv) {
            (Some(kp), kv) => (kp, servo(kp, kv.unwrap_or(0.0))),
            (None, Some(kv)) => (kv, servo(0.0, kv)),
            (None, None) => (1.0, [0.0; 3]),
        };
        if timeconst.is_none() && actrange.is_some() {
            return refuse(of("actrange"), "a range without a time constant", "timeconst too");
        }
        let actuator = Actuator {
            gain: optional_triple(&of("gain"), gain, [factor, 0.0, 0.0])?,
            bias: optional_triple(&of("bias"), bias, rest)?,
            control: range("ctrlrange", ctrlrange)?,
            force: range("forcerange", forcerange)?,
            activation: timeconst.map(|time| Ok::<_, PyErr>((time, range("actrange", actrange)?))).transpose()?,
            ..Actuator::new(name.clone(), joint, gear)
        };
        Ok(Self::with(slf, |builder| builder.actuator(actuator)))
    }
}

#[pymethods]
impl PySceneBuilder {
    /// Sets all actuators, for readers in Python.
    fn _set_actuators(&mut self, actuators: Vec<ActuatorTuple>) {
        self.change(|builder| builder.with_actuators(actuators.into_iter().map(actuator_of).collect()));
    }
}

#[pymethods]
impl PyScene {
    /// Actuators of the file (MJCF, or `<transmission>` of URDF) and of SceneBuilder.actuator, a sequence by name.
    #[getter]
    fn actuators<'py>(slf: &Bound<'py, Self>) -> PyResult<Object<'py>> {
        let tuples: Vec<_> = slf.get().scene.source().actuators().iter().map(actuator_tuple).collect();
        imported!(slf.py(), "phipsi._actuators", "Actuators")?.call1((slf, tuples))
    }
}
