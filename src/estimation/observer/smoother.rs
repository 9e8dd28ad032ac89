//! Fixed-interval smoother: estimates of all stored times from the readings of all of them.
//!
//! Back over the times, with the root L of (error, torque noise) and the prediction P1 of the next time:
//! G = P (F B)* P1^-1, e = G (x1 - prediction), and P + G (P1s - P1) G* as the sum of squares of L - G (F B) L, of
//! G times the growth of the random walks, and of G times the smoothed root.

use super::filter::{Scratch, multiply};
use super::robot::Record;
use super::settings::Plan;
use crate::error::Error;
use crate::kinematics::manifold::step_jacobians;
use crate::memory;
use crate::scene::Scene;
use nalgebra::{DMatrix, DVector};

/// Part of a row of a root, relative to the row, below which the row depends on the rows before it.
const SINGULAR: f64 = 1e-12;

/// Smoothed estimates of the stored times of one robot, one time after another.
#[derive(Debug, Clone, PartialEq)]
pub struct SmoothedMotion {
    /// Index of the first time: the number of steps before it.
    pub first: usize,
    /// Times since the first step, s.
    pub time: Vec<f64>,
    /// Configurations, (steps, nq).
    pub q: Vec<f64>,
    /// Joint velocities, (steps, nv).
    pub qd: Vec<f64>,
    /// Wrenches in their order, six numbers each, then biases of the sensors that have one, three each.
    pub rest: Vec<f64>,
    /// Covariances of the error, (steps, n, n), as [`MotionEstimate::covariance`](super::MotionEstimate::covariance).
    pub covariance: Vec<f64>,
}

/// The smoothed estimate of one time.
struct Smoothed {
    q: Vec<f64>,
    qd: Vec<f64>,
    rest: Vec<f64>,
    /// A root of the covariance, one row per component of the error.
    root: DMatrix<f64>,
}

/// Smooths the records, which are in the order of time; the first has the index `first`.
pub(super) fn smooth(
    (plan, scene): (&Plan, &Scene),
    scratch: &mut Scratch,
    (first, records): (usize, &[&Record]),
) -> Result<SmoothedMotion, Error> {
    /// Matrices of n times width numbers that exist at once in a step.
    const AT_ONCE: usize = 10;
    let (steps, n) = (records.len(), plan.states);
    memory::room("history", memory::bytes_of::<f64>(&[AT_ONCE, n, plan.width]))?;
    let nan = |width: usize| memory::filled("history", steps * width, f64::NAN);
    let (q, qd, rest, covariance) = (nan(plan.nq)?, nan(plan.nv)?, nan(plan.rest)?, nan(n * n)?);
    let time = records.iter().map(|record| record.time).collect();
    let mut out = SmoothedMotion { first, time, q, qd, rest, covariance };
    let mut later: Option<Smoothed> = None;
    for (at, record) in records.iter().enumerate().rev() {
        let now = match &later {
            Some(later) => smoothed((plan, scene), scratch, (record, &records[at + 1].acting), later)?,
            None => filtered(plan, record),
        };
        out.q[at * plan.nq..(at + 1) * plan.nq].copy_from_slice(&now.q);
        out.qd[at * plan.nv..(at + 1) * plan.nv].copy_from_slice(&now.qd);
        out.rest[at * plan.rest..(at + 1) * plan.rest].copy_from_slice(&now.rest);
        let covariance = &now.root * now.root.transpose();
        let order = plan.public_order();
        for (to, (i, j)) in
            out.covariance[at * n * n..].iter_mut().zip(order.clone().flat_map(|i| order.clone().map(move |j| (i, j))))
        {
            *to = covariance[(i, j)];
        }
        later = Some(now);
    }
    Ok(out)
}

/// The filtered estimate of a record.
fn filtered(plan: &Plan, record: &Record) -> Smoothed {
    let [_, wide] = plan.strides();
    let root = DMatrix::from_fn(plan.states, plan.width, |i, j| record.root[j * wide + i]);
    Smoothed { q: record.q.clone(), qd: record.qd.clone(), rest: record.rest.clone(), root }
}

