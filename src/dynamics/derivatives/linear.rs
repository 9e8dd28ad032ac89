//! The linear system of small deviations from a motion.

use super::{DerivativeScratch, ForwardDerivatives, forward_dynamics_derivatives};
use crate::filter::Rows;
use crate::filter::pivots::LostPivot;
use crate::joints::vectors::{triple, write};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::skew;
use crate::workspace::Workspace;
use nalgebra::{Vector3, Vector6};

/// A (2nv x 2nv) and B (2nv x nv) of dx/dt = A x + B u, both row by row: x = (d, change of qd) is a small deviation q (+) d from the motion that goes
/// through the state under `tau`, and u a change of torques.
///
/// `A = [[-ad(qd), 1], [dqdd/dq, dqdd/dqd]]`, `B = [[0], [M^-1]]`, with [`forward_dynamics_derivatives`]. ad(v) is the bracket within a joint: the cross
/// product w x of a spherical joint, (w~, v~; 0, w~) of a free one, linear first; zero for joints of one axis, and at rest.
///
/// # Errors
///
/// As [`forward_dynamics_derivatives`].
#[allow(clippy::too_many_arguments)] // a state is three arrays and forces; scratch and results are the caller's
pub fn linearize<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    q: &[T],
    qd: &[T],
    tau: &[T],
    wrenches: &[Vector6<T>],
    (a, b): (&mut [T], &mut [T]),
) -> Result<(), LostPivot> {
    let nv = model.nv();
    let (upper, lower) = a.split_at_mut(2 * nv * nv);
    let (top, mass_matrix_inverse) = b.split_at_mut(nv * nv);
    // One after another in the upper half, which is written last.
    let (dqdd_dq, dqdd_dqd) = upper.split_at_mut(nv * nv);
    let mut out = ForwardDerivatives { dqdd_dq, dqdd_dqd, mass_matrix_inverse };
    forward_dynamics_derivatives(model, workspace, scratch, q, qd, tau, wrenches, &mut out)?;
    for row in 0..nv {
        let to = &mut lower[2 * nv * row..2 * nv * (row + 1)];
        to[..nv].copy_from_slice(&dqdd_dq[row * nv..(row + 1) * nv]);
        to[nv..].copy_from_slice(&dqdd_dqd[row * nv..(row + 1) * nv]);
    }
    top.fill(T::zero());
    upper.fill(T::zero());
    for row in 0..nv {
        upper[row * 2 * nv + nv + row] = T::one();
    }
    for stage in &model.system.stages {
        let first = stage.first_row;
        match stage.rows {
            Rows::Angular => put_minus_cross(upper, 2 * nv, (first, first), &triple(&qd[first..])),
            Rows::Six => {
                let (v, w) = (triple(&qd[first..]), triple(&qd[first + 3..]));
                put_minus_cross(upper, 2 * nv, (first, first), &w);
                put_minus_cross(upper, 2 * nv, (first, first + 3), &v);
                put_minus_cross(upper, 2 * nv, (first + 3, first + 3), &w);
            }
            Rows::One(_) | Rows::None => {}
        }
    }
    Ok(())
}

/// Writes -w~ at a place of a matrix, `width` numbers a row.
fn put_minus_cross<T: Real>(matrix: &mut [T], width: usize, (row, column): (usize, usize), w: &Vector3<T>) {
    let cross = skew(w);
    for i in 0..3 {
        // The transpose of an antisymmetric matrix.
        let line = cross.column(i);
        write(&mut matrix[(row + i) * width + column..], &Vector3::new(line[0], line[1], line[2]));
    }
}
