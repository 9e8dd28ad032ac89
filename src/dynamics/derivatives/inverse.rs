//! Derivatives of inverse dynamics.

use super::columns::{self, DerivativeColumns};
use super::{DerivativeScratch, Kept, Matrices, outward};
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::SweepModel;
use crate::dynamics::sweeps::motion::carriers;
use crate::dynamics::sweeps::scratch::SweepScratch;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// dtau/dq, dtau/dqd and dtau/dqdd = M of [`inverse_dynamics`](crate::dynamics::inverse_dynamics) at a state, (nv x nv)
/// each, row by row, one after another into `out`. O(N depth).
///
/// Arguments as in `inverse_dynamics`. With the composite inertia r (3.5) and the sum B over all bodies outboard, the
/// columns of a joint are r S, r Psi2 + B Psi1 (plus S x* F further inward) and r (Psi1 + V x S) + B S. They are
/// propagated to the base, and H of each joint on the path times a column is an entry. The entries on the other side of
/// the diagonal are S* r Psi2 + S* B Psi1 and S* r (Psi1 + V x S) + S* B S, with Psi1, Psi2 and the right S of the
/// joint inboard. Entries between branches are zero.
pub fn inverse_dynamics_derivatives<T: Real<Parameter = T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    (q, qd, qdd): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    out: &mut [T],
) {
    general(model, workspace, scratch, (Motion { q, qd, qdd: Some(qdd), wrenches }, Matrices::Derivatives), out);
}

/// All three matrices in any scalar of one lane, compiled once for its two callers.
#[inline(never)]
fn general<T: Real<Parameter = T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    (state, matrices): (Motion<'_, T>, Matrices),
    out: &mut [T],
) {
    let DerivativeScratch { kept, columns, .. } = scratch;
    let (scene, store) = workspace.passes(model);
    columns.prepare(model, scene.1);
    in_sweeps(scene, (store, kept, columns), state, matrices, out);
}

/// The Coriolis matrix C(q, qd), (nv x nv) row by row, in O(N depth). C qd is the velocity-dependent torque.
/// dM/dt = C + C^T, so that dM/dt - 2 C is antisymmetric. For joints with one axis it is the matrix of the Christoffel
/// symbols.
///
/// It consists of the columns of [`inverse_dynamics_derivatives`] by qd, with B/2 for B and V x S for Psi1 + V x S.
pub fn coriolis_matrix<T: Real<Parameter = T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    q: &[T],
    qd: &[T],
    out: &mut [T],
) {
    let mut three = vec![T::zero(); 3 * out.len()];
    general(model, workspace, scratch, (Motion { q, qd, qdd: None, wrenches: &[] }, Matrices::Coriolis), &mut three);
    out.copy_from_slice(&three[out.len()..2 * out.len()]);
}

/// dM/dt = C + C^T along qd, (nv x nv) row by row, with C as in [`coriolis_matrix`]. Armature is constant and does not
/// appear.
pub fn mass_matrix_derivative<T: Real<Parameter = T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    q: &[T],
    qd: &[T],
    out: &mut [T],
) {
    coriolis_matrix(model, workspace, scratch, q, qd, out);
    with_transpose(model.nv(), out, |a, b| a + b);
}

/// Replaces C by C + C^T.
pub(crate) fn with_transpose<N: Copy>(nv: usize, matrix: &mut [N], sum: impl Fn(N, N) -> N) {
    for i in 0..nv {
        for j in 0..=i {
            let both = sum(matrix[i * nv + j], matrix[j * nv + i]);
            (matrix[i * nv + j], matrix[j * nv + i]) = (both, both);
        }
    }
}

/// The three matrices for states in lanes and for one state, after the columns were
/// [prepared](DerivativeColumns::prepare), in the layout of the columns. Without `qdd` those of the bias.
#[inline(always)]
pub(crate) fn in_sweeps<T: Real, C: ColumnsOf<T>>(
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, kept, columns): (&mut SweepScratch<T>, &mut Kept<T>, &mut DerivativeColumns<T, C>),
    state: Motion<'_, T>,
    matrices: Matrices,
    out: &mut [C::Entry],
) {
    carriers(scene.1, scratch, columns.like(), state.q);
    outward::base_to_tip(scene, scratch, kept, state, matrices);
    columns::tip_to_base(scene, scratch, kept, columns, out);
}
