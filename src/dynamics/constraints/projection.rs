//! Projection of positions and velocities onto the connections, by steps of least kinetic energy.

use super::RowFault;
use super::gram_inverse::Relaxed;
use super::rows::errors_of_rows;
use super::scratch::ConstraintScratch;
use crate::dynamics::forward::factorise;
use crate::filter::pivots::PivotMonitor;
use crate::kinematics::manifold::advance;
use crate::model::Model;
use crate::scalar::largest_of;
use crate::scene::constraint::Constraints;
use crate::workspace::Workspace;

/// The largest change of a coordinate in one step, rad or m.
pub(crate) const FARTHEST: f64 = 0.5;

/// The maximum number of steps: the error halves per step near a singular position.
const STEPS: usize = 100;

/// An error below this, m or rad, that no longer decreases is rounding.
pub(crate) const CLOSED: f64 = 1e-9;

/// An error below this is rounding, relative to one plus the distance of the bodies from the base.
pub(crate) const ROUNDED: f64 = 4.0 * f64::EPSILON;

/// The result of a projection.
#[derive(Debug, Clone)]
pub(crate) struct Projected {
    pub pivots: PivotMonitor<f64>,
    /// The rank of G at the last configuration.
    pub rank: usize,
    /// The largest remaining error, m or rad, or its largest time derivative.
    pub left: f64,
    /// The row of that error if it exceeds rounding.
    pub stays: Option<usize>,
}

/// A Newton step of a projection of positions from q: x = M^-1 J* p, of which the [`share`] is added.
#[derive(Debug, Clone)]
#[cfg_attr(not(feature = "motion"), allow(dead_code))]
pub(crate) struct ProjectionStep {
    pub q: Vec<f64>,
    pub x: Vec<f64>,
    pub p: Vec<f64>,
}

/// The configuration that meets the connections, by Newton steps -M^-1 J* (G + compliance)^+ error from `q`, each of
/// least kinetic energy. Rows with compliance end at error = -compliance lambda, where lambda is the sum of the forces
/// of the steps.
///
/// On return, the factors of the tree and of the rows are those of the last configuration from which a step was made.
/// O(N + m^2 depth + m^3) per step.
/// Adds the steps that lead to the result to `steps`.
pub(crate) fn project_positions(
    (model, constraints): (&Model<f64>, &Constraints),
    workspace: &mut Workspace<f64>,
    scratch: &mut ConstraintScratch,
    (q, compliance): (&mut [f64], &[f64]),
    mut steps: Option<&mut Vec<ProjectionStep>>,
) -> Result<Projected, RowFault> {
    let recorded = steps.as_ref().map_or(0, |steps| steps.len());
    let mut best = (f64::INFINITY, q.to_vec());
    let mut pivots = PivotMonitor::new();
    let mut next = q.to_vec();
    let size = 1.0 + extent(model);
    scratch.relaxed = Relaxed::default();
    scratch.forces.fill(0.0);
    for _ in 0..STEPS {
        errors_of_rows(model, constraints, q, &mut scratch.errors)?;
        let mut left = scratch.open(compliance, true);
        let falls = left < 0.5 * best.0;
        if left < best.0 {
            best = (left, q.to_vec());
        }
        let is_closed = |left: f64| left <= ROUNDED * size;
        // Rounding errors are not corrected: at singular rows, the step would be as large as their square root.
        if is_closed(left) || !left.is_finite() || (!falls && best.0 <= CLOSED * size) {
            break;
        }
        pivots = factorise(model, workspace, q);
        if workspace.lost_pivot(model, &pivots).is_some() {
            return Ok(Projected { pivots, rank: 0, left, stays: None });
        }
        scratch.factorise((model, constraints), workspace, q, compliance)?;
        if scratch.relaxed.basis().is_some() {
            // Recomputed because the kept rows are now known.
            left = scratch.open(compliance, true);
            best.0 = best.0.min(left);
            if is_closed(left) {
                best.1.copy_from_slice(q);
                break;
            }
        }
        scratch.step_against(model, workspace);
        let share = share(&scratch.estimates);
        if let Some(steps) = &mut steps {
            steps.push(ProjectionStep { q: q.to_vec(), x: scratch.estimates.clone(), p: scratch.step.clone() });
        }
        for v in &mut scratch.estimates {
            *v *= share;
        }
        scratch.push(share);
        advance(model, q, &scratch.estimates, &mut next);
        q.copy_from_slice(&next);
    }
    q.copy_from_slice(&best.1);
    if let Some(steps) = steps
        && let Some(end) = steps[recorded..].iter().position(|step| step.q == q)
    {
        // Steps from the best configuration are not part of the result.
        steps.truncate(recorded + end);
    }
    errors_of_rows(model, constraints, q, &mut scratch.errors)?;
    let left = largest_of(&scratch.errors, 0.0);
    let ConstraintScratch { errors, relaxed, dropped, .. } = scratch;
    let mut stays = (!(best.0 <= CLOSED * size)).then(|| worst(errors));
    if stays.is_none() && compliance.is_empty() {
        relaxed.split(errors, dropped);
        stays = relaxed.beyond(dropped, 1.0);
    }
    Ok(Projected { pivots, rank: scratch.inverse.rank, left, stays })
}

