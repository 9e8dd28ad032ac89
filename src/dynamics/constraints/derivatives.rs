//! Derivatives of forward dynamics through connections, by the implicit function theorem.
//!
//! M qdd + bias = tau + J* lambda and J qdd + gamma = 0. Changes of q, qd and tau therefore satisfy
//!
//! ```text
//! M dqdd - J* dlambda = dtau - (dID/dq - J* dw/dq) dq - dID/dqd dqd
//! J dqdd              = -d(J qdd + gamma)/dq dq - dgamma/dqd dqd
//! dqdd = Mc (right side of the first) - N (change of the rows),    Mc = M^-1 - N J M^-1,  N = M^-1 J* G^+
//! ```
//!
//! ID is inverse dynamics with the forces w of the connections fixed on their bodies.
//!
//! The changes of the rows and of their forces are computed with dual numbers on the bodies between the two frames and
//! the base.

use super::NoDirection;
use super::inverse::constrained_mass_matrix_inverse;
use super::rows::pair_at;
use super::scratch::ConstraintScratch;
use crate::dynamics::derivatives::{DerivativeScratch, inverse_dynamics_derivatives};
use crate::kinematics::coordinate_rates;
use crate::kinematics::propagation::tip_to_base;
use crate::model::Model;
use crate::scalar::Dual;
use crate::scene::constraint::{Constraint, Constraints, Tie};
use crate::spatial::{RigidShift, dot, scaled_add, sum, zero};
use crate::workspace::Workspace;
use nalgebra::{DMatrix, Vector6};

/// Changes of the rows, (m x nv) each.
struct RowChanges {
    by_q: DMatrix<f64>,
    by_qd: DMatrix<f64>,
}

/// q, qd and qdd with tangents.
type DualState<'a> = (&'a [Dual<f64>], &'a [Dual<f64>], &'a [Dual<f64>]);

/// Forces on bodies, by index.
type Forces = [Option<(usize, Vector6<f64>)>; 2];

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
) -> Result<(), NoDirection> {
    let (nv, m) = (model.nv(), constraints.rows);
    let square = nv * nv;
    let forces = scratch.forces.clone();
    scratch.spread(&forces);
    let mut acting = scratch.wrenches.clone();
    for (sum, own) in acting.iter_mut().zip(wrenches) {
        *sum += own;
    }
    let mut of_tree = DerivativeScratch::new(model);
    inverse_dynamics_derivatives(model, workspace, &mut of_tree, (q, qd, qdd), &acting, out);
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
        scratch.spread(&step);
        scratch.respond(model, workspace);
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

/// The derivatives of every row by q and qd, and dID/dq minus the change of the connection forces that rotate with
/// their frames.
fn changes(
    (model, constraints): (&Model<f64>, &Constraints),
    shift: &[RigidShift<f64>],
    (q, qd, qdd): (&[f64], &[f64], &[f64]),
    forces: &[f64],
    by_q: &mut DMatrix<f64>,
) -> Result<RowChanges, NoDirection> {
    let (nv, m) = (model.nv(), constraints.rows);
    let mut changes = RowChanges { by_q: DMatrix::zeros(m, nv), by_qd: DMatrix::zeros(m, nv) };
    let dual: Model<Dual<f64>> = model.cast();
    let constants = |x: &[f64]| -> Vec<Dual<f64>> { x.iter().map(|&x| Dual::constant_of(x)).collect() };
    let (mut q_along, mut qd_along, qdd) = (constants(q), constants(qd), constants(qdd));
    let (mut tangent, mut rates) = (vec![0.0; nv], vec![0.0; q.len()]);
    let mut state = vec![zero(); model.bodies.len()];
    for (index, constraint) in constraints.all.iter().enumerate() {
        if matches!(constraint.tie, Tie::Coordinates { .. }) {
            continue;
        }
        let on_path = constraint.branches.iter().flat_map(|&k| {
            let stage = &model.system.stages[k];
            stage.first_row..stage.first_row + stage.rows.count()
        });
        for j in on_path {
            tangent[j] = 1.0;
            coordinate_rates(model, q, &tangent, &mut rates);
            tangent[j] = 0.0;
            for (along, &rate) in q_along.iter_mut().zip(&rates) {
                along.tangent = rate;
            }
            let (accelerations, turned) =
                along((&dual, constraint, index), (&q_along, &qd_along, &qdd), &forces[constraint.rows()])?;
            for along in &mut q_along {
                along.tangent = 0.0;
            }
            let torques = felt(model, shift, constraint, turned, &mut state);
            for (row, torque) in torques {
                by_q[(row, j)] -= torque;
            }
            qd_along[j].tangent = 1.0;
            let (by_rate, _) =
                along((&dual, constraint, index), (&q_along, &qd_along, &qdd), &forces[constraint.rows()])?;
            qd_along[j].tangent = 0.0;
            for (i, row) in constraint.rows().enumerate() {
                changes.by_q[(row, j)] = accelerations[i];
                changes.by_qd[(row, j)] = by_rate[i];
            }
        }
    }
    Ok(changes)
}

/// The change of a connection's rows J qdd + gamma along the tangents of a state, and the change of its forces on
/// bodies, expressed in the body frames.
fn along(
    (model, constraint, index): (&Model<Dual<f64>>, &Constraint, usize),
    (q, qd, qdd): DualState<'_>,
    forces: &[f64],
) -> Result<([f64; 6], Forces), NoDirection> {
    let mut accelerations = [0.0; 6];
    let Tie::Frames { frames: [c, d], .. } = &constraint.tie else { return Ok((accelerations, [None; 2])) };
    let Some((motion, rows)) = pair_at(model, (index, constraint), (q, qd), Some(qdd))? else {
        return Ok((accelerations, [None; 2]));
    };
    let mut force = zero();
    for (i, row) in rows.of_motion.iter().take(rows.count).enumerate() {
        accelerations[i] = (dot(row, &motion.acceleration) + rows.turning[i]).tangent;
        force = scaled_add(row, Dual::constant_of(forces[i]), &force);
    }
    let back = motion.place.force_to_parent(&force);
    let change = |force: &Vector6<Dual<f64>>| Vector6::from_fn(|i, _| force[i].tangent);
    let on = |body: Option<usize>, placement: &RigidShift<f64>, force: Vector6<f64>| {
        body.map(|k| (k, placement.force_to_parent(&force)))
    };
    Ok((accelerations, [on(c.body, &c.placement, change(&force)), on(d.body, &d.placement, -change(&back))]))
}

/// J* of forces on the bodies of a connection's path: the torque of each joint.
fn felt(
    model: &Model<f64>,
    shift: &[RigidShift<f64>],
    constraint: &Constraint,
    forces: Forces,
    state: &mut [Vector6<f64>],
) -> Vec<(usize, f64)> {
    for &k in &constraint.path {
        state[k] = zero();
    }
    for (k, force) in forces.into_iter().flatten() {
        state[k] = sum(&state[k], &force);
    }
    let mut torques = Vec::new();
    tip_to_base(&model.system.stages, shift, constraint.path.iter().copied(), state, |k, z| {
        let stage = &model.system.stages[k];
        torques.extend((0..stage.rows.count()).map(|i| (stage.first_row + i, stage.rows.row(i).project(z))));
    });
    torques
}
