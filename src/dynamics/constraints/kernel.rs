//! Forward dynamics through connections, for states in lanes and for one state, when only the result is required.
//!
//! With the factor of M in the scratch of the [sweeps](crate::dynamics::sweeps) and the innovations e^- of the tree
//! (4.2):
//!
//! ```text
//! w_i     innovations of a unit force along row i, over its path only
//! G_ij    = sum of w_i w_j / D
//! lambda  = -(G + compliance)^-1 (sum of w e^- / D + gamma)      J qdd0 is the sum: it needs no smoother
//! e^-     + sum of w_i lambda_i                   one pass outward through the smoother (4.9 to 4.11)
//! ```
//!
//! The residual of J qdd + gamma at the resulting accelerations is corrected once if it exceeds rounding. A row that
//! moves no joint is skipped. If the other rows are dependent, or if a residual above rounding remains, the state needs
//! a fallback: [`constrained_dynamics`](super::constrained_dynamics) determines the rank.

mod gram;

use super::faults::IN_CALLS;
use super::rows::ConnectionRows;
use super::solution::{NO_ROUNDING, weight};
use crate::dynamics::sweeps::{SweepModel, SweepScratch};
use crate::model::Model;
use crate::scalar::{Real, larger, largest_of};
use crate::scene::constraint::Constraints;

/// A residual of a row below this number of units in the last place of its terms is rounding and is not corrected.
const ROUNDING: f64 = 8.0;

/// Rows count as independent in this kernel only if they are independent to within the geometric tolerance times this.
const UNSURE: f64 = 10.0;

/// The residuals that a step of the projection removes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Residuals {
    /// Errors, m and rad.
    Errors,
    /// Their time derivatives.
    Rates,
}

/// The data of the kernel for one scene and the current states; initialized with NaN.
#[derive(Debug)]
pub(crate) struct ConstraintKernel<T> {
    /// The rows, and W; in the place of G, its factor L D L*.
    pub rows: ConnectionRows<T>,
    /// One for each row, zero for a row that moves no joint; and the diagonal of G, one for such rows.
    kept: Vec<T>,
    diagonal: Vec<T>,
    pivot_inverses: Vec<T>,
    step: Vec<T>,
    /// Sizes of the terms of each row at the last accelerations.
    sizes: Vec<T>,
    /// Rows that depend on each other to within this, squared, need the rank by geometry.
    unsure: f64,
    /// The compliance of each row as measurement noise; zero for rigid rows.
    pub compliance: Vec<T>,
    /// The scale of the rounding errors of each row.
    terms: Vec<T>,
    /// The size of a row times this bounds the effect of the robot's weight on the row; and the same for weight and
    /// torques.
    weight: T,
    pushing: T,
    /// The largest error of a row, m or rad, and the largest |J qd| for joint velocities of at most 1, that count as
    /// meeting the connections.
    pub slack: f64,
    /// lambda.
    pub forces_of_rows: Vec<T>,
    /// The number of rows that move a joint.
    pub rank: T,
    /// The largest residual of a row, rad/s^2 or m/s^2.
    pub residual: T,
}

impl<T: Real> ConstraintKernel<T> {
    pub fn new((model, sweeps): (&Model<T>, &SweepModel<T>), constraints: &Constraints) -> Self {
        let (nan, zero, m) = (T::from_f64(f64::NAN), T::zero(), constraints.rows);
        Self {
            rows: ConnectionRows::new((model, sweeps), constraints),
            kept: vec![nan; m],
            diagonal: vec![nan; m],
            pivot_inverses: vec![nan; m],
            step: vec![nan; m],
            sizes: vec![nan; m],
            unsure: (UNSURE * constraints.tolerance).powi(2),
            compliance: vec![zero; m],
            terms: vec![nan; m],
            weight: T::from_f64(weight(model)),
            pushing: nan,
            slack: IN_CALLS + constraints.allowance,
            forces_of_rows: vec![nan; m],
            rank: nan,
            residual: nan,
        }
    }

    /// Computes the rows, w, G and its factor at q, which is that of the scratch, and at qd. Returns a value that is
    /// negative or NaN in lanes whose rows are dependent, need the general form or violate the connections.
    #[inline(always)]
    pub fn factor(
        &mut self,
        scene: (&Model<T>, &SweepModel<T>),
        scratch: &SweepScratch<T>,
        (q, qd): (&[T], &[T]),
    ) -> T {
        let zero = scene.0.gravity[0].constant(0.0);
        let (slack, speed) = (zero.constant(self.slack), largest_of(qd, zero.constant(1.0)));
        let regular = self.rows.whiten(scene, scratch, (q, qd), [slack, speed * slack]);
        let independent = self.prepare(zero);
        regular.worst(independent).worst(self.factorise(zero))
    }

