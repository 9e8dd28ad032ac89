//! The Bryson-Frazier smoother of one stage (4.9, and 4.11 as it holds).
//!
//! ```
//! use nalgebra::Vector6;
//! use phipsi::filter::riccati::Measured;
//! use phipsi::filter::{HingeMap, Rows, Stage, smoother};
//!
//! let stage = Stage { parent: None, rows: Rows::One(HingeMap::Axis(2)), first_row: 0 };
//! let gain = Vector6::new(0.5, 0.0, 1.0, 0.0, 0.0, 0.0);
//! let measured = [Measured { pivot: 2.0, pivot_inverse: 0.5, gain }];
//! // The innovation over D, less what the co-state inboard of the joint explains.
//! let (mut co_state, mut estimates) = (Vector6::repeat(1.0), [4.0]);
//! smoother::through_stage(&stage, &measured, &mut co_state, &mut estimates);
//! assert_eq!((estimates[0], co_state[2]), (0.5, 1.5));
//! ```

use super::riccati::Measured;
use super::system::Stage;
use crate::scalar::Real;
use nalgebra::Vector6;

/// The rows of one stage, first to last: replaces e^- in `estimates` by a = e^+ - g* lambda^+ (4.9), and lambda^+ by
/// lambda^- = lambda^+ + H^T a (4.11).
#[inline(always)]
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
