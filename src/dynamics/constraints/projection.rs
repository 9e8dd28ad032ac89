//! Positions and velocities onto the connections, by moves of least kinetic energy.

use super::NoDirection;
use super::rows::{errors_of_rows, rates_of_rows};
use super::scratch::ConstraintScratch;
use crate::dynamics::forward::factorise;
use crate::filter::pivots::PivotMonitor;
use crate::joints::Motion;
use crate::model::Model;
use crate::scene::constraint::Constraints;
use crate::workspace::Workspace;

/// The most that a coordinate moves in one step, rad or m.
const FARTHEST: f64 = 0.5;

/// The most steps: a position that is singular is reached by halves.
const STEPS: usize = 100;

/// An error below this, m or rad, that no longer falls is rounding.
const CLOSED: f64 = 1e-9;

/// What a projection found.
#[derive(Debug, Clone)]
pub(crate) struct Projected {
    pub pivots: PivotMonitor<f64>,
    /// The rank of G at the end.
    pub rank: usize,
    /// The largest entry that is left: an error, m or rad, or a rate of one.
    pub left: f64,
    /// Its row, where that is no rounding.
    pub stays: Option<usize>,
}

/// The configuration that meets the connections, from `q` by Newton steps -M^-1 J* G^+ error, each of least kinetic energy.
///
/// On return the factors of the tree and of the rows are those of the last configuration that a step was made from. O(N + m^2 depth + m^3) a step.
pub(crate) fn project_positions(
    (model, constraints): (&Model<f64>, &Constraints),
    workspace: &mut Workspace<f64>,
    scratch: &mut ConstraintScratch,
    q: &mut [f64],
) -> Result<Projected, NoDirection> {
    let mut best = (f64::INFINITY, q.to_vec());
    let mut pivots = PivotMonitor::new();
    let mut next = q.to_vec();
    let size = 1.0 + extent(model);
    for _ in 0..STEPS {
        let mut errors = std::mem::take(&mut scratch.errors);
        let told = errors_of_rows(model, constraints, q, &mut errors);
        scratch.errors = errors;
        told?;
        let left = largest(&scratch.errors);
        let falls = left < 0.5 * best.0;
        if left < best.0 {
            best = (left, q.to_vec());
        }
        // Of rounding no step is made: where the rows are singular it would be the root of it.
        if left <= 4.0 * f64::EPSILON * size || !left.is_finite() || (!falls && best.0 <= CLOSED * size) {
            break;
        }
        pivots = factorise(model, workspace, q, |_, _| {});
        if workspace.lost_pivot(model, &pivots).is_some() {
            return Ok(Projected { pivots, rank: 0, left, stays: None });
        }
        scratch.factorise((model, constraints), workspace, q, &[])?;
        let errors = std::mem::take(&mut scratch.errors);
        scratch.step_against(&errors, model, workspace);
        scratch.errors = errors;
        let longest = largest(&scratch.estimates);
        let share = if longest > FARTHEST { FARTHEST / longest } else { 1.0 };
        for v in &mut scratch.estimates {
            *v *= share;
        }
        for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
            let motion: &Motion<f64> = &body.motion;
            motion.advance(&q[body.q..], &scratch.estimates[stage.first_row..], &mut next[body.q..]);
        }
        q.copy_from_slice(&next);
    }
    q.copy_from_slice(&best.1);
    errors_of_rows(model, constraints, q, &mut scratch.errors)?;
    let stays = (!(best.0 <= CLOSED * size)).then(|| worst(&scratch.errors));
    Ok(Projected { pivots, rank: scratch.inverse.rank, left: best.0, stays })
}

/// The velocities nearest to `qd` that keep the connections as they are, by kinetic energy: qd - M^-1 J* G^+ J qd.
pub(crate) fn project_velocities(
    (model, constraints): (&Model<f64>, &Constraints),
    workspace: &mut Workspace<f64>,
    scratch: &mut ConstraintScratch,
    (q, qd): (&[f64], &mut [f64]),
) -> Result<Projected, NoDirection> {
    let pivots = factorise(model, workspace, q, |_, _| {});
    if workspace.lost_pivot(model, &pivots).is_some() {
        return Ok(Projected { pivots, rank: 0, left: f64::NAN, stays: None });
    }
    scratch.factorise((model, constraints), workspace, q, &[])?;
    let speed = 1.0 + largest(qd) * (1.0 + extent(model));
    let mut before = f64::INFINITY;
    loop {
        rates_of_rows(model, constraints, (q, qd), &mut scratch.rates)?;
        let left = largest(&scratch.rates);
        if !(left < 0.25 * before && left > 0.0) {
            let stays = (!(left <= CLOSED * speed)).then(|| worst(&scratch.rates));
            return Ok(Projected { pivots, rank: scratch.inverse.rank, left, stays });
        }
        before = left;
        let rates = std::mem::take(&mut scratch.rates);
        scratch.step_against(&rates, model, workspace);
        scratch.rates = rates;
        for (v, change) in qd.iter_mut().zip(&scratch.estimates) {
            *v += change;
        }
    }
}

impl ConstraintScratch {
    /// -M^-1 J* G^+ x, in `estimates`.
    fn step_against(&mut self, x: &[f64], model: &Model<f64>, workspace: &mut Workspace<f64>) {
        let mut step = std::mem::take(&mut self.step);
        self.inverse.apply(x, &mut step);
        for lambda in &mut step {
            *lambda = -*lambda;
        }
        self.spread(&step);
        self.step = step;
        self.respond(model, workspace);
    }
}

/// The largest of all by size; NaN where one is.
fn largest(x: &[f64]) -> f64 {
    x.iter().fold(0.0, |largest: f64, x| if x.is_nan() { f64::NAN } else { largest.max(x.abs()) })
}

/// Where that is.
fn worst(x: &[f64]) -> usize {
    (0..x.len()).max_by(|&i, &j| x[i].abs().total_cmp(&x[j].abs())).unwrap_or_default()
}

/// About how far bodies are from the base, m: the sum of all levers.
fn extent(model: &Model<f64>) -> f64 {
    model.bodies.iter().map(|body| body.tree.lever.norm()).sum()
}