    /// The first step of lambda, from the innovations of the tree. The scales of rounding errors are needed only if the
    /// residual [is looked at](ConstraintKernel::look).
    #[inline(always)]
    pub fn first_step(&mut self, scratch: &SweepScratch<T>, tau: &[T], innovations: &[T], is_watched: bool) {
        let zero = self.weight.constant(0.0);
        self.forces_of_rows.fill(zero);
        let Self { step, terms, rows: ConnectionRows { all, whitened, .. }, pushing, weight, .. } = self;
        if is_watched {
            *pushing = *weight;
            for (row, &tau) in tau.iter().enumerate() {
                *pushing = tau.abs().mul_add(scratch.pivot_inverse(row).sqrt(), *pushing);
            }
        }
        for of in &whitened.paths {
            for i in of.rows.clone() {
                let gamma = all[i].gamma;
                if is_watched {
                    (step[i], terms[i]) = whitened.times(of, i, innovations, (gamma, gamma.abs()));
                } else {
                    step[i] = whitened.product(of, i, innovations, gamma);
                }
            }
        }
        self.solve();
    }

    /// The next accelerations meet J qdd = -`biases`, which are zero if they are empty, as at rest.
    #[inline(always)]
    pub fn set_biases(&mut self, biases: &[T]) {
        for (i, row) in self.rows.all.iter_mut().enumerate() {
            row.gamma = biases.get(i).copied().unwrap_or(row.gamma.constant(0.0));
        }
    }

    /// The last step of lambda.
    pub fn step(&self) -> &[T] {
        &self.step
    }

    /// Adds the step to lambda, and its effect to the innovations of the tree.
    #[inline(always)]
    pub fn take(&mut self, innovations: &mut [T]) {
        for (lambda, &step) in self.forces_of_rows.iter_mut().zip(&self.step) {
            *lambda += step;
        }
        self.rows.whitened.add(&self.step, innovations);
    }

    /// The residuals of the rows at these accelerations, and the step that corrects them. Returns the margins to the
    /// bound on rounding and to the bound on what can be rounding; negative where a residual exceeds the bound.
    #[inline(always)]
    pub fn look(&mut self, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>, qdd: &[T]) -> [T; 2] {
        let zero = scene.0.gravity[0].constant(0.0);
        let Self { rows, step, sizes, compliance, terms, forces_of_rows, diagonal, pushing, residual, .. } = self;
        let (mut most, mut near, mut far) = (zero, zero.constant(1.0), zero.constant(1.0));
        // The row of bodies in static equilibrium is a sum of rounding errors. It is compared with the forces that act
        // on the bodies: sqrt(G_jj) |lambda_j| for connection forces.
        let mut acting = *pushing;
        for (&lambda, &diagonal) in forces_of_rows.iter().zip(&*diagonal) {
            // Skipped rows contribute zero.
            acting = lambda.abs().mul_add(diagonal.sqrt(), acting);
        }
        rows.times::<true>(scene, scratch, qdd, (step, sizes));
        for i in 0..step.len() {
            most = larger(most, step[i].abs());
            let given_way = compliance[i] * forces_of_rows[i];
            step[i] += given_way;
            terms[i] = larger(terms[i], sizes[i] + given_way.abs());
            let unit = terms[i] * zero.constant(f64::EPSILON);
            near = near.worst(unit.mul_add(zero.constant(ROUNDING), -step[i].abs()));
            let unit = rows.whitened.sizes[i].sqrt().mul_add(acting, terms[i]) * zero.constant(f64::EPSILON);
            far = far.worst(unit.mul_add(zero.constant(NO_ROUNDING), -step[i].abs()));
        }
        *residual = most;
        self.solve();
        [near, far]
    }

    /// G^-1 of a matrix (m x n), row by row.
    #[cfg(feature = "derivatives")]
    #[inline(always)]
    pub fn times_gram_inverse(&mut self, matrix: &[T], out: &mut [T]) {
        let count = matrix.len() / self.step.len().max(1);
        for column in 0..count {
            for (step, row) in self.step.iter_mut().zip(matrix.chunks_exact(count)) {
                *step = -row[column];
            }
            self.solve();
            for (step, row) in self.step.iter().zip(out.chunks_exact_mut(count)) {
                row[column] = *step;
            }
        }
    }

    /// Sets the step to zero where `kept` is zero.
    #[inline(always)]
    pub fn mask(&mut self, kept: T) {
        for step in &mut self.step {
            *step *= kept;
        }
    }

    /// The largest residual of a row.
    #[inline(always)]
    pub fn largest(&self, which: Residuals) -> T {
        let zero = self.weight.constant(0.0);
        let mut most = zero;
        for row in &self.rows.all {
            let left = if which == Residuals::Errors { row.error } else { row.rate };
            most = larger(most, left.abs());
        }
        most
    }

    /// The innovations of the forces -G^-1 residual, which remove the residuals to first order, into `innovations`.
    #[inline(always)]
    pub fn step_against(&mut self, which: Residuals, innovations: &mut [T]) {
        for (step, row) in self.step.iter_mut().zip(&self.rows.all) {
            *step = if which == Residuals::Errors { row.error } else { row.rate };
        }
        self.solve();
        let zero = self.weight.constant(0.0);
        innovations.fill(zero);
        self.rows.whitened.add(&self.step, innovations);
    }
}
