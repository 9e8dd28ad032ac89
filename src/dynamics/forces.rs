//! Base to tip: where each body is, how it moves, and the force that this motion needs.

use crate::kinematics::{base_acceleration, joint_motion, joint_shift, motion_step};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{scaled_add, sum, zero};
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// One state of a scene, as the sweeps read it.
#[derive(Clone, Copy)]
pub(crate) struct Motion<'a, T: Real> {
    pub q: &'a [T],
    pub qd: &'a [T],
    /// Without joint accelerations the force is the bias b(k).
    pub qdd: Option<&'a [T]>,
    /// Empty, or one a body in its frame.
    pub wrenches: &'a [Vector6<T>],
}

/// What a call computes of a body's motion and of the force that this needs.
#[derive(Clone, Copy)]
pub(super) struct Needed {
    /// Some rate is not zero.
    pub velocity: bool,
    /// Some acceleration is not zero: gravity, what velocities cause, or joint accelerations.
    pub acceleration: bool,
}

impl Needed {
    /// For all lanes together; a rate that is NaN is not zero.
    #[inline(always)]
    pub fn of<T: Real>(model: &Model<T>, state: Motion<'_, T>) -> Self {
        let simplifications = &model.simplifications;
        let velocity = !(simplifications.zero_velocity && is_zero(state.qd));
        let weightless = simplifications.zero_gravity && is_zero(model.gravity.as_slice());
        Self { velocity, acceleration: velocity || state.qdd.is_some() || !weightless }
    }
}

/// Whether all numbers are zero in all lanes.
#[inline(always)]
fn is_zero<T: Real>(numbers: &[T]) -> bool {
    // Mostly the first says it.
    for number in numbers {
        for lane in 0..T::LANES {
            if number.lane(lane) != 0.0 {
                return false;
            }
        }
    }
    true
}

/// The step of body `k`: phi, velocity, acceleration, and `z` = M a + v x* (M v) - wrench; parents must have been done.
#[inline(always)]
pub(super) fn step_outward<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    k: usize,
    state: Motion<'_, T>,
    needed: Needed,
    (still, base): (&Vector6<T>, &Vector6<T>),
) {
    let (body, stage) = (&model.bodies[k], &model.system.stages[k]);
    let shift = joint_shift(body, state.q);
    workspace.shift[k] = shift;
    let mut force = if needed.velocity {
        let parent = match stage.parent {
            Some(parent) => (&workspace.velocity[parent], &workspace.acceleration[parent]),
            None => (still, base),
        };
        let (velocity, mut acceleration) = motion_step(body, stage.first_row, &shift, parent, state.qd);
        if let Some(qdd) = state.qdd {
            acceleration = sum(&acceleration, &joint_motion(body, stage.first_row, qdd));
        }
        workspace.velocity[k] = velocity;
        workspace.acceleration[k] = acceleration;
        body.inertia.bias_force(&velocity, &acceleration)
    } else if needed.acceleration {
        let parent = match stage.parent {
            Some(parent) => &workspace.acceleration[parent],
            None => base,
        };
        let mut acceleration = shift.motion_to_child(parent);
        if let Some(qdd) = state.qdd {
            acceleration = sum(&acceleration, &joint_motion(body, stage.first_row, qdd));
        }
        workspace.velocity[k] = *still;
        workspace.acceleration[k] = acceleration;
        body.inertia.mul_motion(&acceleration)
    } else {
        workspace.velocity[k] = *still;
        workspace.acceleration[k] = *still;
        *still
    };
    if !state.wrenches.is_empty() {
        force = scaled_add(&state.wrenches[k], force[0].constant(-1.0), &force);
    }
    workspace.z[k] = force;
}

/// Base to tip: the force that each body needs, into `workspace.z`.
pub(crate) fn forces_base_to_tip<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, state: Motion<'_, T>) {
    let (still, base) = (zero(), base_acceleration(model));
    let needed = Needed::of(model, state);
    for k in 0..model.bodies.len() {
        step_outward(model, workspace, k, state, needed, (&still, &base));
    }
}
