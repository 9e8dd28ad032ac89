//! Forward dynamics through connections.

use super::RowFault;
use super::scratch::ConstraintScratch;
use crate::accuracy::largest;
use crate::dynamics::forces::Motion;
use crate::dynamics::forward::{factorise, forward_dynamics};
use crate::dynamics::inverse::forces_base_to_tip;
use crate::dynamics::sweeps::general;
use crate::filter::Form;
use crate::filter::pivots::PivotMonitor;
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::constraint::Constraints;
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// A row agrees with the others if its residual is below this fraction of its terms.
const AGREES: f64 = 1e-6;

/// A residual below this multiple of the rounding of its terms is not corrected.
const ROUNDING: f64 = 4.0;

/// A residual below this number of units in the last place of the forces on the robot can be rounding.
pub(super) const NO_ROUNDING: f64 = 4096.0;

/// The maximum number of corrections of residuals.
const CORRECTIONS: usize = 6;

/// sqrt(m) |g| of the whole robot: times the size of a row it bounds the effect of the weight on that row.
pub(super) fn weight<T: Real>(model: &Model<T>) -> f64 {
    let mass: f64 = model.bodies.iter().map(|body| body.inertia.mass.lane(0)).sum();
    mass.sqrt() * model.gravity.map(|g| g.lane(0)).norm()
}

/// The result of constrained dynamics.
#[derive(Debug, Clone)]
pub(crate) struct Outcome {
    pub pivots: PivotMonitor<f64>,
    /// The rank of G.
    pub rank: usize,
    /// The largest remaining entry of J qdd + gamma - wanted, rad/s^2 or m/s^2.
    pub residual: f64,
    /// The rows whose residual exceeds rounding: no forces satisfy all of them.
    pub contradicted: Vec<usize>,
}

/// Accelerations `qdd` and connection forces (in the scratch) from torques, with J qdd + gamma = -compliance lambda.
/// `compliance` is that of each row as measurement noise, zero or positive, (m/s^2)/N; empty for rigid connections.
///
/// Computes the accelerations qdd0 of the tree, then lambda = -(G + compliance)^+ (J qdd0 + gamma), then the
/// accelerations of the tree with the forces J* lambda. Residuals are corrected by one more right-hand side each while
/// they decrease. The covariance form needs one factor and two right-hand sides, other forms need forward dynamics
/// twice, O(N); the rows add O(m^2 depth + m^3).
pub(crate) fn constrained_dynamics(
    (model, constraints): (&Model<f64>, &Constraints),
    workspace: &mut Workspace<f64>,
    scratch: &mut ConstraintScratch,
    (q, qd, tau): (&[f64], &[f64], &[f64]),
    (wrenches, compliance): (&[Vector6<f64>], &[f64]),
    qdd: &mut [f64],
) -> Result<Outcome, RowFault> {
    let (mut pivots, right_sides) = accelerations_of_tree(model, workspace, (q, qd, tau), wrenches, qdd);
    if workspace.lost_pivot(model, &pivots).is_some() {
        return Ok(Outcome { pivots, rank: 0, residual: f64::NAN, contradicted: Vec::new() });
    }
    scratch.factorise_moving((model, constraints), workspace, (q, qd), compliance)?;
    scratch.forces.fill(0.0);
    let mut terms = vec![0.0; constraints.rows];
    let before = scratch.left(model, workspace, (qdd, compliance));
    keep_larger(&mut terms, &scratch.terms);
    scratch.solve_for_step();
    scratch.push(1.0);

    // The forces enter as arguments, so that cancellation occurs in the sums that determine the rounding bound and not
    // in the accelerations.
    scratch.spread();
    for (sum, own) in scratch.torque.iter_mut().zip(tau) {
        *sum += own;
    }
    match right_sides {
        RightSides::OneFactor => {
            let Workspace { store, z, .. } = &mut *workspace;
            store.set_forces(z.iter().zip(&scratch.wrenches).map(|(bias, force)| bias - force));
            right_side(model, workspace, &scratch.torque, qdd);
        }
        RightSides::Anew => {
            for (sum, own) in scratch.wrenches.iter_mut().zip(wrenches) {
                *sum += own;
            }
            let acting = std::mem::take(&mut scratch.wrenches);
            pivots = forward_dynamics(model, workspace, q, qd, &scratch.torque, &acting, qdd);
            scratch.wrenches = acting;
        }
    }
    let mut largest = scratch.left(model, workspace, (qdd, compliance));
    keep_larger(&mut terms, &scratch.terms);
    let mut residual = before.max(largest);
    for _ in 0..CORRECTIONS {
        let is_rounding = |i: usize| scratch.residual[i].abs() <= ROUNDING * f64::EPSILON * terms[i];
        if !(largest <= 0.25 * residual && largest > 0.0) || (0..constraints.rows).all(is_rounding) {
            break;
        }
        residual = largest;
        let (kept, forces) = (qdd.to_vec(), scratch.forces.clone());
        // Propagates the step itself, not the difference of the much larger forces.
        scratch.step_against(model, workspace);
        scratch.push(1.0);
        for (a, change) in qdd.iter_mut().zip(&scratch.estimates) {
            *a += change;
        }
        largest = scratch.left(model, workspace, (qdd, compliance));
        if !(largest < residual) {
            qdd.copy_from_slice(&kept);
            scratch.forces = forces;
            scratch.left(model, workspace, (qdd, compliance));
            break;
        }
    }
    // For bodies in static equilibrium the terms of a row can be rounding errors themselves, because the forces on the
    // bodies cancel.
    let acting = scratch.acting() + pushing(model, workspace, tau);
    let is_left = |&i: &usize| {
        let (left, dropped) = (scratch.residual[i].abs(), scratch.dropped[i].abs());
        let is_kept = left > AGREES * terms[i]
            && left > NO_ROUNDING * f64::EPSILON * scratch.rows.whitened.sizes[i].sqrt() * acting;
        is_kept || dropped > (AGREES + scratch.relaxed.allowed) * terms[i]
    };
    let contradicted = (0..constraints.rows).filter(is_left).collect();
    // Residuals due to compliance and those of dropped rows are not rounding, and are reported.
    let given_way = |i: usize| compliance.get(i).map_or(0.0, |compliance| compliance * scratch.forces[i]);
    let left = |i: usize| (scratch.residual[i] + scratch.dropped[i] - given_way(i)).abs();
    let residual = (0..constraints.rows).map(left).fold(0.0, f64::max);
    Ok(Outcome { pivots, rank: scratch.inverse.rank, residual, contradicted })
}

