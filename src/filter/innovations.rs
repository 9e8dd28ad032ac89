//! The filter of one stage (4.2, 4.5), and its adjoint: the corrections of the prediction by the measurements.
//!
//! ```
//! use nalgebra::Vector6;
//! use phipsi::filter::riccati::Measured;
//! use phipsi::filter::{HingeMap, Rows, Stage, System, innovations};
//!
//! // One stage, measured once without noise: component 2 of its state.
//! let stage = Stage { parent: None, rows: Rows::One(HingeMap::Axis(2)), first_row: 0 };
//! let system = System { stages: vec![stage], noise: vec![0.0] };
//! let gain = Vector6::new(0.5, 0.0, 1.0, 0.0, 0.0, 0.0);
//! let measured = [Measured { pivot: 2.0, pivot_inverse: 0.5, gain }];
//! // The measurement is larger than predicted by 3, and the gain says what that adds to the state.
//! let (mut z, mut e) = (Vector6::repeat(1.0), [f64::NAN]);
//! innovations::through_stage((&system, 0), &measured, &[4.0], &mut z, &mut e);
//! assert_eq!((e[0], z[0], z[2]), (3.0, 2.5, 4.0));
//! ```
//!
//! A tree of two stages is in the example of [`filter`](super).

use super::riccati::Measured;
use super::system::{HingeMap, Stage, System};
use crate::scalar::Real;
use crate::spatial::scaled_add;
use nalgebra::Vector6;
use std::ops::Range;

/// The rows of one stage, last first: e^- = tau - H z^- (4.2) into `innovations`; replaces z^- by z^+ = z^- + g e^-
/// (4.5).
#[inline(always)]
pub fn through_stage<T: Real>(
    (system, k): (&System<T>, usize),
    measured: &[Measured<T>],
    measurement: &[T],
    state: &mut Vector6<T>,
    innovations: &mut [T],
) {
    let stage = &system.stages[k];
    for i in (0..stage.rows.count()).rev() {
        let row = stage.first_row + i;
        let (hinge, m) = (stage.rows.row(i), &measured[row]);
        let e_minus = measurement[row] - hinge.project(state);
        *state = scaled_add(&m.gain, e_minus, state);
        // H z^+ = tau - (r / D) e^-: a sum with a large H z^- would lose precision.
        if let HingeMap::Axis(i) = hinge
            && system.is_measured(row)
        {
            state[i] = measurement[row].minus_product(e_minus, system.noise[row] * m.pivot_inverse);
        }
        innovations[row] = e_minus;
    }
}

/// A state past some of a stage's rows, outermost first: x becomes (1 - g H) x at each, the closed loop A (3.9).
///
/// The effect of measurements of x alone. Nine products per row.
#[inline(always)]
#[doc(hidden)]
pub fn past_rows<T: Real>(stage: &Stage<T>, measured: &[Measured<T>], rows: Range<usize>, x: &mut Vector6<T>) {
    for i in rows.rev() {
        *x = scaled_add(&measured[stage.first_row + i].gain, -stage.rows.row(i).project(x), x);
    }
}
