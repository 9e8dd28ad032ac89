//! Hessians of forward dynamics through connections times a direction, in O(N + m^2 depth + m^3).
//!
//! The gradients of c* qdd are those of -y* ID(q, qd, qdd) + p* J y - r* (J qdd + J' qd), where p are the forces of the
//! rows, and y and r solve the adjoint system of c ([`adjoint`](super::adjoint)). Their derivative along (dq, dqd,
//! dtau) is one evaluation in dual numbers, with the changes of qdd and p along that direction, and with those of y and
//! r:
//!
//! ```text
//! M dy + J* dr = -dM y - dJ* r,    J dy = -dJ y
//! ```

use super::RowFault;
use super::adjoint::ConstraintAdjoint;
use super::products::RowGradients;
use super::scratch::ConstraintScratch;
use crate::dynamics::derivatives::{Directions, HessianScratch, join};
use crate::dynamics::forces::Motion;
use crate::model::Model;
use crate::scalar::Dual;
use crate::scene::constraint::Constraints;
use crate::workspace::Workspace;

/// The derivative of the gradients of [`ConstraintAdjoint::of_dynamics`] along (dq, dqd, dtau), (3 x nv) into `out`, at
/// a state of [`constrained_dynamics`](super::constrained_dynamics) with rigid connections and the forces in the
/// scratch.
pub(crate) fn constrained_hvp(
    system: (&Model<f64>, &Constraints),
    (workspace, scratch): (&mut Workspace<f64>, &mut ConstraintScratch),
    (adjoint, hessian): (&mut ConstraintAdjoint, &mut HessianScratch),
    motion: Motion<'_, f64>,
    (cotangent, [dq, dqd, dtau]): (&[f64], [&[f64]; 3]),
    out: &mut [f64],
) -> Result<(), RowFault> {
    let (Motion { q, qd, qdd, wrenches }, nv) = (motion, cotangent.len());
    let along = Directions { q: dq, qd: dqd, u: dtau, ..Directions::default() };
    let mut qdd_change = vec![0.0; nv];
    let state = (q, qd, qdd.unwrap_or_default());
    adjoint.along_dynamics(system, (workspace, scratch), state, (wrenches, &along), &mut qdd_change)?;
    let forces = joined(&scratch.forces, adjoint.r.iter().map(|r| -r));
    let ([x, r], [x_change, r_change]) = adjoint.along_adjoint(system, (workspace, scratch), (q, dq), cotangent)?;
    let minus = |x: &[f64]| -> Vec<f64> { x.iter().map(|x| -x).collect() };
    let found = hessian.along(system.0, motion, [dq, dqd, &qdd_change], [&minus(&x), &minus(&x_change)]);
    let (by_state, y) = (&mut found.out[..2 * nv], joined(&x, x_change.iter().copied()));
    let (by_q, by_qd) = by_state.split_at_mut(nv);
    let rows = &mut RowGradients::new((found.model, system.1));
    rows.add_row_gradient(found.shifts, (found.q, &y), &forces, by_q)?;
    let negative = joined(&minus(&r), r_change.iter().map(|r| -r));
    rows.add_acceleration_gradient(found.shifts, (found.q, found.qd, found.qdd), &negative, [by_q, by_qd])?;
    for (to, from) in out.iter_mut().zip(by_state) {
        *to = from.tangent;
    }
    out[2 * nv..].copy_from_slice(&x_change);
    Ok(())
}

/// Values with their changes.
fn joined(values: &[f64], changes: impl Iterator<Item = f64>) -> Vec<Dual<f64>> {
    let changes: Vec<f64> = changes.collect();
    let mut all = vec![Dual::constant_of(f64::NAN); values.len()];
    join(&mut all, values, &changes);
    all
}
