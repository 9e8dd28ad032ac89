//! The changes of velocities and positions by projections of a step, as its adjoint reads them.

use crate::contact::Cone;
use crate::dynamics::constraints::ProjectionStep;
use nalgebra::DVector;

/// A Newton step of the projection of positions.
#[derive(Debug, Clone)]
pub(super) enum Move {
    /// Out of the surfaces of contacts.
    Push(Push),
    /// Onto the connections.
    Pull(ProjectionStep),
}

impl Move {
    /// The configuration at its start.
    pub fn start(&self) -> &Vec<f64> {
        match self {
            Self::Push(push) => &push.q,
            Self::Pull(step) => &step.q,
        }
    }
}

/// One Newton step of the projection: its start, the near rows with their gaps and G, the impulses, and the
/// displacement.
#[derive(Debug, Clone)]
pub(super) struct Push {
    pub q: Vec<f64>,
    pub near: Vec<usize>,
    pub gaps: DVector<f64>,
    pub cone: Cone,
    pub impulses: DVector<f64>,
    pub moved: Vec<f64>,
}

/// A change of velocities by impulses lambda of the connections, M^-1 `J_k`* lambda.
#[derive(Debug, Clone, Default)]
pub(super) struct Pulled {
    pub change: Vec<f64>,
    pub impulses: Vec<f64>,
}
