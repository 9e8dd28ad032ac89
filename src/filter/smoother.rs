//! The Bryson-Frazier smoother (4.7 to 4.11, with 4.11 as it holds).

use super::riccati::Measured;
use super::system::{Stage, System};
use crate::scalar::Real;
use crate::spatial::RigidShift;
use nalgebra::Vector6;

/// Base to tip: co-states and estimates.
///
/// lambda^+(k) = phi^T lambda^-(parent) (4.10); then row by row, from the root outward, a = e^+ - g* lambda^+ (4.9) and
/// lambda^- = lambda^+ + H^T a (4.11). `estimates` holds e^- on entry and a on return; `co_state` receives lambda^-.
#[inline(always)]
pub fn sweep<T: Real>(
    system: &System<T>,
    shift: &[RigidShift<T>],
    measured: &[Measured<T>],
    co_state: &mut [Vector6<T>],
    estimates: &mut [T],
) {
    for (k, stage) in system.stages.iter().enumerate() {
        let mut lambda = match stage.parent {
            Some(parent) => shift[k].motion_to_child(&co_state[parent]),
            None => crate::spatial::zero(),
        };
        through_stage(stage, measured, &mut lambda, estimates);
        co_state[k] = lambda;
    }
}

/// The rows of one stage, first to last: lambda^+ becomes lambda^- (4.11), `estimates` holds e^- on entry and a on return (4.9).
#[inline(always)]
#[doc(hidden)]
pub fn through_stage<T: Real>(
    stage: &Stage<T>,
    measured: &[Measured<T>],
    lambda: &mut Vector6<T>,
    estimates: &mut [T],
) {
    for i in 0..stage.rows.count() {
        let row = stage.first_row + i;
        let m = &measured[row];
        let a = estimates[row].mul_add(m.pivot_inverse, -crate::spatial::dot(&m.gain, lambda));
        *lambda = stage.rows.row(i).spread_onto(lambda, a);
        estimates[row] = a;
    }
}
