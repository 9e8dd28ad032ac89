//! Derivatives of forward dynamics, by M^-1 times those of inverse dynamics.

use super::inverse::{InverseDerivatives, at_state};
use super::{AT_A_TIME, DerivativeScratch, doubled};
use crate::dynamics::forces::Motion;
use crate::dynamics::inverse::forces_base_to_tip;
use crate::dynamics::mass_inverse::closed_form;
use crate::dynamics::{factorise, forward_dynamics, solve};
use crate::filter::pivots::{LostPivot, PivotMonitor};
use crate::filter::{Form, innovations, smoother};
use crate::model::Model;
use crate::scalar::{Real, larger};
use crate::watch;
use crate::workspace::Workspace;
use nalgebra::Vector6;
use std::ops::Range;

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

/// Where the largest entry of dqdd/dq or dqdd/dqd may be off by more than this, relative to itself, form `auto` takes twice the digits.
///
/// The estimate is eps times the terms that the largest column is the sum of. Over 2,200 random scenes, ordinary and extreme, the error is as a rule
/// half of it, and in 99 of 100 less than seven times; robots stay far below (docs/derivatives.md).
const MOST_LOST: f64 = 1e-9;

/// -M^-1 dtau/dq, -M^-1 dtau/dqd and M^-1: the derivatives of [`forward_dynamics`](crate::dynamics::forward_dynamics) at a state.
///
/// Arguments as there; P is carried as the workspace's form says. dtau/dq and dtau/dqd are those of
/// [`inverse_dynamics_derivatives`](super::inverse_dynamics_derivatives) at the accelerations of the state; M^-1 is (6.1), and what it multiplies are
/// the entries between joints on one way to the base: O(N^2 depth). On chains of 55 and more columns go through filter and smoother instead, O(N^2).
///
/// In form `auto` a state is done in double-double arithmetic and rounded where the covariance form loses digits in the factor of M, or the products
/// cancel all but nine of theirs: f64 only, some thirty times as long, with scratch for as long as it lasts. Under a
/// [`watch`] that ends the work `out` means nothing.
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
    let state = (q, qd, tau);
    let monitor = accelerations(model, workspace, &mut scratch.acceleration, state, wrenches);
    if let Some(lost) = workspace.lost_pivot(model, &monitor) {
        return Err(lost);
    }
    let is_auto = workspace.form == Form::Auto;
    if is_auto && monitor.of_roots && doubled::derivatives(model, state, wrenches, out) {
        return Ok(());
    }
    let cancels = at_accelerations(model, workspace, scratch, (q, qd), wrenches, out);
    if is_auto && cancels {
        // Where there are not twice the digits, what there is stays.
        doubled::derivatives(model, state, wrenches, out);
    }
    Ok(())
}

/// The accelerations of a state, and the factor of M in the workspace that columns go through too.
///
/// In form `auto` the factor is judged by right sides that are made up, for the columns are many: by the torques alone more would pass.
#[inline(always)]
fn accelerations<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    acceleration: &mut [T],
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
) -> PivotMonitor<T> {
    if workspace.form != Form::Auto {
        return forward_dynamics(model, workspace, q, qd, tau, wrenches, acceleration);
    }
    let monitor = factorise(model, workspace, q, |_, _| {});
    forces_base_to_tip(model, workspace, Motion { q, qd, qdd: None, wrenches });
    let Workspace { shift, measured, z, co_state, .. } = workspace;
    innovations::sweep(&model.system, shift, measured, tau, z, acceleration);
    smoother::sweep(&model.system, shift, measured, co_state, acceleration);
    monitor
}

/// The same with the accelerations in the scratch and the factor of M in the workspace; whether digits cancel.
#[inline(always)]
fn at_accelerations<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    (q, qd): (&[T], &[T]),
    wrenches: &[Vector6<T>],
    out: &mut ForwardDerivatives<'_, T>,
) -> bool {
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
    let nv = model.nv();
    for (row, largest) in scratch.largest.iter_mut().enumerate() {
        *largest = largest_of(&out.mass_matrix_inverse[row * nv..(row + 1) * nv]);
    }
    let by_q = minus_inverse_times(model, workspace, scratch, out.mass_matrix_inverse, out.dqdd_dq);
    let by_qd = minus_inverse_times(model, workspace, scratch, out.mass_matrix_inverse, out.dqdd_dqd);
    by_q || by_qd
}

/// -M^-1 times a matrix, in its place: by filter and smoother where that is fewer operations, else by products, of which its zeros between branches are
/// left out. Whether digits cancel. Told to stop, it stops: whoever checks next says so.
#[inline(always)]
fn minus_inverse_times<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    inverse: &[T],
    matrix: &mut [T],
) -> bool {
    let (nv, stages) = (model.nv(), &model.system.stages);
    let DerivativeScratch { column: right, product, last, largest, by_columns, .. } = scratch;
    let mut most_terms = T::zero();
    for (k, stage) in stages.iter().enumerate() {
        if watch::check_at(k + 1, AT_A_TIME).is_err() {
            return false;
        }
        for column in stage.first_row..stage.first_row + stage.rows.count() {
            let mut terms = T::zero();
            for (row, (right, &largest)) in right.iter_mut().zip(largest.iter()).enumerate() {
                *right = -matrix[row * nv + column];
                terms = right.abs().mul_add(largest, terms);
            }
            most_terms = larger(most_terms, terms);
            if *by_columns {
                solve(model, workspace, right, product);
            } else {
                product.fill(T::zero());
                let end = &stages[last[k]];
                add_rows(product, right, inverse, stage.first_row..end.first_row + end.rows.count());
                let mut inboard = stage.parent;
                while let Some(parent) = inboard {
                    let stage = &stages[parent];
                    add_rows(product, right, inverse, stage.first_row..stage.first_row + stage.rows.count());
                    inboard = stage.parent;
                }
            }
            for (row, &entry) in product.iter().enumerate() {
                matrix[row * nv + column] = entry;
            }
        }
    }
    let size = largest_of(matrix);
    let rounding = T::epsilon().lane(0) / MOST_LOST;
    (0..T::LANES).any(|lane| !(most_terms.lane(lane) * rounding <= size.lane(lane)))
}

/// sum + some rows of a matrix, each times its factor.
#[inline(always)]
fn add_rows<T: Real>(sum: &mut [T], factors: &[T], matrix: &[T], rows: Range<usize>) {
    let nv = sum.len();
    for row in rows {
        let factor = factors[row];
        for (sum, &x) in sum.iter_mut().zip(&matrix[row * nv..(row + 1) * nv]) {
            *sum = factor.mul_add(x, *sum);
        }
    }
}

/// The largest absolute value; zero of none, NaN where any is.
#[inline(always)]
fn largest_of<T: Real>(values: &[T]) -> T {
    let mut largest = T::zero();
    for value in values {
        largest = larger(largest, value.abs());
    }
    largest
}
