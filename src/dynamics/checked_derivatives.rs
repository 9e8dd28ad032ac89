//! Derivatives on one state by the passes on the general model, with argument checks and error messages.

use super::constraints::{self, ConstraintScratch};
use super::derivatives::{
    self, ConstantParts, Constants, DerivativeScratch, Directions, GradientParts, ProductScratch, constants_of,
};
use crate::algorithm::{Arguments, Derivatives, Products};
use crate::error::{Error, check_finite};
use crate::interrupt;
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::Workspace;

impl Scene {
    /// dqdd/dq, dqdd/dqd and dqdd/dtau of a scene with connections. Returns qdd.
    fn derivatives_through_connections(
        &self,
        workspace: &mut Workspace<f64>,
        (q, qd, tau): (&[f64], &[f64], &[f64]),
        wrenches: &[SpatialVector<f64>],
        out: &mut [f64],
    ) -> Result<Vec<f64>, Error> {
        let scratch = &mut ConstraintScratch::new(self.model(), self.constraints());
        let mut qdd = vec![f64::NAN; self.nv()];
        self.accelerations_through_connections(workspace, scratch, (q, qd, tau), (wrenches, &[]), &mut qdd)?;
        self.check_result("forward dynamics", &qdd)?;
        let system = (self.model(), self.constraints());
        constraints::constrained_derivatives(system, workspace, scratch, (q, qd, &qdd), wrenches, out)
            .map_err(|at| self.row_fault(at))?;
        Ok(qdd)
    }

    /// Products with these matrices. The rows of the connections do not depend on the constants (armature, gravity,
    /// wrenches, inertial parameters). A change of a constant therefore gives dqdd = -Mc dID, with the third matrix Mc
    /// and the change dID of inverse dynamics at the accelerations of the state.
    fn products_through_connections(
        &self,
        workspace: &mut Workspace<f64>,
        which: Products,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let &Arguments { q, qd, u, wrenches, seed: [first, second, third], tolerance: _ } = state;
        let nv = self.nv();
        let mut three = vec![f64::NAN; 3 * nv * nv];
        let qdd = self.derivatives_through_connections(workspace, (q, qd, u), wrenches, &mut three)?;
        let (at, zeros) = (Arguments { u: &qdd, ..*state }, vec![0.0; nv]);
        if which.gives_constants() {
            let mut of_state = vec![f64::NAN; 3 * nv];
            multiply(&three, which, state.seed, &mut of_state);
            let minus: Vec<f64> = of_state[2 * nv..].iter().map(|x| -x).collect();
            self.products(workspace, Products::InverseGradients, &Arguments { seed: [&minus, &[], &[]], ..at }, out)?;
            GradientParts::of(out, nv, self.model().bodies.len()).state.copy_from_slice(&of_state);
        } else if which.takes_constants() {
            let mut constant = third.to_vec();
            constant[..nv].fill(0.0);
            let along = Arguments { seed: [&zeros, &zeros, &constant], ..at };
            let mut right = vec![f64::NAN; nv];
            self.products(workspace, Products::InverseTangents, &along, &mut right)?;
            right.iter_mut().zip(third).for_each(|(right, dtau)| *right = dtau - *right);
            multiply(&three, which, [first, second, &right], out);
        } else {
            multiply(&three, which, state.seed, out);
        }
        Ok(())
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
            return self.derivatives_through_connections(workspace, (q, qd, u), wrenches, out).map(|_| ());
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
        mut out: &mut [f64],
    ) -> Result<(), Error> {
        if which.form().is_some() && !self.constraints().is_empty() {
            return self.products_through_connections(workspace, which, state, out);
        }
        let &Arguments { q, qd, u: given, wrenches, seed, .. } = state;
        let (model, at) = (self.model(), (q, qd, given));
        let scratch = &mut ProductScratch::new(model);
        let (mut constants, mut forces, mut by_wrenches) = (Constants::default(), Vec::new(), &mut [][..]);
        let bodies = model.bodies.len();
        if which.gives_constants() {
            let parts = GradientParts::of(out, self.nv(), bodies);
            forces.resize(bodies, SpatialVector::zeros());
            let ConstantParts { armature, gravity, wrenches, parameters } = parts.constants;
            (out, by_wrenches) = (parts.state, wrenches);
            constants = Constants { wrenches: &mut forces, parameters, armature, gravity };
        }
        match which {
            Products::InverseTangent | Products::InverseTangents => {
                let along = Directions::of_seed(seed, bodies, &mut forces);
                derivatives::inverse_dynamics_jvp(model, workspace, scratch, at, wrenches, &along, out);
                Ok(())
            }
            Products::InverseGradient | Products::InverseGradients => {
                derivatives::inverse_dynamics_vjp(
                    model,
                    workspace,
                    scratch,
                    at,
                    wrenches,
                    seed[0],
                    (&mut constants, out),
                );
                Ok(())
            }
            Products::ForwardTangent(_) | Products::ForwardTangents(_) => {
                let along = Directions::of_seed(seed, bodies, &mut forces);
                derivatives::forward_dynamics_jvp(model, workspace, scratch, at, wrenches, &along, out)
            }
            Products::ForwardGradient(_) | Products::ForwardGradients(_) => {
                let results = (&mut constants, out);
                derivatives::forward_dynamics_vjp(model, workspace, scratch, at, wrenches, seed[0], results)
            }
        }
        .map_err(|lost| self.singular(lost))?;
        for (to, force) in by_wrenches.iter_mut().zip(&forces) {
            *to = (*force).into();
        }
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

/// A product of forward dynamics from its three Jacobians, (nv x nv) each row by row.
fn multiply(three: &[f64], which: Products, [first, second, third]: [&[f64]; 3], out: &mut [f64]) {
    let nv = first.len().max(1);
    out.fill(0.0);
    let matrices = three.chunks_exact(nv * nv);
    if matches!(which, Products::ForwardTangent(_) | Products::ForwardTangents(_)) {
        for (matrix, x) in matrices.zip([first, second, third]) {
            for (out, row) in out.iter_mut().zip(matrix.chunks_exact(nv)) {
                *out += row.iter().zip(x).map(|(a, x)| a * x).sum::<f64>();
            }
        }
        return;
    }
    for (matrix, out) in matrices.zip(out.chunks_exact_mut(nv)) {
        for (row, &cotangent) in matrix.chunks_exact(nv).zip(first) {
            out.iter_mut().zip(row).for_each(|(out, a)| *out += cotangent * a);
        }
    }
}
