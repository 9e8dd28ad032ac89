//! Joint limits as stops in scenes with contacts or connections: frictionless unilateral rows, in steps of order 1.

use super::events::{StopImpact, largest};
use super::stops::{AT_MOST, returning};
use crate::dynamics::contacts::LimitRow;
use crate::scene::Scene;

/// Relative rounding errors of velocities and coordinates.
const ROUNDING: f64 = 1e-12;

/// A joint does not return to its limits if joints would move faster than in the step without stops, and than this
/// times the largest velocity of returns. A larger bound would let consecutive returns add energy.
const VIOLENT: f64 = 10.0;

/// A joint that approaches its stop more slowly than this rests on it, rad/s or m/s.
const RESTS: f64 = 1e-3;

/// The limits of all joints with one degree of freedom; a joint with both limits has two rows.
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

/// The least velocity away from a limit at the end of a step. A joint inside can reach its limit; a joint outside
/// returns slowly.
pub(super) fn least_velocity(gap: f64, start: f64, h: f64) -> f64 {
    if gap < 0.0 { returning(-gap, start, h).velocity } else { -gap / h }
}

/// Derivatives of [`least_velocity`] by the gap and by the velocity at the start.
pub(super) fn least_slopes(gap: f64, start: f64, h: f64) -> [f64; 2] {
    if gap < 0.0 { returning(-gap, start, h).slopes } else { [-1.0 / h, 0.0] }
}

/// True if the return of a joint to its limits would move joints too fast, as near a dead center; for the velocities of
/// the step with and without stops.
pub(super) fn is_violent(velocities: &[f64], free: &[f64]) -> bool {
    largest(velocities, 0.0) > largest(free, VIOLENT * AT_MOST)
}

/// True if a joint that approaches its limit with velocity `start` rebounds. A rebound that would end within two steps
/// is ignored.
pub(super) fn rebounds(start: f64, free: f64, restitution: f64) -> bool {
    start < 0.0 && -restitution * start > 2.0 * (free - start).abs()
}

/// Ends a step at a limit: removes rounding errors from the coordinate and from the velocity of a joint that `rests`
/// there, and returns the impact of a joint that reached it, with this time.
pub(super) fn settle_at(
    limit: &LimitRow,
    (time, start): (f64, f64),
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
        time,
        speed: -start,
        impulse: limit.sign() * impulse,
    })
}
