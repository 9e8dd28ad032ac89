//! Products with the Jacobians of the dynamics at one state (forward and reverse mode, Hessian products). Each method
//! checks its arguments before it computes.

use super::declared::algorithms;
use crate::algorithm::{Algorithm, Arguments, FORWARD_DYNAMICS_JVP, INVERSE_DYNAMICS_JVP, Products};
use crate::dynamics::derivatives::{self, HessianScratch};
use crate::error::{Error, check_length};
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::Workspace;

impl Scene {
    /// Scratch memory for [`Scene::inverse_dynamics_hvp`] and [`Scene::forward_dynamics_hvp`].
    #[must_use]
    pub fn hessian_scratch(&self) -> HessianScratch {
        HessianScratch::new(self.model())
    }

    /// [`Scene::inverse_dynamics_jvp`] along a direction that also changes wrenches, inertias, armature and gravity.
    ///
    /// In `state`, u is qdd, and the seed is that of [`Products::tangent`] with constants, whose third part has
    /// [`Scene::seed_width`] entries; bodies and body frames are those of [`Scene::model`]. O(N).
    ///
    /// # Errors
    ///
    /// As [`Scene::inverse_dynamics_jvp`].
    pub fn inverse_dynamics_along(
        &self,
        workspace: &mut Workspace<f64>,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.run_one(workspace, None, Algorithm::Products(Products::tangent(None).with_constants()), state, out)
    }

    /// [`Scene::forward_dynamics_jvp`] along a direction that also changes wrenches, inertias, armature and gravity.
    ///
    /// In `state`, u is tau; the seed is as in [`Scene::inverse_dynamics_along`]. O(N).
    ///
    /// # Errors
    ///
    /// As [`Scene::forward_dynamics_jvp`].
    pub fn forward_dynamics_along(
        &self,
        workspace: &mut Workspace<f64>,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let algorithm = Algorithm::Products(Products::tangent(Some(workspace.form)).with_constants());
        self.run_one(workspace, None, algorithm, state, out)
    }

    /// Hessian of x . tau of inverse dynamics times the direction (dq, dqd, dqdd), (3 x nv), written to `out`.
    ///
    /// This is the directional derivative of the gradients of [`Scene::inverse_dynamics_vjp`]; see
    /// [`derivatives::inverse_dynamics_hvp`]. In `state`, u is qdd, and the first seed is the cotangent x. The general
    /// recursion on dual numbers computes the result. O(N).
    ///
    /// # Errors
    ///
    /// As [`Scene::inverse_dynamics_vjp`].
    pub fn inverse_dynamics_hvp(
        &self,
        scratch: &mut HessianScratch,
        state: &Arguments<'_>,
        direction: [&[f64]; 3],
        out: &mut [f64],
    ) -> Result<(), Error> {
        state.check_of_scene("inverse_dynamics_hvp")?;
        self.check_product_state(Products::gradient(None), state, (scratch.identity(), out.len()))?;
        for ((name, _), direction) in INVERSE_DYNAMICS_JVP.seeds().iter().zip(direction) {
            self.check_rates(name, direction)?;
        }
        let q = self.tree_configuration("q", state.q)?;
        let rates = |x| self.tree_rates("", x);
        let (qd, qdd, cotangent) = (rates(state.qd)?, rates(state.u)?, rates(state.seed[0])?);
        let [dq, dqd, dqdd] = direction.map(rates);
        let (dq, dqd, dqdd) = (dq?, dqd?, dqdd?);
        let mut on_tree = |out: &mut [f64]| {
            let (at, along) = ((&*q, &*qd, &*qdd), [&*dq, &*dqd, &*dqdd]);
            derivatives::inverse_dynamics_hvp(self.model(), scratch, at, state.wrenches, &cotangent, along, out);
        };
        match self.coupling() {
            None => on_tree(out),
            Some(coupling) => {
                let full = self.model().nv();
                let mut three = vec![f64::NAN; 3 * full];
                on_tree(&mut three);
                for (of, out) in three.chunks_exact(full.max(1)).zip(out.chunks_exact_mut(self.nv().max(1))) {
                    coupling.reduce(of, out);
                }
            }
        }
        self.check_result("derivatives", out)
    }

