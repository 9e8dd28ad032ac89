//! The connections of a scene as hard constraints of inverse kinematics.
//!
//! With the constraint errors c and their Jacobian C, steps satisfy C d + c = 0 by the method of multipliers: the
//! quadratic is augmented by the penalty w |C d + c + y|^2 / 2, and y is increased by the remaining violation. After a
//! step, Levenberg-Marquardt steps on c alone close the connections again, within the limits. C can have dependent
//! rows.

use super::limits::Bounds;
use super::step::{BoxStep, add_squares};
use crate::decompositions::eigenvalues;
use crate::dynamics::ConstraintScratch;
use crate::dynamics::constraints::errors_of_rows;
use crate::error::Error;
use crate::scene::Scene;
use crate::workspace::Workspace;
use nalgebra::DMatrix;

/// The penalty relative to the largest entry of the quadratic: larger ones lose precision, smaller ones need more
/// iterations.
const PENALTY: f64 = 1e4;
/// Rounds of the method of multipliers; each reduces the violation by about the penalty.
const ROUNDS: usize = 8;
/// Largest number of steps to close connections, initial damping, and least damping.
const STEPS: usize = 100;
const DAMPING: f64 = 1e-6;
const LEAST: f64 = 1e-12;
/// Connections are closed if the largest constraint error, m and rad, relative to 1 m plus the size of the scene, is
/// below this, as in [`Scene::project`].
const CLOSED: f64 = 1e-9;
/// Eigenvalues of C^T C below this fraction of the largest are zero.
const RANK: f64 = 1e-14;

/// Constraint rows at a configuration, with scratch memory.
#[derive(Debug, Clone)]
pub struct Closure {
    scratch: ConstraintScratch,
    boxed: BoxStep,
    /// Error of each row, m and rad, and its Jacobian, (rows x nv), row-major.
    errors: Vec<f64>,
    jacobian: Vec<f64>,
    matrix: Vec<f64>,
    slope: Vec<f64>,
    step: Vec<f64>,
    trial: Vec<f64>,
    multipliers: Vec<f64>,
    tolerance: f64,
}

impl Closure {
    /// The connections of a scene; `None` if it has none.
    pub fn of(scene: &Scene) -> Option<Self> {
        let (rows, nv) = (scene.constraint_rows(), scene.nv());
        let extent: f64 = scene.model().bodies.iter().map(|body| body.tree.lever.norm()).sum();
        let numbers = |count: usize| vec![f64::NAN; count];
        (!scene.constraints().is_empty()).then(|| Self {
            scratch: scene.constraint_scratch(),
            boxed: BoxStep::new(nv),
            errors: numbers(rows),
            jacobian: numbers(rows * nv),
            matrix: numbers(nv * nv),
            slope: numbers(nv),
            step: numbers(nv),
            trial: numbers(scene.nq()),
            multipliers: numbers(rows),
            tolerance: CLOSED * (1.0 + extent),
        })
    }

    /// True if the connections are closed at the configuration of the last call.
    pub fn is_closed(&self) -> bool {
        self.largest().1 <= self.tolerance
    }

    /// The row with the largest error, and that error.
    pub fn largest(&self) -> (usize, f64) {
        let pick = |worst: (usize, f64), (row, error): (usize, &f64)| {
            if error.abs() <= worst.1 { worst } else { (row, error.abs()) }
        };
        self.errors.iter().enumerate().fold((0, 0.0), pick)
    }

    fn errors_at(&mut self, scene: &Scene, q: &[f64]) -> Result<f64, Error> {
        errors_of_rows(scene.model(), scene.constraints(), q, &mut self.errors).map_err(|at| scene.row_fault(at))?;
        Ok(0.5 * self.errors.iter().map(|error| error * error).sum::<f64>())
    }

    /// Computes errors and Jacobian at `q`.
    pub fn evaluate(&mut self, workspace: &mut Workspace<f64>, scene: &Scene, q: &[f64]) -> Result<(), Error> {
        self.errors_at(scene, q)?;
        scene.constraint_jacobian(workspace, &mut self.scratch, q, &mut self.jacobian)
    }

