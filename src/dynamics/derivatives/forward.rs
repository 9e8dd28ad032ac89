//! Derivatives of forward dynamics, and the linearization about a motion. States whose error estimate exceeds the
//! tolerance are recomputed in double-double arithmetic.

use super::DerivativeScratch;
use super::inverse::inverse_dynamics_derivatives;
use crate::dynamics::forces::Motion;
use crate::dynamics::mass_inverse::closed_form;
use crate::dynamics::refined::DoubleDoubleState;
use crate::dynamics::sweeps::general;
use crate::dynamics::{factorise, forward_dynamics, solve};
use crate::filter::pivots::{LostPivot, PivotMonitor};
use crate::filter::{Form, Rows};
use crate::interrupt;
use crate::joints::vectors::{triple, write};
use crate::model::Model;
use crate::scalar::{Real, larger, largest_of};
use crate::spatial::skew;
use crate::workspace::{Made, Workspace};
use nalgebra::{Vector3, Vector6};

/// -M^-1 dtau/dq, -M^-1 dtau/dqd and M^-1: the derivatives of [`forward_dynamics`](crate::dynamics::forward_dynamics)
/// at a state, (nv x nv) each, row by row (one row per acceleration), one after another into `out`.
///
/// Arguments as in `forward_dynamics`; P is propagated in the form of the workspace. dtau/dq and dtau/dqd are those of
/// [`inverse_dynamics_derivatives`] at the accelerations of the state. M^-1 is (6.1). The columns of both are solved by
/// filter and smoother: O(N^2).
///
/// In form `auto`, a state is recomputed in double-double arithmetic and rounded if the error estimate of the factor of
/// M exceeds the tolerance, or if the estimated error of the columns exceeds the tolerance of products
/// ([`Workspace::tolerance`]). This is for f64 only, takes about 30 times longer, and allocates temporary scratch. If
/// an [`interrupt`] ends the work, `out` is undefined.
///
/// # Errors
///
/// The lost pivot furthest from the base; `out` is then undefined.
pub fn forward_dynamics_derivatives<T: Real<Parameter = T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    out: &mut [T],
) -> Result<(), LostPivot> {
    let mut acceleration = std::mem::take(&mut scratch.acceleration);
    let monitor = accelerations(model, workspace, &mut acceleration, state, wrenches);
    let lost = workspace.lost_pivot(model, &monitor);
    let is_auto = workspace.form == Form::Auto;
    let is_done =
        lost.is_some() || is_auto && monitor.of_roots && doubled((model, &mut workspace.wide), state, wrenches, out);
    let mut cancels = false;
    if !is_done {
        let (q, qd, _) = state;
        inverse_dynamics_derivatives(model, workspace, scratch, (q, qd, &acceleration), wrenches, out);
        let nv = model.nv();
        let (both, inverse) = out.split_at_mut(2 * nv * nv);
        closed_form(model, workspace, &mut scratch.inverse, inverse);
        let (by_q, by_qd) = both.split_at_mut(nv * nv);
        for matrix in [by_q, by_qd] {
            cancels |= columns(model, workspace, scratch, inverse, matrix);
        }
    }
    scratch.acceleration = acceleration;
    if let Some(lost) = lost {
        return Err(lost);
    }
    if is_auto && cancels {
        // If there is no wider model, the result is kept.
        doubled((model, &mut workspace.wide), state, wrenches, out);
    }
    Ok(())
}

/// Computes the accelerations of a state, and the factor of M in the workspace for the columns.
///
/// In form `auto`, test vectors estimate the error of the factor, because many columns follow: an estimate for the
/// torques alone would accept more factors.
pub(super) fn accelerations<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    acceleration: &mut [T],
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
) -> PivotMonitor<T> {
    if workspace.form != Form::Auto {
        return forward_dynamics(model, workspace, q, qd, tau, wrenches, acceleration);
    }
    let monitor = factorise(model, workspace, q);
    let (scene, store) = workspace.passes(model);
    general::forces::<T, false>(scene, store, Motion { q, qd, qdd: None, wrenches });
    general::solve::<T, true>(scene, store, tau, acceleration);
    monitor
}

/// -M^-1 times a matrix, in place, column by column through filter and smoother. Returns true if precision is lost. It
/// stops at an interruption; the next check raises the error.
fn columns<T: Real<Parameter = T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    inverse: &[T],
    matrix: &mut [T],
) -> bool {
    let nv = model.nv();
    let DerivativeScratch { column: right, solved, largest, .. } = scratch;
    for (row, largest) in largest.iter_mut().enumerate() {
        *largest = largest_of(&inverse[row * nv..(row + 1) * nv], T::zero());
    }
    let mut most_terms = T::zero();
    for column in 0..nv {
        if interrupt::check_at(column + 1, super::AT_A_TIME).is_err() {
            return false;
        }
        let mut terms = T::zero();
        for (row, (right, &largest)) in right.iter_mut().zip(largest.iter()).enumerate() {
            *right = -matrix[row * nv + column];
            terms = right.abs().mul_add(largest, terms);
        }
        most_terms = larger(most_terms, terms);
        solve(model, workspace, right, solved);
        for (row, &entry) in solved.iter().enumerate() {
            matrix[row * nv + column] = entry;
        }
    }
    let size = largest_of(matrix, T::zero());
    let accepted = workspace.accepted_error().of_products();
    !(most_terms.lane(0) * T::epsilon().lane(0) <= size.lane(0) * accepted)
}

/// The derivatives of forward dynamics in double-double arithmetic, see [`DoubleDoubleState::recompute`].
fn doubled<T: Real>(
    model: (&Model<T>, &mut Made),
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    out: &mut [T],
) -> bool {
    DoubleDoubleState::recompute(model, state, wrenches, out, |wide, out| {
        let DoubleDoubleState { model, workspace, q, qd, tau, wrenches } = wide;
        let scratch = &mut DerivativeScratch::new(model);
        forward_dynamics_derivatives(model, workspace, scratch, (q, qd, tau), wrenches, out).is_ok()
    })
}

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
