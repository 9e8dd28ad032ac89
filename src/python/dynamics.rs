//! Methods of `Scene`: forces, accelerations, and the mass matrix.

use super::fresh;
use super::keywords::Keywords;
use super::object::Object;
use super::scene::PyScene;
use crate::algorithm::Algorithm;
use crate::error::Error;
use pyo3::prelude::*;

/// Largest number of degrees of freedom for dense matrices: (4000, 4000) is 128 MB per state.
const DENSE_LIMIT: usize = 4000;

methods! {
    /// Joint accelerations from joint torques and wrenches on links, in O(N): qdd of M qdd + bias = tau + J^T w.
    #[doc = parameters!(q qd tau)]
    /// form : {"auto", "covariance", "square-root"}, default "auto"
    ///     Form of the covariance P in the filter. "covariance" (eq. 3.6) is the fastest; "square-root" is accurate at
    ///     extreme mass ratios too and takes about twice the time. "auto" runs the covariance form and recomputes a
    ///     state in square-root form, and then in double-double arithmetic, if its error estimate exceeds the
    ///     tolerance.
    /// tolerance : float, optional
    ///     Largest accepted error relative to the largest acceleration, between 0 and 1, in the forms "auto" and
    ///     "square-root". Default: max(5e-14, 4 n eps) with n degrees of freedom on the longest path to the base.
    ///     Errors as small as the effect of one rounding of the forces are always accepted.
    #[doc = entries!(wrenches models out)]
    /// dtype : {"float64", "float32"} or numpy dtype, optional
    ///     Type of the result, float64 by default. The arithmetic is in float64 in both cases; float32 results are the
    ///     float64 results rounded, and a result beyond the range of float32 is an error.
    /// errors : {"raise", "nan"}, default "raise"
    ///     "nan": the results of invalid states (not finite, a quaternion off unit norm, a singular joint, an overflow)
    ///     are NaN, and one BadStateWarning has .states and .reasons. Wrong shapes raise in both cases.
    /// return_info : bool, default False
    ///     If true, return an Accuracy too. That costs about five times the time in the forms "covariance" and
    ///     "square-root", almost nothing in "auto".
    #[doc = section!(Returns)]
    /// qdd : (..., nv) ndarray
    ///     Joint accelerations, rad/s^2 or m/s^2; those of a free joint are (linear, angular) in its body frame.
    /// info : Accuracy
    ///     Only with return_info: .form, .error (estimated) and .bound of each state.
    #[doc = raises!(singular)]
    /// ConstraintError
    ///     Connections that contradict each other.
    /// ArgumentError
    ///     The square-root form of an inertia that no rigid body can have. The message names the link.
    #[doc = entries!(arguments)]
    #[doc = section!(Notes)]
    /// Equations 4.4 to 4.11. With connections, the result is that of loops.dynamics, without an error estimate.
    /// Contacts act in simulations only. If the call raises, `out` may be partly written.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd, tau = [0.3, 0.2, 0.1], [1.0, 0.0, 0.0], [0.0, 0.5, 0.0]
    /// >>> qdd = scene.forward_dynamics(q, qd, tau)
    /// >>> np.allclose(scene.inverse_dynamics(q, qd, qdd), tau)
    /// True
    fn forward_dynamics(q, qd, tau; form, tolerance, wrenches, inertias, armature, out, dtype, errors, return_info)
        => evaluate(Algorithm::ForwardDynamics);

    /// Joint torques from joint accelerations, in O(N): tau = M qdd + bias - J^T w, including gravity and armature.
    #[doc = parameters!(q qd qdd wrenches models out dtype errors)]
    #[doc = section!(Returns)]
    /// tau : (..., nv) ndarray
    ///     Joint torques, N m or N; those of a free joint are (force, moment), whereas wrenches are (moment, force).
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// tau = H phi (Q lambda + b) + armature qdd - J^T w (1.5, 2.9, 2.10). Damping, friction and springs act in
    /// simulations only.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    /// >>> scene.inverse_dynamics(scene.neutral(), np.zeros(6), np.full(6, 0.5)).round(1)
    /// array([  2. , -33.5,   0.9,   0.1,   0.1,   0.1])
    fn inverse_dynamics(q, qd, qdd; wrenches, inertias, armature, out, dtype,
        errors) => evaluate(|_| Algorithm::InverseDynamics);

    /// Joint torques for zero joint accelerations (Coriolis, centrifugal and gravity), in O(N): the bias torque.
    #[doc = parameters!(q qd models out dtype errors)]
    #[doc = section!(Returns)]
    /// tau : (..., nv) ndarray
    ///     Bias torque, N m or N.
    #[doc = raises!(arguments)]
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
    /// >>> nonlinear = scene.coriolis_matrix(q, qd) @ qd + scene.gravity_torque(q)
    /// >>> np.allclose(scene.bias_torque(q, qd), nonlinear)
    /// True
    fn bias_torque(q, qd; inertias, armature, out, dtype, errors) => evaluate(|_| Algorithm::BiasTorque);

    /// Gravity torque dU/dq: joint torques that hold the scene in static equilibrium, in O(N).
    #[doc = parameters!(q models out dtype errors)]
    #[doc = section!(Returns)]
    /// tau : (..., nv) ndarray
    ///     Gravity torque, N m or N, along the tangent space of q.
    #[doc = raises!(arguments)]
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    /// >>> scene.gravity_torque(scene.neutral()).round(1)
    /// array([  0. , -37. ,   0.2,   0. ,   0. ,   0. ])
    fn gravity_torque(q; inertias, armature, out, dtype, errors) |scene, py, keywords| {
        let rest = fresh::zeros::<f64>(py, &[scene.scene.nv()])?.into_any();
        scene.evaluate(py, |_| Algorithm::BiasTorque, [q, &rest], keywords)
    }

    /// Joint-space mass matrix M(q) of tau = M qdd + bias, including armature (5.1).
    #[doc = parameters!(q models out dtype errors)]
    #[doc = section!(Returns)]
    /// M : (..., nv, nv) ndarray
    ///     Mass matrix, kg m^2, kg m or kg; full and exactly symmetric.
    #[doc = raises!(dense arguments)]
    #[doc = section!(Notes)]
    /// inverse_dynamics multiplies by M in O(N) without forming it. Large batches are faster into an `out` that is
    /// reused.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> M = scene.mass_matrix([0.3, 0.2, 0.1])
    /// >>> M.shape, bool((M == M.T).all())
    /// ((3, 3), True)
    fn mass_matrix(q; inertias, armature, out, dtype, errors) => evaluate(|_| Algorithm::MassMatrix);

    /// Inverse of the joint-space mass matrix in closed form (eq. 6.1), without forming or factoring M.
    #[doc = parameters!(q form tolerance models out dtype errors)]
    #[doc = section!(Returns)]
    /// Minv : (..., nv, nv) ndarray
    ///     Inverse mass matrix of the kinematic tree, SI units; full and exactly symmetric.
    #[doc = raises!(singular dense arguments)]
    #[doc = section!(Notes)]
    /// forward_dynamics multiplies by the inverse in O(N) without forming it. The error estimate is that of the factor
    /// of M. loops.mass_matrix_inverse includes the connections.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q = [0.3, 0.2, 0.1]
    /// >>> np.allclose(scene.mass_matrix_inverse(q) @ scene.mass_matrix(q), np.eye(3))
    /// True
    fn mass_matrix_inverse(q; form, tolerance, inertias, armature, out, dtype,
        errors) => evaluate(Algorithm::MassMatrixInverse);
}

impl PyScene {
    pub(super) fn check_dense(&self, method: &str, instead: &str) -> Result<(), Error> {
        let nv = self.scene.nv();
        if nv <= DENSE_LIMIT {
            return Ok(());
        }
        Err(Error::argument(
            method,
            format!("a scene of {nv} degrees of freedom"),
            format!("at most {DENSE_LIMIT} for a dense matrix; use {instead}"),
        ))
    }
}
