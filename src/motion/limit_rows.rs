//! Joint limits as stops in scenes with contacts or connections: rows of the contact law without friction, in steps of order 1 where one acts.

use super::stops::returning;
use super::substeps::StopImpact;
use crate::dynamics::contacts::LimitRow;
use crate::scene::Scene;

/// Parts of velocities, and of coordinates, that are rounding.
const ROUNDING: f64 = 1e-12;

/// A joint that moves toward its stop more slowly rests on it, rad/s or m/s.
const RESTS: f64 = 1e-3;

/// The limits of all joints with one degree of freedom, two rows for a joint that has both.
pub(super) fn limit_rows(scene: &Scene) -> Vec<LimitRow> {
    let mut rows = Vec::new();
    for joint in scene.joints().iter().filter(|joint| joint.v.len() == 1 && joint.q.len() == 1) {
        let (row, coordinate) = (joint.v.start, joint.q.start);
        let Some(body) = scene.model().system.stages.iter().position(|stage| stage.first_row == row) else { continue };
        for (upper, bound) in [(false, joint.limits.lower), (true, joint.limits.upper)] {
            if bound.is_finite() {
                rows.push(LimitRow { body, row, coordinate, upper, bound });
            }
        }
    }
    rows
}

/// The least velocity away from a limit at the end of a step: the joint may arrive there, and returns slowly from outside.
pub(super) fn least_velocity(gap: f64, start: f64, h: f64) -> f64 {
    if gap < 0.0 { returning(-gap, start, h).velocity } else { -gap / h }
}

/// True if a joint that moves toward its limit at `start` rebounds: one that would end within two steps is none.
pub(super) fn rebounds(start: f64, free: f64, restitution: f64) -> bool {
    start < 0.0 && -restitution * start > 2.0 * (free - start).abs()
}

/// Ends a step of joints at their limits: removes rounding from the coordinate and the velocity `rests` of a joint that stays there, and gives the impact of one that arrived.
pub(super) fn settle_at(
    limit: &LimitRow,
    (h, start): (f64, f64),
    (impulse, rests): (f64, Option<f64>),
    (q, v): (&mut [f64], &mut [f64]),
) -> Option<StopImpact> {
    let at = &mut q[limit.coordinate];
    if (*at - limit.bound).abs() <= ROUNDING * (1.0 + limit.bound.abs()) {
        *at = limit.bound;
    }
    let (velocity, size) = (&mut v[limit.row], 1.0 + start.abs());
    if let Some(rests) = rests
        && (*velocity - limit.sign() * rests).abs() <= ROUNDING * size
    {
        *velocity = limit.sign() * rests;
    }
    (start < -RESTS && impulse > 0.0).then(|| StopImpact {
        state: 0,
        row: limit.row,
        upper: limit.upper,
        time: h,
        speed: -start,
        impulse: limit.sign() * impulse,
    })
}
