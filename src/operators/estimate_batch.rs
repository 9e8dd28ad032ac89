//! Batch estimation: the printed equations of section 2 with composite matrices, as a check of the sequential solution.
//!
//! This module does not call the filter: phi, H and Q are matrices, the gain G = R H* (H R H* + r + noise/s)^-1 is that
//! of the measured rows, and faer factors the covariance to be inverted.

use super::dense::{Composite, product};
use crate::dynamics::estimate::Measurements;
use crate::dynamics::forces::Motion;
use crate::dynamics::inverse::forces_base_to_tip;
use crate::error::Error;
use crate::model::Model;
use crate::workspace::Workspace;
use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, Side};
use nalgebra::Vector6;

/// The estimate of one state, with a block of six per degree of freedom as in [`crate::operators`].
#[derive(Debug, Clone)]
pub struct BatchEstimate {
    /// E(a|y), nv: rad/s^2 or m/s^2.
    pub acceleration: Vec<f64>,
    /// E(T|y), nv: N m or N.
    pub torque: Vec<f64>,
    /// E(X|y), 6 nv (2.1).
    pub force: Vec<f64>,
    /// E(W|y), 6 nv; zero except at the outermost row of each body (2.7).
    pub process: Vec<f64>,
    /// Log of the density of the measured torques.
    pub log_likelihood: f64,
    /// Full covariances, if requested.
    pub covariance: Option<BatchCovariance>,
}

/// Covariances of the errors of a [`BatchEstimate`], between all degrees of freedom.
#[derive(Debug, Clone)]
pub struct BatchCovariance {
    /// Covariance of the accelerations, nv x nv.
    pub acceleration: Mat<f64>,
    /// Covariance of the torques, nv x nv.
    pub torque: Mat<f64>,
    /// Covariance of X, 6nv x 6nv: s (R - G H R), (2.6).
    pub force: Mat<f64>,
    /// Covariance of W, 6nv x 6nv: s (Q - Q phi* H* (H R H* + r + noise/s)^-1 H phi Q), (2.11).
    pub process: Mat<f64>,
}

