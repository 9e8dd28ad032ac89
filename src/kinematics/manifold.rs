//! Vectorized operations on configurations: integration of velocities, and velocities transported to the start of a
//! step.
//!
//! [`Scene::integrate`](crate::Scene::integrate) and [`Scene::difference`](crate::Scene::difference) are the checked
//! equivalents for one state.

#[cfg(feature = "estimation")]
use crate::joints::Motion;
use crate::model::Model;
use crate::scalar::Real;

/// q exp(v), joint by joint: integrates `v` (nv) from `q` (nq) over unit time. Quaternions are normalized.
#[inline(always)]
pub(crate) fn advance<T: Real>(model: &Model<T>, q: &[T], v: &[T], out: &mut [T]) {
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        body.motion.advance(&q[body.q..], &v[stage.first_row..], &mut out[body.q..]);
    }
}

/// The displacement from `q` to `to` in the child frames at `to`: to first order the velocities that [`advance`]
/// integrates, exactly if no free joint rotates.
#[cfg(feature = "motion")]
pub(crate) fn displacement(model: &Model<f64>, q: &[f64], to: &[f64]) -> Vec<f64> {
    let mut x = vec![0.0; model.nv()];
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        body.motion.displacement(&q[body.q..], &to[body.q..], &mut x[stage.first_row..]);
    }
    x
}

/// Adds the gradients by q, in its tangent space, and by x of a function of [`advance`], from those by its result; (nv)
/// each.
#[cfg(feature = "derivatives")]
#[inline(always)]
pub(crate) fn advance_cotangents<T: Real>(model: &Model<T>, x: &[T], of_end: &[T], (of_q, of_x): (&mut [T], &mut [T])) {
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        let row = stage.first_row;
        body.motion.advance_cotangents(&x[row..], &of_end[row..], &mut of_q[row..], &mut of_x[row..]);
    }
}

/// d q'/d q and d q'/d x of q' = q exp(x), for x (3) of a spherical joint or (6) of a free one; row by row.
#[cfg(feature = "estimation")]
pub(crate) fn step_jacobians(x: &[f64]) -> [[f64; 36]; 2] {
    let motion = if x.len() == 3 { Motion::Spherical } else { Motion::Free };
    let [mut of_q, mut of_x] = [[0.0; 36]; 2];
    for i in 0..x.len() {
        let (mut next, row) = ([0.0; 6], i * x.len());
        next[i] = 1.0;
        motion.advance_cotangents(x, &next, &mut of_q[row..], &mut of_x[row..]);
    }
    [of_q, of_x]
}

/// Replaces the body velocities `v` by the time derivative of the increment x: see
/// [`Motion::carry_back`](crate::joints::Motion::carry_back).
#[cfg(feature = "motion")]
#[inline(always)]
pub(crate) fn carry_back<T: Real>(model: &Model<T>, x: &[T], v: &mut [T]) {
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        body.motion.carry_back(&x[stage.first_row..], &mut v[stage.first_row..]);
    }
}
