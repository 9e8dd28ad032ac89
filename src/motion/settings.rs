//! The settings of a rollout.

use super::method::Method;
use super::properties::{Gains, Properties};
use super::wrenches::Wrenches;
use crate::batch::instruction_set::InstructionSet;
use crate::filter::Form;
use crate::scene::Scene;
use crate::setters::setters;

/// Settings that are constant during a rollout.
///
/// ```
/// use phipsi::motion::{Method, Settings};
/// # fn main() -> Result<(), phipsi::Error> {
/// let scene = phipsi::scenes::chain(7)?;
/// let settings = Settings::new(&scene, 1e-3).with_method(Method::RungeKutta4);
/// assert_eq!(settings, Settings::new(&scene, 1e-3).with_method("rk4".parse::<Method>()?));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Settings {
    /// Time step, s.
    pub dt: f64,
    /// The integrator.
    pub method: Method,
    /// Form of the filter, [`Form::Auto`] or [`Form::Covariance`]. `Auto` estimates the error of the covariance form
    /// and recomputes a step whose estimate exceeds the tolerance in square-root form; `Covariance` only checks the
    /// pivots and takes less time.
    pub form: Form,
    /// Largest estimated error of an acceleration that form `auto` accepts, relative to the largest acceleration;
    /// `None` for the default of [`Workspace::tolerance`](crate::Workspace::tolerance), with error control at least
    /// 1e-4 times `accuracy`.
    pub tolerance: Option<f64>,
    /// Armature, damping, springs and friction of the joints.
    pub properties: Properties,
    /// The control law, if any.
    pub gains: Option<Gains>,
    /// Wrenches on links, if any.
    pub wrenches: Option<Wrenches>,
    /// Instruction set; the baseline if the processor does not support it.
    pub arm: InstructionSet,
    /// Compliance of each row of the connections, (m/s^2)/N or (rad/s^2)/(N m), zero or positive; empty if all are
    /// rigid.
    pub compliance: Vec<f64>,
    /// The effect of joint limits.
    pub limits: Limits,
    /// Coefficient of restitution of the stops, 0 to 1.
    pub restitution: f64,
    /// Error control: each step of `dt` consists of substeps whose estimated error is at most this value, in rad, m,
    /// and relative to the fastest joint velocity if that exceeds 1. `None` for fixed steps.
    pub accuracy: Option<f64>,
    /// Length by which the contact law is relaxed, m; zero for the exact law. A contact at rest that carries its equal
    /// share of the weight of its tree has this gap. Gradients then exist before contact and at changes of its state.
    pub smoothing: f64,
}

/// The effect of a joint limit in a simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Limits {
    /// It stops the joint.
    #[default]
    Stop,
    /// It does not act on the joint.
    Report,
}

impl Settings {
    /// The default method, with the properties of the scene.
    #[must_use]
    pub fn new(scene: &Scene, dt: f64) -> Self {
        let properties = Properties::of(scene);
        Self {
            dt,
            method: Method::default(),
            form: Form::Auto,
            tolerance: None,
            properties,
            gains: None,
            wrenches: None,
            arm: InstructionSet::of_process(),
            compliance: Vec::new(),
            limits: Limits::default(),
            restitution: 0.0,
            accuracy: None,
            smoothing: 0.0,
        }
    }
}

setters!(Settings {
    with_dt: dt: f64,
    with_method: method: Method,
    with_form: form: Form,
    with_tolerance: tolerance => Option<f64>,
    with_properties: properties: Properties,
    with_gains: gains => Option<Gains>,
    with_wrenches: wrenches => Option<Wrenches>,
    with_arm: arm: InstructionSet,
    with_compliance: compliance => Vec<f64>,
    with_limits: limits: Limits,
    with_restitution: restitution: f64,
    with_accuracy: accuracy => Option<f64>,
    with_smoothing: smoothing: f64,
});
