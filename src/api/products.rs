//! Products with the Jacobians of the dynamics at one state (forward and reverse mode, Hessian products). Each method
//! checks its arguments before it computes.

use super::declared::algorithms;
use crate::algorithm::{Algorithm, Arguments, FORWARD_DYNAMICS_JVP, INVERSE_DYNAMICS_JVP, Products};
use crate::dynamics::derivatives::{self, HessianScratch};
use crate::error::{Error, check_length};
use crate::scene::{Coupling, Scene};
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
        if let Some((own, state)) = self.of_own_model(state)? {
            return own.inverse_dynamics_hvp(&mut own.hessian_scratch(), &state, direction, out);
        }
        self.check_product_state(Products::gradient(None), state, (scratch.identity(), out.len()))?;
        for ((name, _), direction) in INVERSE_DYNAMICS_JVP.seeds().iter().zip(direction) {
            self.check_rates(name, direction)?;
        }
        self.on_tree(Products::gradient(None), state, direction, out, |state, direction, out| {
            let &Arguments { q, qd, u, wrenches, seed: [cotangent, ..], .. } = state;
            let (model, at) = (self.model(), (q, qd, u));
            derivatives::inverse_dynamics_hvp(model, scratch, at, wrenches, cotangent, direction, out);
            Ok(())
        })
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
        if let Some((own, state)) = self.of_own_model(state)? {
            let mut of_own = own.workspace().in_form(workspace.form);
            of_own.tolerance = workspace.tolerance;
            return own.forward_dynamics_hvp(&mut of_own, &mut own.hessian_scratch(), &state, direction, out);
        }
        let which = Products::gradient(Some(workspace.form));
        self.check_product(workspace, which, state, (scratch.identity(), out.len()))?;
        for ((name, _), direction) in FORWARD_DYNAMICS_JVP.seeds().iter().zip(direction) {
            self.check_rates(name, direction)?;
        }
        let tied = self.coupling().map_or(self, Coupling::tied);
        self.on_tree(which, state, direction, out, |state, direction, out| {
            if !tied.constraints().is_empty() {
                return tied.hvp_through_connections(workspace, scratch, state, direction, out);
            }
            let (model, at, cotangent) = (self.model(), (state.q, state.qd, state.u), state.seed[0]);
            derivatives::forward_dynamics_hvp(model, workspace, scratch, at, state.wrenches, cotangent, direction, out)
                .map_err(|lost| self.singular(lost))
        })
    }

    /// Runs a Hessian product on the tree of a scene whose joints follow others, or on the scene itself, and checks its
    /// result.
    fn on_tree(
        &self,
        which: Products,
        state: &Arguments<'_>,
        direction: [&[f64]; 3],
        out: &mut [f64],
        product: impl FnOnce(&Arguments<'_>, [&[f64]; 3], &mut [f64]) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let Some(coupling) = self.coupling() else {
            product(state, direction, out)?;
            return self.check_result("derivatives", out);
        };
        let (entry, along, acts) = (which.entry(), Products::tangent(which.form()).entry(), which.form().is_some());
        let given = [state.q, state.qd, state.u, state.seed[0]].into_iter().chain(direction);
        let names = entry.arguments.iter().chain(along.seeds());
        let all: Vec<_> = names.zip(given).map(|(&(name, _), given)| coupling.expanded(name, acts, given)).collect();
        let [q, qd, u, cotangent, dq, dqd, du] = &all[..] else { return Ok(()) };
        let sizes = coupling.tree().sizes();
        let (mut of_tree, mut reduced) = (vec![f64::NAN; 3 * sizes.nv], Vec::new());
        product(&Arguments { q, qd, u, seed: [cotangent, &[], &[]], ..*state }, [dq, dqd, du], &mut of_tree)?;
        coupling.reduced_all(entry.results, (&sizes, acts), &of_tree, &mut reduced);
        out.copy_from_slice(&reduced);
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
