//! Methods of `Scene`: variances through the dynamics, and observers.

use super::bad_states::Errors;
use super::call::BatchCall;
use super::choice::names;
use super::cost::Cost;
use super::input::{FEW, fixed, shaped, wrong_shape};
use super::object::{Object, imported};
use super::output::{Array, Output};
use super::own_models::Models;
use super::scene::PyScene;
use super::wrenches::Wrench;
use crate::algorithm::{Algorithm, Arguments};
use crate::batch::Fault;
use crate::batch::evaluator::Evaluator;
use crate::batch::instruction_set::InstructionSet;
use crate::dynamics::derivatives::Parameters;
use crate::error::Error;
use crate::estimation::lanes::{Kept, Question, VarianceLanes};
use crate::estimation::{JointCovariance, ParameterRoots, TorqueVariance, Variances};
use crate::filter::Form;
use crate::kinematics::Frame;
use crate::scene::Scene;
use crate::spatial::Symmetric6;
use crate::workspace::Workspace;
use nalgebra::Matrix6;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Arc, Mutex};

/// Rough times of one body in one state, ns (see `BatchCall::new`).
mod cost {
    pub const FORWARD: usize = 2000;
    pub const INVERSE: usize = 600;
    /// Of one link's covariance.
    pub const LINK: usize = 300;
}