/// The method for further right-hand sides.
#[derive(Clone, Copy)]
enum RightSides {
    /// With the existing factor, in covariance form, and the bias forces in the workspace's `z`.
    OneFactor,
    /// Forward dynamics in the workspace's form.
    Anew,
}

/// The accelerations of the tree; leaves the factor of M in the workspace. Form `auto` uses one factor in covariance
/// form if its error estimate for test vectors meets the tolerance, because more right-hand sides follow.
fn accelerations_of_tree(
    model: &Model<f64>,
    workspace: &mut Workspace<f64>,
    (q, qd, tau): (&[f64], &[f64], &[f64]),
    wrenches: &[Vector6<f64>],
    qdd: &mut [f64],
) -> (PivotMonitor<f64>, RightSides) {
    let form = workspace.form;
    if matches!(form, Form::Auto | Form::Covariance) {
        let pivots = factorise(model, workspace, q);
        if form == Form::Covariance || !pivots.of_roots {
            forces_base_to_tip(model, workspace, Motion { q, qd, qdd: None, wrenches });
            right_side(model, workspace, tau, qdd);
            return (pivots, RightSides::OneFactor);
        }
    }
    let mut pivots = forward_dynamics(model, workspace, q, qd, tau, wrenches, qdd);
    if workspace.lost_pivot(model, &pivots).is_none() && form == Form::Auto {
        // The error estimate of that form is valid for one right-hand side only.
        pivots = factorise(model, workspace, q);
    }
    (pivots, RightSides::Anew)
}

/// Accelerations by the factor in the workspace, for these torques and the forces in its store.
fn right_side(model: &Model<f64>, workspace: &mut Workspace<f64>, tau: &[f64], qdd: &mut [f64]) {
    let (scene, store) = workspace.passes(model);
    general::solve::<f64, true>(scene, store, tau, qdd);
}

/// The bound on the effect of the torques, by the factor in the workspace, and of the weight.
fn pushing(model: &Model<f64>, workspace: &Workspace<f64>, tau: &[f64]) -> f64 {
    let torques = tau.iter().zip(&workspace.store.measured).map(|(tau, row)| tau.abs() * row.pivot_inverse.sqrt());
    torques.sum::<f64>() + weight(model)
}

/// The larger of two values, for each entry.
fn keep_larger(terms: &mut [f64], others: &[f64]) {
    for (term, &other) in terms.iter_mut().zip(others) {
        *term = term.max(other);
    }
}

impl ConstraintScratch {
    /// The residual of every row at these accelerations, in `residual`. Returns the largest.
    fn left(&mut self, model: &Model<f64>, workspace: &Workspace<f64>, (qdd, compliance): (&[f64], &[f64])) -> f64 {
        let Self { rows, residual, terms, forces, relaxed, dropped, .. } = self;
        rows.times::<true>((model, &workspace.sweeps), &workspace.store, qdd, (residual, terms));
        relaxed.split(residual, dropped);
        for (i, &compliance) in compliance.iter().enumerate() {
            let given_way = compliance * forces[i];
            residual[i] += given_way;
            terms[i] += given_way.abs();
        }
        largest(residual)
    }

    /// The sum of sqrt(`G_jj`) |`lambda_j`|. Times the size of a row it bounds the terms of the connection forces in
    /// that row.
    fn acting(&self) -> f64 {
        self.inverse.weighed(&self.forces)
    }
}
