//! The filter (4.4 to 4.6) and its open-loop and adjoint relatives: what the measurements add to the prediction.
//!
//! ```
//! use nalgebra::Vector6;
//! use phipsi::filter::innovations;
//! use phipsi::filter::{HingeMap, Rows, Stage, System};
//!
//! // Two stages, each measured once without noise: component 2 of its state.
//! let stage = |parent, first_row| Stage { parent, rows: Rows::One(HingeMap::Axis(2)), first_row };
//! let system = System { stages: vec![stage(None, 0), stage(Some(0), 1)], noise: vec![0.0; 2] };
//! use phipsi::spatial::RigidShift;
//!
//! // Open loop: what the torques would be if the states had these means and no noise.
//! let shift = [RigidShift::identity(); 2];
//! let (mut z, mut predicted) = ([Vector6::repeat(1.0); 2], [f64::NAN; 2]);
//! innovations::predict(&system, &shift, &mut z, &mut predicted);
//! assert_eq!(predicted, [2.0, 1.0]);
//! ```
//!
//! The closed loop is in the example of [`filter`](super).

use super::riccati::Measured;
use super::system::{HingeMap, Stage, System};
use crate::scalar::Real;
use crate::spatial::{RigidShift, scaled_add, sum};
use nalgebra::Vector6;
use std::ops::Range;

/// One stage of the filter: e^- = tau - H z^- (4.2), z^+ = z^- + g e^- (4.5), z^-(parent) += phi z^+ (4.4).
///
/// `z` holds b(k) plus what the children sent; `innovations` receives e^- of each row.
#[doc(hidden)]
pub fn step<T: Real>(
    system: &System<T>,
    k: usize,
    shift: &[RigidShift<T>],
    measured: &[Measured<T>],
    measurement: &[T],
    z: &mut [Vector6<T>],
    innovations: &mut [T],
) {
    let mut state = z[k];
    through_stage((system, k), measured, measurement, &mut state, innovations);
    z[k] = state;
    if let Some(parent) = system.stages[k].parent {
        z[parent] = sum(&z[parent], &shift[k].force_to_parent(&state));
    }
}

/// The rows of one stage, last first: z^- becomes z^+ (4.5), `innovations` receives e^- (4.2).
#[inline(always)]
#[doc(hidden)]
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
        // H z^+ = tau - (r / D) e^-, which a sum with a large H z^- would not give.
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
/// What measurements that see nothing else leave of x. Nine products a row.
#[inline(always)]
#[doc(hidden)]
pub fn past_rows<T: Real>(stage: &Stage<T>, measured: &[Measured<T>], rows: Range<usize>, x: &mut Vector6<T>) {
    for i in rows.rev() {
        *x = scaled_add(&measured[stage.first_row + i].gain, -stage.rows.row(i).project(x), x);
    }
}

/// Tip to base: the innovations of every row, with the factor already known.
pub fn sweep<T: Real>(
    system: &System<T>,
    shift: &[RigidShift<T>],
    measured: &[Measured<T>],
    measurement: &[T],
    z: &mut [Vector6<T>],
    innovations: &mut [T],
) {
    for k in (0..system.stages.len()).rev() {
        step(system, k, shift, measured, measurement, z, innovations);
    }
}

/// Tip to base, open loop: T = H phi W (1.5), the measurements that the process noise `z` causes.
///
/// `z` holds w(k) on entry and the whole force z(k) on return.
pub fn predict<T: Real>(system: &System<T>, shift: &[RigidShift<T>], z: &mut [Vector6<T>], predicted: &mut [T]) {
    for (k, stage) in system.stages.iter().enumerate().rev() {
        for i in 0..stage.rows.count() {
            predicted[stage.first_row + i] = stage.rows.row(i).project(&z[k]);
        }
        if let Some(parent) = stage.parent {
            z[parent] = sum(&z[parent], &shift[k].force_to_parent(&z[k]));
        }
    }
}
