//! Derivatives of forward dynamics, by M^-1 times those of inverse dynamics.

use super::inverse::{InverseDerivatives, at_state};
use super::{DerivativeScratch, doubled};
use crate::dynamics::forces::Motion;
use crate::dynamics::mass_inverse::closed_form;
use crate::dynamics::{factorise, forward_dynamics};
use crate::filter::Form;
use crate::filter::pivots::LostPivot;
use crate::model::Model;
use crate::scalar::Real;
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// Where the derivatives of joint accelerations go, (nv x nv) each, row by row: a row an acceleration.
#[derive(Debug)]
pub struct ForwardDerivatives<'a, T> {
    /// By the tangent of q.
    pub dqdd_dq: &'a mut [T],
    /// By qd.
    pub dqdd_dqd: &'a mut [T],
    /// M^-1, by tau; full and symmetric.
    pub mass_matrix_inverse: &'a mut [T],
}

/// -M^-1 dtau/dq, -M^-1 dtau/dqd and M^-1: the derivatives of [`forward_dynamics`](crate::dynamics::forward_dynamics) at a state.
///
/// Arguments as there; P is carried as the workspace's form says. dtau/dq and dtau/dqd are those of
/// [`inverse_dynamics_derivatives`](super::inverse_dynamics_derivatives) at the accelerations of the state; M^-1 is (6.1). Of the products only entries
/// of joints on one way to the base are formed: O(N^2 depth), and O(N depth) what goes before. In form `auto` a state that loses digits in covariance
/// form, be it in the accelerations or in the factor of M, is done in double-double arithmetic and rounded: f64 only, some thirty times as long, with
/// scratch for as long as it lasts.
///
/// # Errors
///
/// The lost pivot furthest from the base, where one was lost; then `out` means nothing.
#[allow(clippy::too_many_arguments)] // a state is three arrays and forces; scratch and results are the caller's
pub fn forward_dynamics_derivatives<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    q: &[T],
    qd: &[T],
    tau: &[T],
    wrenches: &[Vector6<T>],
    out: &mut ForwardDerivatives<'_, T>,
) -> Result<(), LostPivot> {
    let mut acceleration = std::mem::take(&mut scratch.acceleration);
    let found = forward_dynamics(model, workspace, q, qd, tau, wrenches, &mut acceleration);
    scratch.acceleration = acceleration;
    if let Some(lost) = workspace.lost_pivot(model, &found) {
        return Err(lost);
    }
    if workspace.form == Form::Auto {
        // The accelerations were watched for these torques; columns are other right sides.
        let factor = factorise(model, workspace, q, |_, _| {});
        if let Some(lost) = workspace.lost_pivot(model, &factor) {
            return Err(lost);
        }
        if (found.of_roots || factor.of_roots) && doubled::derivatives(model, (q, qd, tau), wrenches, out) {
            return Ok(());
        }
    }
    at_accelerations(model, workspace, scratch, (q, qd), wrenches, out);
    Ok(())
}

/// The same with the accelerations in the scratch and the factor of M in the workspace.
fn at_accelerations<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    (q, qd): (&[T], &[T]),
    wrenches: &[Vector6<T>],
    out: &mut ForwardDerivatives<'_, T>,
) {
    let acceleration = std::mem::take(&mut scratch.acceleration);
    let state = Motion { q, qd, qdd: Some(&acceleration), wrenches };
    // M is not asked for; its place is that of its inverse.
    let mut of_torques = InverseDerivatives {
        dtau_dq: &mut *out.dqdd_dq,
        dtau_dqd: &mut *out.dqdd_dqd,
        mass_matrix: &mut *out.mass_matrix_inverse,
    };
    at_state(model, workspace, scratch, state, &mut of_torques);
    scratch.acceleration = acceleration;
    closed_form(model, workspace, &mut scratch.inverse, out.mass_matrix_inverse);
    minus_inverse_times(model, scratch, out.mass_matrix_inverse, out.dqdd_dq);
    minus_inverse_times(model, scratch, out.mass_matrix_inverse, out.dqdd_dqd);
}

/// -M^-1 times a matrix, in its place; its entries between branches are zero, and left out.
#[inline(always)]
fn minus_inverse_times<T: Real>(model: &Model<T>, scratch: &mut DerivativeScratch<T>, inverse: &[T], matrix: &mut [T]) {
    let (nv, stages) = (model.nv(), &model.system.stages);
    let DerivativeScratch { column: sum, last, .. } = scratch;
    for (k, stage) in stages.iter().enumerate() {
        for column in stage.first_row..stage.first_row + stage.rows.count() {
            sum.fill(T::zero());
            let end = &stages[last[k]];
            for row in stage.first_row..end.first_row + end.rows.count() {
                subtract_row(sum, matrix[row * nv + column], inverse, row);
            }
            let mut inboard = stage.parent;
            while let Some(parent) = inboard {
                let stage = &stages[parent];
                for row in stage.first_row..stage.first_row + stage.rows.count() {
                    subtract_row(sum, matrix[row * nv + column], inverse, row);
                }
                inboard = stage.parent;
            }
            for (row, &entry) in sum.iter().enumerate() {
                matrix[row * nv + column] = entry;
            }
        }
    }
}

/// sum - entry times a row of a matrix.
#[inline(always)]
fn subtract_row<T: Real>(sum: &mut [T], entry: T, matrix: &[T], row: usize) {
    let nv = sum.len();
    for (sum, &x) in sum.iter_mut().zip(&matrix[row * nv..(row + 1) * nv]) {
        *sum = sum.minus_product(entry, x);
    }
}
