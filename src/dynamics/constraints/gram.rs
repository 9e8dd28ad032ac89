//! G = J M^-1 J* as the Gram matrix of the innovations of unit forces along the rows.

use super::RowFault;
use super::gram_inverse::GramInverse;
use super::rows::{begin, units_of_rows};
use super::scratch::ConstraintScratch;
use crate::dynamics::sweeps::{SweepScratch, general};
use crate::filter::{HingeMap, innovations};
use crate::kinematics::propagation::tip_to_base;
use crate::model::Model;
use crate::scene::constraint::{Constraint, Constraints};
use crate::spatial::linear;
use crate::workspace::Workspace;
use nalgebra::DMatrix;

impl ConstraintScratch {
    /// W and (G + compliance)^+ at `q`, with the factor of M in the workspace. An empty compliance means zero.
    pub(crate) fn factorise(
        &mut self,
        (model, constraints): (&Model<f64>, &Constraints),
        workspace: &Workspace<f64>,
        q: &[f64],
        compliance: &[f64],
    ) -> Result<(), RowFault> {
        units_of_rows(model, constraints, (q, &workspace.rest), &mut self.units)?;
        for constraint in &constraints.all {
            for i in constraint.rows() {
                self.whiten(model, workspace, constraint, i);
            }
        }
        let mut gram = self.gram(model, constraints);
        for (i, compliance) in compliance.iter().enumerate() {
            gram[(i, i)] += compliance;
        }
        for i in 0..constraints.rows {
            // The entries of a row are finite if that on the diagonal is, the sum of their squares.
            if let Some(wrong) = [gram[(i, i)], self.sizes[i]].into_iter().find(|entry| !entry.is_finite()) {
                return Err(RowFault::NotFinite(i, wrong));
            }
        }
        self.relax((model, constraints), &workspace.store.shifts, q, compliance)?;
        let inverse = GramInverse::of(&gram, &self.sizes, self.relaxed.basis());
        self.inverse = inverse.ok_or(RowFault::NotFinite(0, f64::NAN))?;
        Ok(())
    }

    /// Row i of W*: a unit force along row i is propagated inward from the bodies on which it acts, through the
    /// measurements of each joint.
    fn whiten(&mut self, model: &Model<f64>, workspace: &Workspace<f64>, constraint: &Constraint, i: usize) {
        let Self { units, state, whitened, sizes, torque, estimates, .. } = self;
        let (system, nv) = (&model.system, model.nv());
        let SweepScratch { shifts, measured, .. } = &workspace.store;
        // The measurement is the torque of the row. A force on a body reduces the force that its joint transmits.
        begin(constraint, &units[i], state, -1.0);
        torque.fill(0.0);
        for (v, unit) in units[i].torques.into_iter().flatten() {
            torque[v] = unit;
        }
        let out = &mut whitened[i * nv..(i + 1) * nv];
        let mut square = 0.0;
        tip_to_base(&system.stages, shifts, constraint.path.iter().copied(), state, |k, z| {
            let stage = &system.stages[k];
            for row in 0..stage.rows.count() {
                let size = match stage.rows.row(row) {
                    HingeMap::Axis(axis) if axis < 3 => z.moment,
                    HingeMap::Axis(_) => linear(&z.force).norm(),
                    HingeMap::Screw(pitch) => z.moment + pitch.abs() * linear(&z.force).norm(),
                } + torque[stage.first_row + row].abs();
                square += size * size * measured[stage.first_row + row].pivot_inverse;
            }
            innovations::through_stage((system, k), measured, torque, &mut z.force, estimates);
            for row in stage.first_row..stage.first_row + stage.rows.count() {
                out[row] = estimates[row] * measured[row].pivot_inverse.sqrt();
            }
        });
        sizes[i] = square.sqrt();
    }

    /// W* W, summed over the joints that two connections share.
    fn gram(&self, model: &Model<f64>, constraints: &Constraints) -> DMatrix<f64> {
        let nv = model.nv();
        let mut gram = DMatrix::zeros(constraints.rows, constraints.rows);
        for (at, first) in constraints.all.iter().enumerate() {
            for second in &constraints.all[at..] {
                for k in common(&first.path, &second.path) {
                    let stage = &model.system.stages[k];
                    let joint = stage.first_row..stage.first_row + stage.rows.count();
                    for i in first.rows() {
                        for j in second.rows().filter(|&j| j >= i) {
                            let product = |row: usize| self.whitened[i * nv + row] * self.whitened[j * nv + row];
                            gram[(i, j)] += joint.clone().map(product).sum::<f64>();
                        }
                    }
                }
            }
        }
        gram.fill_lower_triangle_with_upper_triangle();
        gram
    }

    /// Row i of W*, (nv), for combinations of whitened rows.
    pub(super) fn whitened_row(&self, i: usize, nv: usize) -> &[f64] {
        &self.whitened[i * nv..(i + 1) * nv]
    }

    /// Sets `wrenches` and `torque` to the forces of the rows `step` on bodies and at joints.
    pub(super) fn spread(&mut self, step: &[f64]) {
        self.wrenches.fill(nalgebra::Vector6::zeros());
        self.torque.fill(0.0);
        for (unit, &lambda) in self.units.iter().zip(step) {
            for (k, force) in unit.forces.into_iter().flatten() {
                self.wrenches[k] += force * lambda;
            }
            for (v, torque) in unit.torques.into_iter().flatten() {
                self.torque[v] += torque * lambda;
            }
        }
    }

    /// M^-1 J* of the forces that [`ConstraintScratch::spread`] has set, into `estimates`: one more right-hand side.
    /// O(N).
    pub(super) fn respond(&mut self, model: &Model<f64>, workspace: &mut Workspace<f64>) {
        let (scene, store) = workspace.passes(model);
        store.set_forces(self.wrenches.iter().map(|wrench| -wrench));
        general::solve::<f64, true>(scene, store, &self.torque, &mut self.estimates);
    }
}

/// The common entries of two decreasing lists.
fn common<'a>(first: &'a [usize], second: &'a [usize]) -> impl Iterator<Item = usize> + 'a {
    let mut at = 0;
    first.iter().copied().filter(move |&k| {
        while second.get(at).is_some_and(|&other| other > k) {
            at += 1;
        }
        second.get(at) == Some(&k)
    })
}
