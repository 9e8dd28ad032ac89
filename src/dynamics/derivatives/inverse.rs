//! Derivatives of inverse dynamics.

use super::{DerivativeScratch, columns, outward};
use crate::dynamics::forces::Motion;
use crate::dynamics::mass_matrix::composite_inertias_tip_to_base;
use crate::filter::innovations;
use crate::model::Model;
use crate::scalar::Real;
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// Where the derivatives of joint torques go, (nv x nv) each, row by row: a row a torque.
#[derive(Debug)]
pub struct InverseDerivatives<'a, T> {
    /// By the tangent of q.
    pub dtau_dq: &'a mut [T],
    /// By qd.
    pub dtau_dqd: &'a mut [T],
    /// M, by qdd; full and symmetric, armature on the diagonal.
    pub mass_matrix: &'a mut [T],
}

/// dtau/dq, dtau/dqd and dtau/dqdd = M of [`inverse_dynamics`](crate::dynamics::inverse_dynamics) at a state, in O(N depth).
///
/// Arguments as there. With r the composite inertia (3.5) and B that of all bodies outboard, a joint's columns are r S, r Psi2 + B Psi1 (and S x* F
/// from there on inward) and r (Psi1 + V x S) + B S; they are carried to the base, and H of each joint on the way is an entry. Entries on the other
/// side of the diagonal are S* r Psi2 + S* B Psi1 and S* r (Psi1 + V x S) + S* B S of the joint inboard. Between branches they are zero. Under a
/// [`watch`](crate::watch) that ends the work `out` means nothing.
#[allow(clippy::too_many_arguments)] // a state is three arrays and forces; scratch and results are the caller's
pub fn inverse_dynamics_derivatives<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    q: &[T],
    qd: &[T],
    qdd: &[T],
    wrenches: &[Vector6<T>],
    out: &mut InverseDerivatives<'_, T>,
) {
    at_state(model, workspace, scratch, Motion { q, qd, qdd: Some(qdd), wrenches }, out);
}

/// The same of a state in one piece.
#[inline(always)]
pub(super) fn at_state<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    state: Motion<'_, T>,
    out: &mut InverseDerivatives<'_, T>,
) {
    outward::base_to_tip(model, workspace, scratch, state);
    composite_inertias_tip_to_base(model, workspace);
    // The torques themselves are not asked for; the forces through the joints are.
    innovations::predict(&model.system, &workspace.shift, &mut workspace.z, &mut scratch.column);
    columns::tip_to_base(model, workspace, scratch, out);
}