/// Section 2 with dense matrices, O(N^3); the state is (q, qd, wrenches) as in
/// [`forward_dynamics`](crate::dynamics::forward_dynamics).
///
/// # Errors
///
/// [`Error::Argument`] beyond 300 degrees of freedom, or if the covariance of the measured torques (or, with
/// covariances, the mass matrix) is not positive definite.
pub fn estimate_batch(
    model: &Model<f64>,
    workspace: &mut Workspace<f64>,
    (q, qd, wrenches): (&[f64], &[f64], &[Vector6<f64>]),
    measurements: &Measurements<'_, f64>,
    with_covariance: bool,
) -> Result<BatchEstimate, Error> {
    let composite = Composite::new(model, q)?;
    let nv = model.nv();
    let s = measurements.acceleration_variance;
    let phi = composite.phi()?;
    let to_torque = &composite.h * &phi;
    let mass = composite.mass_matrix()?;

    // The prior means: W ~ b + Q phi* H* a0, T = H phi W + r a0.
    forces_base_to_tip(model, workspace, Motion { q, qd, qdd: None, wrenches });
    let mut process = Mat::<f64>::zeros(6 * nv, 1);
    for (z, stage) in workspace.z.iter().zip(&model.system.stages) {
        let outermost = stage.first_row + stage.rows.count() - 1;
        for i in 0..6 {
            process[(6 * outermost + i, 0)] = z[i];
        }
    }
    let prior = Mat::from_fn(nv, 1, |i, _| measurements.prior_acceleration.map_or(0.0, |prior| prior[i]));
    process += &composite.q * (to_torque.transpose() * &prior);
    let mut torque = &to_torque * &process;
    for i in 0..nv {
        torque[(i, 0)] += composite.noise[i] * prior[(i, 0)];
    }

    // The measured rows: H_m, and H_m R H_m* + r + noise/s.
    let rows: Vec<usize> = (0..nv).filter(|&row| measurements.is_measured(row)).collect();
    let m = rows.len();
    let to_measured = Mat::from_fn(m, 6 * nv, |i, j| to_torque[(rows[i], j)]);
    let variance = Mat::from_fn(m, m, |i, j| {
        mass[(rows[i], rows[j])] + if i == j { measurements.noise[rows[i]] / s } else { 0.0 }
    });
    let factor = cholesky(&variance, "covariance of the measured torques")?;
    let error = Mat::from_fn(m, 1, |i, _| measurements.torque[rows[i]] - torque[(rows[i], 0)]);
    let weighted = factor.solve(&error);

    // 2.7, 2.1, and T = M a + ... by its covariance with the measurements.
    process += &composite.q * (to_measured.transpose() * &weighted);
    let force = &phi * &process;
    torque += Mat::from_fn(nv, m, |i, j| mass[(i, rows[j])]) * &weighted;
    let mut acceleration: Vec<f64> = (0..nv).map(|i| prior[(i, 0)]).collect();
    for (j, &row) in rows.iter().enumerate() {
        acceleration[row] += weighted[(j, 0)];
    }

    let square: f64 = (0..m).map(|i| error[(i, 0)] * weighted[(i, 0)]).sum();
    let constant = (2.0 * std::f64::consts::PI).ln() + s.ln();
    let log_likelihood: f64 = (0..m).map(|i| -factor.L()[(i, i)].ln() - 0.5 * constant).sum::<f64>() - 0.5 * square / s;
    let covariance = if with_covariance {
        Some(covariances(&composite, &phi, &mass, &rows, (&to_measured, &factor), s)?)
    } else {
        None
    };
    let column = |m: &Mat<f64>| (0..m.nrows()).map(|i| m[(i, 0)]).collect();
    Ok(BatchEstimate {
        acceleration,
        torque: column(&torque),
        force: column(&force),
        process: column(&process),
        log_likelihood,
        covariance,
    })
}

/// s times the difference of the prior covariances and the information of the measured rows, from H phi of those rows
/// and the factor of their covariance.
fn covariances(
    composite: &Composite,
    phi: &Mat<f64>,
    mass: &Mat<f64>,
    rows: &[usize],
    (to_measured, factor): (&Mat<f64>, &Llt<f64>),
    s: f64,
) -> Result<BatchCovariance, Error> {
    let (nv, m) = (mass.nrows(), rows.len());
    let mut acceleration = cholesky(mass, "mass matrix")?.solve(&Mat::<f64>::identity(nv, nv));
    let told = factor.solve(&Mat::<f64>::identity(m, m));
    for (i, &row) in rows.iter().enumerate() {
        for (j, &column) in rows.iter().enumerate() {
            acceleration[(row, column)] -= told[(i, j)];
        }
    }
    // Covariances of W, X = phi W and T with the measured torques.
    let process = &composite.q * to_measured.transpose();
    let force = phi * &process;
    let torque = Mat::from_fn(nv, m, |i, j| mass[(i, rows[j])]);
    let remaining = |prior: &Mat<f64>, with_measured: &Mat<f64>| {
        let told = product(with_measured, &factor.solve(with_measured.transpose()))?;
        Ok::<_, Error>((prior - told) * faer::Scale(s))
    };
    let r = product(&product(phi, &composite.q)?, &phi.transpose().to_owned())?;
    Ok(BatchCovariance {
        acceleration: acceleration * faer::Scale(s),
        torque: remaining(mass, &torque)?,
        force: remaining(&r, &force)?,
        process: remaining(&composite.q, &process)?,
    })
}

fn cholesky(m: &Mat<f64>, what: &str) -> Result<Llt<f64>, Error> {
    m.llt(Side::Lower).map_err(|error| {
        let found = format!("a matrix that is not positive definite ({error:?} in faer's Cholesky)");
        Error::argument(what, found, "a positive definite one; method \"sequential\" names the joint at fault")
    })
}