    /// Hessian of c . qdd of forward dynamics times the direction (dq, dqd, dtau), (3 x nv), written to `out`.
    ///
    /// This is the directional derivative of the gradients of [`Scene::forward_dynamics_vjp`]; see
    /// [`derivatives::forward_dynamics_hvp`]. In `state`, u is tau, and the first seed is the cotangent c. The factor
    /// of M is in the form of the workspace. The general recursion on dual numbers computes the result. O(N).
    ///
    /// # Errors
    ///
    /// As [`Scene::forward_dynamics_vjp`].
    pub fn forward_dynamics_hvp(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut HessianScratch,
        state: &Arguments<'_>,
        direction: [&[f64]; 3],
        out: &mut [f64],
    ) -> Result<(), Error> {
        state.check_of_scene("forward_dynamics_hvp")?;
        let which = Products::gradient(Some(workspace.form));
        self.check_product(workspace, which, state, (scratch.identity(), out.len()))?;
        for ((name, _), direction) in FORWARD_DYNAMICS_JVP.seeds().iter().zip(direction) {
            self.check_rates(name, direction)?;
        }
        if !self.constraints().is_empty() {
            self.hvp_through_connections(workspace, scratch, state, direction, out)?;
            return self.check_result("derivatives", out);
        }
        if self.coupling().is_some() {
            return self.hvp_by_inverse_dynamics(workspace, scratch, state, direction, out);
        }
        let (at, cotangent) = ((state.q, state.qd, state.u), state.seed[0]);
        derivatives::forward_dynamics_hvp(
            self.model(),
            workspace,
            scratch,
            at,
            state.wrenches,
            cotangent,
            direction,
            out,
        )
        .map_err(|lost| self.singular(lost))?;
        self.check_result("derivatives", out)
    }

    /// The Hessian of forward dynamics by that of inverse dynamics, for scenes with joints that follow others.
    ///
    /// The gradients are g = -x . d(tau) for q and qd, and x = M^-1 c for tau. Along the direction, with the change of
    /// qdd, M dx = -dM x, and dM x is the third part of the Hessian of x . tau of inverse dynamics.
    fn hvp_by_inverse_dynamics(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut HessianScratch,
        state: &Arguments<'_>,
        direction: [&[f64]; 3],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let (nv, &Arguments { q, qd, u: tau, wrenches, seed, .. }) = (self.nv(), state);
        let (mut qdd, mut change, mut dx) = (vec![f64::NAN; nv], vec![f64::NAN; nv], vec![f64::NAN; nv]);
        let mut gradients = vec![f64::NAN; 3 * nv];
        self.forward_dynamics(workspace, q, qd, tau, wrenches, &mut qdd)?;
        self.forward_dynamics_vjp(workspace, q, qd, tau, wrenches, seed[0], &mut gradients)?;
        let x = gradients[2 * nv..].to_vec();
        self.forward_dynamics_jvp(workspace, q, qd, tau, wrenches, direction, &mut change)?;
        let at = Arguments { u: &qdd, seed: [&x, &[], &[]], ..*state };
        self.inverse_dynamics_hvp(scratch, &at, [direction[0], direction[1], &change], out)?;
        let (zero, turned): (Vec<f64>, Vec<f64>) = (vec![0.0; nv], out[2 * nv..].iter().map(|w| -w).collect());
        self.forward_dynamics_jvp(workspace, q, qd, tau, wrenches, [&zero, &zero, &turned], &mut dx)?;
        self.inverse_dynamics_vjp(workspace, q, qd, &qdd, wrenches, &dx, &mut gradients)?;
        for (out, gradient) in out[..2 * nv].iter_mut().zip(&gradients) {
            *out = -(*out + gradient);
        }
        out[2 * nv..].copy_from_slice(&dx);
        self.check_result("derivatives", out)
    }

    /// Checks the arguments of a product that needs a factor of M: those of `check_product_state`, and the workspace.
    fn check_product(
        &self,
        workspace: &Workspace<f64>,
        which: Products,
        state: &Arguments<'_>,
        sizes: (u64, usize),
    ) -> Result<(), Error> {
        self.check_product_state(which, state, sizes)?;
        self.check_workspace(workspace)?;
        which.form().map_or(Ok(()), |_| self.check_form(workspace))
    }

