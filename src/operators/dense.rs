//! The same operators as matrices, built from their definitions with dense algebra, and faer's LDLT of M for
//! comparison.
//!
//! This module calls no sweep: phi is the inverse of 1 - E (unit triangular, in this order), the Riccati recursion uses
//! full 6x6 matrices, and K and L are products of the composite matrices. The sweeps are tested against it.
//!
//! ```
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(4)?;
//! let q = [0.3; 4];
//! let dense = scene.composite(&q)?;
//! let by_definition = dense.mass_matrix()?; // H phi Q phi* H* (5.1)
//! let mut m = [f64::NAN; 16];
//! scene.mass_matrix(&mut scene.workspace(), &q, &mut m)?;
//! assert!((by_definition[(1, 2)] - m[4 + 2]).abs() <= 1e-14);
//! # Ok(())
//! # }
//! ```

use super::Kind;
use crate::error::Error;
use crate::interrupt;
use crate::kinematics::joint_shift;
use crate::model::Model;
use crate::scene::Scene;
use faer::linalg::solvers::Solve;
use faer::linalg::triangular_solve::solve_unit_upper_triangular_in_place;
use faer::{Mat, MatRef, Par, Side};
use nalgebra::{Matrix6, Vector6};

/// Dense composites with more degrees of freedom are rejected: 6N x 6N values at 300 take 26 MB.
pub(crate) const DENSE_CAP: usize = 300;

/// The composite matrices of a scene at one configuration; block rows base to tip, as in [`crate::operators`].
#[derive(Debug, Clone)]
pub struct Composite {
    /// E: only the blocks phi(inward, row).
    pub shifts: Mat<f64>,
    /// H, nv x 6nv.
    pub h: Mat<f64>,
    /// Q, 6nv x 6nv.
    pub q: Mat<f64>,
    /// Armature.
    pub noise: Vec<f64>,
    /// P^- as a block diagonal.
    pub p: Mat<f64>,
    /// P^+ as a block diagonal.
    pub p_plus: Mat<f64>,
    /// D.
    pub d: Vec<f64>,
    /// g, 6nv x nv.
    pub gain: Mat<f64>,
}

/// (row inward, phi to it, M(k) of the row, H^T) for every row.
type Row = (Option<usize>, Matrix6<f64>, Matrix6<f64>, Vector6<f64>);

fn rows(model: &Model<f64>, q: &[f64]) -> Vec<Row> {
    let stages = &model.system.stages;
    let mut rows = Vec::with_capacity(model.nv());
    for (body, stage) in model.bodies.iter().zip(stages) {
        for i in 0..stage.rows.count() {
            let (inward, phi) = match (i, stage.parent) {
                (0, None) => (None, Matrix6::zeros()),
                (0, Some(parent)) => {
                    (Some(stages[parent].first_row + stages[parent].rows.count() - 1), joint_shift(body, q).to_matrix())
                }
                _ => (Some(stage.first_row + i - 1), Matrix6::identity()),
            };
            let outermost = i + 1 == stage.rows.count();
            let inertia = if outermost { body.inertia.to_symmetric().to_matrix() } else { Matrix6::zeros() };
            rows.push((inward, phi, inertia, stage.rows.row(i).to_column()));
        }
    }
    rows
}

fn put(m: &mut Mat<f64>, (row, column): (usize, usize), block: &Matrix6<f64>) {
    for i in 0..6 {
        for j in 0..6 {
            m[(6 * row + i, 6 * column + j)] = block[(i, j)];
        }
    }
}

/// The 6x6 blocks on the diagonal.
fn block_diagonal(m: &Mat<f64>) -> Mat<f64> {
    Mat::from_fn(m.nrows(), m.ncols(), |i, j| if i / 6 == j / 6 { m[(i, j)] } else { 0.0 })
}

