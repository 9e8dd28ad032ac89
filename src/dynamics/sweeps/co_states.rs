//! Base to tip: the covariance of the co-states, Lambda (5.6, 5.7).

use crate::filter::System;
use crate::filter::covariance::row_update;
use crate::filter::riccati::Measured;
use crate::scalar::Real;
use crate::spatial::{RigidShift, Symmetric6};
use nalgebra::Vector6;

/// Lambda^- of every body into `lambda`, from phi of every body, and D and g of every row, of the factor of M. `seen`
/// is called with the body and the index of each row, base to tip, its Lambda^+ and Lambda^+ g. About 150 operations
/// per joint with one axis.
#[inline(always)]
pub fn co_state_covariances<T: Real>(
    system: &System<T>,
    (shifts, measured): (&[RigidShift<T>], &[Measured<T>]),
    lambda: &mut [Symmetric6<T>],
    mut seen: impl FnMut((usize, usize), &Symmetric6<T>, &Vector6<T>),
) {
    for (k, stage) in system.stages.iter().enumerate() {
        // 5.7, from Lambda^+ = 0 at the root.
        let mut here = match stage.parent {
            Some(parent) => shifts[k].co_covariance_to_child(&lambda[parent]),
            None => Symmetric6::zero(),
        };
        for i in 0..stage.rows.count() {
            let row = stage.first_row + i;
            let (next, spread_gain) = row_update(&here, &stage.rows.row(i), &measured[row]);
            seen((k, row), &here, &spread_gain);
            here = next;
        }
        lambda[k] = here;
    }
}