    /// Checks the state and the seed of a product, the scene of its scratch, and the length of its result.
    fn check_product_state(
        &self,
        which: Products,
        state: &Arguments<'_>,
        (scratch, out): (u64, usize),
    ) -> Result<(), Error> {
        let entry = which.entry();
        self.check_coordinates("q", state.q)?;
        self.check_rates("qd", state.qd)?;
        self.check_rates(entry.arguments[2].0, state.u)?;
        self.check_wrenches(state.wrenches)?;
        for ((name, _), seed) in entry.seeds().iter().zip(state.seed) {
            self.check_rates(name, seed)?;
        }
        check_length("out", out, entry.results.len() * self.nv())?;
        self.check_scratch("scratch", scratch, "scene.hessian_scratch()")
    }
}

algorithms! {
    /// Directional derivative dtau (nv) of inverse dynamics along (dq, dqd, dqdd): see
    /// [`derivatives::inverse_dynamics_jvp`].
    ///
    /// `q` (nq), `qd` and `qdd` (nv) are in SI units; `wrenches` is empty or holds one spatial force per body, constant
    /// in its body frame; `direction` holds three vectors (nv), dq in the tangent space of `q`. The compiled kernels
    /// compute the result, as in [`Scene::forward_dynamics`]; the first call allocates their scratch. O(N); forms no
    /// matrix.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], and [`Error::Argument`] for a workspace of another scene.
    fn inverse_dynamics_jvp(q, qd, qdd, direction) -> out = |_| Algorithm::Products(Products::tangent(None));

    /// Gradients of x . tau of inverse dynamics by q, qd and qdd, (3 x nv), written to `out`.
    ///
    /// x is the `cotangent` of tau (nv); the gradient by q is in its tangent space. See
    /// [`derivatives::inverse_dynamics_vjp`]. The other arguments and the cost are those of
    /// [`Scene::inverse_dynamics_jvp`].
    ///
    /// # Errors
    ///
    /// As [`Scene::inverse_dynamics_jvp`].
    fn inverse_dynamics_vjp(q, qd, qdd, cotangent) -> out = |_| Algorithm::Products(Products::gradient(None));

    /// Directional derivative dqdd (nv) of forward dynamics along (dq, dqd, dtau), in the form of the workspace: see
    /// [`derivatives::forward_dynamics_jvp`].
    ///
    /// `q` (nq), `qd` and `tau` (nv); the other arguments are as in [`Scene::inverse_dynamics_jvp`]. The compiled
    /// kernels compute the forms `auto` and `covariance`. The general recursion, which allocates its scratch, computes
    /// the other forms and the states whose error estimate exceeds the tolerance. O(N); forms no matrix.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::Argument`] for a workspace of another scene,
    /// [`Error::SingularJoint`] if a pivot has no significant digits, and, in square-root form, an error for an inertia
    /// that has no square root.
    fn forward_dynamics_jvp(q, qd, tau, direction) -> out = |form| Algorithm::Products(Products::tangent(Some(form)));

    /// Gradients of c . qdd of forward dynamics by q, qd and tau, (3 x nv), written to `out`, in the form of the
    /// workspace.
    ///
    /// c is the `cotangent` of qdd (nv); the gradient by q is in its tangent space. See
    /// [`derivatives::forward_dynamics_vjp`]. The other arguments and the cost are those of
    /// [`Scene::forward_dynamics_jvp`].
    ///
    /// # Errors
    ///
    /// As [`Scene::forward_dynamics_jvp`].
    fn forward_dynamics_vjp(q, qd, tau, cotangent) -> out = |form| Algorithm::Products(Products::gradient(Some(form)));

    /// [`Scene::inverse_dynamics_vjp`] with the gradients by armature, gravity, wrenches and inertias.
    ///
    /// `out` has [`Scene::width`] entries in the order of [`Products::with_constants`]; bodies and body frames are
    /// those of [`Scene::model`].
    ///
    /// # Errors
    ///
    /// As [`Scene::inverse_dynamics_vjp`].
    fn inverse_dynamics_gradients(q, qd, qdd, cotangent) -> out =
        |_| Algorithm::Products(Products::gradient(None).with_constants());

    /// [`Scene::forward_dynamics_vjp`] with the gradients by armature, gravity, wrenches and inertias, in the order of
    /// [`Scene::inverse_dynamics_gradients`].
    ///
    /// # Errors
    ///
    /// As [`Scene::forward_dynamics_vjp`].
    fn forward_dynamics_gradients(q, qd, tau, cotangent) -> out =
        |form| Algorithm::Products(Products::gradient(Some(form)).with_constants());
}
