//! Vectorized operations on configurations: integration of velocities, and velocities transported to the start of a
//! step.
//!
//! [`Scene::integrate`](crate::Scene::integrate) and [`Scene::difference`](crate::Scene::difference) are the checked
//! equivalents for one state.

use crate::model::Model;
use crate::scalar::Real;

/// q exp(v), joint by joint: integrates `v` (nv) from `q` (nq) over unit time. Quaternions are normalized.
#[inline(always)]
pub fn advance<T: Real>(model: &Model<T>, q: &[T], v: &[T], out: &mut [T]) {
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        body.motion.advance(&q[body.q..], &v[stage.first_row..], &mut out[body.q..]);
    }
}

/// The displacement from `q` to `to` in the child frames at `to`: to first order the velocities that [`advance`]
/// integrates, exactly if no free joint rotates.
pub(super) fn displacement(model: &Model<f64>, q: &[f64], to: &[f64]) -> Vec<f64> {
    let mut x = vec![0.0; model.nv()];
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        body.motion.displacement(&q[body.q..], &to[body.q..], &mut x[stage.first_row..]);
    }
    x
}

/// Adds the gradients by q, in its tangent space, and by x of a function of [`advance`], from those by its result; (nv)
/// each.
#[inline(always)]
pub(super) fn advance_cotangents<T: Real>(model: &Model<T>, x: &[T], of_end: &[T], (of_q, of_x): (&mut [T], &mut [T])) {
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        let row = stage.first_row;
        body.motion.advance_cotangents(&x[row..], &of_end[row..], &mut of_q[row..], &mut of_x[row..]);
    }
}

/// Replaces the body velocities `v` by the time derivative of the increment x: see
/// [`Motion::carry_back`](crate::joints::Motion::carry_back).
#[inline(always)]
pub(super) fn carry_back<T: Real>(model: &Model<T>, x: &[T], v: &mut [T]) {
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        body.motion.carry_back(&x[stage.first_row..], &mut v[stage.first_row..]);
    }
}
