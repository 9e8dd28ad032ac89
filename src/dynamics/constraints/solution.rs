//! Forward dynamics through connections.

use super::rows::{accelerations_of_rows, errors_of_rows, rates_of_rows};
use super::scratch::{ConstraintScratch, NoDirection};
use crate::dynamics::forward::{factorise, forward_dynamics};
use crate::filter::Form;
use crate::filter::pivots::PivotMonitor;
use crate::model::Model;
use crate::scene::constraint::Constraints;
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// A row whose residual is so small beside the terms that it is the sum of agrees with the others.
const AGREES: f64 = 1e-6;

/// The most corrections of what rounding has left in the rows.
const CORRECTIONS: usize = 6;

/// What constrained dynamics found.
#[derive(Debug, Clone)]
pub(crate) struct Outcome {
    pub pivots: PivotMonitor<f64>,
    /// The rank of G.
    pub rank: usize,
    /// The largest entry of J qdd + gamma - wanted that is left, rad/s^2 or m/s^2.
    pub residual: f64,
    /// The rows whose residual is no rounding: no forces meet all of them.
    pub contradicted: Vec<usize>,
}

/// Accelerations `qdd` and the forces of the connections (in the scratch) from torques, where J qdd + gamma = wanted: -2 alpha J qd - alpha^2 errors, or zero
/// for `alpha` of none.
///
/// The tree's accelerations qdd0; lambda = -G^+ (J qdd0 + gamma - wanted); the tree's accelerations with J* lambda acting on it. What is left of the
/// rows is taken away by one more right side each, while it falls. Two forward dynamics in the workspace's form, O(N), and O(m^2 depth + m^3).
pub(crate) fn constrained_dynamics(
    (model, constraints): (&Model<f64>, &Constraints),
    workspace: &mut Workspace<f64>,
    scratch: &mut ConstraintScratch,
    (q, qd, tau): (&[f64], &[f64], &[f64]),
    wrenches: &[Vector6<f64>],
    alpha: Option<f64>,
    qdd: &mut [f64],
) -> Result<Outcome, NoDirection> {
    let state = (q, qd);
    let mut pivots = forward_dynamics(model, workspace, q, qd, tau, wrenches, qdd);
    let lost = |workspace: &Workspace<f64>, pivots: &PivotMonitor<f64>| workspace.lost_pivot(model, pivots).is_some();
    if !lost(workspace, &pivots) && workspace.form == Form::Auto {
        // That form watched one right side; these are others.
        pivots = factorise(model, workspace, q, |_, _| {});
    }
    if lost(workspace, &pivots) {
        return Ok(Outcome { pivots, rank: 0, residual: f64::NAN, contradicted: Vec::new() });
    }
    scratch.factorise(model, constraints, workspace, q)?;
    if alpha.is_some() {
        rates_of_rows(model, constraints, state, &mut scratch.rates)?;
        errors_of_rows(model, constraints, q, &mut scratch.errors)?;
    }
    scratch.forces.fill(0.0);
    let mut terms = vec![0.0; constraints.rows];
    let before = scratch.left(model, constraints, state, (qdd, alpha))?;
    keep_larger(&mut terms, &scratch.terms);
    scratch.take_away();

    // With the forces as they are, so that they cancel in the sums that rounding is relative to, and not in accelerations.
    let forces = std::mem::take(&mut scratch.forces);
    scratch.spread(&forces);
    scratch.forces = forces;
    for (sum, own) in scratch.wrenches.iter_mut().zip(wrenches) {
        *sum += own;
    }
    for (sum, own) in scratch.torque.iter_mut().zip(tau) {
        *sum += own;
    }
    let acting = std::mem::take(&mut scratch.wrenches);
    pivots = forward_dynamics(model, workspace, q, qd, &scratch.torque, &acting, qdd);
    scratch.wrenches = acting;
    let mut largest = scratch.left(model, constraints, state, (qdd, alpha))?;
    keep_larger(&mut terms, &scratch.terms);
    let mut residual = before.max(largest);
    for _ in 0..CORRECTIONS {
        if !(largest <= 0.25 * residual && largest > 0.0) {
            break;
        }
        residual = largest;
        let (kept, forces) = (qdd.to_vec(), scratch.forces.clone());
        // The step as it is, not as forces that are much larger have rounded it.
        scratch.take_away();
        let step = std::mem::take(&mut scratch.step);
        scratch.spread(&step);
        scratch.step = step;
        scratch.respond(model, workspace);
        for (a, change) in qdd.iter_mut().zip(&scratch.estimates) {
            *a += change;
        }
        largest = scratch.left(model, constraints, state, (qdd, alpha))?;
        if !(largest < residual) {
            qdd.copy_from_slice(&kept);
            scratch.forces = forces;
            largest = scratch.left(model, constraints, state, (qdd, alpha))?;
            break;
        }
    }
    let is_left = |&i: &usize| scratch.residual[i].abs() > AGREES * terms[i];
    let contradicted = (0..constraints.rows).filter(is_left).collect();
    Ok(Outcome { pivots, rank: scratch.inverse.rank, residual: largest, contradicted })
}

/// The larger of two, entry by entry.
fn keep_larger(terms: &mut [f64], others: &[f64]) {
    for (term, &other) in terms.iter_mut().zip(others) {
        *term = term.max(other);
    }
}

impl ConstraintScratch {
    /// What is left of every row at these accelerations, in `residual`; gives the largest.
    fn left(
        &mut self,
        model: &Model<f64>,
        constraints: &Constraints,
        state: (&[f64], &[f64]),
        (qdd, alpha): (&[f64], Option<f64>),
    ) -> Result<f64, NoDirection> {
        let Self { residual, terms, rates, errors, .. } = self;
        accelerations_of_rows(model, constraints, state, Some(qdd), (residual, terms))?;
        if let Some(alpha) = alpha {
            for (i, left) in residual.iter_mut().enumerate() {
                let wanted = -alpha * (2.0 * rates[i] + alpha * errors[i]);
                *left -= wanted;
                terms[i] += wanted.abs();
            }
        }
        Ok(residual.iter().fold(0.0, |largest: f64, left| largest.max(left.abs())))
    }

    /// lambda += step, step = -G^+ residual.
    fn take_away(&mut self) {
        self.inverse.apply(&self.residual, &mut self.step);
        for (lambda, step) in self.forces.iter_mut().zip(&mut self.step) {
            *step = -*step;
            *lambda += *step;
        }
    }
}