methods_in_python! {
    /// Variances of the joint accelerations for uncertain inertial parameters, joint parameters and torques, O(N).
    ///
    /// At the true acceleration an error of the parameters pi is a force on the bodies: M d(qdd) = dtau - H phi Y
    /// d(pi), with Y the regressor at the qdd that forward dynamics gives. The variances are those of a filter and
    /// smoother whose gains were made for another noise. First order in the errors. With connections or joints that
    /// follow others, A Y Sigma Y* A* by dense matrices, O(N^3), with A the inverse mass matrix through the connections
    /// (loops.mass_matrix_inverse) or of the independent joints. Contacts are ignored: their forces depend on the
    /// motion before.
    ///
    /// Parameters
    /// ----------
    /// q : (..., nq)
    ///     Configurations. Leading axes broadcast.
    /// qd, tau : (..., nv)
    ///     Joint velocities, rad/s or m/s, and torques, N m or N.
    /// parameters : (bodies, 10, 10), (10 bodies, 10 bodies), or an Identification, optional
    ///     Covariance of (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) of each link of body_names, I about the
    ///     link's origin, in the link's frame. Bodies are independent of each other, or correlated in a full matrix (10
    ///     bodies, 10 bodies), which costs one right side of the filter per column of its root. Any object with
    ///     `.covariance` of one of these shapes stands for it. Default: the parameters are known.
    /// joints : dict or (nv, 4, 4), optional
    ///     Variances of "armature", "damping", "friction" and "offset" by name, a number or (nv,) each, or the
    ///     covariance of the four of each degree of freedom; not for those that `parameters` has.
    /// torque : (nv,) or float, optional
    ///     Variance of the torque, (N m)^2 or N^2.
    /// links : str or sequence of str, optional
    ///     Links whose accelerations are wanted too.
    /// wrenches : dict, optional
    ///     As in forward_dynamics; they are known.
    /// inertias, armature : array_like, optional
    ///     Model of each state, as in forward_dynamics.
    /// friction_speed : float
    ///     Speed below which friction is viscous, as in identify.
    /// errors : str
    ///     As in forward_dynamics.
    ///
    /// Returns
    /// -------
    /// array (..., nv), or AccelerationVariance
    ///     Variances of the joint accelerations, (rad/s^2)^2 or (m/s^2)^2. With links an AccelerationVariance(joints,
    ///     links): links is a dict from names to the covariance (..., 6, 6) of the (angular, linear) acceleration of
    ///     the link's origin in the link's frame.
    ///
    /// Raises
    /// ------
    /// ArgumentError
    ///     A covariance that is not symmetric or has a negative eigenvalue, a negative variance, an unknown name.
    /// SingularJointError, ShapeError, NotFiniteError
    ///     As in forward_dynamics.
    ///
    /// Examples
    /// --------
    /// >>> import numpy as np, phipsi
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> parameters = np.zeros((3, 10, 10))
    /// >>> parameters[2, 0, 0] = 0.01  # the mass of the last link, to 0.1 kg
    /// >>> variance = scene.forward_dynamics_variance([0.3, 0.2, 0.1], [0.0] * 3, [1.0, 0.0, 0.0], parameters=parameters, torque=0.01)
    /// >>> variance.shape, bool((variance > 0).all())
    /// ((3,), True)
    #[pyo3(text_signature = "($self, q, qd, tau, *, parameters=None, joints=None, torque=None, links=None, wrenches=None, inertias=None, armature=None, friction_speed=0.01, errors='raise')")]
    fn forward_dynamics_variance(q, qd, tau) = "phipsi.estimation.uncertainty", "forward_dynamics_variance";

    /// Variances of the joint torques of inverse dynamics for uncertain parameters, in O(N).
    ///
    /// C is the covariance of the force that a body's parameter errors are, Y Sigma Y*. Torques are linear in the
    /// parameters: nothing is approximate. With connections or joints that follow others, by dense matrices, O(N^2).
    ///
    /// Parameters
    /// ----------
    /// q : (..., nq)
    ///     Configurations. Leading axes broadcast.
    /// qd, qdd : (..., nv)
    ///     Joint velocities, rad/s or m/s, and accelerations.
    /// parameters, joints, torque
    ///     As in forward_dynamics_variance; torque: the variance of what is added to the torque, of a sensor's noise
    ///     for instance.
    /// inertias, armature : array_like, optional
    ///     Model of each state, as in inverse_dynamics. Variances are the same for all models, because torques are
    ///     linear in the parameters.
    /// friction_speed, errors
    ///     As in forward_dynamics_variance.
    ///
    /// Returns
    /// -------
    /// array (..., nv)
    ///     Variances of the torques, (N m)^2 or N^2.
    ///
    /// Raises
    /// ------
    /// ArgumentError, ShapeError, NotFiniteError
    ///     As forward_dynamics_variance; connections are no obstacle, since their forces are not part of these torques.
    ///
    /// Examples
    /// --------
    /// >>> import numpy as np, phipsi
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> parameters = np.zeros((3, 10, 10))
    /// >>> parameters[:, 0, 0] = 0.01
    /// >>> variance = scene.inverse_dynamics_variance([0.3, 0.2, 0.1], [0.0] * 3, [1.0, 0.0, 0.0], parameters=parameters)
    /// >>> variance.shape
    /// (3,)
    #[pyo3(text_signature = "($self, q, qd, qdd, *, parameters=None, joints=None, torque=None, inertias=None, armature=None, friction_speed=0.01, errors='raise')")]
    fn inverse_dynamics_variance(q, qd, qdd) = "phipsi.estimation.uncertainty", "inverse_dynamics_variance";

    /// Momentum observer of external joint torques that raises alarms at a stated rate.
    ///
    /// With connections, whose forces are unknown, external torques are observed as far as they act on motions that the
    /// connections allow. Contacts of the scene are ignored, because their forces are external ones.
    #[doc = section!(Parameters)]
    /// dt : float
    ///     Time between two steps, s.
    /// torque_noise : float or (nv,) array_like
    ///     Density of the torque noise of each degree of freedom, (N m)^2 s, positive: the variance of its mean over a
    ///     time T, times T. It includes friction that is not modeled.
    /// bandwidth : float
    ///     Bandwidth K of the estimate, 1/s. A lower bandwidth detects smaller torques, with a longer delay.
    /// false_alarms_per_hour : float, default 1
    ///     Number of alarms per hour without any contact.
    /// parameters : array_like or Identification, optional
    ///     Covariance of the parameters, as in forward_dynamics_variance. With the parameters of joints of an
    ///     Identification, `tau` given to the observer is without their friction. None: the parameters are exact.
    /// load : (str, (3,) array_like), optional
    ///     Link and point in the link frame, m, of a load to detect. The alarm then tests its mass alone, which
    ///     detects a load earlier than the test of all external torques.
    /// velocity_noise : float or (nv,) array_like, default 0
    ///     Standard deviation of independent errors of each qd, rad/s or m/s.
    /// correlation_time : float or (nv,) array_like, default 0
    ///     Correlation time T of the torque noise, s; zero for white noise. Its variance is torque_noise/(2 T).
    /// stiction : float or (nv,) array_like, default 0
    ///     Largest torque of dry friction that holds a joint at rest and is not part of tau, N m or N. The alarm tests
    ///     the part of the torque that friction of at most this size cannot explain.
    /// rest_speed : float or (nv,) array_like, default 0.01
    ///     Joint velocity up to which a joint is at rest, rad/s or m/s.
    #[doc = section!(Returns)]
    /// observer : phipsi.estimation.MomentumObserver
    ///     The observer; see its `step`.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     A noise, bandwidth, step or rate that is not positive; a load that no joint moves; velocity noise, correlated
    ///     noise or stiction with connections.
    /// ShapeError
    ///     An array of an invalid shape.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> observer = scene.momentum_observer(1e-3, torque_noise=0.01, bandwidth=10.0)
    /// >>> torque, alarm = observer.step([0.3, 0.2, 0.1], [0.0] * 3, scene.gravity_torque([0.3, 0.2, 0.1]))
    /// >>> torque.shape, bool(alarm)
    /// ((3,), False)
    #[pyo3(text_signature = "($self, dt, *, torque_noise, bandwidth, false_alarms_per_hour=1.0, parameters=None, load=None, velocity_noise=0.0, correlation_time=0.0, stiction=0.0, rest_speed=0.01)")]
    fn momentum_observer(dt) = "phipsi.estimation.momentum", "MomentumObserver";

    /// Create an observer of joint motion, external wrenches and sensor biases from any sensors: a Kalman filter.
    ///
    /// Connections are measurements without noise: the estimate satisfies them, and so does its error, to first order.
    /// Contacts of the scene are ignored, because their forces are external ones: estimate them as wrenches, or give
    /// Contact sensors. With joints that follow others, states and errors are those of the independent joints.
    #[doc = section!(Parameters)]
    /// dt : float
    ///     Time between two steps, s.
    /// sensors : collection of phipsi.estimation.Sensor
    ///     Encoder, Gyro, Accelerometer, TorqueSensor and Contact objects with different names.
    /// q : (..., nq) array_like
    ///     Initial joint positions, rad or m. Leading axes are robots that are observed together.
    /// qd : (..., nv) array_like, optional
    ///     Initial joint velocities, rad/s or m/s; zero by default.
    /// torque_noise : float or (nv,) array_like
    ///     Density of the torque noise, (N m)^2 s. It includes friction that is not modeled. Zero for degrees of
    ///     freedom without torque, such as a free joint.
    /// wrenches : collection of phipsi.estimation.ExternalWrench, optional
    ///     External wrenches to estimate.
    /// initial : (float, float) or (2 nv,) array_like, optional
    ///     Initial standard deviations of q in its tangent space and of qd: two values, or one per component.
    /// history : int, default 1000
    ///     Number of past steps that `smooth` covers.
    #[doc = section!(Returns)]
    /// observer : phipsi.estimation.Observer
    ///     The observer; see its `step` and `smooth`.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     An invalid argument, an unknown link or joint, two sensors with the same name.
    /// ConstraintError
    ///     Initial positions or velocities that violate the connections; see loops.project.
    /// ShapeError, NotFiniteError
    ///     An invalid array. The message names the argument.
    #[doc = section!(Examples)]
    /// >>> from phipsi.estimation import Encoder
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> observer = scene.observer(1e-3, [Encoder(noise=1e-4)], q=[0.3, 0.2, 0.1], torque_noise=0.01)
    /// >>> estimate = observer.step(scene.gravity_torque([0.3, 0.2, 0.1]), {"encoder": [0.3, 0.2, 0.1]})
    /// >>> estimate.q.shape, estimate.covariance.shape
    /// ((3,), (6, 6))
    #[pyo3(text_signature = "($self, dt, sensors, *, q, qd=None, torque_noise, wrenches=(), initial=(0.1, 0.1), history=1000)")]
    fn observer(dt, sensors) = "phipsi.estimation.observer", "Observer";
}

