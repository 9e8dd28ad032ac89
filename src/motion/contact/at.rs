//! Solves with M, the contacts and the connections at one configuration, for the adjoint of a step.

use super::super::step_settings::StepSettings;
use super::closed::constraints;
use super::faults::factorised;
use crate::dynamics::constraints::{ConstraintAdjoint, ConstraintScratch, Pushed, RowFault};
use crate::dynamics::contacts::ContactScratch;
use crate::error::Error;
use crate::model::Model;
use crate::scene::Scene;
use crate::scene::constraint::Constraints;
use crate::scene::contact_point::ContactPoint;
use crate::workspace::Workspace;
use nalgebra::DVector;

/// Joint velocities v of generalized impulses t, and the impulses lambda of the connections: M v = t + `J_k`* lambda,
/// `J_k` v = 0.
#[derive(Debug, Clone)]
pub(super) struct Moved {
    pub v: Vec<f64>,
    pub lambda: Vec<f64>,
}

/// The connections of a scene, or its coupled joints, and their adjoint.
pub(super) struct Connections {
    constraints: Constraints,
    scratch: ConstraintScratch,
    pub adjoint: ConstraintAdjoint,
    /// The configuration of the factors.
    q: Vec<f64>,
}

impl Connections {
    pub fn new(scene: &Scene, settings: &StepSettings, model: &Model<f64>, parameters: bool) -> Self {
        let constraints = constraints(scene, settings);
        Self {
            scratch: ConstraintScratch::new(model, &constraints),
            adjoint: ConstraintAdjoint::new(model, &constraints, parameters),
            q: vec![0.0; model.nq],
            constraints,
        }
    }
}

/// The model, the contacts, the connections and the scratch of a step.
pub(super) struct At<'a> {
    pub scene: &'a Scene,
    pub model: &'a Model<f64>,
    pub workspace: &'a mut Workspace<f64>,
    pub rows: &'a mut ContactScratch,
    pub connections: &'a mut Connections,
}

type System<'a> = (&'a Model<f64>, &'a Constraints);
type Room<'a> = (&'a mut Workspace<f64>, &'a mut ConstraintScratch);

impl<'a> At<'a> {
    pub fn points(&self) -> &'a [ContactPoint] {
        self.scene.contact_points()
    }

    /// Rows and factors of M and of the connections at `q`.
    pub fn place(&mut self, q: &[f64]) -> Result<(), (String, Error)> {
        self.place_rows(q);
        factorised(self.scene, (self.model, q), self.workspace)?;
        let Connections { constraints, scratch, .. } = &mut *self.connections;
        if constraints.is_empty() {
            return Ok(());
        }
        let factorised = scratch.factorise((self.model, constraints), self.workspace, q, &[]);
        factorised.map_err(|at| self.row_fault(at))
    }

    /// Rows at `q`, at which the factor of M already is.
    pub fn place_rows(&mut self, q: &[f64]) {
        self.rows.place(self.model, self.points(), q);
        self.connections.q.copy_from_slice(q);
    }

    /// The error of a rod without direction.
    pub fn row_fault(&self, at: RowFault) -> (String, Error) {
        (String::new(), self.scene.row_fault(at))
    }

    /// The connections with M, the scratch, and their adjoint.
    pub fn of_connections(&mut self) -> (System<'_>, Room<'_>, &mut ConstraintAdjoint) {
        let Connections { constraints, scratch, adjoint, .. } = &mut *self.connections;
        ((self.model, constraints), (&mut *self.workspace, scratch), adjoint)
    }

    /// J x of the contacts `near`.
    pub fn velocities(&mut self, near: &[usize], x: &[f64]) -> DVector<f64> {
        let all = self.rows.velocities(self.model, self.points(), x);
        DVector::from_fn(3 * near.len(), |i, _| all[3 * near[i / 3] + i % 3])
    }

    /// The response to `torque` + J* p.
    pub fn respond(&mut self, near: &[usize], torque: &[f64], p: &DVector<f64>) -> Moved {
        let mut all = torque.to_vec();
        self.add_torques(near, p, &mut all);
        self.solve(&all)
    }

    /// The response to `torque`.
    pub fn solve(&mut self, torque: &[f64]) -> Moved {
        let Connections { scratch, adjoint, .. } = &mut *self.connections;
        adjoint.solve(self.model, (&mut *self.workspace, scratch), (torque, &[]), &[]);
        Moved { v: adjoint.y.clone(), lambda: adjoint.r.iter().map(|r| -r).collect() }
    }

    /// out += J* p.
    pub fn add_torques(&mut self, near: &[usize], p: &DVector<f64>, out: &mut [f64]) {
        self.rows.add_torques(self.model, self.points(), (near, p), out);
    }

    /// Adds the gradient of lambda* `J_k`(q) m + mu* `J_k`(q) along - m* M(q) y by q to `out` for a response (y,
    /// lambda) and the response (m, mu) of the adjoint, and that by the inertias to the sums of the connections.
    pub fn add_gradient(
        &mut self,
        (response, adjoint_response): (&Moved, &Moved),
        along: &[f64],
        out: &mut [f64],
    ) -> Result<(), (String, Error)> {
        let Connections { constraints, adjoint, q, .. } = &mut *self.connections;
        adjoint.y.copy_from_slice(&adjoint_response.v);
        adjoint.r.iter_mut().zip(&adjoint_response.lambda).for_each(|(r, lambda)| *r = -lambda);
        let pushed = Pushed { x: &response.v, p: &response.lambda };
        let added = adjoint.add_response((self.model, constraints), self.workspace, q, pushed, along, out);
        added.map_err(|at| self.row_fault(at))
    }
}
