//! Closed loops: accelerations, forces, velocities and positions that meet the connections of a scene.
//!
//! A connection is some scalar rows of a Jacobian J, and J qdd = -gamma is a measurement of the accelerations without noise. With the factor of the
//! tree at hand (gains g, pivots D),
//!
//! ```text
//! M qdd + bias = tau + J* lambda,   J qdd + gamma = 0,   gamma = J' qd
//! W = D^-1/2 (1 - L) J*             a unit force along each row runs inward to the base, collecting innovations
//! G = W* W = J M^-1 J*              never a difference
//! lambda = -G^+ (J qdd0 + gamma)    qdd0: the tree's accelerations
//! ```
//!
//! O(N + m^2 depth + m^3) for m rows. Rows that depend on each other are no fault: G^+ leaves out what of G is lost in rounding, and tells the rank.
//! The accelerations are unique then, the forces those of least sum `G_ii` `lambda_i`^2. What no force can take away is no rounding, and is reported
//! as [`Outcome::contradicted`].

mod derivatives;
mod faults;
mod gram;
mod inverse;
mod projection;
mod rows;
mod solution;

pub(crate) use derivatives::constrained_derivatives;
pub(crate) use inverse::{constrained_inverse_dynamics, constrained_mass_matrix_inverse};
pub(crate) use projection::{project_positions, project_velocities};
pub(crate) use rows::{accelerations_of_rows, errors_of_rows, jacobian_of_rows, rates_of_rows};
pub(crate) use solution::{Outcome, constrained_dynamics};

use self::gram::GramInverse;
use self::rows::UnitRow;
use crate::model::Model;
use crate::scene::constraint::Constraints;
use nalgebra::Vector6;

/// A rod whose two ends coincide, so that it has no direction: the index of its connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct NoDirection(pub usize);

/// Scratch for closed loops, about 300 bytes a body and 8 (nv + m) bytes for each of m rows.
#[derive(Debug, Clone)]
pub struct ConstraintScratch {
    /// Where the forces of each row act.
    units: Vec<UnitRow>,
    /// W*, (m x nv) row by row; zero off a row's path.
    whitened: Vec<f64>,
    /// Sizes of the terms that a row of W* is formed from.
    sizes: Vec<f64>,
    /// Forces on bodies of one right side, and torques.
    wrenches: Vec<Vector6<f64>>,
    torque: Vec<f64>,
    /// Spatial forces on their way inward, and innovations, then accelerations.
    state: Vec<Vector6<f64>>,
    /// Sizes of the terms that the moments among them are the sum of.
    moments: Vec<f64>,
    estimates: Vec<f64>,
    /// G^+.
    inverse: GramInverse,
    /// What is left of each row, and the sizes of its terms.
    pub(crate) residual: Vec<f64>,
    terms: Vec<f64>,
    /// lambda of each row: moments N m and forces N, on the connection's link in its first frame's axes.
    pub(crate) forces: Vec<f64>,
    step: Vec<f64>,
    /// J qd and the errors, where they are asked for.
    pub(crate) rates: Vec<f64>,
    pub(crate) errors: Vec<f64>,
}

impl ConstraintScratch {
    /// For a model with these connections.
    pub(crate) fn new(model: &Model<f64>, constraints: &Constraints) -> Self {
        let (bodies, nv, m) = (model.bodies.len(), model.nv(), constraints.rows);
        Self {
            units: vec![UnitRow::default(); m],
            whitened: vec![0.0; m * nv],
            sizes: vec![f64::NAN; m],
            wrenches: vec![Vector6::zeros(); bodies],
            torque: vec![0.0; nv],
            state: vec![Vector6::zeros(); bodies],
            moments: vec![0.0; bodies],
            estimates: vec![f64::NAN; nv],
            inverse: GramInverse::default(),
            residual: vec![f64::NAN; m],
            terms: vec![f64::NAN; m],
            forces: vec![0.0; m],
            step: vec![f64::NAN; m],
            rates: vec![f64::NAN; m],
            errors: vec![f64::NAN; m],
        }
    }

    /// Whether it has the sizes of this model's.
    pub(crate) fn fits(&self, model: &Model<f64>, constraints: &Constraints) -> bool {
        (self.wrenches.len(), self.torque.len(), self.units.len()) == (model.bodies.len(), model.nv(), constraints.rows)
    }
}
