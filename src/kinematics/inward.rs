//! From one frame inward, over the joints that move it: its placement, velocity and acceleration, in O(depth) and
//! without scratch.

use super::frame::{AccelerationKind, Frame, ReferenceFrame};
use super::outward::{joint_motion, joint_shift};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{RigidShift, angular, cross_add, cross_motion, linear, spatial, sum, zero};
use nalgebra::{Vector3, Vector6};

/// The path from a frame to the base.
pub(super) struct PathToBase<'a, T: Real> {
    model: &'a Model<T>,
    q: &'a [T],
    /// The body at hand; none once the base is reached.
    pub body: Option<usize>,
    /// From the frame to the body at hand, in the end to the base: motions go outward with its phi^T.
    pub placement: RigidShift<T>,
}

impl<'a, T: Real> PathToBase<'a, T> {
    /// At the body that carries the frame.
    #[inline(always)]
    pub fn from(model: &'a Model<T>, q: &'a [T], frame: &Frame<T>) -> Self {
        Self { model, q, body: frame.body, placement: frame.placement }
    }

    /// Past the joint of body `k`, which is the one at hand.
    #[inline(always)]
    pub fn past(&mut self, k: usize) {
        self.placement = joint_shift(&self.model.bodies[k], self.q).compose(&self.placement);
        self.body = self.model.system.stages[k].parent;
    }

    /// The same; on the body `junction` the placement is from `origin`.
    #[inline(always)]
    pub fn past_from(&mut self, k: usize, junction: Option<usize>, origin: &Vector3<T>) {
        let mut shift = joint_shift(&self.model.bodies[k], self.q);
        self.body = self.model.system.stages[k].parent;
        if self.body == junction {
            // Before anything is added to it: both are as far away, and what is left is exact.
            shift.lever = less(&shift.lever, origin);
        }
        self.placement = shift.compose(&self.placement);
    }

    /// The placement on the body `junction`, which is reached; from `origin` if the frame was there from the start.
    #[inline(always)]
    pub fn placement_from(&self, frame: &Frame<T>, junction: Option<usize>, origin: &Vector3<T>) -> RigidShift<T> {
        let mut placement = self.placement;
        if frame.body == junction {
            placement.lever = less(&placement.lever, origin);
        }
        placement
    }
}

/// a - b, entry by entry.
#[inline(always)]
fn less<T: Real>(a: &Vector3<T>, b: &Vector3<T>) -> Vector3<T> {
    Vector3::new(a[0] - b[0], a[1] - b[1], a[2] - b[2])
}

/// Where a frame is on the base at `q`. O(depth).
#[inline(always)]
pub fn placement<T: Real>(model: &Model<T>, q: &[T], frame: &Frame<T>) -> RigidShift<T> {
    let mut path = PathToBase::from(model, q, frame);
    while let Some(k) = path.body {
        path.past(k);
    }
    path.placement
}

/// Where bodies are on the base at `q`, into `placements`: those that `needed` says and all inboard of them, which it
/// says afterwards. The others are left as they are.
#[inline(always)]
pub fn placements_on_the_way<T: Real>(
    model: &Model<T>,
    q: &[T],
    needed: &mut [bool],
    placements: &mut [RigidShift<T>],
) {
    let stages = &model.system.stages;
    for (k, stage) in stages.iter().enumerate().rev() {
        if let (true, Some(parent)) = (needed[k], stage.parent) {
            needed[parent] = true;
        }
    }
    for (k, stage) in stages.iter().enumerate().filter(|&(k, _)| needed[k]) {
        let shift = joint_shift(&model.bodies[k], q);
        placements[k] = match stage.parent {
            Some(parent) => placements[parent].compose(&shift),
            None => shift,
        };
    }
}

/// How a frame moves against the base; vectors are (angular, linear), at its origin and in its axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameMotion<T> {
    /// From the frame to the base.
    pub placement: RigidShift<T>,
    /// V = J qd.
    pub velocity: Vector6<T>,
    /// A = J qdd + J' qd, the rate of V in the frame's axes, without gravity.
    pub acceleration: Vector6<T>,
}

/// The motion of a frame at q and qd with the accelerations `qdd`, or with none: J' qd is then the acceleration.
/// O(depth).
///
/// With s(k) what joint k adds to the velocity, V = sum of s, and s' = (V(k) - V) x s in the frame's axes, where V -
/// V(k) = sum of s outboard of k: so one pass inward is enough, and J' is not formed.
#[inline(always)]
pub fn frame_motion<T: Real>(
    model: &Model<T>,
    q: &[T],
    qd: &[T],
    qdd: Option<&[T]>,
    frame: &Frame<T>,
) -> FrameMotion<T> {
    motion_along(model, (q, qd, qdd), frame, (None, &Vector3::from_element(T::zero())))
}

/// The same against the body `junction`, whose own motion does not count; the placement is in its axes, from `origin`.
#[inline(always)]
pub(super) fn motion_along<T: Real>(
    model: &Model<T>,
    (q, qd, qdd): (&[T], &[T], Option<&[T]>),
    frame: &Frame<T>,
    (junction, origin): (Option<usize>, &Vector3<T>),
) -> FrameMotion<T> {
    let mut path = PathToBase::from(model, q, frame);
    let (mut velocity, mut acceleration) = (zero(), zero());
    while path.body != junction {
        let Some(k) = path.body else { break };
        let (body, row) = (&model.bodies[k], model.system.stages[k].first_row);
        let own = path.placement.motion_to_child(&joint_motion(body, row, qd));
        acceleration = sum(&acceleration, &cross_motion(&own, &velocity));
        if let Some(qdd) = qdd {
            acceleration = sum(&acceleration, &path.placement.motion_to_child(&joint_motion(body, row, qdd)));
        }
        velocity = sum(&velocity, &own);
        path.past_from(k, junction, origin);
    }
    FrameMotion { placement: path.placement_from(frame, junction, origin), velocity, acceleration }
}

impl<T: Real> FrameMotion<T> {
    /// The velocity, written in `reference`.
    #[inline(always)]
    pub fn velocity_in(&self, reference: ReferenceFrame) -> Vector6<T> {
        reference.express(&self.placement, &self.velocity)
    }

    /// The acceleration of that kind, written in `reference`.
    #[inline(always)]
    pub fn acceleration_in(&self, reference: ReferenceFrame, kind: AccelerationKind) -> Vector6<T> {
        let spatial_one = reference.express(&self.placement, &self.acceleration);
        match kind {
            AccelerationKind::Spatial => spatial_one,
            AccelerationKind::Classical => {
                let v = self.velocity_in(reference);
                spatial(&angular(&spatial_one), &cross_add(&angular(&v), &linear(&v), &linear(&spatial_one)))
            }
        }
    }

    /// The rate of the velocity as it is written in `reference`: J' qd + J qdd of the Jacobian there. In the frame
    /// itself and in the world that is the spatial acceleration; in the base's axes at the frame's origin, which moves,
    /// the classical one.
    #[inline(always)]
    pub fn rate_in(&self, reference: ReferenceFrame) -> Vector6<T> {
        let turning = cross_motion(&reference.seen_from(&self.velocity), &self.velocity);
        reference.express(&self.placement, &sum(&self.acceleration, &turning))
    }
}
