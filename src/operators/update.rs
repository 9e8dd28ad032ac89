//! The update of a factor to another configuration, for the bodies affected by the difference.

use super::Factor;
use crate::dynamics::sweeps::general;
use crate::error::Error;
use crate::filter::Form;
use crate::filter::pivots::PivotMonitor;
use crate::kinematics::joint_shift;
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::Scene;
use crate::workspace::Workspace;

/// The result of an update.
#[derive(Debug, Clone, Copy)]
pub struct Updated<T> {
    /// Number of recomputed bodies: bodies whose joints moved (phi), and all their ancestors (P, D and g).
    pub bodies: usize,
    /// The pivots of the recomputed bodies.
    pub pivots: PivotMonitor<T>,
}

/// The change of a body.
#[derive(Clone, Copy, PartialEq)]
enum Change {
    /// No change.
    None,
    /// Its joint moved: phi changes.
    Joint,
    /// A joint outboard of it moved: P, D and g change; phi changes if its own joint moved too.
    Inertia,
}

impl<T: Real> Factor<T> {
    /// Updates the factor to `q`, with the same bits as [`Factor::new`] at `q`.
    ///
    /// phi(k) depends on joint k only, and P(k), D(k), g(k) on the joints outboard of body k. Only phi of the changed
    /// joints and P, D, g of their ancestors are computed, from P^+ of unchanged bodies. This holds in covariance form;
    /// the other forms estimate the error of the whole factor and recompute it with `workspace`. `model` is the model
    /// of the factor.
    ///
    /// # Panics
    ///
    /// If `q` is shorter than the model requires, or if the model or workspace is another one; [`Scene::update_factor`]
    /// returns errors.
    pub fn update(&mut self, model: &Model<T>, workspace: &mut Workspace<T>, q: &[T]) -> Updated<T> {
        match self.sweep.form {
            Form::Covariance => self.update_covariance(model, workspace, q),
            form @ (Form::Auto | Form::SquareRoot) => {
                (workspace.form, workspace.tolerance) = (form, self.sweep.tolerance);
                let (factor, pivots) = Self::new(model, workspace, q);
                *self = factor;
                Updated { bodies: model.bodies.len(), pivots }
            }
        }
    }

    /// The update in covariance form: the pass over the affected bodies, with the store of the workspace in the state
    /// that it had for this factor.
    fn update_covariance(&mut self, model: &Model<T>, workspace: &mut Workspace<T>, q: &[T]) -> Updated<T> {
        let changes = self.take_configuration(model, q);
        let is_changed = |k: usize| changes[k] == Change::Inertia;
        workspace.store.shifts.copy_from_slice(&self.shift);
        workspace.store.measured.copy_from_slice(&self.measured);
        workspace.store.covariances_mut().copy_from_slice(&self.sweep.arrived);
        let (scene, store) = workspace.passes(model);
        let pivots = general::update_factor(scene, store, &is_changed);
        self.measured.copy_from_slice(&workspace.store.measured);
        self.sweep.arrived.copy_from_slice(workspace.store.covariances());
        self.forces.take();
        self.co_states.take();
        Updated { bodies: changes.iter().filter(|&&change| change != Change::None).count(), pivots }
    }

    /// Stores `q` and phi of every changed joint. Returns the change of each body.
    fn take_configuration(&mut self, model: &Model<T>, q: &[T]) -> Vec<Change> {
        let mut changes = vec![Change::None; model.bodies.len()];
        for (k, (body, stage)) in model.bodies.iter().zip(&self.system.stages).enumerate() {
            let own = body.q..body.q + body.motion.nq();
            if self.sweep.q[own.clone()].iter().zip(&q[own]).all(|(&before, &after)| is_same(before, after)) {
                continue;
            }
            self.shift[k] = joint_shift(body, q);
            if changes[k] == Change::None {
                changes[k] = Change::Joint;
            }
            let mut carrier = stage.parent;
            while let Some(parent) = carrier.filter(|&parent| changes[parent] != Change::Inertia) {
                changes[parent] = Change::Inertia;
                carrier = self.system.stages[parent].parent;
            }
        }
        self.sweep.q.copy_from_slice(q);
        changes
    }
}

/// True if two values are identical, including the sign of a zero, which affects a bit of a sine.
fn is_same<T: Real>(before: T, after: T) -> bool {
    before == after && (0..T::LANES).all(|lane| before.lane(lane).to_bits() == after.lane(lane).to_bits())
}

impl Scene {
    /// Moves a factor of this scene to `q`, with the same bits as a new factor at `q`. Returns the number of recomputed
    /// bodies: see [`Factor::update`].
    ///
    /// The factor keeps its form. The cost is that of the bodies between the changed joints and the base, and one
    /// comparison per coordinate.
    ///
    /// # Errors
    ///
    /// As [`Scene::factor`], and [`Error::Argument`] for a factor of another scene; the factor is then unchanged.
    pub fn update_factor(
        &self,
        workspace: &mut Workspace<f64>,
        factor: &mut Factor<f64>,
        q: &[f64],
    ) -> Result<usize, Error> {
        let model = self.model();
        self.check_scratch("factor", factor.sweep.identity, "scene.factor()")?;
        self.check_workspace(workspace)?;
        self.check_configuration("q", q)?;
        if matches!(factor.sweep.form, Form::Auto | Form::SquareRoot) {
            (workspace.form, workspace.tolerance) = (factor.sweep.form, factor.sweep.tolerance);
            *factor = self.factor(workspace, q)?;
            return Ok(model.bodies.len());
        }
        let before = factor.sweep.q.clone();
        let Updated { bodies, pivots } = factor.update(model, workspace, q);
        if let Some(lost) = workspace.lost_pivot(model, &pivots) {
            let error = self.singular(lost);
            factor.update(model, workspace, &before);
            return Err(error);
        }
        Ok(bodies)
    }
}
