//! Derivatives of the dynamics at one state. Each method checks its arguments before it computes.

use super::declared::algorithms;
use crate::algorithm::{Algorithm, Arguments, Derivatives};
use crate::error::{Error, check_length};
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::Workspace;

impl Scene {
    /// Linearization dx/dt = A x + B u of the motion about one state, with A (2nv x 2nv) and B (2nv x nv), row-major.
    ///
    /// x = (d, change of qd), where the perturbed configuration is q (+) d with d in the tangent space of q, and u is
    /// the change of tau. The motion is that of simulations: the springs and the viscous damping of the joints act in
    /// addition to `tau`. Dry friction is not part of it, because it has no derivative at rest. The blocks without
    /// springs and damping are those of [`Scene::forward_dynamics_derivatives`], whose arguments are the same.
    ///
    /// # Errors
    ///
    /// As [`Scene::forward_dynamics_derivatives`].
    #[allow(clippy::too_many_arguments)] // a state has three arrays and forces; the caller owns scratch and results
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
        self.check_coordinates("q", q)?;
        self.check_rates("qd", qd)?;
        self.check_rates("tau", tau)?;
        let mut numbers = std::mem::take(&mut workspace.matrices);
        numbers.resize(3 * nv * nv + nv, 0.0);
        let (three, torque) = numbers.split_at_mut(3 * nv * nv);
        torque.copy_from_slice(tau);
        let done = self
            .add_linear_joint_forces(q, qd, torque)
            .and_then(|()| self.forward_dynamics_derivatives(workspace, q, qd, torque, wrenches, three));
        if done.is_ok() {
            self.linear_system(qd, three, (&mut *a, &mut *b));
            self.add_linear_joint_forces_to_system(q, (a, b));
        }
        workspace.matrices = numbers;
        done
    }
}

algorithms! {
    /// Derivatives of inverse dynamics at one state: dtau/dq, dtau/dqd and M, one after another in `out` (3 x nv x nv).
    ///
    /// Derivatives by q are in its tangent space; see [`crate::dynamics::derivatives::inverse_dynamics_derivatives`].
    /// `q` (nq), `qd` and `qdd` (nv) are in SI units; `wrenches` is empty or holds one spatial force per body, constant
    /// in its body frame. The compiled kernels compute the result, as in [`Scene::forward_dynamics`]; the first call
    /// allocates their scratch. O(N depth).
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], and [`Error::Argument`] for a workspace of another scene.
    fn inverse_dynamics_derivatives(q, qd, qdd) -> out = |_| Algorithm::Derivatives(Derivatives::InverseDynamics);

    /// Derivatives of forward dynamics at one state: dqdd/dq, dqdd/dqd and M^-1, one after another in `out` (3 x nv x
    /// nv).
    ///
    /// Derivatives by q are in its tangent space; see [`crate::dynamics::derivatives::forward_dynamics_derivatives`].
    /// `q` (nq), `qd` and `tau` (nv) are in SI units; `wrenches` and `out` are as in
    /// [`Scene::inverse_dynamics_derivatives`].
    ///
    /// In the forms `auto` and `covariance` the compiled kernels multiply M^-1 by dtau/dq and dtau/dqd, in O(N^2
    /// depth). In the other forms, for chains of more than 300 links, and for states whose error estimate exceeds the
    /// tolerance, filter and smoother compute one column after another, and the call allocates its scratch.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::Argument`] for a workspace of another scene,
    /// [`Error::SingularJoint`] if a pivot has no significant digits, and, in square-root form, an error for an inertia
    /// that has no square root.
    fn forward_dynamics_derivatives(q, qd, tau) -> out =
        |form| Algorithm::Derivatives(Derivatives::ForwardDynamics(form));

    /// Coriolis matrix C at `q` and `qd`, (nv x nv), row-major, written to `out`.
    ///
    /// C qd is the vector of Coriolis and centrifugal torques, and dM/dt - 2 C is skew-symmetric; see
    /// [`crate::dynamics::derivatives::coriolis_matrix`].
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], and [`Error::Argument`] for a workspace of another scene.
    fn coriolis_matrix(q, qd) -> out = |_| Algorithm::Derivatives(Derivatives::CoriolisMatrix);

    /// Time derivative dM/dt of the mass matrix at `q` for the joint velocities `qd`, (nv x nv), row-major, written to
    /// `out`: see [`crate::dynamics::derivatives::mass_matrix_derivative`].
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], and [`Error::Argument`] for a workspace of another scene.
    fn mass_matrix_derivative(q, qd) -> out = |_| Algorithm::Derivatives(Derivatives::MassMatrix);
}
