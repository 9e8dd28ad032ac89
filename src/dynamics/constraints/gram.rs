//! G = J M^-1 J* and its pseudoinverse, and responses to forces of the rows.

use super::RowFault;
use super::gram_inverse::GramInverse;
use super::scratch::ConstraintScratch;
use crate::dynamics::sweeps::{SweepScratch, WhitenedRows, general};
use crate::model::Model;
use crate::scene::constraint::Constraints;
use crate::workspace::Workspace;
use nalgebra::{DMatrix, Vector6};

impl ConstraintScratch {
    /// W and (G + compliance)^+ at `q`, with the factor of M in the workspace. An empty compliance means zero.
    pub(crate) fn factorise(
        &mut self,
        system: (&Model<f64>, &Constraints),
        workspace: &Workspace<f64>,
        q: &[f64],
        compliance: &[f64],
    ) -> Result<(), RowFault> {
        self.factorise_moving(system, workspace, (q, &workspace.rest), compliance)
    }

    /// The same, with J qd and J' qd of the rows.
    pub(super) fn factorise_moving(
        &mut self,
        (model, constraints): (&Model<f64>, &Constraints),
        workspace: &Workspace<f64>,
        (q, qd): (&[f64], &[f64]),
        compliance: &[f64],
    ) -> Result<(), RowFault> {
        self.rows.whiten((model, &workspace.sweeps), &workspace.store, (q, qd), [f64::INFINITY; 2]);
        self.rows.check()?;
        let (m, WhitenedRows { gram, sizes, .. }) = (constraints.rows, &self.rows.whitened);
        let mut gram = DMatrix::from_fn(m, m, |i, j| gram[i.max(j) * m + i.min(j)]);
        for (i, compliance) in compliance.iter().enumerate() {
            gram[(i, i)] += compliance;
        }
        for i in 0..m {
            // The entries of a row are finite if that on the diagonal is, the sum of their squares.
            if let Some(wrong) = [gram[(i, i)], sizes[i]].into_iter().find(|entry| !entry.is_finite()) {
                return Err(RowFault::NotFinite(i, wrong));
            }
        }
        self.relax((model, constraints), &workspace.store.shifts, q, compliance)?;
        let inverse = GramInverse::of(&gram, &self.rows.whitened.sizes, self.relaxed.basis());
        self.inverse = inverse.ok_or(RowFault::NotFinite(0, f64::NAN))?;
        Ok(())
    }

    /// W, (nv x m), with the factor of M in the store.
    pub(super) fn whitened(&self, store: &SweepScratch<f64>) -> DMatrix<f64> {
        let w = &self.rows.whitened;
        let mut out = DMatrix::zeros(store.measured.len(), w.sizes.len());
        w.scaled(&store.measured, out.as_mut_slice());
        out
    }

    /// Sets `wrenches` and `torque` to the forces of the rows on bodies and at joints.
    pub(super) fn spread(&mut self) {
        self.wrenches.fill(Vector6::zeros());
        self.torque.fill(0.0);
        self.rows.add_forces(&self.forces, (&mut self.wrenches, &mut self.torque), 1.0);
    }

    /// M^-1 J* of the forces `step`, into `estimates`: one more right-hand side. O(N).
    pub(super) fn respond(&mut self, model: &Model<f64>, workspace: &mut Workspace<f64>, step: &[f64]) {
        self.estimates.fill(0.0);
        self.rows.whitened.add(step, &mut self.estimates);
        let (scene, store) = workspace.passes(model);
        general::smooth(scene, store, &mut self.estimates);
    }
}