#[pymethods]
impl PyScene {
    /// Variances of accelerations (forward) or torques, (..., nv), then the covariance (6, 6) of each of the links;
    /// `roots` is (bodies, rank, 10).
    #[pyo3(name = "_variance")]
    fn variance<'py>(
        &self,
        py: Python<'py>,
        forward: bool,
        state: [Object<'py>; 3],
        roots: &Object<'py>,
        torque: &Object<'py>,
        joints: Option<&Object<'py>>,
        friction_speed: f64,
        links: Option<&Object<'py>>,
        wrenches: Option<&Object<'py>>,
        inertias: Option<&Object<'py>>,
        armature: Option<&Object<'py>>,
        errors: &str,
    ) -> Array<'py> {
        let scene = &self.scene;
        scene.check_independent()?;
        if forward {
            scene.check_no_connections("forward_dynamics_variance")?;
        }
        let (nv, bodies) = (scene.nv(), scene.joints().len());
        let kept = Kept::of(scene);
        let parameters = self.roots(&kept, roots)?;
        let noise = fixed("torque", torque, &[nv])?;
        let joints = joints.map(|joints| fixed("joints", joints, &[nv, 4, 4])).transpose()?;
        let joints: Vec<JointCovariance<f64>> =
            joints.iter().flat_map(|all| all.as_chunks::<16>().0).map(by_rows).collect();
        let links = links.map(|links| names("links", links, "names of links")).transpose()?.unwrap_or_default();
        let frames = links.iter().map(|link| scene.frame(&link.as_str().into())).collect::<Result<Vec<_>, _>>()?;
        let lanes = InstructionSet::of_process().lanes();
        let each = if forward { cost::FORWARD } else { cost::INVERSE } * bodies.max(1) + cost::LINK * links.len();
        let [q, qd, third] = &state;
        let given = [("q", q), ("qd", qd), (if forward { "tau" } else { "qdd" }, third)];
        let cost = each / lanes;
        let (wrenches, models) = (Wrench::read(scene, wrenches)?, Models::read(scene, inertias, armature)?);
        let call = BatchCall::of_models(self, self.inputs(given)?, wrenches, models, Cost::of(cost))?;
        let call = call.with(Errors::read(errors)?);
        let torque = TorqueVariance { noise: &noise, joints: &joints, friction_speed };
        let question = Question { forward, parameters: &parameters, torque, frames: &frames };
        let width = nv + 36 * links.len();
        let mut output = call.output(py, &[width], None, Output::new)?;
        let kernels: Mutex<Vec<Box<dyn VarianceLanes>>> = Mutex::new(Vec::new());
        let outcome = call.chunks(py, (width, cost), None, output.numbers()?, &|evaluator, states, _, out| {
            let used = kernels.lock().ok().and_then(|mut kernels| kernels.pop());
            let mut kernel = used.unwrap_or_else(|| kept.kernel(scene, &question));
            let outcome = of_states(scene, &question, evaluator, &mut *kernel, states, out);
            if let Ok(mut kernels) = kernels.lock() {
                kernels.push(kernel);
            }
            outcome
        });
        kept.give_back(kernels.into_inner().unwrap_or_default());
        outcome?;
        Ok(output.finish())
    }
}

