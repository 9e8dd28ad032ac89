//! Inverse dynamics: the torques that the model predicts, T = H phi (Q lambda + b).

use super::forces::{Motion, forces_base_to_tip};
use crate::filter::innovations;
use crate::kinematics::joint_motion;
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::sum;
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// Joint torques from joint accelerations in O(N): accelerations base to tip (2.9), forces tip to base (1.5, 2.10).
///
/// Arguments as in [`forward_dynamics`](super::forward_dynamics). Armature adds `r qdd` to its joint. About 330 operations
/// a one-axis joint.
pub fn inverse_dynamics<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    q: &[T],
    qd: &[T],
    qdd: &[T],
    wrenches: &[Vector6<T>],
    tau: &mut [T],
) {
    forces_base_to_tip(model, workspace, Motion { q, qd, qdd: Some(qdd), wrenches });
    innovations::predict(&model.system, &workspace.shift, &mut workspace.z, tau);
    for ((tau, &qdd), &armature) in tau.iter_mut().zip(qdd).zip(&model.system.noise) {
        *tau += armature * qdd;
    }
}

/// The bias torque H phi b: what the joints must give when no joint accelerates (velocity effects, gravity, wrenches).
pub fn bias_torque<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    q: &[T],
    qd: &[T],
    wrenches: &[Vector6<T>],
    tau: &mut [T],
) {
    forces_base_to_tip(model, workspace, Motion { q, qd, qdd: None, wrenches });
    innovations::predict(&model.system, &workspace.shift, &mut workspace.z, tau);
}

/// Base to tip: the bias force b(k) of every body (1.3), in its frame, into `workspace.z`.
#[cfg(feature = "stochastic")]
pub(crate) fn bias_forces_base_to_tip<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, q: &[T], qd: &[T]) {
    forces_base_to_tip(model, workspace, Motion { q, qd, qdd: None, wrenches: &[] });
}

/// M a = H phi Q phi* H* a + r a (2.8), with phi already in the workspace.
pub fn mul_mass<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, a: &[T], out: &mut [T]) {
    for (k, body) in model.bodies.iter().enumerate() {
        let stage = &model.system.stages[k];
        let mut lambda = joint_motion(body, stage.first_row, a);
        if let Some(parent) = stage.parent {
            lambda = sum(&lambda, &workspace.shift[k].motion_to_child(&workspace.co_state[parent]));
        }
        workspace.co_state[k] = lambda;
        workspace.z[k] = body.inertia.mul_motion(&lambda);
    }
    innovations::predict(&model.system, &workspace.shift, &mut workspace.z, out);
    for ((out, &a), &armature) in out.iter_mut().zip(a).zip(&model.system.noise) {
        *out += armature * a;
    }
}
