//! Base to tip: poses, velocities, and accelerations at zero joint acceleration.

use crate::model::{Body, Model};
use crate::scalar::Real;
use crate::spatial::{RigidShift, sum, zero};
use nalgebra::Vector6;

/// phi from the body's frame to its parent's, at configuration `q`.
#[inline(always)]
pub fn joint_shift<T: Real>(body: &Body<T>, q: &[T]) -> RigidShift<T> {
    body.motion.shift(&body.tree, &q[body.q..])
}

/// H^T u in the frame of the body, for the joint velocities (or accelerations) `u` of all joints; `row` is the first
/// row of the joint.
#[inline(always)]
pub fn joint_motion<T: Real>(body: &Body<T>, row: usize, u: &[T]) -> Vector6<T> {
    body.motion.velocity(&u[row..], body.tree.lever[0])
}

/// The acceleration of the base: minus gravity, so that every b(k) includes the weight.
#[inline(always)]
pub fn base_acceleration<T: Real>(model: &Model<T>) -> Vector6<T> {
    let (o, g) = (T::zero(), &model.gravity);
    Vector6::new(o, o, o, -g[0], -g[1], -g[2])
}

/// Base to tip: phi of every body at `q`.
#[inline(always)]
pub fn placements_base_to_tip<T: Real>(model: &Model<T>, q: &[T], shift: &mut [RigidShift<T>]) {
    for (shift, body) in shift.iter_mut().zip(&model.bodies) {
        *shift = joint_shift(body, q);
    }
}

/// Base to tip over `bodies`, innermost first: the pose of each body on the base, in the place of phi to its parent.
#[inline(always)]
pub fn placements_on_base<T: Real>(
    model: &Model<T>,
    bodies: impl Iterator<Item = usize>,
    placements: &mut [RigidShift<T>],
) {
    for k in bodies {
        if let Some(parent) = model.system.stages[k].parent {
            placements[k] = placements[parent].compose(&placements[k]);
        }
    }
}

/// Base to tip: the spatial velocity v(k) of every body in its frame, with phi in `shift`.
#[inline(always)]
pub fn velocities_base_to_tip<T: Real>(
    model: &Model<T>,
    shift: &[RigidShift<T>],
    qd: &[T],
    velocity: &mut [Vector6<T>],
) {
    for (k, (body, stage)) in model.bodies.iter().zip(&model.system.stages).enumerate() {
        let joint = joint_motion(body, stage.first_row, qd);
        velocity[k] = match stage.parent {
            Some(parent) => sum(&joint, &shift[k].motion_to_child(&velocity[parent])),
            None => joint,
        };
    }
}

/// Base to tip: the spatial acceleration of every body in its frame (2.9) at joint accelerations `qdd`, with phi in
/// `shift` and the velocities of [`velocities_base_to_tip`]. `base` is the acceleration of the base; None means zero.
#[inline(always)]
pub fn accelerations_base_to_tip<T: Real>(
    model: &Model<T>,
    (shift, velocity): (&[RigidShift<T>], &[Vector6<T>]),
    (qd, qdd): (&[T], &[T]),
    base: Option<&Vector6<T>>,
    acceleration: &mut [Vector6<T>],
) {
    for (k, (body, stage)) in model.bodies.iter().zip(&model.system.stages).enumerate() {
        let (row, joint) = (stage.first_row, joint_motion(body, stage.first_row, qd));
        let own = sum(&body.motion.velocity_product(&velocity[k], &joint), &joint_motion(body, row, qdd));
        let carried = match (stage.parent, base) {
            (Some(parent), _) => shift[k].motion_to_child(&acceleration[parent]),
            (None, Some(base)) => shift[k].motion_to_child(base),
            (None, None) => zero(),
        };
        acceleration[k] = sum(&carried, &own);
    }
}

/// The velocity of a body, and the velocity-dependent part of its acceleration, from those of its parent transported to
/// the joint, phi^T of both. The acceleration of the parent may contain joint accelerations; the caller adds those of
/// this joint.
#[inline(always)]
pub fn motion_past_joint<T: Real>(
    body: &Body<T>,
    row: usize,
    seen: &(Vector6<T>, Vector6<T>),
    qd: &[T],
) -> (Vector6<T>, Vector6<T>) {
    let joint = joint_motion(body, row, qd);
    let velocity = sum(&seen.0, &joint);
    let acceleration = sum(&seen.1, &body.motion.velocity_product(&velocity, &joint));
    (velocity, acceleration)
}

/// dq/dt for the velocity `v` at `q`: equal to v, except for quaternions (half q times the angular velocity) and for
/// the position of a free joint (its linear velocity, rotated into the frame of the parent).
pub fn coordinate_rates<T: Real>(model: &Model<T>, q: &[T], v: &[T], rates: &mut [T]) {
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        body.motion.coordinate_rates(&q[body.q..], &v[stage.first_row..], &mut rates[body.q..]);
    }
}