/// The states of one chunk: accelerations by the kernels, variances in lanes, and with the checked method where a lane
/// reports it.
fn of_states(
    scene: &Scene,
    question: &Question<'_>,
    evaluator: &mut Evaluator,
    kernel: &mut dyn VarianceLanes,
    states: &[Arguments<'_>],
    out: &mut [f64],
) -> Result<(), Fault> {
    let (nv, count) = (scene.nv(), states.len());
    let mut qdd = [f64::NAN; FEW];
    let mut many = Vec::new();
    let qdd = if let Some(qdd) = qdd.get_mut(..nv * count) {
        qdd
    } else {
        many.resize(nv * count, f64::NAN);
        &mut many[..]
    };
    // Inverse dynamics checks q, qd and qdd.
    let algorithm = if question.forward { Algorithm::ForwardDynamics(Form::Auto) } else { Algorithm::InverseDynamics };
    let outcome = scene.evaluate(evaluator, algorithm, states, qdd);
    // The states before an invalid one are finished.
    let valid = outcome.as_ref().map_or_else(|fault| fault.state, |()| count);
    if !question.forward {
        for (qdd, state) in qdd.chunks_exact_mut(nv.max(1)).zip(states) {
            qdd.copy_from_slice(state.u);
        }
    }
    let at = |i: usize| Arguments { u: &qdd[i * nv..(i + 1) * nv], ..states[i] };
    let width = out.len() / count.max(1);
    let mut doubt = 0;
    for first in (0..valid).step_by(kernel.lanes()) {
        let last = valid.min(first + kernel.lanes());
        let some: Vec<Arguments<'_>> = (first..last).map(at).collect();
        doubt |= kernel.run(&some, &mut out[first * width..last * width]) << first;
    }
    for i in (0..valid).filter(|i| (doubt >> i) & 1 == 1) {
        let out = &mut out[i * width..(i + 1) * width];
        one_by_one(scene, question, &states[i], out).map_err(|error| Fault { state: i, error })?;
    }
    outcome
}

/// One state with every check.
#[cold]
fn one_by_one(scene: &Scene, question: &Question<'_>, state: &Arguments<'_>, out: &mut [f64]) -> Result<(), Error> {
    if let Some((own, state)) = scene.of_own_model(state)? {
        return one_by_one(&own, question, &state, out);
    }
    let Question { forward, parameters, torque, frames } = question;
    let mut scratch = scene.variance_scratch();
    let (joints, of_frames) = out.split_at_mut(scene.nv());
    let at = (state.q, state.qd, state.u);
    if !forward {
        return scene.inverse_dynamics_variance(&mut scratch, at, parameters, torque, joints);
    }
    let count = if frames.is_empty() { 0 } else { scene.model().bodies.len() };
    let mut bodies = vec![Symmetric6::filled(f64::NAN); count];
    let mut workspace = Workspace::new(scene.model());
    let mut variances = Variances { joints, bodies: &mut bodies };
    let wrenches = state.wrenches;
    scene.forward_dynamics_variance(&mut workspace, &mut scratch, at, wrenches, parameters, torque, &mut variances)?;
    for (out, Frame { body, placement }) in of_frames.chunks_exact_mut(36).zip(*frames) {
        let phi = placement.to_matrix();
        let own = body.map_or_else(Matrix6::zeros, |body| bodies[body].to_matrix());
        // Symmetric: the order of columns is that of rows.
        out.copy_from_slice((phi.transpose() * own * phi).as_slice());
    }
    Ok(())
}

impl PyScene {
    /// The roots of the parameters' covariances, from (bodies, rank, 10).
    fn roots(&self, kept: &Kept, roots: &Object<'_>) -> PyResult<Arc<ParameterRoots<f64>>> {
        let (shape, numbers) = shaped("parameters", roots, 10)?;
        let bodies = self.scene.joints().len();
        let rank = match shape[..] {
            [found, rank, 10] if found == bodies => rank,
            _ => return Err(wrong_shape("parameters", &shape, format!("({bodies}, rank, 10)"))),
        };
        let make = |numbers: &[f64]| {
            let columns: &[Parameters<f64>] = numbers.as_chunks::<10>().0;
            let of_body = |k: usize| columns[k * rank..(k + 1) * rank].to_vec();
            let of_links: Vec<Vec<Parameters<f64>>> = (0..bodies).map(of_body).collect();
            self.scene.parameter_roots(&of_links)
        };
        Ok(kept.roots(numbers, make)?)
    }
}

/// Sixteen numbers as rows of four.
fn by_rows(all: &[f64; 16]) -> JointCovariance<f64> {
    std::array::from_fn(|i| std::array::from_fn(|j| all[4 * i + j]))
}
