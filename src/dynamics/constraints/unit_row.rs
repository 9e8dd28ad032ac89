//! What one row of the connections does to bodies and joints.

use crate::kinematics::Frame;
use crate::scalar::Real;
use crate::spatial::{RigidShift, angular, linear};
use nalgebra::{Vector3, Vector6};

/// J* of one row: the forces on bodies, each in its body's frame, and the torques at joints of a unit force along it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct UnitRow<T = f64> {
    pub forces: [Option<(usize, Vector6<T>)>; 2],
    /// Sizes of the terms that their moments are the sum of.
    pub moments: [T; 2],
    pub torques: [Option<(usize, T)>; 2],
}

impl<T: Real> UnitRow<T> {
    /// That which does nothing.
    pub fn none() -> Self {
        Self { forces: [None; 2], moments: [T::zero(); 2], torques: [None; 2] }
    }

    /// Of a force on frame C, in its axes at its origin, and of the opposite one on frame D, where C is at `place` in D's axes.
    #[inline(always)]
    pub fn between([c, d]: [&Frame<T>; 2], place: &RigidShift<T>, force: &Vector6<T>) -> Self {
        let back = -place.force_to_parent(force);
        let (moment, push) = (norm(&angular(force)), norm(&linear(force)));
        let reach = [norm(&c.placement.lever), norm(&place.lever) + norm(&d.placement.lever)];
        Self {
            forces: [(c, force), (d, &back)]
                .map(|(frame, force)| frame.body.map(|k| (k, frame.placement.force_to_parent(force)))),
            moments: reach.map(|reach| reach.mul_add(push, moment)),
            torques: [None; 2],
        }
    }
}

#[inline(always)]
fn norm<T: Real>(v: &Vector3<T>) -> T {
    v[0].mul_add(v[0], v[1].mul_add(v[1], v[2] * v[2])).sqrt()
}
