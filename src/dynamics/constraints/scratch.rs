//! Scratch for closed loops.

use super::gram_inverse::{GramInverse, Relaxed};
use super::mobility::SizedForce;
use super::rows::ConnectionRows;
use crate::dynamics::sweeps::SweepModel;
use crate::model::Model;
use crate::scene::constraint::Constraints;
use nalgebra::Vector6;

/// Scratch for closed loops: about 300 bytes per body and 8 (nv + m) bytes per row.
#[derive(Debug, Clone)]
pub struct ConstraintScratch {
    /// The rows, W and G, in the frames of the bodies.
    pub(crate) rows: ConnectionRows<f64>,
    /// Forces on bodies for one right-hand side, and torques.
    pub(super) wrenches: Vec<Vector6<f64>>,
    pub(super) torque: Vec<f64>,
    /// Forces of one row during the inward pass.
    pub(crate) state: Vec<SizedForce>,
    /// Innovations, then accelerations.
    pub(super) estimates: Vec<f64>,
    /// G^+.
    pub(super) inverse: GramInverse,
    /// The combinations of rows that are kept.
    pub(crate) relaxed: Relaxed,
    /// The dropped part of the current rows.
    pub(crate) dropped: Vec<f64>,
    /// The residual of each row, and the sizes of its terms.
    pub(crate) residual: Vec<f64>,
    pub(super) terms: Vec<f64>,
    /// lambda of each row: moments, N m, and forces, N, on the connection's link in the axes of its first frame.
    pub(crate) forces: Vec<f64>,
    pub(super) step: Vec<f64>,
    /// J qd and the errors, if requested.
    pub(crate) rates: Vec<f64>,
    pub(crate) errors: Vec<f64>,
    /// Accelerations, forces, rank and residual of forward dynamics.
    pub(crate) results: Vec<f64>,
    /// Identity of the model.
    pub(crate) identity: u64,
}

impl ConstraintScratch {
    /// Scratch for a model with these connections.
    pub(crate) fn new(model: &Model<f64>, constraints: &Constraints) -> Self {
        let (bodies, nv, m) = (model.bodies.len(), model.nv(), constraints.rows);
        Self {
            rows: ConnectionRows::new((model, &SweepModel::general(model)), constraints),
            wrenches: vec![Vector6::zeros(); bodies],
            torque: vec![0.0; nv],
            state: vec![SizedForce::none(); bodies],
            estimates: vec![f64::NAN; nv],
            inverse: GramInverse::default(),
            relaxed: Relaxed::default(),
            dropped: vec![0.0; m],
            residual: vec![f64::NAN; m],
            terms: vec![f64::NAN; m],
            forces: vec![0.0; m],
            step: vec![f64::NAN; m],
            rates: vec![f64::NAN; m],
            errors: vec![f64::NAN; m],
            results: vec![f64::NAN; nv + m + 2],
            identity: model.identity(),
        }
    }
}