impl Composite {
    /// Builds the matrices at `q`. O(N^2) memory, O(N^3) for the inverses that are computed later.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] beyond 300 degrees of freedom; the message names the operators to use instead.
    pub fn new(model: &Model<f64>, q: &[f64]) -> Result<Self, Error> {
        let nv = model.nv();
        if nv > DENSE_CAP {
            return Err(Error::argument(
                "scene",
                format!("{nv} degrees of freedom"),
                format!("at most {DENSE_CAP} for 6N x 6N matrices; apply the operators of factor(q) instead"),
            ));
        }
        let square = || Mat::<f64>::zeros(6 * nv, 6 * nv);
        let mut all = Self {
            shifts: square(),
            h: Mat::zeros(nv, 6 * nv),
            q: square(),
            noise: model.system.noise.clone(),
            p: square(),
            p_plus: square(),
            d: vec![f64::NAN; nv],
            gain: Mat::zeros(6 * nv, nv),
        };
        let rows = rows(model, q);
        let mut p: Vec<Matrix6<f64>> = rows.iter().map(|row| row.2).collect();
        for (row, (inward, phi, inertia, h)) in rows.iter().enumerate().rev() {
            // 3.6 and 3.10 on full matrices.
            let d = (h.transpose() * p[row] * h)[(0, 0)] + all.noise[row];
            let gain = p[row] * h / d;
            let p_plus = p[row] - gain * (h.transpose() * p[row]);
            put(&mut all.p, (row, row), &p[row]);
            put(&mut all.p_plus, (row, row), &p_plus);
            put(&mut all.q, (row, row), inertia);
            all.d[row] = d;
            for i in 0..6 {
                all.gain[(6 * row + i, row)] = gain[i];
                all.h[(row, 6 * row + i)] = h[i];
            }
            if let Some(inward) = *inward {
                put(&mut all.shifts, (inward, row), phi);
                p[inward] += phi * p_plus * phi.transpose();
            }
        }
        Ok(all)
    }

    fn identity(&self) -> Mat<f64> {
        Mat::identity(self.q.nrows(), self.q.nrows())
    }

    /// phi = (1 - E)^-1.
    ///
    /// # Errors
    ///
    /// [`Error::Interrupted`] if an [`interrupt`] ends the work, which takes minutes for the largest matrices.
    pub fn phi(&self) -> Result<Mat<f64>, Error> {
        unit_upper_solved(&(self.identity() - &self.shifts), &self.identity())
    }

    /// A = 1 - g H.
    #[must_use]
    pub fn closed_loop(&self) -> Mat<f64> {
        self.identity() - &self.gain * &self.h
    }

    /// Psi = (1 - E A)^-1 E.
    ///
    /// # Errors
    ///
    /// As [`Composite::phi`].
    pub fn psi(&self) -> Result<Mat<f64>, Error> {
        unit_upper_solved(&(self.identity() - product(&self.shifts, &self.closed_loop())?), &self.shifts)
    }

    /// R = phi Q phi* (2.2).
    fn state_covariance(&self) -> Result<Mat<f64>, Error> {
        let phi = self.phi()?;
        product(&product(&phi, &self.q)?, &phi.transpose().to_owned())
    }

    /// cov(lambda^+) = Psi* H* D^-1 H Psi, full matrix (5.5).
    fn co_state_covariance(&self) -> Result<Mat<f64>, Error> {
        let observed = &self.h * self.psi()?;
        let scaled = Mat::from_fn(observed.nrows(), observed.ncols(), |i, j| observed[(i, j)] / self.d[i]);
        product(&observed.transpose().to_owned(), &scaled)
    }

    /// The matrix of one operator, from its definition.
    ///
    /// # Errors
    ///
    /// As [`Composite::phi`].
    pub fn matrix(&self, kind: Kind) -> Result<Mat<f64>, Error> {
        Ok(match kind {
            Kind::Phi => self.phi()?,
            Kind::Shifts => self.shifts.clone(),
            Kind::PhiStrict => self.phi()? - self.identity(),
            Kind::Psi => self.psi()?,
            Kind::ClosedLoop => self.closed_loop(),
            Kind::PsiA => product(&self.psi()?, &self.closed_loop())?,
            Kind::APsi => product(&self.closed_loop(), &self.psi()?)?,
            Kind::H => self.h.clone(),
            Kind::Q => self.q.clone(),
            Kind::R => self.state_covariance()?,
            Kind::P => self.p.clone(),
            Kind::PFiltered => self.p_plus.clone(),
            Kind::D => Mat::from_fn(self.d.len(), self.d.len(), |i, j| if i == j { self.d[i] } else { 0.0 }),
            Kind::Gain => self.gain.clone(),
            Kind::BatchGain => self.state_covariance()? * self.h.transpose() * self.matrix(Kind::MassInverse)?,
            // The diagonal blocks of the full covariances, without the recursion of 5.6 and 5.7.
            Kind::Lambda => {
                let to_torque = &self.h * self.phi()?;
                let scaled = to_torque.transpose() * self.matrix(Kind::MassInverse)?;
                block_diagonal(&product(&scaled, &to_torque)?)
            }
            Kind::LambdaPlus => block_diagonal(&self.co_state_covariance()?),
            Kind::S => {
                let psi_p = product(&self.psi()?, &self.p)?;
                let told = product(&product(&self.p, &self.co_state_covariance()?)?, &self.p)?;
                &self.p - &psi_p - psi_p.transpose() + told
            }
            Kind::K => &self.h * self.matrix(Kind::PhiStrict)? * &self.gain,
            Kind::L => &self.h * self.psi()? * &self.gain,
            Kind::Mass => self.mass_matrix()?,
            Kind::MassInverse => {
                let m = self.mass_matrix()?;
                let one = Mat::<f64>::identity(m.nrows(), m.nrows());
                m.partial_piv_lu().solve(&one)
            }
        })
    }

