//! The Bryson-Frazier smoother (4.7 to 4.11, with 4.11 as it holds).
//!
//! ```
//! use nalgebra::Vector6;
//! use phipsi::filter::riccati::Measured;
//! use phipsi::filter::smoother;
//! use phipsi::filter::{HingeMap, Rows, Stage, System};
//!
//! // Two stages, each measured once without noise: component 2 of its state.
//! let stage = |parent, first_row| Stage { parent, rows: Rows::One(HingeMap::Axis(2)), first_row };
//! let system = System { stages: vec![stage(None, 0), stage(Some(0), 1)], noise: vec![0.0; 2] };
//! use phipsi::spatial::RigidShift;
//!
//! // Gains of zero: the estimate of each row is its innovation over D, and co-states gather what is inboard.
//! let measured = [Measured { pivot: 2.0, pivot_inverse: 0.5, gain: Vector6::zeros() }; 2];
//! let (mut co_state, mut estimates) = ([Vector6::zeros(); 2], [4.0, 6.0]);
//! smoother::sweep(&system, &[RigidShift::identity(); 2], &measured, &mut co_state, &mut estimates);
//! assert_eq!(estimates, [2.0, 3.0]);
//! assert_eq!(co_state[1][2], 5.0);
//! ```

use super::riccati::Measured;
use super::system::{Stage, System};
use crate::scalar::Real;
use crate::spatial::RigidShift;
use nalgebra::Vector6;

/// Base to tip: co-states and estimates.
///
/// lambda^+(k) = phi^T lambda^-(parent) (4.10); then row by row, from the root outward, a = e^+ - g* lambda^+ (4.9) and
/// lambda^- = lambda^+ + H^T a (4.11). `estimates` holds e^- on entry and a on return; `co_state` receives lambda^-.
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
