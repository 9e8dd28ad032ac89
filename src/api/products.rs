//! Products with the Jacobians of a scene's dynamics at one state, with arguments checked and faults named.

use crate::algorithm::{Algorithm, Arguments, Products};
use crate::dynamics::derivatives::{self, HessianScratch};
use crate::error::{Error, check_length};
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::Workspace;

impl Scene {
    /// Scratch for [`Scene::inverse_dynamics_hvp`] and [`Scene::forward_dynamics_hvp`].
    #[must_use]
    pub fn hessian_scratch(&self) -> HessianScratch {
        HessianScratch::new(self.model())
    }

    /// dtau of inverse dynamics at one state along the direction (dq, dqd, dqdd), (nv) into `out`: see [`derivatives::inverse_dynamics_jvp`].
    ///
    /// `q` (nq), `qd`, `qdd` (nv), SI units; `wrenches` is empty or holds a spatial force a body, held in that body's frame; `direction` (nv) each, dq in the
    /// tangent space of `q`. By the compiled kernels, as [`Scene::forward_dynamics`]; the first call makes their scratch. O(N), without any matrix.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, and a workspace of another scene.
    #[allow(clippy::too_many_arguments)] // a state is three arrays and forces; scratch and results are the caller's
    pub fn inverse_dynamics_jvp(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        qdd: &[f64],
        wrenches: &[SpatialVector<f64>],
        direction: [&[f64]; 3],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let state = Arguments { q, qd, u: qdd, wrenches, seed: direction, ..Arguments::default() };
        self.run_one(workspace, None, Algorithm::Products(Products::InverseTangent), &state, out)
    }

    /// The gradients of x . tau of inverse dynamics at one state, x being the `cotangent` of tau, (nv): those by q (in its tangent space), qd and qdd, (3 x nv) into
    /// `out`; see [`derivatives::inverse_dynamics_vjp`].
    ///
    /// Other arguments, cost and errors as in [`Scene::inverse_dynamics_jvp`].
    ///
    /// # Errors
    ///
    /// As there.
    #[allow(clippy::too_many_arguments)] // as above
    pub fn inverse_dynamics_vjp(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        qdd: &[f64],
        wrenches: &[SpatialVector<f64>],
        cotangent: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let state = Arguments { q, qd, u: qdd, wrenches, seed: [cotangent, &[], &[]], ..Arguments::default() };
        self.run_one(workspace, None, Algorithm::Products(Products::InverseGradient), &state, out)
    }

    /// dqdd of forward dynamics at one state along the direction (dq, dqd, dtau), (nv) into `out`, in the form of the workspace: see
    /// [`derivatives::forward_dynamics_jvp`].
    ///
    /// `q` (nq), `qd`, `tau` (nv); other arguments as in [`Scene::inverse_dynamics_jvp`]. In the forms `auto` and `covariance` by the compiled kernels; in the
    /// others, and for states in doubt, by the general recursion with scratch of the call's own. O(N), without any matrix.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, a workspace of another scene, [`Error::SingularJoint`] where a pivot is lost, and in
    /// square-root form an inertia that has no root.
    #[allow(clippy::too_many_arguments)] // as above
    pub fn forward_dynamics_jvp(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        tau: &[f64],
        wrenches: &[SpatialVector<f64>],
        direction: [&[f64]; 3],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let algorithm = Algorithm::Products(Products::ForwardTangent(workspace.form));
        let state = Arguments { q, qd, u: tau, wrenches, seed: direction, ..Arguments::default() };
        self.run_one(workspace, None, algorithm, &state, out)
    }

    /// The gradients of c . qdd of forward dynamics at one state, c being the `cotangent` of qdd, (nv): those by q (in its tangent space), qd and tau, (3 x nv) into
    /// `out`, in the form of the workspace; see [`derivatives::forward_dynamics_vjp`].
    ///
    /// Other arguments, cost and errors as in [`Scene::forward_dynamics_jvp`].
    ///
    /// # Errors
    ///
    /// As there.
    #[allow(clippy::too_many_arguments)] // as above
    pub fn forward_dynamics_vjp(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        tau: &[f64],
        wrenches: &[SpatialVector<f64>],
        cotangent: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let algorithm = Algorithm::Products(Products::ForwardGradient(workspace.form));
        let state = Arguments { q, qd, u: tau, wrenches, seed: [cotangent, &[], &[]], ..Arguments::default() };
        self.run_one(workspace, None, algorithm, &state, out)
    }