    /// M = H phi Q phi* H* + r (2.8, 5.1).
    ///
    /// # Errors
    ///
    /// As [`Composite::phi`].
    pub fn mass_matrix(&self) -> Result<Mat<f64>, Error> {
        let to_torque = &self.h * self.phi()?;
        let mut m = &to_torque * &self.q * to_torque.transpose();
        for (i, r) in self.noise.iter().enumerate() {
            m[(i, i)] += r;
        }
        Ok(m)
    }
}

/// Products of at most this number of operations are formed in one call; larger ones in blocks of columns, with a check
/// for interruption before each block.
const AT_ONCE: usize = 100_000_000;

/// a b.
pub(crate) fn product(a: &Mat<f64>, b: &Mat<f64>) -> Result<Mat<f64>, Error> {
    by_columns(b, a.nrows(), a.nrows() * a.ncols(), |b| a * b)
}

/// a^-1 b, where a is a unit upper triangular matrix, because its rows are numbered from the base outward.
fn unit_upper_solved(a: &Mat<f64>, b: &Mat<f64>) -> Result<Mat<f64>, Error> {
    by_columns(b, a.nrows(), a.nrows() * a.ncols(), |b| {
        let mut x = b.to_owned();
        solve_unit_upper_triangular_in_place(a.as_ref(), x.as_mut(), Par::Seq);
        x
    })
}

/// Applies `of` to blocks of columns of `b`. `rows` is the number of rows of the result, `each` the number of
/// operations per column.
fn by_columns(
    b: &Mat<f64>,
    rows: usize,
    each: usize,
    of: impl Fn(MatRef<'_, f64>) -> Mat<f64>,
) -> Result<Mat<f64>, Error> {
    interrupt::check()?;
    let together = (AT_ONCE / each.max(1)).max(1);
    if b.ncols() <= together {
        return Ok(of(b.as_ref()));
    }
    let mut all = Mat::zeros(rows, b.ncols());
    for first in (0..b.ncols()).step_by(together) {
        interrupt::check()?;
        let count = together.min(b.ncols() - first);
        all.subcols_mut(first, count).copy_from(of(b.subcols(first, count)));
    }
    Ok(all)
}

/// faer's LDLT of a symmetric matrix with the rows in order from the tip: (unit upper factor in base-to-tip order,
/// diagonal).
///
/// In this order the factor is unit lower triangular and unique, so it must be 1 + K, and the diagonal D (3.1).
///
/// # Errors
///
/// [`Error::Argument`] if faer finds a pivot of zero.
pub fn ldlt_from_tip(m: &Mat<f64>) -> Result<(Mat<f64>, Vec<f64>), Error> {
    let n = m.nrows();
    let flipped = Mat::from_fn(n, n, |i, j| m[(n - 1 - i, n - 1 - j)]);
    let factor = flipped.ldlt(Side::Lower).map_err(|error| {
        Error::argument("mass matrix", format!("{error:?} in faer's LDLT"), "a matrix with an LDLT factorisation")
    })?;
    let (lower, diagonal) = (factor.L(), factor.D());
    let unit = Mat::from_fn(n, n, |i, j| lower[(n - 1 - i, n - 1 - j)]);
    let d = (0..n).map(|i| diagonal.column_vector()[n - 1 - i]).collect();
    Ok((unit, d))
}

impl Scene {
    /// The composite matrices at `q`: see [`Composite`].
    ///
    /// # Errors
    ///
    /// An invalid configuration, or too many degrees of freedom.
    pub fn composite(&self, q: &[f64]) -> Result<Composite, Error> {
        self.model().simplifications.check_every_body_moves("scene")?;
        self.check_configuration("q", q)?;
        Composite::new(self.model(), q)
    }
}
