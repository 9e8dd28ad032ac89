//! Settings common to all steps of a rollout: the method, properties of the joints, the control law, and the rows with a set-valued law.

use super::conserve::KEPT;
use super::contact;
use super::method::{Method, Scheme};
use super::properties::{Gains, Properties};
use super::settings::Stabilization;
use super::stops::SetValued;
use super::totals::TOTALS;
use crate::filter::{HingeMap, Rows};
use crate::model::Model;
use crate::scene::{Coupling, Scene};
use std::sync::Arc;

/// Settings common to all steps of a rollout, as scalars of one state.
#[derive(Debug, Clone)]
pub(super) struct StepSettings {
    /// The step of the run, s.
    pub step: f64,
    /// The method that advances a state; never [`Method::Auto`].
    pub method: Method,
    /// True if [`Method::Auto`] chose the method, which also divides steps that are too long.
    pub divides: bool,
    /// The method at the step of the run.
    pub scheme: Scheme,
    pub properties: Properties,
    pub gains: Option<Gains>,
    /// The bodies that trees begin with whose momentum is kept; empty where it is left to the method.
    pub roots: Vec<usize>,
    /// How joints follow each other, where some do; the numbers are then those of the tree.
    pub coupling: Option<Arc<Coupling>>,
    /// True if some joint has regularized friction.
    pub rubs: bool,
    /// The bound on the error of a substep, where the substeps are chosen by it.
    pub accuracy: Option<f64>,
    /// The largest estimated error of an acceleration that form `auto` accepts, where it is not the usual one.
    pub tolerance: Option<f64>,
    /// The rows with exact friction or stops.
    pub set_valued: Vec<SetValued>,
    /// True if joint limits are stops.
    pub stops: bool,
    /// The coefficient of restitution of the stops.
    pub restitution: f64,
    /// The kind of each degree of freedom, for the error estimate.
    pub kinds: Vec<RateKind>,
    /// Of a scene with connections, what keeps states on them.
    pub connected: Option<Stabilization>,
    /// Of each row of the connections; empty: none gives way.
    pub compliance: Vec<f64>,
    /// Bodies whose joints have a spring, and bodies that the control law pulls.
    pub sprung: Vec<bool>,
    pub pulled: Vec<bool>,
}

impl StepSettings {
    pub fn new(
        model: &Model<f64>,
        step: f64,
        method: Method,
        (properties, gains): (Properties, Option<Gains>),
        roots: Vec<usize>,
    ) -> Self {
        let stiff = |values: &[f64]| {
            let stages = model.system.stages.iter();
            stages.map(|s| values[s.first_row..][..s.rows.count()].iter().any(|&k| k != 0.0)).collect()
        };
        Self {
            step,
            method,
            divides: false,
            scheme: Scheme::new(method, step),
            coupling: None,
            rubs: properties.friction_speed > 0.0 && properties.friction.iter().any(|&f| f != 0.0),
            accuracy: None,
            tolerance: None,
            set_valued: Vec::new(),
            stops: false,
            restitution: 0.0,
            kinds: rate_kinds(model),
            sprung: stiff(&properties.stiffness),
            pulled: gains.as_ref().map_or_else(|| vec![false; model.bodies.len()], |g| stiff(&g.proportional)),
            properties,
            gains,
            roots,
            connected: None,
            compliance: Vec::new(),
        }
    }

    /// The same for joints that follow each other.
    pub fn with_coupling(self, coupling: Option<Arc<Coupling>>) -> Self {
        Self { coupling, ..self }
    }

    /// True if steps are vectorized: those of a tree whose joints are independent, without error control.
    pub fn is_vectorized(&self) -> bool {
        self.coupling.is_none() && self.connected.is_none() && self.accuracy.is_none()
    }

    /// The same for the adjoint of the steps, which needs the displacement of every joint from rest, also without a spring.
    pub fn backward(&self) -> Self {
        let mut settings = self.clone();
        settings.sprung.fill(true);
        settings
    }

    /// The time of a step, counted from the start of the run, s.
    #[allow(clippy::cast_precision_loss)] // steps of a run
    pub fn time(&self, steps: usize) -> f64 {
        steps as f64 * self.step
    }

    /// The number of values that a rollout stores per state: q, qd, the [`Totals`](super::totals); where momentum is conserved, its value and two corrections; of a scene
    /// with contacts, their impulses and their report.
    pub fn width(&self, scene: &Scene) -> usize {
        let kept = if self.roots.is_empty() { 0 } else { KEPT * self.roots.len() + 2 };
        let touching = if self.method == Method::Contact { contact::width(scene.contact_points().len()) } else { 0 };
        scene.nq() + scene.nv() + TOTALS + kept + touching
    }

    /// Damping and stiffness of one degree of freedom, the control law's with the joint's own.
    fn implicit_terms(&self, row: usize) -> (f64, f64) {
        let (d, k) = (self.properties.damping[row], self.properties.stiffness[row]);
        self.gains.as_ref().map_or((d, k), |gains| (d + gains.derivative[row], k + gains.proportional[row]))
    }

    /// Measurement noise r + h g d + h^2 g^2 k of every row in a step by `scheme`, without that of regularized friction and of locked joints.
    pub fn noise(&self, scheme: &Scheme) -> Vec<f64> {
        // All stages of a method have the same g.
        let hg = if scheme.implicit { scheme.tableau.gamma[0][0] } else { 0.0 };
        let armature = self.properties.armature.iter().enumerate();
        armature
            .map(|(row, r)| {
                let (d, k) = self.implicit_terms(row);
                r + hg * (d + hg * k)
            })
            .collect()
    }
}

/// The kind of a degree of freedom, for the error estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RateKind {
    /// A rotation: its displacement in a step and its estimated error determine the substeps.
    Rotation,
    /// A linear velocity in axes that rotate: its estimated error determines the substeps.
    InRotatingAxes,
    /// A translation along an axis of the parent.
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
pub(super) type By<'a> = (&'a StepSettings, &'a Scheme);
