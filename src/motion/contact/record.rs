//! The start and the results of the contacts in a step, and the data that its adjoint reads.

use super::moves::{Move, Pulled};
use super::report::ContactReport;
use crate::contact::{Cone, ContactState, Impact, Relaxation};
use nalgebra::{DVector, Matrix3};

/// Gaps, axes and velocities of contacts at the start of a step.
#[derive(Debug, Clone, Default)]
pub(super) struct StepStart {
    pub gaps: Vec<f64>,
    pub axes: Vec<Matrix3<f64>>,
    /// J v, and J times the velocities without contacts.
    pub start: DVector<f64>,
    pub free: DVector<f64>,
}

/// Results of the contacts in a step; without active contacts by default.
#[derive(Default)]
pub(super) struct Outcome {
    pub near: Vec<usize>,
    /// Impulses of impacts, and impulses of persistent contact.
    pub hit: Option<Impact>,
    pub held: DVector<f64>,
    pub states: Vec<ContactState>,
    pub report: ContactReport,
    /// Velocities at the end, if joints that reach a stop end the step slower than they moved in it.
    pub slowed: Option<Vec<f64>>,
    /// True if the slip of a contact with friction turned by more than 60 degrees.
    pub reverses: bool,
    /// The solves of the law, if they are recorded.
    pub laws: Option<Laws>,
}

/// The solves of the law in a step, for the active contacts.
#[derive(Debug, Clone)]
pub(super) struct Laws {
    pub cone: Cone,
    /// Coefficients of restitution in this step: zero for a contact that does not rebound.
    pub rebound: Vec<f64>,
    /// Velocities of impacts: those at the start plus this part of their change to the free ones.
    pub middle: DVector<f64>,
    pub part: f64,
    /// Velocities and impulses of persistent contact.
    pub c: DVector<f64>,
    pub held: DVector<f64>,
    /// Active joint limits at which joints arrive, and the velocities and impulses with which they end the step.
    pub arriving: Vec<usize>,
    pub slower: Option<(DVector<f64>, DVector<f64>)>,
    /// Joint limits whose joints do not return to them in this step.
    pub dropped: Vec<usize>,
    /// The energies of the relaxed law, with smoothing.
    pub energies: Option<Vec<Relaxation>>,
}

impl Laws {
    pub fn new(
        cone: Cone,
        rebound: &[f64],
        (middle, part): (DVector<f64>, f64),
        (c, held): (&DVector<f64>, &DVector<f64>),
        arriving: &[usize],
    ) -> Self {
        let (rebound, arriving) = (rebound.to_vec(), arriving.to_vec());
        let (slower, dropped, energies) = (None, Vec::new(), None);
        Self { cone, rebound, middle, part, c: c.clone(), held: held.clone(), arriving, slower, dropped, energies }
    }
}

/// A step with contacts; by default the request for a record.
#[derive(Debug, Clone, Default)]
pub(super) struct StepRecord {
    /// The velocities without contacts, and those of the displacement.
    pub v_free: Vec<f64>,
    pub moving: Vec<f64>,
    pub before: StepStart,
    pub near: Vec<usize>,
    /// True for a step of the tree, with the velocities at its end in `moving`.
    pub flies: bool,
    pub hit: Option<Impact>,
    pub states: Vec<ContactState>,
    /// `None` without active contacts.
    pub laws: Option<Laws>,
    /// The Newton steps of the projection out of the surfaces and onto the connections.
    pub moves: Vec<Move>,
    /// The projection of the velocities without contacts onto the connections, and that of the last velocities.
    pub free: Pulled,
    pub end: Pulled,
}

impl StepRecord {
    pub fn new(v_free: Vec<f64>, moving: &[f64], before: &StepStart, outcome: &mut Outcome) -> Self {
        Self {
            v_free,
            moving: moving.to_vec(),
            before: before.clone(),
            near: outcome.near.clone(),
            hit: outcome.hit.clone(),
            states: outcome.states.clone(),
            laws: outcome.laws.take(),
            ..Self::default()
        }
    }
}
