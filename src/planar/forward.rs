//! Forward dynamics in the plane, covariance form.

use super::inward;
use super::model::{Direction, PlanarModel};
use super::outward::{self, State, dot, turned_back};
use super::scratch::PlanarScratch;
use crate::filter::pivots::PivotMonitor;
use crate::scalar::Real;
use nalgebra::Vector6;

/// Joint accelerations from joint torques in O(N), as [`dynamics::forward_dynamics`](crate::dynamics::forward_dynamics()) gives them in
/// covariance form; arguments and results as there.
///
/// About 160 operations a joint that turns without armature, 52 of them its sine and cosine. Where the monitor is not clear, `qdd` means
/// nothing.
#[inline(always)]
pub fn forward_dynamics<T: Real, C: Real>(
    model: &PlanarModel<T>,
    scratch: &mut PlanarScratch<T, C>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    qdd: &mut [T],
) -> PivotMonitor<T> {
    let of = &mut scratch.of[..];
    outward::forces(model, of, State { q, qd, qdd: None, wrenches });
    let monitor = inward::sweep::<T, true>(model, of, tau, qdd);
    // The smoother (4.9 to 4.11): co-states are the accelerations that joint accelerations cause.
    for (k, body) in model.bodies.iter().enumerate() {
        let own = of[k];
        let zero = own.pivot_inverse.constant(0.0);
        let mut motion = [zero; 3];
        let mut acceleration = qdd[k];
        if let Some(parent) = body.parent {
            let [angular, x, y] = of[parent].motion;
            let [lx, ly] = own.lever;
            let [x, y] = turned_back(own.turn, [x.minus_product(angular, ly), angular.mul_add(lx, y)]);
            motion = [angular, x, y];
            acceleration -= projected(body.is_noise_free, body.direction, own.gain, motion);
        }
        motion[usize::from(!body.turns())] += acceleration;
        of[k].motion = motion;
        qdd[k] = body.along(acceleration);
    }
    monitor
}

/// g* of a motion; the entry of g that is one is not multiplied.
#[inline(always)]
fn projected<T: Real>(exact: bool, direction: Direction<T>, gain: [T; 3], [w, x, y]: [T; 3]) -> T {
    match direction {
        Direction::Turns { .. } if exact => gain[1].mul_add(x, gain[2].mul_add(y, w)),
        Direction::Slides { .. } if exact => gain[0].mul_add(w, gain[2].mul_add(y, x)),
        _ => dot(gain, [w, x, y]),
    }
}
