//! The settings of a rollout.

use super::method::Method;
use super::properties::{Gains, Properties};
use crate::batch::arms::Arm;
use crate::filter::Form;
use crate::scene::Scene;

/// What does not change during a rollout.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// The step, s.
    pub dt: f64,
    /// How a state is advanced.
    pub method: Method,
    /// How the filter carries P: [`Form::Auto`] watches the covariance form and redoes a step whose digits are in doubt in
    /// square-root form; [`Form::Covariance`] watches its pivots only, in less time. No other.
    pub form: Form,
    /// The largest estimated error of an acceleration that form `auto` accepts, relative to the largest; None: the usual one, see
    /// [`Workspace::tolerance`](crate::Workspace::tolerance).
    pub tolerance: Option<f64>,
    /// What the joints do by themselves.
    pub properties: Properties,
    /// A control law, if there is one.
    pub gains: Option<Gains>,
    /// The instructions to use; the baseline where this processor lacks them.
    pub arm: Arm,
    /// Whether floating trees keep their momentum, and their mass centre its parabola, to rounding: each step ends with a rigid motion of
    /// the tree, as large as the step's error in them (see [`Rollout::correction`](super::Rollout::correction)). Every tree must hang on the base by a free joint
    /// without armature, damping, spring, friction, control law or torque.
    pub conserve_momentum: bool,
    /// What keeps the states of a scene with connections on them.
    pub stabilisation: Stabilisation,
    /// How much each row of the connections gives way, (m/s^2)/N or (rad/s^2)/(N m), zero or above; empty: none does.
    pub compliance: Vec<f64>,
    /// The effect of joint limits.
    pub limits: Limits,
    /// The coefficient of restitution of the stops, 0 to 1.
    pub restitution: f64,
    /// Error control: each step of `dt` is made in substeps whose estimated error, in rad, m, and relative to the fastest joint velocity where that exceeds 1, is at most this; none: fixed steps.
    pub accuracy: Option<f64>,
}

/// The effect of a joint limit in a simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Limits {
    /// It stops the joint.
    #[default]
    Stop,
    /// It does not act on the joint.
    Report,
}

impl Settings {
    /// The default method, [`Method::Contact`] for a scene with contacts, with the properties of the scene.
    #[must_use]
    pub fn new(scene: &Scene, dt: f64) -> Self {
        let properties = Properties::of(scene);
        Self {
            dt,
            method: if scene.contacts().is_empty() { Method::default() } else { Method::Contact },
            form: Form::Auto,
            tolerance: None,
            properties,
            gains: None,
            arm: Arm::of_process(),
            conserve_momentum: false,
            stabilisation: Stabilisation::default(),
            compliance: Vec::new(),
            limits: Limits::default(),
            restitution: 0.0,
            accuracy: None,
        }
    }
}

/// How a motion is kept on the connections.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Stabilisation {
    /// Positions and velocities are projected after each step, by moves of least kinetic energy.
    #[default]
    Projection,
    /// Accelerations are those of J qdd + J' qd = -2 a J qd - a^2 error, with this a in 1/s: errors fall as t exp(-a t), and nothing is projected. J.
    /// Baumgarte, Computer Methods in Applied Mechanics and Engineering 1, 1972, 1-16.
    Baumgarte(f64),
}