    /// [`Scene::inverse_dynamics_vjp`] and the gradients by armature, gravity, wrenches and inertias, one after another into `out` as
    /// [`Products::InverseGradients`] has them: of [`Scene::width`] numbers; bodies and their frames are those of [`Scene::model`].
    ///
    /// # Errors
    ///
    /// As there.
    #[allow(clippy::too_many_arguments)] // as above
    pub fn inverse_dynamics_gradients(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        qdd: &[f64],
        wrenches: &[SpatialVector<f64>],
        cotangent: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let state = Arguments { q, qd, u: qdd, wrenches, seed: [cotangent, &[], &[]], ..Arguments::default() };
        self.run_one(workspace, None, Algorithm::Products(Products::InverseGradients), &state, out)
    }

    /// [`Scene::forward_dynamics_vjp`] and the gradients by what is constant, as [`Scene::inverse_dynamics_gradients`] has them.
    ///
    /// # Errors
    ///
    /// As there.
    #[allow(clippy::too_many_arguments)] // as above
    pub fn forward_dynamics_gradients(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        tau: &[f64],
        wrenches: &[SpatialVector<f64>],
        cotangent: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let algorithm = Algorithm::Products(Products::ForwardGradients(workspace.form));
        let state = Arguments { q, qd, u: tau, wrenches, seed: [cotangent, &[], &[]], ..Arguments::default() };
        self.run_one(workspace, None, algorithm, &state, out)
    }

    /// [`Scene::inverse_dynamics_jvp`] along changes of wrenches, inertias, armature and gravity too.
    ///
    /// `state`: u is qdd, the seed as [`Products::InverseTangents`] has it, its third of [`Scene::seed_width`] numbers; bodies and their frames are those of
    /// [`Scene::model`]. O(N).
    ///
    /// # Errors
    ///
    /// As there.
    pub fn inverse_dynamics_along(
        &self,
        workspace: &mut Workspace<f64>,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.run_one(workspace, None, Algorithm::Products(Products::InverseTangents), state, out)
    }

    /// [`Scene::forward_dynamics_jvp`] likewise; u is tau.
    ///
    /// # Errors
    ///
    /// As there.
    pub fn forward_dynamics_along(
        &self,
        workspace: &mut Workspace<f64>,
        state: &Arguments<'_>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        let algorithm = Algorithm::Products(Products::ForwardTangents(workspace.form));
        self.run_one(workspace, None, algorithm, state, out)
    }

    /// How the gradients of [`Scene::inverse_dynamics_vjp`] change along (dq, dqd, dqdd), (3 x nv) into `out`: the Hessian of x . tau times that direction; see
    /// [`derivatives::inverse_dynamics_hvp`].
    ///
    /// `state`: u is qdd, the first seed the cotangent x. By the general recursion on dual numbers. O(N).
    ///
    /// # Errors
    ///
    /// As there.
    pub fn inverse_dynamics_hvp(
        &self,
        scratch: &mut HessianScratch,
        state: &Arguments<'_>,
        direction: [&[f64]; 3],
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.check_product_state(Products::InverseGradient, state, (scratch.identity(), out.len()))?;
        for ((name, _), direction) in Products::InverseTangent.entry().seeds().iter().zip(direction) {
            self.check_rates(name, direction)?;
        }
        let at = (state.q, state.qd, state.u);
        derivatives::inverse_dynamics_hvp(self.model(), scratch, at, state.wrenches, state.seed[0], direction, out);
        self.check_result("derivatives", out)
    }

    /// How the gradients of [`Scene::forward_dynamics_vjp`] change along (dq, dqd, dtau), (3 x nv) into `out`: the Hessian of c . qdd times that direction; see
    /// [`derivatives::forward_dynamics_hvp`].
    ///
    /// `state`: u is tau, the first seed the cotangent c. The factor of M is in the form of the workspace. By the general recursion on dual numbers. O(N).
    ///
    /// # Errors
    ///
    /// As there.
    pub fn forward_dynamics_hvp(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut HessianScratch,
        state: &Arguments<'_>,
        direction: [&[f64]; 3],
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.check_no_connections("second derivatives of forward dynamics")?;
        let which = Products::ForwardGradient(workspace.form);
        self.check_product(workspace, which, state, (scratch.identity(), out.len()))?;
        for ((name, _), direction) in Products::ForwardTangent(workspace.form).entry().seeds().iter().zip(direction) {
            self.check_rates(name, direction)?;
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

    /// The same of a call that needs a factor: its workspace too.
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

    /// State and seed of a product, the scene that its scratch is of, and the length of its result.
    fn check_product_state(
        &self,
        which: Products,
        state: &Arguments<'_>,
        (scratch, out): (u64, usize),
    ) -> Result<(), Error> {
        let entry = which.entry();
        self.check_configuration("q", state.q)?;
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
