//! Free joints in steps with contacts: they move in axes that are fixed during the step.

use super::super::scratch::Scratch;
use crate::joints::quaternion;
use crate::joints::vectors::{cross, triple, write};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::RigidShift;
use nalgebra::Matrix3;

/// The body that each free joint moves, and the index in qd of its first velocity.
pub(super) fn free_joints<T: Real>(model: &Model<T>) -> impl Iterator<Item = (usize, usize)> {
    let each = model.bodies.iter().zip(&model.system.stages).enumerate();
    each.filter(|(_, (body, _))| body.motion.is_free()).map(|(k, (_, stage))| (k, stage.first_row))
}

/// The rotation from the axes of a free joint with coordinates `q` to those of its parent.
pub(super) fn rotation(q: &[f64]) -> Matrix3<f64> {
    quaternion::rotation(&q[3..7]).rotation
}

/// Adds w x v to the accelerations of free joints: the acceleration of the origin in axes that are fixed at the start
/// of the step.
#[inline(always)]
pub(super) fn to_axes_at_rest<T: Real>(model: &Model<T>, h: f64, v: &[T], v_next: &mut [T]) {
    for (_, row) in free_joints(model) {
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
            let own = triple(x);
            let along = quaternion::rotation(&q[3..7]).rotate(&own);
            for x in &mut x[..3] {
                *x = x.constant(0.0);
            }
            body.motion.advance(q, x, &mut s.q_next[body.q..]);
            for i in 0..3 {
                s.q_next[body.q + i] = q[i] + along[i];
            }
            // The works of the step are those for the whole displacement, in the axes at its start.
            write(x, &own);
        } else {
            body.motion.advance(q, x, &mut s.q_next[body.q..]);
        }
    }
}

/// Expresses the linear velocities of free joints, which are in the axes at `q`, in the axes at `q_next`.
#[inline(always)]
pub(super) fn to_axes_at_end<T: Real>(model: &Model<T>, (q, q_next): (&[T], &[T]), v: &mut [T]) {
    for (k, row) in free_joints(model) {
        let at = model.bodies[k].q + 3;
        let [before, after]: [RigidShift<T>; 2] = [q, q_next].map(|q| quaternion::rotation(&q[at..]));
        let turned = after.rotate_back(&before.rotate(&triple(&v[row..])));
        write(&mut v[row..], &turned);
    }
}
