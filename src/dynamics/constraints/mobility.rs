//! The number of independent rows of each group of the intended linkage, away from singular positions.
//!
//! The group is closed from several starts by steps -J^+ error in the units of [`SizedRows`], without dynamics. The
//! result is the rank at the majority of the closed positions.

use super::rows::{errors_of_rows, units_of_rows};
use super::scratch::ConstraintScratch;
use super::sized_rows::{Group, SizedRows, groups};
use crate::kinematics::placements_base_to_tip;
use crate::model::Model;
use crate::scene::constraint::{Constraints, Mobility, Near};
use crate::spatial::RigidShift;

/// Number of starts from the neutral configuration, and from the given one.
const STARTS: usize = 6;

/// The search ends at this number of closed positions.
const ENOUGH: usize = 3;

/// Steps from one start.
const STEPS: usize = 40;

/// The largest change of a coordinate in one step, rad, or m divided by the reach.
const FARTHEST: f64 = 0.5;

/// A dimensionless error below this counts as closed.
const CLOSED: f64 = 1e-9;

/// Singular values above this are not rounding errors of exact linkages.
const NOTABLE: f64 = 1e-11;

/// A closed position of one group.
struct Closed {
    rank: usize,
    near: Option<Near>,
}

/// The ranks of all groups, from the neutral configuration, or from `q` if that cannot be closed.
pub(super) fn mobility(model: &Model<f64>, constraints: &Constraints, q: &[f64]) -> Mobility {
    let mut scratch = ConstraintScratch::new(model, constraints);
    let mut shift = vec![RigidShift::identity(); model.bodies.len()];
    let mut found = Mobility::default();
    for group in groups(model, constraints) {
        let mut closed: Vec<Closed> = Vec::new();
        for (from, size) in [(&constraints.neutral[..], 0.5), (q, 0.2)] {
            for start in 0..STARTS {
                if closed.len() < ENOUGH {
                    let start = moved(model, from, &scattered(model.nv(), start, size));
                    closed.extend(close((model, constraints), (&mut scratch, &mut shift), &group, start));
                }
            }
        }
        let votes = |rank: usize| closed.iter().filter(|of| of.rank == rank).count();
        let most = closed.iter().map(|of| of.rank).max_by_key(|&rank| (votes(rank), rank));
        found.ranks.push(most);
        for of in closed.into_iter().filter(|of| Some(of.rank) == most) {
            if let Some(near) = of.near
                && found.near.as_ref().is_none_or(|known| near.value > known.value)
            {
                found.near = Some(near);
            }
        }
    }
    found
}

/// Joint velocities within `size` without a repeating pattern. The first start is not zero, so that a configuration
/// that is already closed counts only if others have the same rank.
pub(super) fn scattered(nv: usize, start: usize, size: f64) -> Vec<f64> {
    #[allow(clippy::cast_precision_loss)] // a few thousand
    let number =
        |i: usize| ((i + 1) as f64 * 0.618_033_988_749_895 + (start + 1) as f64 * 0.754_877_666_246_693).fract();
    (0..nv).map(|i| size * (2.0 * number(i) - 1.0)).collect()
}

/// The configuration that velocities reach in unit time.
pub(super) fn moved(model: &Model<f64>, q: &[f64], velocity: &[f64]) -> Vec<f64> {
    let mut next = q.to_vec();
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        body.motion.advance(&q[body.q..], &velocity[stage.first_row..], &mut next[body.q..]);
    }
    next
}

/// A closed position of a group near a start, if there is one.
fn close(
    (model, constraints): (&Model<f64>, &Constraints),
    (scratch, shift): (&mut ConstraintScratch, &mut [RigidShift<f64>]),
    group: &Group,
    mut q: Vec<f64>,
) -> Option<Closed> {
    let rest = vec![0.0; model.nv()];
    let mut errors = vec![0.0; constraints.rows];
    let mut velocity = vec![0.0; model.nv()];
    for _ in 0..STEPS {
        errors_of_rows(model, constraints, &q, &mut errors).ok()?;
        placements_base_to_tip(model, &q, shift);
        units_of_rows(model, constraints, (&q, &rest), &mut scratch.units).ok()?;
        let sized = SizedRows::of(scratch, (model, constraints), shift);
        let svd = sized.part(&group.rows, group).svd(true, true);
        let (u, v) = (svd.u.as_ref()?, svd.v_t.as_ref()?);
        velocity.fill(0.0);
        let mut open = 0.0_f64;
        for (k, &value) in svd.singular_values.iter().enumerate().filter(|(_, value)| **value > constraints.tolerance) {
            let along: f64 = group.rows.iter().zip(&u.column(k)).map(|(&i, u)| u * errors[i] / sized.sizes[i]).sum();
            open = open.max(along.abs());
            for (j, &column) in group.columns.iter().enumerate() {
                velocity[column] -= v[(k, j)] * along / value;
            }
        }
        if open <= CLOSED {
            // Dropped combinations must also hold, to within the tolerance.
            let slack = |&i: &usize| errors[i].abs() <= (CLOSED + 10.0 * constraints.tolerance) * sized.sizes[i];
            let rank = svd.singular_values.iter().filter(|&&value| value > constraints.tolerance).count();
            let small = svd.singular_values.iter().enumerate();
            let near = small
                .filter(|&(_, &value)| value > NOTABLE && value <= constraints.tolerance)
                .max_by(|a, b| a.1.total_cmp(b.1))
                .map(|(k, &value)| Near { row: group.rows[u.column(k).iamax()], value, q: q.clone() });
            return group.rows.iter().all(slack).then_some(Closed { rank, near });
        }
        let longest = velocity.iter().fold(0.0, |longest: f64, v| longest.max(v.abs()));
        let share = if longest > FARTHEST { FARTHEST / longest } else { 1.0 };
        for (v, weight) in velocity.iter_mut().zip(&sized.weights) {
            *v *= share * weight;
        }
        q = moved(model, &q, &velocity);
    }
    None
}
