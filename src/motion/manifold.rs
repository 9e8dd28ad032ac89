//! Configurations in lanes: steps along velocities, and velocities seen from where a step began.
//!
//! [`Scene::integrate`](crate::Scene::integrate) and [`Scene::difference`](crate::Scene::difference) are the same for one checked state.

use crate::model::Model;
use crate::scalar::Real;

/// q exp(v), joint by joint: from `q` (nq) along `v` (nv) for unit time; quaternions come out unit.
#[inline(always)]
pub fn advance<T: Real>(model: &Model<T>, q: &[T], v: &[T], out: &mut [T]) {
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        body.motion.advance(&q[body.q..], &v[stage.first_row..], &mut out[body.q..]);
    }
}

/// The rate of the increment x where the bodies move with the velocity `v`, in place: see [`Motion::carry_back`](crate::joints::Motion::carry_back).
#[inline(always)]
pub(super) fn carry_back<T: Real>(model: &Model<T>, x: &[T], v: &mut [T]) {
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        body.motion.carry_back(&x[stage.first_row..], &mut v[stage.first_row..]);
    }
}
