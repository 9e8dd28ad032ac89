//! The forces of one row of the connections on bodies and joints.

use crate::kinematics::Frame;
use crate::kinematics::propagation::Accumulates;
use crate::spatial::{RigidShift, angular, linear, sum, zero};
use nalgebra::Vector6;

/// J* of one row: the forces on bodies, in their body frames, and the joint torques for a unit force along the row.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct UnitRow {
    pub forces: [Option<(usize, Vector6<f64>)>; 2],
    /// Sizes of the terms of their moments.
    pub moments: [f64; 2],
    pub torques: [Option<(usize, f64)>; 2],
}

impl UnitRow {
    /// The row of a force on frame C, in its axes at its origin, and of the opposite force on frame D. `place` is the
    /// pose of C in D.
    pub fn between([c, d]: [&Frame<f64>; 2], place: &RigidShift<f64>, force: &Vector6<f64>) -> Self {
        let back = -place.force_to_parent(force);
        let (moment, push) = (angular(force).norm(), linear(force).norm());
        let reach = [c.placement.lever.norm(), place.lever.norm() + d.placement.lever.norm()];
        Self {
            forces: [(c, force), (d, &back)]
                .map(|(frame, force)| frame.body.map(|k| (k, frame.placement.force_to_parent(force)))),
            moments: reach.map(|reach| moment + reach * push),
            torques: [None; 2],
        }
    }
}

/// The force of a row on a body with those that were propagated to it, and the size of the terms of its moment.
#[derive(Debug, Clone, Copy)]
pub(super) struct SizedForce {
    pub force: Vector6<f64>,
    pub moment: f64,
}

impl SizedForce {
    pub fn zero() -> Self {
        Self { force: zero(), moment: 0.0 }
    }
}

impl Accumulates<f64> for SizedForce {
    fn propagated(&self, shift: &RigidShift<f64>) -> Self {
        let Self { force, moment } = self;
        // A lever parallel to a force gives a moment that is only rounding; it does not count as a moment.
        let moment = angular(force).norm().max(*moment) + shift.lever.norm() * linear(force).norm();
        Self { force: shift.force_to_parent(force), moment }
    }

    fn plus(&self, other: &Self) -> Self {
        Self { force: sum(&self.force, &other.force), moment: self.moment + other.moment }
    }
}
