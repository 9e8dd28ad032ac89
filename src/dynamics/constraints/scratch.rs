//! Scratch for closed loops, and the forces of one row of the connections on bodies and joints.

use super::gram_inverse::{GramInverse, Relaxed};
use crate::kinematics::Frame;
use crate::kinematics::propagation::Accumulates;
use crate::model::Model;
use crate::scene::constraint::Constraints;
use crate::spatial::{RigidShift, angular, linear, sum, zero};
use nalgebra::Vector6;

/// Scratch for closed loops: about 300 bytes per body and 8 (nv + m) bytes per row.
#[derive(Debug, Clone)]
pub struct ConstraintScratch {
    /// The points of application of the forces of each row.
    pub(super) units: Vec<UnitRow>,
    /// W*, (m x nv) row by row; zero outside of a row's path.
    pub(super) whitened: Vec<f64>,
    /// Sizes of the terms of each row of W*.
    pub(super) sizes: Vec<f64>,
    /// Forces on bodies for one right-hand side, and torques.
    pub(super) wrenches: Vec<Vector6<f64>>,
    pub(super) torque: Vec<f64>,
    /// Forces during the inward pass.
    pub(super) state: Vec<SizedForce>,
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
            units: vec![UnitRow::default(); m],
            whitened: vec![0.0; m * nv],
            sizes: vec![f64::NAN; m],
            wrenches: vec![Vector6::zeros(); bodies],
            torque: vec![0.0; nv],
            state: vec![SizedForce::zero(); bodies],
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

/// J* of one row: the forces on bodies, in their body frames, and the joint torques for a unit force along the row.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct UnitRow {
    pub forces: [Option<(usize, Vector6<f64>)>; 2],
    /// Sizes of the terms of their moments.
    pub moments: [f64; 2],
    pub torques: [Option<(usize, f64)>; 2],
}

impl UnitRow {
    /// The row of a force on frame C, in its axes at its origin, and of the opposite force on frame D. `place` is the
    /// pose of C in D.
    pub fn between([c, d]: [&Frame<f64>; 2], place: &RigidShift<f64>, force: &Vector6<f64>) -> Self {
        let back = -place.force_to_parent(force);
        let (moment, push) = (angular(force).norm(), linear(force).norm());
        let reach = [c.placement.lever.norm(), place.lever.norm() + d.placement.lever.norm()];
        Self {
            forces: [(c, force), (d, &back)]
                .map(|(frame, force)| frame.body.map(|k| (k, frame.placement.force_to_parent(force)))),
            moments: reach.map(|reach| moment + reach * push),
            torques: [None; 2],
        }
    }
}

/// The force of a row on a body with those that were propagated to it, and the size of the terms of its moment.
#[derive(Debug, Clone, Copy)]
pub(super) struct SizedForce {
    pub force: Vector6<f64>,
    pub moment: f64,
}

impl SizedForce {
    pub fn zero() -> Self {
        Self { force: zero(), moment: 0.0 }
    }
}

impl Accumulates<f64> for SizedForce {
    fn propagated(&self, shift: &RigidShift<f64>) -> Self {
        let Self { force, moment } = self;
        // A lever parallel to a force gives a moment that is only rounding; it does not count as a moment.
        let moment = angular(force).norm().max(*moment) + shift.lever.norm() * linear(force).norm();
        Self { force: shift.force_to_parent(force), moment }
    }

    fn plus(&self, other: &Self) -> Self {
        Self { force: sum(&self.force, &other.force), moment: self.moment + other.moment }
    }
}