    /// Moves `q` within the limits until the connections are closed, as far as possible; [`Self::is_closed`] reports
    /// the result.
    pub fn close(
        &mut self,
        workspace: &mut Workspace<f64>,
        scene: &Scene,
        limits: &Bounds,
        q: &mut [f64],
    ) -> Result<(), Error> {
        let nv = scene.nv();
        self.evaluate(workspace, scene, q)?;
        let mut damping = DAMPING;
        for _ in 0..STEPS {
            let left = self.largest().1;
            if left <= 4.0 * f64::EPSILON * self.tolerance / CLOSED {
                break;
            }
            let value = 0.5 * self.errors.iter().map(|error| error * error).sum::<f64>();
            self.matrix.fill(0.0);
            self.slope.fill(0.0);
            add_squares(&self.jacobian, &self.errors, &mut self.matrix, &mut self.slope);
            let largest = (0..nv).fold(f64::MIN_POSITIVE, |largest, i| largest.max(self.matrix[i * nv + i]));
            (0..nv).for_each(|i| self.matrix[i * nv + i] += damping * largest);
            let has_step = self.boxed.minimize(&self.matrix, &self.slope, |row| limits.room(row, q), &mut self.step);
            if has_step {
                scene.integrate(q, &self.step, &mut self.trial)?;
                limits.hold(&mut self.trial);
                let trial = std::mem::take(&mut self.trial);
                let next = self.errors_at(scene, &trial);
                self.trial = trial;
                if next? < value {
                    q.copy_from_slice(&self.trial);
                    // At rounding level, errors do not halve.
                    let is_done = left <= self.tolerance && self.largest().1 > 0.5 * left;
                    self.evaluate(workspace, scene, q)?;
                    if is_done {
                        break;
                    }
                    damping = LEAST.max(0.1 * damping);
                    continue;
                }
                self.evaluate(workspace, scene, q)?;
                if left <= self.tolerance {
                    break;
                }
            }
            damping *= 10.0;
            if damping > 1e6 {
                break;
            }
        }
        Ok(())
    }

    /// Minimizes the quadratic of `a` and `g` within the limits, subject to the linearized constraints C d + `target` c
    /// = 0, and writes the minimizer to `step`. Returns whether it exists.
    pub fn minimize(
        &mut self,
        boxed: &mut BoxStep,
        (a, g): (&[f64], &[f64]),
        target: f64,
        room: impl Fn(usize) -> (f64, f64),
        step: &mut [f64],
    ) -> bool {
        let n = g.len();
        let largest = |matrix: &[f64]| (0..n).fold(f64::MIN_POSITIVE, |most, i| most.max(matrix[i * n + i]));
        self.matrix.fill(0.0);
        self.slope.fill(0.0);
        add_squares(&self.jacobian, &self.errors, &mut self.matrix, &mut self.slope);
        let weight = PENALTY * largest(a) / largest(&self.matrix);
        self.matrix.iter_mut().zip(a).for_each(|(entry, a)| *entry = a + weight * *entry);
        self.multipliers.iter_mut().zip(&self.errors).for_each(|(y, error)| *y = target * error);
        let mut before = f64::INFINITY;
        for _ in 0..ROUNDS {
            self.slope.copy_from_slice(g);
            for (row, y) in self.jacobian.chunks_exact(n.max(1)).zip(&self.multipliers) {
                self.slope.iter_mut().zip(row).for_each(|(slope, of)| *slope += weight * y * of);
            }
            if !boxed.minimize(&self.matrix, &self.slope, &room, step) {
                return false;
            }
            let mut left: f64 = 0.0;
            for ((row, y), error) in self.jacobian.chunks_exact(n.max(1)).zip(&mut self.multipliers).zip(&self.errors) {
                let rest = target * error + row.iter().zip(&*step).map(|(of, step)| of * step).sum::<f64>();
                *y += rest;
                left = left.max(rest.abs());
            }
            // Stops at rounding level, or if the limits prevent further progress.
            if !(left < 0.5 * before) || left == 0.0 {
                break;
            }
            before = left;
        }
        true
    }

    /// Writes to `out` the inverse of `a` restricted to the motions that satisfy the constraints. Returns whether it is
    /// positive definite there.
    pub fn inverse(&self, a: &[f64], is_free: impl Fn(usize) -> bool, out: &mut [f64]) -> bool {
        let n = self.slope.len();
        out.fill(0.0);
        let free: Vec<usize> = (0..n).filter(|&i| is_free(i)).collect();
        let m = free.len();
        if m == 0 {
            return true;
        }
        let c = DMatrix::from_fn(self.errors.len(), m, |row, j| self.jacobian[row * n + free[j]]);
        let Some(eigen) = eigenvalues(c.transpose() * &c) else { return false };
        let largest = eigen.eigenvalues.iter().fold(0.0_f64, |most, value| most.max(*value));
        let allowed: Vec<usize> = (0..m).filter(|&i| eigen.eigenvalues[i] <= RANK * largest).collect();
        let z = eigen.eigenvectors.select_columns(&allowed);
        let reduced = z.transpose() * DMatrix::from_fn(m, m, |i, j| a[free[i] * n + free[j]]) * &z;
        let Some(factor) = reduced.cholesky() else { return false };
        let covariance = &z * factor.inverse() * z.transpose();
        for (i, &row) in free.iter().enumerate() {
            for (j, &column) in free.iter().enumerate() {
                out[row * n + column] = covariance[(i, j)];
            }
        }
        true
    }
}
