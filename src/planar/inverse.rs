//! Inverse dynamics and the bias in the plane.

use super::model::PlanarModel;
use super::outward::{self, State, force_to_parent};
use super::scratch::{Of, PlanarScratch};
use crate::scalar::Real;
use nalgebra::Vector6;

/// Joint torques from joint accelerations in O(N), as [`dynamics::inverse_dynamics`](crate::dynamics::inverse_dynamics()) gives them;
/// arguments and results as there. About 100 operations a joint that turns, 52 of them its sine and cosine.
#[inline(always)]
pub fn inverse_dynamics<T: Real, C: Real>(
    model: &PlanarModel<T>,
    scratch: &mut PlanarScratch<T, C>,
    (q, qd, qdd): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    tau: &mut [T],
) {
    outward::forces(model, &mut scratch.of, State { q, qd, qdd: Some(qdd), wrenches });
    torques(model, &mut scratch.of, tau);
    for ((tau, &qdd), body) in tau.iter_mut().zip(qdd).zip(&model.bodies) {
        if !body.is_noise_free {
            *tau = body.armature.mul_add(qdd, *tau);
        }
    }
}

/// The bias torque H phi b, as [`dynamics::bias_torque`](crate::dynamics::bias_torque()) gives it.
#[inline(always)]
pub fn bias_torque<T: Real, C: Real>(
    model: &PlanarModel<T>,
    scratch: &mut PlanarScratch<T, C>,
    (q, qd): (&[T], &[T]),
    wrenches: &[Vector6<T>],
    tau: &mut [T],
) {
    outward::forces(model, &mut scratch.of, State { q, qd, qdd: None, wrenches });
    torques(model, &mut scratch.of, tau);
}

/// Tip to base: H phi f.
#[inline(always)]
fn torques<T: Real>(model: &PlanarModel<T>, of: &mut [Of<T>], tau: &mut [T]) {
    for (k, body) in model.bodies.iter().enumerate().rev() {
        let Of { turn, lever, force, .. } = of[k];
        tau[k] = if body.turns() { body.along(force[0]) } else { force[1] };
        if let Some(parent) = body.parent {
            let carried = force_to_parent(turn, lever, force);
            for (force, carried) in of[parent].force.iter_mut().zip(carried) {
                *force += carried;
            }
        }
    }
}
