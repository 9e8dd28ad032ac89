//! Methods of `Scene`: mass, center of mass, and centroidal momentum.

use super::keywords::Keywords;
use super::object::Object;
use super::scene::PyScene;
use crate::algorithm::KinematicQuantity;
use pyo3::prelude::*;

getters! {
    in PyScene;

    /// Mass of all moving links, kg: links fixed to them included, links fixed to the base and armature excluded.
    total_mass: f64 = |of, _| of.scene.total_mass();
}

methods! {
    /// Center of mass of all moving links, in the base frame.
    #[doc = parameters!(q inertias errors)]
    #[doc = section!(Returns)]
    /// c : (..., 3) ndarray
    ///     Center of mass, m, from the origin of the base frame.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     A scene whose moving links have no mass.
    #[doc = entries!(arguments)]
    #[doc = section!(Notes)]
    /// O(N). Links fixed to the base are excluded.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    /// >>> scene.center_of_mass(scene.neutral()).round(3)
    /// array([0.113, 0.147, 0.023])
    fn center_of_mass(q; inertias, errors) => kinematic_quantity(&KinematicQuantity::CenterOfMass);

    /// Velocity of the center of mass in the base frame: linear momentum divided by mass, in O(N).
    #[doc = parameters!(q qd inertias errors)]
    #[doc = section!(Returns)]
    /// v : (..., 3) ndarray
    ///     Velocity, m/s.
    #[doc = raises!(arguments)]
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
    /// >>> np.allclose(scene.center_of_mass_velocity(q, qd), scene.center_of_mass_jacobian(q) @ qd)
    /// True
    fn center_of_mass_velocity(q, qd; inertias, errors) => kinematic_quantity(&KinematicQuantity::CenterOfMassVelocity);

    /// Acceleration of the center of mass in the base frame for joint accelerations qdd, without gravity, in O(N).
    #[doc = parameters!(q qd qdd inertias errors)]
    #[doc = section!(Returns)]
    /// a : (..., 3) ndarray
    ///     Acceleration, m/s^2. Multiplied by total_mass, it is the sum of the external forces, weight included.
    #[doc = raises!(arguments)]
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, still = [0.3, 0.2, 0.1], np.zeros(3)
    /// >>> a = scene.center_of_mass_acceleration(q, still, [1.0, 0.0, 0.0])
    /// >>> np.allclose(a, scene.center_of_mass_jacobian(q)[:, 0])
    /// True
    fn center_of_mass_acceleration(q, qd, qdd; inertias, errors)
        => kinematic_quantity(&KinematicQuantity::CenterOfMassAcceleration);

    /// Jacobian J of the center of mass: its velocity in the base frame is J qd.
    #[doc = parameters!(q inertias errors)]
    #[doc = section!(Returns)]
    /// J : (..., 3, nv) ndarray
    ///     Jacobian, m or 1: the linear rows of centroidal_momentum_matrix divided by the mass.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(N).
    #[doc = section!(Examples)]
    /// >>> phipsi.scenes.chain(3).center_of_mass_jacobian([0.3, 0.2, 0.1]).shape
    /// (3, 3)
    fn center_of_mass_jacobian(q; inertias, errors) => kinematic_quantity(&KinematicQuantity::CenterOfMassJacobian);

    /// Centroidal momentum matrix A: A qd is (angular momentum about the center of mass, linear), in base axes.
    #[doc = parameters!(q inertias errors)]
    #[doc = section!(Returns)]
    /// A : (..., 6, nv) ndarray
    ///     Matrix in SI units; angular rows first. Pinocchio's Ag has the linear rows first.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(N): column j is r S, with the composite inertia r (eq. 3.5) of the bodies outboard of joint j. Armature does
    /// not contribute.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> A = scene.centroidal_momentum_matrix([0.3, 0.2, 0.1])
    /// >>> np.allclose(A[3:] / scene.total_mass, scene.center_of_mass_jacobian([0.3, 0.2, 0.1]))
    /// True
    fn centroidal_momentum_matrix(q; inertias, errors) => kinematic_quantity(&KinematicQuantity::CentroidalMomentumMatrix);

    /// Time derivative A' of the centroidal momentum matrix along qd: the momentum changes at A qdd + A' qd.
    #[doc = parameters!(q qd inertias errors)]
    #[doc = section!(Returns)]
    /// dA : (..., 6, nv) ndarray
    ///     Matrix in SI units, with the rows of centroidal_momentum_matrix.
    #[doc = raises!(arguments)]
    #[doc = section!(Notes)]
    /// O(N). For a floating tree, A qdd + A' qd is the sum of weight and external forces, with moments about the center
    /// of mass.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
    /// >>> ahead, behind = (scene.centroidal_momentum_matrix(q + h * qd) for h in (1e-6, -1e-6))
    /// >>> np.allclose(scene.centroidal_momentum_matrix_rate(q, qd), (ahead - behind) / 2e-6)
    /// True
    fn centroidal_momentum_matrix_rate(q, qd; inertias, errors)
        => kinematic_quantity(&KinematicQuantity::CentroidalMomentumMatrixRate);

    /// Derivatives of the centroidal momentum A qd with respect to q and qd; the second is A.
    #[doc = parameters!(q qd inertias errors)]
    #[doc = section!(Returns)]
    /// dh : (..., 2, 6, nv) ndarray
    ///     dh/dq and dh/dqd in SI units, with the rows of centroidal_momentum_matrix.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     A scene whose moving links have no mass.
    #[doc = entries!(arguments)]
    #[doc = section!(Notes)]
    /// O(N). Derivatives with respect to q are along its tangent space, as in velocity_derivatives.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
    /// >>> by_q, by_qd = scene.centroidal_momentum_derivatives(q, qd)
    /// >>> step = 1e-6 * np.array([0.0, 1.0, 0.0])
    /// >>> ahead, behind = (scene.centroidal_momentum_matrix(q + h) @ qd for h in (step, -step))
    /// >>> np.allclose(by_q[:, 1], (ahead - behind) / 2e-6)
    /// True
    fn centroidal_momentum_derivatives(q, qd; inertias, errors)
        => kinematic_quantity(&KinematicQuantity::CentroidalMomentumDerivatives);
}
