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
//! ID is inverse dynamics without the forces of the connections.
//!
//! The changes of the rows and of their forces are gradients of single rows ([`products`](super::products)).

use super::RowFault;
use super::inverse::constrained_mass_matrix_inverse;
use super::products::RowGradients;
use super::scratch::ConstraintScratch;
use crate::dynamics::derivatives::{DerivativeScratch, inverse_dynamics_derivatives};
use crate::model::Model;
use crate::scene::constraint::Constraints;
use crate::spatial::RigidShift;
use crate::workspace::Workspace;
use nalgebra::{DMatrix, Vector6};

/// Changes of the rows, (m x nv) each.
struct RowChanges {
    by_q: DMatrix<f64>,
    by_qd: DMatrix<f64>,
}

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
    let forces = scratch.forces.clone();
    let mut of_tree = DerivativeScratch::new(model);
    inverse_dynamics_derivatives(model, workspace, &mut of_tree, (q, qd, qdd), wrenches, out);
    // Row by row in `out`.
    let by = |matrix: &[f64]| DMatrix::from_row_slice(nv, nv, matrix);
    let (mut by_q, by_qd) = (by(&out[..square]), by(&out[square..2 * square]));
    let rows = changes((model, constraints), &workspace.store.shifts, (q, qd, qdd), &forces, &mut by_q)?;

    let mut inverse = vec![0.0; square];
    constrained_mass_matrix_inverse((model, constraints), workspace, scratch, q, &mut inverse)?;
    let mut response = DMatrix::zeros(nv, m);
    let (mut unit, mut step) = (vec![0.0; m], vec![0.0; m]);
    for i in 0..m {
        unit[i] = 1.0;
        scratch.inverse.apply(&unit, &mut step);
        unit[i] = 0.0;
        scratch.respond(model, workspace, &step);
        response.column_mut(i).copy_from_slice(&scratch.estimates);
    }
    let through = by(&inverse);
    let of_q = -(&through * by_q) - &response * rows.by_q;
    let of_qd = -(&through * by_qd) - &response * rows.by_qd;
    for (matrix, out) in [&of_q, &of_qd].into_iter().zip(out.chunks_exact_mut(square.max(1))) {
        // Column by column in memory.
        out.copy_from_slice(matrix.transpose().as_slice());
    }
    out[2 * square..].copy_from_slice(&inverse);
    scratch.forces = forces;
    Ok(())
}

/// The derivatives of every row by q and qd, and dID/dq minus the change of J* lambda.
fn changes(
    system: (&Model<f64>, &Constraints),
    shifts: &[RigidShift<f64>],
    (q, qd, qdd): (&[f64], &[f64], &[f64]),
    forces: &[f64],
    by_q: &mut DMatrix<f64>,
) -> Result<RowChanges, RowFault> {
    let (nv, m) = (system.0.nv(), system.1.rows);
    let mut changes = RowChanges { by_q: DMatrix::zeros(m, nv), by_qd: DMatrix::zeros(m, nv) };
    let mut gradients = RowGradients::new(system);
    let mut unit = vec![0.0; m.max(nv)];
    for i in 0..m {
        let (mut of_q, mut of_qd) = (vec![0.0; nv], vec![0.0; nv]);
        unit[i] = 1.0;
        let of = [&mut of_q[..], &mut of_qd];
        gradients.add_acceleration_gradient(system, shifts, (q, qd, qdd), &unit[..m], of)?;
        unit[i] = 0.0;
        changes.by_q.row_mut(i).copy_from_slice(&of_q);
        changes.by_qd.row_mut(i).copy_from_slice(&of_qd);
    }
    for constraint in &system.1.all {
        let mut own = vec![0.0; m];
        own[constraint.rows()].copy_from_slice(&forces[constraint.rows()]);
        for row in constraint.columns(system.0) {
            let mut change = vec![0.0; nv];
            unit[row] = 1.0;
            gradients.add_row_gradient(system, shifts, (q, &unit[..nv]), &own, &mut change)?;
            unit[row] = 0.0;
            for (entry, change) in by_q.row_mut(row).iter_mut().zip(&change) {
                *entry -= change;
            }
        }
    }
    Ok(changes)
}