fn smoothed(
    (plan, scene): (&Plan, &Scene),
    scratch: &mut Scratch,
    (record, acting): (&Record, &[f64]),
    later: &Smoothed,
) -> Result<Smoothed, Error> {
    let (n, [column, _]) = (plan.states, plan.strides());
    let mut now = filtered(plan, record);
    let predicted = scratch.carried((plan, scene), record)?;
    let columns = plan.width + plan.walks.len();
    let predicted = DMatrix::from_fn(n, columns, |i, j| predicted[j * column + i]);
    let carried = predicted.columns(0, plan.width);
    // Rows are normalized, so that zero variance is distinguished from small variance.
    let size = DVector::from_fn(n, |i, _| Some(predicted.row(i).norm()).filter(|size| *size > 0.0).unwrap_or(1.0));
    // That a wrench has ended says nothing about its size before.
    let ended = |i: usize| acting.get(i / 6).is_some_and(|&acts| acts == 0.0);
    let (kept, root) =
        independent_rows(DMatrix::from_fn(columns, n, |j, i| if ended(i) { 0.0 } else { predicted[(i, j)] / size[i] }));
    let shared = carried * now.root.transpose();
    let right = DMatrix::from_fn(kept.len(), n, |k, j| shared[(kept[k], j)] / size[kept[k]]);
    let lost = || Error::argument("covariance of the prediction", "a root without an inverse", "finite variances");
    let half = root.solve_lower_triangular(&right).ok_or_else(lost)?;
    let solved = root.tr_solve_lower_triangular(&half).ok_or_else(lost)?;
    let mut gain = DMatrix::zeros(n, n);
    for (k, &at) in kept.iter().enumerate() {
        for i in 0..n {
            gain[(i, at)] = solved[(k, i)] / size[at];
        }
    }
    let mut moved = DVector::zeros(n);
    for (i, (to, from)) in later.rest.iter().zip(&record.next_rest).enumerate() {
        moved[i] = to - from;
    }
    scene.difference(&record.next_q, &later.q, &mut moved.as_mut_slice()[plan.q()..plan.qd()])?;
    for (i, (to, from)) in later.qd.iter().zip(&record.next_qd).enumerate() {
        moved[plan.qd() + i] = to - from;
    }
    let change = &gain * moved;
    // Square root of P + G (P1s - P1) G*, as a sum of squares.
    let (walks, others) = (plan.walks.len(), later.root.ncols());
    let mut whole = DMatrix::zeros(n, columns + others);
    whole.columns_mut(0, plan.width).copy_from(&(&now.root - &gain * carried));
    whole.columns_mut(plan.width, walks).copy_from(&(&gain * predicted.columns(plan.width, walks)));
    whole.columns_mut(columns, others).copy_from(&(&gain * &later.root));
    now.root = whole.transpose().qr().r().transpose();
    correct((plan, scene), &mut now, change.as_slice())?;
    scratch.close((plan, scene), (&mut now.q, &mut now.qd), now.root.as_mut_slice().chunks_exact_mut(n))?;
    scene.check_result("smoothed covariance", now.root.as_slice())?;
    Ok(now)
}

/// Applies a correction, and transports the error to the tangent space at the new q, to first order.
fn correct((plan, scene): (&Plan, &Scene), now: &mut Smoothed, change: &[f64]) -> Result<(), Error> {
    let q = std::mem::take(&mut now.q);
    now.q = vec![f64::NAN; plan.nq];
    scene.integrate(&q, &change[plan.q()..plan.qd()], &mut now.q)?;
    now.qd.iter_mut().zip(&change[plan.qd()..]).for_each(|(x, dx)| *x += dx);
    now.rest.iter_mut().zip(change).for_each(|(x, dx)| *x += dx);
    for &(first, size) in &plan.groups {
        let at = plan.q() + first;
        let [_, right] = step_jacobians(&change[at..at + size]);
        for mut own in now.root.column_iter_mut() {
            multiply(&right, size, &mut own.as_mut_slice()[at..at + size]);
        }
    }
    Ok(())
}

/// The rows of a matrix that do not depend on rows before them, and their lower triangular root. The matrix is given
/// transposed, with rows of length one or zero.
fn independent_rows(mut transposed: DMatrix<f64>) -> (Vec<usize>, DMatrix<f64>) {
    let (length, rows) = transposed.shape();
    let mut kept = Vec::new();
    for i in 0..rows {
        let rank = kept.len();
        let norm = transposed.view((rank, i), (length - rank, 1)).norm();
        if norm <= SINGULAR {
            continue;
        }
        let lead = transposed[(rank, i)] + norm.copysign(transposed[(rank, i)]);
        let mut axis: DVector<f64> = transposed.view((rank, i), (length - rank, 1)).column(0).into_owned();
        axis[0] = lead;
        let factor = 2.0 / axis.norm_squared();
        for j in i..rows {
            let mut other = transposed.view_mut((rank, j), (length - rank, 1));
            let along = factor * axis.dot(&other.column(0));
            other.column_mut(0).axpy(-along, &axis, 1.0);
        }
        kept.push(i);
        if kept.len() == length {
            break;
        }
    }
    let root = DMatrix::from_fn(kept.len(), kept.len(), |i, j| if j <= i { transposed[(j, kept[i])] } else { 0.0 });
    (kept, root)
}
