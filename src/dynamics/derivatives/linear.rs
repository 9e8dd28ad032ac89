//! The linearization of the dynamics about a motion.

use crate::filter::Rows;
use crate::joints::vectors::{triple, write};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::skew;
use nalgebra::Vector3;

/// A (2nv x 2nv) and B (2nv x nv) of dx/dt = A x + B u, both row by row: x = (d, change of qd) is a small deviation q
/// (+) d from the motion through the state under `tau`, and u a change of the torques.
///
/// `A = [[-ad(qd), 1], [dqdd/dq, dqdd/dqd]]`, `B = [[0], [M^-1]]`, from the `derivatives` of
/// [`forward_dynamics_derivatives`](super::forward_dynamics_derivatives). ad(v) is the Lie bracket of the joint: the
/// cross product w x for a spherical joint, (w~, v~; 0, w~) for a free joint, linear part first. It is zero for joints
/// with one axis, and at rest.
pub(crate) fn linear_system<T: Real>(model: &Model<T>, qd: &[T], derivatives: &[T], (a, b): (&mut [T], &mut [T])) {
    let nv = model.nv();
    let (by_q, rest) = derivatives.split_at(nv * nv);
    let (by_qd, mass_matrix_inverse) = rest.split_at(nv * nv);
    let (upper, lower) = a.split_at_mut(2 * nv * nv);
    for row in 0..nv {
        let to = &mut lower[2 * nv * row..2 * nv * (row + 1)];
        to[..nv].copy_from_slice(&by_q[row * nv..(row + 1) * nv]);
        to[nv..].copy_from_slice(&by_qd[row * nv..(row + 1) * nv]);
    }
    let (top, bottom) = b.split_at_mut(nv * nv);
    top.fill(T::zero());
    bottom.copy_from_slice(mass_matrix_inverse);
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
}

/// Writes -w~ into a matrix with `width` scalars per row.
fn put_minus_cross<T: Real>(matrix: &mut [T], width: usize, (row, column): (usize, usize), w: &Vector3<T>) {
    let cross = skew(w);
    for i in 0..3 {
        // The transpose of an antisymmetric matrix.
        let line = cross.column(i);
        write(&mut matrix[(row + i) * width + column..], &Vector3::new(line[0], line[1], line[2]));
    }
}
