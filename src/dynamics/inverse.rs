//! Inverse dynamics: the torques T = H phi (Q lambda + b) of the model.

use super::forces::Motion;
use super::sweeps::general;
use crate::model::Model;
use crate::scalar::Real;
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// Joint torques from joint accelerations in O(N): accelerations base to tip (2.9), forces tip to base (1.5, 2.10).
///
/// Arguments as in [`forward_dynamics`](super::forward_dynamics). Armature adds `r qdd` to its joint. About 290
/// operations per joint with one axis.
pub fn inverse_dynamics<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    q: &[T],
    qd: &[T],
    qdd: &[T],
    wrenches: &[Vector6<T>],
    tau: &mut [T],
) {
    let (scene, store) = workspace.passes(model);
    general::inverse_dynamics(scene, store, Motion { q, qd, qdd: Some(qdd), wrenches }, tau);
}

/// The bias torque H phi b: the joint torques at zero joint acceleration (velocity effects, gravity, wrenches).
pub fn bias_torque<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    q: &[T],
    qd: &[T],
    wrenches: &[Vector6<T>],
    tau: &mut [T],
) {
    let (scene, store) = workspace.passes(model);
    general::inverse_dynamics(scene, store, Motion { q, qd, qdd: None, wrenches }, tau);
}

/// Base to tip: phi, and the force that each body needs (1.3), in its frame, in the store and in `workspace.z`.
pub(crate) fn forces_base_to_tip<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, state: Motion<'_, T>) {
    let Workspace { sweeps, store, z, .. } = workspace;
    general::forces::<T, false>((model, sweeps), store, state);
    for (z, force) in z.iter_mut().zip(store.forces()) {
        *z = force;
    }
}

/// M a = H phi Q phi* H* a + r a (2.8), with phi already in the workspace.
pub fn mul_mass<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, a: &[T], out: &mut [T]) {
    let (scene, store) = workspace.passes(model);
    general::mul_mass(scene, store, a, out);
}
