//! Actuators: maps from a control to the force on a joint, as data of a scene; simulations in Python apply them.

use super::Scene;
use crate::error::{Error, number};
use std::collections::BTreeMap;

/// An actuator of a joint with one coordinate.
///
/// With the length l = gear q and its rate v, the force is gain [1 l v] u + bias [1 l v], clipped to `force`, and the
/// joint torque is gear times the force. The input u is the control, clipped to `control`, or the activation.
#[derive(Debug, Clone, PartialEq)]
pub struct Actuator {
    /// Name of the actuator, unique in the scene.
    pub name: String,
    /// Name of the joint; empty for an actuator that cannot be represented.
    pub joint: String,
    /// Joint torque per force.
    pub gear: f64,
    /// Coefficients (constant, by length, by velocity) of the input.
    pub gain: [f64; 3],
    /// Force without input: constant, by length, by velocity.
    pub bias: [f64; 3],
    /// Smallest and largest control.
    pub control: [f64; 2],
    /// Smallest and largest force.
    pub force: [f64; 2],
    /// Smallest and largest torque of all actuators of the joint together, in addition to its effort limit.
    pub torque: [f64; 2],
    /// Time constant of the first-order activation, s, infinite for an integrator, and the range of the activation.
    pub activation: Option<(f64, [f64; 2])>,
    /// Control and activation of each keyframe that has some.
    pub keyframes: BTreeMap<String, [f64; 2]>,
    /// Reason why the actuator cannot be represented.
    pub missing: Option<String>,
}

impl Actuator {
    /// A motor without limits: the joint torque is gear times the control.
    #[must_use]
    pub fn new(name: impl Into<String>, joint: impl Into<String>, gear: f64) -> Self {
        let all = [f64::NEG_INFINITY, f64::INFINITY];
        Self {
            name: name.into(),
            joint: joint.into(),
            gear,
            gain: [1.0, 0.0, 0.0],
            bias: [0.0; 3],
            control: all,
            force: all,
            torque: all,
            activation: None,
            keyframes: BTreeMap::new(),
            missing: None,
        }
    }

    fn check(&self, scene: &Scene) -> Result<(), Error> {
        let subject = format!("actuator {:?}", self.name);
        let refuse = |found: String, expected: &str| Err(Error::scene(&subject, found, expected));
        let coefficients = [&[self.gear][..], &self.gain, &self.bias].concat();
        if let Some(value) = coefficients.iter().find(|value| !value.is_finite()) {
            return refuse(format!("{value} in its gear, gain or bias"), "finite numbers");
        }
        let (time, active) = self.activation.unwrap_or((1.0, self.control));
        for [low, high] in [self.control, self.force, self.torque, active] {
            if !(low <= high) {
                let expected = "a lower end that is not above the upper one";
                return refuse(format!("a range from {} to {}", number(low), number(high)), expected);
            }
        }
        if !(time > 0.0) {
            return refuse(format!("the time constant {}", number(time)), "a positive time in s");
        }
        if self.missing.is_some() {
            return Ok(());
        }
        let joint = scene.joint(&self.joint).map_err(|error| error.of_argument(&subject))?;
        if joint.v.len() != 1 {
            let found = format!("joint {:?} with {} degrees of freedom", joint.name, joint.v.len());
            return refuse(found, "a joint with one degree of freedom");
        }
        Ok(())
    }
}

impl Scene {
    /// Checks the actuators of the scene of an assembled tree.
    pub(super) fn actuated(self) -> Result<Self, Error> {
        self.source().actuators.iter().try_for_each(|actuator| actuator.check(&self))?;
        Ok(self)
    }
}
