//! Free joints in steps with contacts: they move in axes that are fixed during the step.

use super::super::scratch::Scratch;
use crate::joints::quaternion::rotation;
use crate::joints::vectors::{cross, triple, write};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::RigidShift;

/// Index in qd of the first velocity of each free joint, and in q of its first coordinate.
fn free_joints<T: Real>(model: &Model<T>) -> impl Iterator<Item = (usize, usize)> {
    let each = model.bodies.iter().zip(&model.system.stages);
    each.filter(|(body, _)| body.motion.is_free()).map(|(body, stage)| (stage.first_row, body.q))
}

/// Adds w x v to the accelerations of free joints: the acceleration of the origin in axes that are fixed at the start
/// of the step.
#[inline(always)]
pub(super) fn to_axes_at_rest<T: Real>(model: &Model<T>, h: f64, v: &[T], v_next: &mut [T]) {
    for (row, _) in free_joints(model) {
        let turning = cross(&triple(&v[row + 3..]), &triple(&v[row..]));
        for i in 0..3 {
            v_next[row + i] = turning[i].mul_add(turning[i].constant(h), v_next[row + i]);
        }
    }
}

/// `q_next` = q exp(h `v_next`), where the origins of free joints move on straight lines.
#[inline(always)]
pub(super) fn move_along<T: Real>(h: f64, s: &mut Scratch<T>) {
    for (x, v) in s.x.iter_mut().zip(&s.v_next) {
        *x = *v * v.constant(h);
    }
    for (body, stage) in s.model.bodies.iter().zip(&s.model.system.stages) {
        let (x, q) = (&mut s.x[stage.first_row..], &s.q[body.q..]);
        if body.motion.is_free() {
            let along = rotation(&q[3..7]).rotate(&triple(x));
            for x in &mut x[..3] {
                *x = x.constant(0.0);
            }
            body.motion.advance(q, x, &mut s.q_next[body.q..]);
            for i in 0..3 {
                s.q_next[body.q + i] = q[i] + along[i];
            }
        } else {
            body.motion.advance(q, x, &mut s.q_next[body.q..]);
        }
    }
}

/// Expresses the linear velocities of free joints, which are in the axes at `q`, in the axes at `q_next`.
#[inline(always)]
pub(super) fn to_axes_at_end<T: Real>(model: &Model<T>, (q, q_next): (&[T], &[T]), v: &mut [T]) {
    for (row, at) in free_joints(model) {
        let (before, after): (RigidShift<T>, RigidShift<T>) = (rotation(&q[at + 3..]), rotation(&q_next[at + 3..]));
        let turned = after.rotate_back(&before.rotate(&triple(&v[row..])));
        write(&mut v[row..], &turned);
    }
}
