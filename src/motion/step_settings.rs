//! Settings common to all steps of a rollout: method, joint properties, control law, and the rows with a set-valued
//! law.

use super::contact;
use super::method::{Method, Scheme};
use super::properties::{Gains, Properties};
use super::settings::{Limits, Settings};
use super::stops::SetValued;
use super::totals::TOTALS;
use super::wrenches::LinkWrenches;
use crate::filter::{HingeMap, Rows};
use crate::model::Model;
use crate::scene::{Coupling, Scene};
use std::sync::Arc;

/// Settings common to all steps of a rollout, in f64.
#[derive(Debug, Clone)]
#[allow(clippy::struct_excessive_bools)] // independent facts
pub(super) struct StepSettings {
    /// The settings as given, without control law and wrenches, which can change.
    pub given: Arc<Settings>,
    /// Time step of the run, s.
    pub step: f64,
    /// The integration method; never [`Method::Auto`].
    pub method: Method,
    /// For a scene with contacts: the settings of a step in which no contact can act, those of the scene without
    /// contacts; `None` if every step is a contact step.
    pub free: Option<Box<Self>>,
    /// True if [`Method::Auto`] selected the method; steps that are too long are then divided.
    pub divides: bool,
    /// The method with the time step of the run.
    pub scheme: Scheme,
    pub properties: Properties,
    pub gains: Option<Arc<Gains>>,
    /// Wrenches on links, if there are any.
    pub wrenches: Option<Arc<LinkWrenches>>,
    /// Coupling of the joints, if there is one; all values are then those of the tree.
    pub coupling: Option<Arc<Coupling>>,
    /// True if some joint has regularized friction.
    pub regularized: bool,
    /// The rows with exact friction or stops.
    pub set_valued: Vec<SetValued>,
    /// The rows of the control law with limits of effort.
    pub limited: Vec<usize>,
    /// True if some limit declines with speed.
    pub has_motors: bool,
    /// True if these limits are those of the sum with the applied torque.
    pub limits_sum: bool,
    /// The kind of each degree of freedom, for the error estimate.
    pub kinds: Vec<RateKind>,
    /// True for a scene with connections.
    pub connected: bool,
    /// Relaxation of the contact law, if it is not exact.
    pub smoothing: Option<contact::Smoothing>,
    /// Per body: whether its joint has a spring, and whether the control law acts on it.
    pub sprung_bodies: Vec<bool>,
    pub controlled_bodies: Vec<bool>,
    /// Per degree of freedom: the largest gains kp and kd of all states.
    pub largest: Vec<[f64; 2]>,
}

impl StepSettings {
    pub fn new(
        model: &Model<f64>,
        given: Arc<Settings>,
        method: Method,
        (properties, gains): (Properties, Option<Gains>),
    ) -> Self {
        let largest = gains.as_ref().map(|gains| (0..model.nv()).map(|row| gains.largest(model.nv(), row)).collect());
        let largest: Vec<[f64; 2]> = largest.unwrap_or_else(|| vec![[0.0; 2]; model.nv()]);
        let step = given.dt;
        Self {
            given,
            step,
            method,
            free: None,
            divides: false,
            scheme: Scheme::new(method, step),
            coupling: None,
            regularized: properties.is_regularized(),
            set_valued: Vec::new(),
            limited: Vec::new(),
            has_motors: false,
            limits_sum: false,
            kinds: rate_kinds(model),
            sprung_bodies: stiff_bodies(model, &properties.stiffness),
            controlled_bodies: stiff_bodies(model, &largest.iter().map(|[kp, _]| *kp).collect::<Vec<_>>()),
            largest,
            properties,
            gains: gains.map(Arc::new),
            wrenches: None,
            connected: false,
            smoothing: None,
        }
    }

    /// Takes other joint properties.
    pub fn adopt_properties(&mut self, model: &Model<f64>, properties: Properties) {
        self.regularized = properties.is_regularized();
        self.sprung_bodies = stiff_bodies(model, &properties.stiffness);
        self.properties = properties;
    }

    /// Sets the length of steps, with contacts and without.
    pub fn adopt(&mut self, h: f64) {
        (self.step, self.scheme) = (h, Scheme::new(self.method, h));
        if let Some(free) = &mut self.free {
            free.adopt(h);
        }
    }

    /// Changes the settings of steps with contacts and without.
    pub fn change(&mut self, change: &impl Fn(&mut Self)) {
        if let Some(free) = &mut self.free {
            free.change(change);
        }
        change(self);
    }

