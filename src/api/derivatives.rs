//! Derivatives of a scene's dynamics at one state, with arguments checked and faults named.

use crate::algorithm::{Algorithm, Arguments, Derivatives};
use crate::error::{Error, check_length};
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::Workspace;

impl Scene {
    /// dtau/dq, dtau/dqd and M of inverse dynamics at one state, in the tangent space of `q`, into `out` one after another: see
    /// [`crate::dynamics::derivatives::inverse_dynamics_derivatives`].
    ///
    /// `q` (nq), `qd`, `qdd` (nv), SI units; `wrenches` is empty or holds a spatial force a body, held in that body's frame; `out`
    /// (3 x nv x nv). By the compiled kernels, as [`Scene::forward_dynamics`]; the first call makes their scratch. O(N depth).
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, and a workspace of another scene.
    #[allow(clippy::too_many_arguments)] // a state is three arrays and forces; scratch and results are the caller's
    pub fn inverse_dynamics_derivatives(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        qdd: &[f64],
        wrenches: &[SpatialVector<f64>],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let algorithm = Algorithm::Derivatives(Derivatives::InverseDynamics);
        self.run_one(workspace, None, algorithm, &Arguments { q, qd, u: qdd, wrenches, ..Arguments::default() }, out)
    }

    /// dqdd/dq, dqdd/dqd and M^-1 of forward dynamics at one state, in the form of the workspace and in the tangent space of `q`, into `out` one after another: see
    /// [`crate::dynamics::derivatives::forward_dynamics_derivatives`].
    ///
    /// `q` (nq), `qd`, `tau` (nv), SI units; `wrenches` and `out` as in [`Scene::inverse_dynamics_derivatives`]. In the forms `auto` and `covariance` by the compiled
    /// kernels, where M^-1 times dtau/dq and dtau/dqd are O(N^2 depth) products; in the others, for chains of more than 300 links, and for states in doubt column by
    /// column through filter and smoother, with scratch of the call's own.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, a workspace of another scene, [`Error::SingularJoint`] where a pivot is lost, and in
    /// square-root form an inertia that has no root.
    #[allow(clippy::too_many_arguments)] // as above
    pub fn forward_dynamics_derivatives(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        tau: &[f64],
        wrenches: &[SpatialVector<f64>],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let algorithm = Algorithm::Derivatives(Derivatives::ForwardDynamics(workspace.form));
        self.run_one(workspace, None, algorithm, &Arguments { q, qd, u: tau, wrenches, ..Arguments::default() }, out)
    }

    /// The Coriolis matrix C at `q` and `qd`, (nv x nv) row by row: C qd is the torque of the rates, and dM/dt - 2 C is antisymmetric; see
    /// [`crate::dynamics::derivatives::coriolis_matrix`].
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, and a workspace of another scene.
    pub fn coriolis_matrix(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let state = Arguments { q, qd, ..Arguments::default() };
        self.run_one(workspace, None, Algorithm::Derivatives(Derivatives::CoriolisMatrix), &state, out)
    }

    /// dM/dt at `q` along `qd`, (nv x nv) row by row: see [`crate::dynamics::derivatives::mass_matrix_derivative`].
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, and a workspace of another scene.
    pub fn mass_matrix_derivative(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let state = Arguments { q, qd, ..Arguments::default() };
        self.run_one(workspace, None, Algorithm::Derivatives(Derivatives::MassMatrix), &state, out)
    }

    /// A (2nv x 2nv) and B (2nv x nv) of dx/dt = A x + B u, x = (d, change of qd), for small deviations q (+) d from the motion through one state.
    ///
    /// Arguments as in [`Scene::forward_dynamics_derivatives`]; both results row by row.
    ///
    /// # Errors
    ///
    /// As [`Scene::forward_dynamics_derivatives`].
    #[allow(clippy::too_many_arguments)] // as above
    pub fn linearize(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        tau: &[f64],
        wrenches: &[SpatialVector<f64>],
        (a, b): (&mut [f64], &mut [f64]),
    ) -> Result<(), Error> {
        let nv = self.nv();
        check_length("a", a.len(), 4 * nv * nv)?;
        check_length("b", b.len(), 2 * nv * nv)?;
        let mut three = std::mem::take(&mut workspace.matrices);
        three.resize(3 * nv * nv, 0.0);
        let done = self.forward_dynamics_derivatives(workspace, q, qd, tau, wrenches, &mut three);
        if done.is_ok() {
            self.linear_system(qd, &three, (a, b));
        }
        workspace.matrices = three;
        done
    }
}
