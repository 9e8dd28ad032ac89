//! Elimination of the rows of connections from steps with contacts, without subtraction of Gram matrices.
//!
//! Let `W_k` be the whitened rows of the connections, one column each, and C the combinations of them that are kept,
//! scaled. A QR factorization with column pivoting, `W_k` C = Q R, drops dependent columns. For contacts with whitened
//! rows `W_c` and impulses p,
//!
//! ```text
//! M dv = J_c* p + J_k* lambda,   J_k dv = 0
//! J_c dv = W* W p,   dv = (1 - L*) D^-1/2 W p,   W = W_c - Q (Q* W_c)
//! ```

use super::RowFault;
use super::gram_inverse::NOTHING;
use super::projection::{Projected, ProjectionStep, project_positions, project_velocities};
use super::scratch::ConstraintScratch;
use crate::decompositions::column_basis;
use crate::model::Model;
use crate::scene::constraint::Constraints;
use crate::workspace::Workspace;
use nalgebra::DMatrix;

/// Diagonal entries of R below this count as zero: the root of the bound for eigenvalues of Gram matrices.
const LOST: f64 = 3e-7;

/// Connections of a scene, and their elimination at one configuration.
#[derive(Debug, Clone)]
pub(crate) struct Elimination {
    constraints: Constraints,
    scratch: ConstraintScratch,
    /// Q, (nv x rank).
    basis: DMatrix<f64>,
}

impl Elimination {
    pub fn new(model: &Model<f64>, constraints: Constraints) -> Self {
        let scratch = ConstraintScratch::new(model, &constraints);
        Self { constraints, scratch, basis: DMatrix::zeros(0, 0) }
    }

    /// Projects `v` onto the velocities that satisfy the connections at `q`, and factorizes their rows. The workspace
    /// then has the factor of M at `q`.
    pub fn velocities(
        &mut self,
        model: &Model<f64>,
        workspace: &mut Workspace<f64>,
        (q, v): (&[f64], &mut [f64]),
    ) -> Result<Projected, RowFault> {
        let projected = project_velocities((model, &self.constraints), workspace, &mut self.scratch, (q, v), &[])?;
        self.orthogonalize(workspace)?;
        Ok(projected)
    }

    /// Projects `q` onto the connections; adds the steps to `steps`, as [`project_positions`].
    pub fn positions(
        &mut self,
        model: &Model<f64>,
        workspace: &mut Workspace<f64>,
        q: &mut [f64],
        steps: Option<&mut Vec<ProjectionStep>>,
    ) -> Result<Projected, RowFault> {
        project_positions((model, &self.constraints), workspace, &mut self.scratch, (q, &[]), steps)
    }

    /// The forces of the last projection.
    pub fn forces(&self) -> &[f64] {
        &self.scratch.forces
    }

    /// Factorizes the rows at `q`, with the factor of M in the workspace.
    pub fn factorize(&mut self, model: &Model<f64>, workspace: &Workspace<f64>, q: &[f64]) -> Result<(), RowFault> {
        self.scratch.factorise((model, &self.constraints), workspace, q, &[])?;
        self.orthogonalize(workspace)
    }

    /// Q from the whitened rows in the scratch.
    fn orthogonalize(&mut self, workspace: &Workspace<f64>) -> Result<(), RowFault> {
        let Self { constraints, scratch, .. } = self;
        let (m, sizes) = (constraints.rows, &scratch.rows.whitened.sizes);
        let combined = scratch.relaxed.basis().map_or_else(|| DMatrix::identity(m, m), DMatrix::transpose);
        let mut columns = scratch.whitened(&workspace.store) * &combined;
        for j in 0..columns.ncols() {
            let size = combined.column(j).iter().zip(sizes).map(|(c, size)| c * c * size).sum::<f64>();
            let (norm, size) = (columns.column(j).norm(), size.sqrt());
            let scale = if norm > NOTHING * size { norm.recip() } else { 0.0 };
            columns.column_mut(j).scale_mut(scale);
        }
        self.basis = column_basis(columns, LOST).ok_or(RowFault::NotFinite(0, f64::NAN))?;
        Ok(())
    }

    /// Replaces the whitened rows of contacts, one column each, by their projection onto the complement of Q. A second
    /// projection removes the rounding errors of the first.
    pub fn project(&self, whitened: &mut DMatrix<f64>) {
        for _ in 0..2 {
            let part = self.basis.tr_mul(&*whitened);
            whitened.gemm(-1.0, &self.basis, &part, 1.0);
        }
    }
}
