//! Derivatives on one state by the passes on the general model, with argument checks and error messages.

use super::constraints::{self, ConstraintAdjoint, ConstraintScratch, RowFault};
use super::derivatives::{
    self, ConstantParts, Constants, DerivativeScratch, Directions, GradientParts, HessianScratch, ProductScratch,
    constants_of,
};
use super::forces::Motion;
use crate::algorithm::{Arguments, Derivatives, Products};
use crate::error::{Error, check_finite};
use crate::interrupt;
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::Workspace;

impl Scene {
    /// Products of a scene with connections, in O(N + m^2 depth + m^3) for m rows.
    fn products_through_connections(
        &self,
        workspace: &mut Workspace<f64>,
        which: Products,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let (system, wrenches, seed) = ((self.model(), self.constraints()), state.wrenches, state.seed);
        let bodies = self.model().bodies.len();
        self.at_constrained_state(workspace, state, |workspace, (rows, adjoint), at| {
            if which.is_gradient() {
                return with_constants(which, (out, self.nv(), bodies), |constants, out| {
                    let wanted = (wrenches, seed[0], &[][..]);
                    adjoint.of_dynamics(system, (workspace, rows), at, wanted, (constants, out))
                });
            }
            let mut forces = Vec::new();
            let along = Directions::of_seed(seed, bodies, &mut forces);
            adjoint.along_dynamics(system, (workspace, rows), at, (wrenches, &along), out)
        })
    }

    /// The Hessian of forward dynamics of a scene with connections, times a direction.
    pub(crate) fn hvp_through_connections(
        &self,
        workspace: &mut Workspace<f64>,
        hessian: &mut HessianScratch,
        state: &Arguments<'_>,
        direction: [&[f64]; 3],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let (system, wrenches, cotangent) = ((self.model(), self.constraints()), state.wrenches, state.seed[0]);
        self.at_constrained_state(workspace, state, |workspace, (rows, adjoint), at| {
            let room = ((workspace, rows), (adjoint, hessian));
            let motion = Motion { q: at.0, qd: at.1, qdd: Some(at.2), wrenches };
            constraints::constrained_hvp(system, room.0, room.1, motion, (cotangent, direction), out)
        })
    }

    /// Calls `then` with scratch and with (q, qd, qdd) at a state of a scene with connections.
    fn at_constrained_state(
        &self,
        workspace: &mut Workspace<f64>,
        &Arguments { q, qd, u, wrenches, .. }: &Arguments<'_>,
        then: impl FnOnce(
            &mut Workspace<f64>,
            (&mut ConstraintScratch, &mut ConstraintAdjoint),
            (&[f64], &[f64], &[f64]),
        ) -> Result<(), RowFault>,
    ) -> Result<(), Error> {
        let (model, constraints) = (self.model(), self.constraints());
        let mut rows = workspace.connected.take(self.identity(), || ConstraintScratch::new(model, constraints));
        let new = || ConstraintAdjoint::new(model, constraints, false);
        let mut adjoint = workspace.connected_products.take(self.identity(), new);
        let mut qdd = vec![f64::NAN; self.nv()];
        let done = self
            .accelerations_through_connections(workspace, &mut rows.1, (q, qd, u), (wrenches, &[]), &mut qdd)
            .and_then(|_| self.check_result("forward dynamics", &qdd))
            .and_then(|()| {
                let scratch = (&mut rows.1, &mut adjoint.1);
                then(workspace, scratch, (q, qd, &qdd)).map_err(|at| self.row_fault(at))
            });
        workspace.connected.keep(rows);
        workspace.connected_products.keep(adjoint);
        done
    }

    /// Derivatives at one state, with argument checks and temporary scratch.
    pub(super) fn derivatives(
        &self,
        workspace: &mut Workspace<f64>,
        which: Derivatives,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let &Arguments { q, qd, u, wrenches, .. } = state;
        let model = self.model();
        if matches!(which, Derivatives::ForwardDynamics(_)) && !self.constraints().is_empty() {
            let system = (model, self.constraints());
            return self.at_constrained_state(workspace, state, |workspace, (rows, _), at| {
                constraints::constrained_derivatives(system, workspace, rows, at, wrenches, out)
            });
        }
        let scratch = &mut DerivativeScratch::new(model);
        derivatives::of_state(which, model, (workspace, scratch), (q, qd, u), wrenches, out)
            .map_err(|lost| self.singular(lost))?;
        // Derivatives of forward dynamics end early at an interruption.
        if matches!(which, Derivatives::ForwardDynamics(_)) { interrupt::check() } else { Ok(()) }
    }

    /// Products at one state, with argument checks and temporary scratch.
    pub(super) fn products(
        &self,
        workspace: &mut Workspace<f64>,
        which: Products,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        if which.form().is_some() && !self.constraints().is_empty() {
            return self.products_through_connections(workspace, which, state, out);
        }
        let &Arguments { q, qd, u: given, wrenches, seed, .. } = state;
        let (model, at, bodies) = (self.model(), (q, qd, given), self.model().bodies.len());
        let scratch = &mut ProductScratch::new(model);
        if which.is_gradient() {
            return with_constants(which, (out, self.nv(), bodies), |constants, out| {
                let results = (constants, out);
                if which.form().is_some() {
                    return derivatives::forward_dynamics_vjp(
                        model, workspace, scratch, at, wrenches, seed[0], results,
                    );
                }
                derivatives::inverse_dynamics_vjp(model, workspace, scratch, at, wrenches, seed[0], results);
                Ok(())
            })
            .map_err(|lost| self.singular(lost));
        }
        let mut forces = Vec::new();
        let along = Directions::of_seed(seed, bodies, &mut forces);
        if which.form().is_some() {
            return derivatives::forward_dynamics_jvp(model, workspace, scratch, at, wrenches, &along, out)
                .map_err(|lost| self.singular(lost));
        }
        derivatives::inverse_dynamics_jvp(model, workspace, scratch, at, wrenches, &along, out);
        Ok(())
    }

    /// Checks the values of one vector of a seed, and of the changes of constants that follow it.
    pub(super) fn check_changes(&self, name: &str, seed: &[f64]) -> Result<(), Error> {
        let (nv, bodies) = (self.nv(), self.model().bodies.len());
        let (own, rest) = seed.split_at(nv);
        check_finite(name, own)?;
        if !rest.is_empty() {
            let names = ["darmature", "dgravity", "dwrenches", "dparameters"];
            for (name, part) in names.into_iter().zip(constants_of(rest, nv, bodies)) {
                check_finite(name, part)?;
            }
        }
        Ok(())
    }
}

/// Calls `gradients` with the parts of `out`: the gradients by the constants, if the product gives them, and (3 x nv).
fn with_constants<E>(
    which: Products,
    (out, nv, bodies): (&mut [f64], usize, usize),
    gradients: impl FnOnce(&mut Constants<'_, f64>, &mut [f64]) -> Result<(), E>,
) -> Result<(), E> {
    if !which.gives_constants() {
        return gradients(&mut Constants::default(), out);
    }
    let GradientParts { state, constants } = GradientParts::of(out, nv, bodies);
    let ConstantParts { armature, gravity, wrenches, parameters } = constants;
    let mut forces = vec![SpatialVector::zeros(); bodies];
    gradients(&mut Constants { wrenches: &mut forces, parameters, armature, gravity }, state)?;
    for (to, force) in wrenches.iter_mut().zip(&forces) {
        *to = (*force).into();
    }
    Ok(())
}
