//! Estimates on the connections of a scene, which are measurements without noise.
//!
//! The estimate satisfies the connections, J qd = 0, and its error is tangent to them. A step of the filter leaves them
//! to third order: then q and qd are projected, with least kinetic energy, and the error by the derivative of that
//! projection. With A the inverse mass matrix through the connections, the velocity A M qd is projected, so that
//!
//! ```text
//! dq' = P dq,  dqd' = P dqd + K dq',  P = A M,  K dq = d(A M)/dq qd dq
//! ```
//!
//! and K is the derivative of forward dynamics at rest with the torque M qd + g, plus A times that of the torque.

use super::settings::Plan;
use crate::decompositions;
use crate::dynamics::ConstraintScratch;
use crate::error::Error;
use crate::scene::Scene;
use crate::workspace::Workspace;
use nalgebra::DMatrix;

/// Singular values of the rows of connections below this share of the largest are zero.
const SINGULAR: f64 = 1e-11;

/// Scratch of the projection, and its derivatives at the last state; one per thread.
#[derive(Debug)]
pub(super) struct Closure {
    rows: ConstraintScratch,
    projector: DMatrix<f64>,
    by_q: DMatrix<f64>,
}

impl Closure {
    /// Scratch for a scene; `None` for one without connections.
    pub fn new(scene: &Scene) -> Option<Self> {
        let none = || DMatrix::zeros(scene.nv(), scene.nv());
        let has_rows = !scene.constraints().is_empty();
        has_rows.then(|| Self { rows: scene.constraint_scratch(), projector: none(), by_q: none() })
    }

    /// Projects a state onto the connections.
    pub fn project(
        &mut self,
        scene: &Scene,
        workspace: &mut Workspace<f64>,
        (q, qd): (&mut [f64], &mut [f64]),
    ) -> Result<(), Error> {
        scene.project(workspace, &mut self.rows, q, Some(qd)).map(|_| ())
    }

    /// Projects a state onto the connections, and computes the derivatives of the projection there.
    pub fn close(
        &mut self,
        scene: &Scene,
        workspace: &mut Workspace<f64>,
        (q, qd): (&mut [f64], &mut [f64]),
    ) -> Result<(), Error> {
        self.project(scene, workspace, (&mut *q, &mut *qd))?;
        let (nv, size) = (scene.nv(), scene.nv() * scene.nv());
        let (rest, mut torque) = (vec![0.0; nv], vec![f64::NAN; nv]);
        let (mut of_torque, mut of_motion) = (vec![f64::NAN; 3 * size], vec![f64::NAN; 3 * size]);
        scene.inverse_dynamics(workspace, q, &rest, qd, &[], &mut torque)?;
        scene.inverse_dynamics_derivatives(workspace, q, &rest, qd, &[], &mut of_torque)?;
        scene.forward_dynamics_derivatives(workspace, q, &rest, &torque, &[], &mut of_motion)?;
        let matrix = |of: &[f64], at: usize| DMatrix::from_row_slice(nv, nv, &of[at * size..(at + 1) * size]);
        let inverse = matrix(&of_motion, 2);
        self.by_q = matrix(&of_motion, 0) + &inverse * matrix(&of_torque, 0);
        self.projector = inverse * matrix(&of_torque, 2);
        Ok(())
    }

    /// Projects the rows of q and qd of some columns of a root, with the derivatives at the last state.
    pub fn project_columns<'a>(&self, plan: &Plan, columns: impl Iterator<Item = &'a mut [f64]>) {
        for column in columns {
            let own = DMatrix::from_column_slice(plan.nv, 2, &column[plan.q()..plan.states]);
            let mut moved = &self.projector * own;
            let turned = &self.by_q * moved.column(0);
            let mut rates = moved.column_mut(1);
            rates += turned;
            column[plan.q()..plan.states].copy_from_slice(moved.as_slice());
        }
    }

    /// A lower triangular root of the covariance of independent errors with these standard deviations of (q, qd), given
    /// that they satisfy the connections; (2 nv x 2 nv) by columns.
    pub fn conditioned(&self, deviations: &[f64]) -> Result<DMatrix<f64>, Error> {
        let (size, nv) = (deviations.len(), self.projector.nrows());
        let mut rows = DMatrix::identity(size, size);
        let turned = &self.by_q * &self.projector;
        for (at, part) in [((0, 0), &self.projector), ((nv, nv), &self.projector), ((nv, 0), &turned)] {
            let mut block = rows.view_mut(at, (nv, nv));
            block -= part;
        }
        // x = S y with S the deviations: y is free in the null space of the rows times S.
        for (mut column, deviation) in rows.column_iter_mut().zip(deviations) {
            column *= *deviation;
        }
        let lost = || Error::argument("initial", "deviations whose rows have no decomposition", "finite ones");
        let found = decompositions::singular_values(rows, false, true).ok_or_else(lost)?;
        let transposed = found.v_t.ok_or_else(lost)?;
        let largest = found.singular_values.max();
        let mut free = transposed.clone();
        for (mut row, value) in free.row_iter_mut().zip(&found.singular_values) {
            if *value > SINGULAR * largest {
                row.fill(0.0);
            }
        }
        for (mut column, deviation) in free.column_iter_mut().zip(deviations) {
            column *= *deviation;
        }
        Ok(free.qr().r().transpose())
    }
}