/// The share of a Newton step that changes no coordinate by more than [`FARTHEST`].
pub(crate) fn share(x: &[f64]) -> f64 {
    let longest = largest_of(x, 0.0);
    if longest > FARTHEST { FARTHEST / longest } else { 1.0 }
}

/// The velocities nearest to `qd`, by kinetic energy, that satisfy the connections: qd - M^-1 J* (G + compliance)^+ J
/// qd.
pub(crate) fn project_velocities(
    (model, constraints): (&Model<f64>, &Constraints),
    workspace: &mut Workspace<f64>,
    scratch: &mut ConstraintScratch,
    (q, qd): (&[f64], &mut [f64]),
    compliance: &[f64],
) -> Result<Projected, RowFault> {
    let pivots = factorise(model, workspace, q);
    if workspace.lost_pivot(model, &pivots).is_some() {
        return Ok(Projected { pivots, rank: 0, left: f64::NAN, stays: None });
    }
    scratch.factorise((model, constraints), workspace, q, compliance)?;
    Ok(project_with_factors(model, (workspace, pivots), scratch, qd, compliance))
}

/// As [`project_velocities`], with the factors of M, which had these `pivots`, and of the rows at one configuration.
pub(crate) fn project_with_factors(
    model: &Model<f64>,
    (workspace, pivots): (&mut Workspace<f64>, PivotMonitor<f64>),
    scratch: &mut ConstraintScratch,
    qd: &mut [f64],
    compliance: &[f64],
) -> Projected {
    let speed = 1.0 + largest_of(qd, 0.0) * (1.0 + extent(model));
    let mut before = f64::INFINITY;
    scratch.forces.fill(0.0);
    loop {
        scratch.rates_of(model, workspace, qd);
        let left = scratch.open(compliance, false);
        if !(left < 0.25 * before && left > 0.0) {
            let stays = (!(left <= CLOSED * speed)).then(|| worst(&scratch.rates));
            let beyond = || scratch.relaxed.beyond(&scratch.dropped, speed);
            let stays = stays.or_else(|| if compliance.is_empty() { beyond() } else { None });
            return Projected { pivots, rank: scratch.inverse.rank, left: largest_of(&scratch.rates, 0.0), stays };
        }
        before = left;
        scratch.step_against(model, workspace);
        scratch.push(1.0);
        for (v, change) in qd.iter_mut().zip(&scratch.estimates) {
            *v += change;
        }
    }
}

impl ConstraintScratch {
    /// The residuals of the kept rows, into `residual`: errors or velocities, plus compliance times lambda. Returns the
    /// largest.
    fn open(&mut self, compliance: &[f64], is_of_positions: bool) -> f64 {
        let Self { residual, errors, rates, forces, relaxed, dropped, .. } = self;
        residual.copy_from_slice(if is_of_positions { errors } else { rates });
        relaxed.split(residual, dropped);
        for (i, compliance) in compliance.iter().enumerate() {
            residual[i] += compliance * forces[i];
        }
        largest_of(residual, 0.0)
    }

    /// J v into `rates`, with the rows and phi of one configuration.
    pub(super) fn rates_of(&mut self, model: &Model<f64>, workspace: &Workspace<f64>, v: &[f64]) {
        let Self { rows, rates, terms, .. } = self;
        rows.times::<false>((model, &workspace.sweeps), &workspace.store, v, (rates, terms));
    }

    /// -G^+ residual, into `step`.
    pub(super) fn solve_for_step(&mut self) {
        self.inverse.apply(&self.residual, &mut self.step);
        for lambda in &mut self.step {
            *lambda = -*lambda;
        }
    }

    /// -M^-1 J* G^+ residual, into `estimates`, and its forces, into `step`.
    pub(super) fn step_against(&mut self, model: &Model<f64>, workspace: &mut Workspace<f64>) {
        self.solve_for_step();
        let step = std::mem::take(&mut self.step);
        self.respond(model, workspace, &step);
        self.step = step;
    }

    /// Adds a fraction of a step to the sum of forces.
    pub(super) fn push(&mut self, share: f64) {
        for (lambda, step) in self.forces.iter_mut().zip(&self.step) {
            *lambda += share * step;
        }
    }
}

/// The index of the largest absolute value.
pub(super) fn worst(x: &[f64]) -> usize {
    (0..x.len()).max_by(|&i, &j| x[i].abs().total_cmp(&x[j].abs())).unwrap_or_default()
}

/// The approximate distance of the bodies from the base, m: the sum of all levers.
pub(crate) fn extent(model: &Model<f64>) -> f64 {
    model.bodies.iter().map(|body| body.tree.lever.norm()).sum()
}