    /// True if steps are vectorized: those without coupled joints, compliant connections, friction curves and error
    /// control.
    pub fn is_vectorized(&self) -> bool {
        self.coupling.is_none() && self.properties.curves.is_empty() && self.is_rigid() && self.given.accuracy.is_none()
    }

    /// True if joint limits are stops.
    pub fn stops(&self) -> bool {
        self.given.limits == Limits::Stop
    }

    /// True if no connection is compliant.
    pub fn is_rigid(&self) -> bool {
        self.given.compliance.iter().all(|&compliance| compliance == 0.0)
    }

    /// True if steps with contacts are vectorized: those of a tree on planes of the base with the exact law, unless its
    /// contacts are in many independent groups, because G of all contacts is computed in lanes, and not with error
    /// control.
    pub fn touches_in_lanes(&self, scene: &Scene) -> bool {
        self.method == Method::Contact
            && scene.shapes().is_none()
            && scene.contacts_have_planes()
            && scene.contacts_are_coupled()
            && self.coupling.is_none()
            && self.properties.curves.is_empty()
            && self.given.accuracy.is_none()
            && !self.connected
            && self.smoothing.is_none()
    }

    /// True if the adjoint of the steps is vectorized: without contacts and coupled joints, with connections if the
    /// steps are.
    pub fn has_vectorized_adjoint(&self) -> bool {
        self.method != Method::Contact && self.coupling.is_none() && (!self.connected || self.is_vectorized())
    }

    /// The settings for the adjoint of the steps, which needs the displacement of every joint from rest, also without a
    /// spring.
    pub fn backward(&self) -> Self {
        let mut settings = self.clone();
        settings.sprung_bodies.fill(true);
        settings.free = settings.free.map(|free| Box::new(free.backward()));
        settings
    }

    /// The time of a step, counted from the start of the run, s.
    #[allow(clippy::cast_precision_loss)] // number of steps of a run
    pub fn time(&self, steps: usize) -> f64 {
        steps as f64 * self.step
    }

    /// Number of values that a rollout stores per state: q, qd and the [`Totals`](super::totals); with contacts, their
    /// impulses and report.
    pub fn width(&self, scene: &Scene) -> usize {
        let touching = if self.method == Method::Contact { contact::width(scene.contact_points().len()) } else { 0 };
        scene.nq() + scene.nv() + TOTALS + touching
    }

    /// Damping and stiffness of one degree of freedom, including those of the control law.
    fn implicit_terms(&self, row: usize) -> (f64, f64) {
        let (d, k) = (self.properties.damping[row], self.properties.stiffness[row]);
        let [kp, kd] = self.largest[row];
        if self.gains.is_some() { (d + kd, k + kp) } else { (d, k) }
    }

    /// Measurement noise r + h g d + h^2 g^2 k of every row in a step of `scheme` with the largest gains, without the
    /// parts of regularized friction and of stuck joints.
    pub fn noise(&self, scheme: &Scheme) -> Vec<f64> {
        let hg = scheme.implicit_step();
        let armature = self.properties.armature.iter().enumerate();
        armature
            .map(|(row, r)| {
                let (d, k) = self.implicit_terms(row);
                r + hg * (d + hg * k)
            })
            .collect()
    }
}

/// Per body: whether a row of its joint has stiffness.
fn stiff_bodies(model: &Model<f64>, stiffness: &[f64]) -> Vec<bool> {
    let stages = model.system.stages.iter();
    stages.map(|s| stiffness[s.first_row..][..s.rows.count()].iter().any(|&k| k != 0.0)).collect()
}

/// The kind of a degree of freedom, for the error estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RateKind {
    /// Rotation: its displacement in a step and its estimated error determine the substeps.
    Rotation,
    /// Linear velocity in rotating axes: its estimated error determines the substeps.
    InRotatingAxes,
    /// Translation along an axis of the parent.
    Translation,
}

fn rate_kinds(model: &Model<f64>) -> Vec<RateKind> {
    use RateKind::{InRotatingAxes, Rotation, Translation};
    let mut kinds = Vec::new();
    for stage in &model.system.stages {
        match stage.rows {
            Rows::None => {}
            Rows::One(HingeMap::Axis(3..)) => kinds.push(Translation),
            Rows::One(_) => kinds.push(Rotation),
            Rows::Angular => kinds.extend([Rotation; 3]),
            Rows::Six => kinds.extend([InRotatingAxes, InRotatingAxes, InRotatingAxes, Rotation, Rotation, Rotation]),
        }
    }
    kinds
}

/// The arguments of a step: the settings common to all steps of the run, and the scheme of this step.
pub(super) type StepArguments<'a> = (&'a StepSettings, &'a Scheme);
