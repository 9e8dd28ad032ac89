//! Derivatives of forward dynamics through connections, by the implicit function theorem.
//!
//! M qdd + bias = tau + J* lambda and J qdd + gamma = 0. Changes of q, qd and tau therefore satisfy
//!
//! ```text
//! M dqdd - J* dlambda = dtau - (dID/dq - d(J* lambda)/dq) dq - dID/dqd dqd
//! J dqdd              = -d(J qdd + gamma)/dq dq - dgamma/dqd dqd
//! dqdd = Mc (right side of the first) - N (change of the rows),    Mc = M^-1 - N J M^-1,  N = M^-1 J* G^+
//! ```
//!
//! ID is inverse dynamics without the forces of the connections. The changes of the rows and of their forces are
//! [`RowMatrices`].

use super::RowFault;
use super::inverse::constrained_mass_matrix_inverse;
use super::row_matrices::RowMatrices;
use super::scratch::ConstraintScratch;
use crate::dynamics::derivatives::{DerivativeScratch, inverse_dynamics_derivatives};
use crate::model::Model;
use crate::scene::constraint::Constraints;
use crate::workspace::Workspace;
use nalgebra::{DMatrix, Vector6};

/// dqdd/dq, dqdd/dqd and dqdd/dtau at the last state that [`constrained_dynamics`](super::constrained_dynamics)
/// computed with this scratch, into `out`, (3 x nv x nv). `qdd` are the accelerations of that state. dqdd/dtau is the
/// inverse mass matrix through the connections. O(nv^3 + m nv depth).
pub(crate) fn constrained_derivatives(
    (model, constraints): (&Model<f64>, &Constraints),
    workspace: &mut Workspace<f64>,
    scratch: &mut ConstraintScratch,
    (q, qd, qdd): (&[f64], &[f64], &[f64]),
    wrenches: &[Vector6<f64>],
    out: &mut [f64],
) -> Result<(), RowFault> {
    let (nv, m) = (model.nv(), constraints.rows);
    let square = nv * nv;
    let mut of_tree = DerivativeScratch::new(model);
    inverse_dynamics_derivatives(model, workspace, &mut of_tree, (q, qd, qdd), wrenches, out);
    let mut rows = RowMatrices::new((model, constraints));
    rows.compute(model, &workspace.store.shifts, (q, qd, qdd), &scratch.forces)?;
    rows.subtract_forces::<f64>(&mut out[..square]);

    let by = |matrix: &[f64]| DMatrix::from_row_slice(nv, nv, matrix);
    let (by_q, by_qd) = (by(&out[..square]), by(&out[square..2 * square]));
    let (forces, inverse) = (scratch.forces.clone(), &mut out[2 * square..]);
    constrained_mass_matrix_inverse((model, constraints), workspace, scratch, q, inverse)?;
    let through = by(inverse);
    let mut response = DMatrix::zeros(nv, m);
    let (mut unit, mut step) = (vec![0.0; m], vec![0.0; m]);
    for i in 0..m {
        unit[i] = 1.0;
        scratch.inverse.apply(&unit, &mut step);
        unit[i] = 0.0;
        scratch.respond(model, workspace, &step);
        response.column_mut(i).copy_from_slice(&scratch.estimates);
    }
    let changes = |matrix: &[f64]| &response * DMatrix::from_row_slice(m, nv, matrix);
    let of_q = -(&through * by_q) - changes(&rows.by_q);
    let of_qd = -(&through * by_qd) - changes(&rows.by_qd);
    for (matrix, out) in [&of_q, &of_qd].into_iter().zip(out.chunks_exact_mut(square.max(1))) {
        // Column by column in memory.
        out.copy_from_slice(matrix.transpose().as_slice());
    }
    scratch.forces = forces;
    Ok(())
}
