//! Base to tip, one body: where it is, how it moves, and the force that this motion needs.

use crate::kinematics::{joint_motion, joint_shift, motion_step};
use crate::scalar::Real;
use crate::scene::Model;
use crate::spatial::{scaled_add, sum};
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// One state of a scene, as the sweeps read it.
#[derive(Clone, Copy)]
pub(super) struct Motion<'a, T: Real> {
    pub q: &'a [T],
    pub qd: &'a [T],
    /// Without joint accelerations the force is the bias b(k).
    pub qdd: Option<&'a [T]>,
    /// Empty, or one a body in its frame.
    pub wrenches: &'a [Vector6<T>],
}

/// The step of body `k`: phi, velocity, acceleration, and `z` = M a + v x* (M v) - wrench; parents must have been done.
#[inline(always)]
pub(super) fn step_outward<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    k: usize,
    state: Motion<'_, T>,
    (still, base): (&Vector6<T>, &Vector6<T>),
) {
    let (body, stage) = (&model.bodies[k], &model.system.stages[k]);
    let shift = joint_shift(body, state.q);
    let parent = match stage.parent {
        Some(parent) => (&workspace.velocity[parent], &workspace.acceleration[parent]),
        None => (still, base),
    };
    let (velocity, mut acceleration) = motion_step(body, stage.first_row, &shift, parent, state.qd);
    if let Some(qdd) = state.qdd {
        acceleration = sum(&acceleration, &joint_motion(body, stage.first_row, qdd));
    }
    let mut force = body.inertia.bias_force(&velocity, &acceleration);
    if !state.wrenches.is_empty() {
        force = scaled_add(&state.wrenches[k], force[0].constant(-1.0), &force);
    }
    workspace.shift[k] = shift;
    workspace.velocity[k] = velocity;
    workspace.acceleration[k] = acceleration;
    workspace.z[k] = force;
}
