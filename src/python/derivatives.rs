//! Methods of `Scene`: derivatives of the dynamics, and linearization.

use super::call::BatchCall;
use super::cost::Cost;
use super::errors::asked_by;
use super::keywords::Keywords;
use super::object::{Object, imported};
use super::output::{Output, three_matrices};
use super::scene::PyScene;
use super::wrenches::Wrench;
use crate::algorithm::{Algorithm, Derivatives};
use crate::filter::Form;
use numpy::{PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// Number of linear systems between two checks for signals.
const AT_A_TIME: usize = 1024;

/// Approximate time of springs and damping of one body, ns.
const COST_OF_FORCES: usize = 20;

/// Derivatives of forward dynamics, (..., 3, nv, nv).
const FORWARD: fn(Form) -> Algorithm = |form| Algorithm::Derivatives(Derivatives::ForwardDynamics(form));

methods! {
    /// Analytical derivatives of inverse dynamics, in the tangent space of q: dtau/dq, dtau/dqd and dtau/dqdd = M.
    #[doc = parameters!(q qd qdd wrenches models out_of_derivatives errors)]
    #[doc = section!(Returns)]
    /// derivatives : InverseDynamicsDerivatives
    ///     Named tuple (dtau_dq, dtau_dqd, mass_matrix), each (..., nv, nv), SI units. Row i is the torque tau_i.
    #[doc = raises!(dense arguments)]
    #[doc = section!(Notes)]
    /// O(N depth). Column j of dtau_dq is the derivative along integrate(q, v) with respect to v_j: an angle or a
    /// length, a rotation in the child frame for spherical joints, (linear, angular) in the child frame for free
    /// joints. Wrenches are constant in the frames of their links.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd, qdd = np.array([0.3, 0.2, 0.1]), [1.0, 0.5, 0.2], [0.0, 1.0, 0.0]
    /// >>> step = np.array([0.0, 1e-6, 0.0])
    /// >>> change = scene.inverse_dynamics(q + step, qd, qdd) - scene.inverse_dynamics(q - step, qd, qdd)
    /// >>> np.allclose(scene.inverse_dynamics_derivatives(q, qd, qdd).dtau_dq[:, 1], change / 2e-6)
    /// True
    fn inverse_dynamics_derivatives(q, qd, qdd; wrenches, inertias, armature, out, errors) |scene, py, keywords| {
        let algorithm = |_| Algorithm::Derivatives(Derivatives::InverseDynamics);
        let all = scene.evaluate(py, algorithm, [q, qd, qdd], keywords)?;
        three_matrices(imported!(py, "phipsi._results", "InverseDynamicsDerivatives")?, &all)
    }

    /// Analytical derivatives of forward dynamics in the tangent space of q: dqdd/dq, dqdd/dqd, dqdd/dtau = M^-1.
    #[doc = parameters!(q qd tau form)]
    /// tolerance : float, optional
    ///     Replaces both bounds of form "auto": that of forward_dynamics for the factor of M, and 1e-11 of the largest
    ///     entry for the derivatives. States beyond are recomputed in double-double arithmetic, which takes about 30
    ///     times longer.
    #[doc = entries!(wrenches models out_of_derivatives errors)]
    #[doc = section!(Returns)]
    /// derivatives : ForwardDynamicsDerivatives
    ///     Named tuple (dqdd_dq, dqdd_dqd, mass_matrix_inverse), each (..., nv, nv), SI units. Row i is the acceleration
    ///     qdd_i.
    #[doc = raises!(singular dense arguments)]
    #[doc = section!(Notes)]
    /// dqdd/dq = -M^-1 dtau/dq and dqdd/dqd = -M^-1 dtau/dqd, by eq. 6.1 from inverse_dynamics_derivatives, whose
    /// columns they have. Wrenches are constant in the frames of their links.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd, tau = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.0, 0.0, 0.0]
    /// >>> qdd = scene.forward_dynamics(q, qd, tau)
    /// >>> forward = scene.forward_dynamics_derivatives(q, qd, tau)
    /// >>> inverse = scene.inverse_dynamics_derivatives(q, qd, qdd)
    /// >>> np.allclose(inverse.mass_matrix @ forward.dqdd_dq, -inverse.dtau_dq)
    /// True
    fn forward_dynamics_derivatives(q, qd, tau; form, tolerance, wrenches, inertias, armature, out,
        errors) |scene, py, keywords| {
        let all = scene.evaluate(py, FORWARD, [q, qd, tau], keywords)?;
        three_matrices(imported!(py, "phipsi._results", "ForwardDynamicsDerivatives")?, &all)
    }

    /// Linearization dx/dt = A x + B u about a motion: x = (tangent of q, change of qd), u = change of tau.
    #[doc = parameters!(q qd tau form tolerance_of_derivatives wrenches)]
    /// springs_and_damping : bool, default True
    ///     If true, the springs and the viscous damping of the joints act in addition to tau, as in simulate. False:
    ///     the linearization of forward_dynamics.
    #[doc = entries!(models errors)]
    #[doc = section!(Returns)]
    /// system : LinearSystem
    ///     Named tuple (A, B), (..., 2 nv, 2 nv) and (..., 2 nv, nv), in continuous time, SI units.
    #[doc = raises!(singular dense arguments)]
    #[doc = section!(Notes)]
    /// A = [[-ad(qd), 1], [dqdd_dq, dqdd_dqd]] and B = [[0], [M^-1]], with qdd = forward_dynamics(q, qd, tau -
    /// stiffness (q - rest) - damping qd), where q - rest is the displacement as in simulate. The deviation
    /// difference(q, q + dq) is expressed in axes that move with the motion: ad(qd) is zero at rest and for joints with
    /// one axis, the cross product with the angular velocity for spherical joints, and the bracket of (linear, angular)
    /// velocities for free joints.
    ///
    /// Dry friction is not included, because it has no derivative at rest: A and B describe the motion of joints
    /// without it. Subtract friction * sign(qd) from tau for joints that slide.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> A, B = scene.linearize([0.3, 0.2, 0.1], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    /// >>> A.shape, B.shape
    /// ((6, 6), (6, 3))
    fn linearize(q, qd, tau; form, tolerance, wrenches, springs_and_damping, inertias, armature,
        errors) |scene, py, keywords| {
        scene.check_dense("linearize", "differences of forward_dynamics")?;
        let has_forces = keywords.springs_and_damping && scene.scene.joint_forces().are_linear();
        let torque;
        let tau = if has_forces {
            let given = [("q", q), ("qd", qd), ("tau", tau)];
            let cost = COST_OF_FORCES * scene.size();
            torque = scene.each(py, given, &[scene.scene.nv()], cost, errors, |scene, _, [q, qd, tau], out| {
                out.copy_from_slice(tau);
                scene.add_linear_joint_forces(q, qd, out)
            })?;
            &torque
        } else {
            tau
        };
        let all = scene.evaluate(py, FORWARD, [q, qd, tau], keywords)?;
        let class = imported!(py, "phipsi._results", "LinearSystem")?;
        let nv = scene.scene.nv();
        let all = all.cast::<PyArrayDyn<f64>>()?.try_readonly()?;
        let batch = &all.shape()[..all.shape().len() - 3];
        let (configurations, rates) = (scene.configuration("q", q)?, scene.rate("qd", qd)?);
        let (over_q, over) = (configurations.over(batch)?, rates.over(batch)?);
        let output = |shape: &[usize]| {
            Output::unwritten(py, &[batch, shape].concat()).or_else(|failed| {
                let inputs = scene.inputs([("q", q), ("qd", qd), ("tau", tau)])?;
                let call = BatchCall::new(scene, inputs, Wrench::read(&scene.scene, wrenches)?, Cost::of(0))?;
                asked_by(py, &call.asking(), Err(failed))
            })
        };
        let mut outputs = [output(&[2 * nv, 2 * nv])?, output(&[2 * nv, nv])?];
        let [a, b] = &mut outputs;
        if nv > 0 {
            let states = all.as_slice()?.chunks_exact(3 * nv * nv);
            let systems = a.numbers()?.chunks_exact_mut(4 * nv * nv).zip(b.numbers()?.chunks_exact_mut(2 * nv * nv));
            for (i, (of_state, (a, b))) in states.zip(systems).enumerate() {
                // All results of an invalid state are NaN.
                if of_state[0].is_nan() {
                    a.fill(f64::NAN);
                    b.fill(f64::NAN);
                } else {
                    scene.scene.linear_system(over.state(i), of_state, (&mut *a, &mut *b));
                    if has_forces {
                        scene.scene.add_linear_joint_forces_to_system(over_q.state(i), (a, b));
                    }
                }
                if i % AT_A_TIME == 0 {
                    py.check_signals()?;
                }
            }
        }
        let [a, b] = outputs.map(Output::finish);
        class.call1((a, b))
    }

    /// Coriolis matrix C: C qd is the torque of the joint velocities, and dM/dt - 2 C is antisymmetric.
    #[doc = parameters!(q qd models out errors)]
    #[doc = section!(Returns)]
    /// C : (..., nv, nv) ndarray
    ///     Coriolis matrix, SI units; for joints with one axis that of the Christoffel symbols.
    #[doc = raises!(dense arguments)]
    #[doc = section!(Notes)]
    /// O(N depth).
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2]
    /// >>> skew = scene.mass_matrix_derivative(q, qd) - 2 * scene.coriolis_matrix(q, qd)
    /// >>> np.allclose(skew, -skew.T)
    /// True
    fn coriolis_matrix(q, qd; inertias, armature, out,
        errors) => evaluate(|_| Algorithm::Derivatives(Derivatives::CoriolisMatrix));

    /// Time derivative dM/dt of the mass matrix along the joint velocities: C + C^T with the Coriolis matrix C.
    #[doc = parameters!(q qd models out errors)]
    #[doc = section!(Returns)]
    /// dM : (..., nv, nv) ndarray
    ///     Derivative, SI units; exactly symmetric. The armature is constant and does not contribute.
    #[doc = raises!(dense arguments)]
    #[doc = section!(Notes)]
    /// O(N depth).
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd = np.array([0.3, 0.2, 0.1]), np.array([1.0, 0.5, 0.2])
    /// >>> change = scene.mass_matrix(q + 1e-6 * qd) - scene.mass_matrix(q - 1e-6 * qd)
    /// >>> np.allclose(scene.mass_matrix_derivative(q, qd), change / 2e-6)
    /// True
    fn mass_matrix_derivative(q, qd; inertias, armature, out,
        errors) => evaluate(|_| Algorithm::Derivatives(Derivatives::MassMatrix));
}
