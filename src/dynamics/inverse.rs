//! Inverse dynamics: the torques that the model predicts, T = H phi (Q lambda + b).

use super::forces::{Motion, Needed, step_outward};
use crate::filter::innovations;
use crate::kinematics::{base_acceleration, joint_motion};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{sum, zero};
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// Joint torques from joint accelerations in O(N): accelerations base to tip (2.9), forces tip to base (1.5, 2.10).
///
/// Arguments as in [`forward_dynamics`](super::forward_dynamics). Armature adds `r qdd` to its joint. About 330 operations
/// a one-axis joint.
#[inline(always)]
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
#[inline(always)]
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

/// Base to tip: the force that each body needs, into `workspace.z`.
#[inline(always)]
pub(crate) fn forces_base_to_tip<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, state: Motion<'_, T>) {
    let (still, base) = (zero(), base_acceleration(model));
    let needed = Needed::of(model, state);
    for k in 0..model.bodies.len() {
        step_outward(model, workspace, k, state, needed, (&still, &base));
    }
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
