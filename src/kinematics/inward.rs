//! The pose, velocity and acceleration of one frame, inward over the joints that move it, in O(depth) and without
//! scratch.

use super::frame::{AccelerationKind, Frame, ReferenceFrame};
use super::outward::{joint_motion, joint_shift, placements_on_base};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{RigidShift, angular, cross_add, cross_motion, less, linear, spatial, sum, zero};
use nalgebra::{Vector3, Vector6};

/// The path from a frame to the base.
pub(super) struct PathToBase<'a, T: Real> {
    model: &'a Model<T>,
    q: &'a [T],
    /// The current body; None when the base is reached.
    pub body: Option<usize>,
    /// From the frame to the current body, and finally to the base. Its phi^T propagates motions outward.
    pub placement: RigidShift<T>,
}

impl<'a, T: Real> PathToBase<'a, T> {
    /// Starts at the body that carries the frame.
    #[inline(always)]
    pub fn from(model: &'a Model<T>, q: &'a [T], frame: &Frame<T>) -> Self {
        Self { model, q, body: frame.body, placement: frame.placement }
    }

    /// Past the joint of body `k`, which is the current body.
    #[inline(always)]
    pub fn past(&mut self, k: usize) {
        self.placement = joint_shift(&self.model.bodies[k], self.q).compose(&self.placement);
        self.body = self.model.system.stages[k].parent;
    }

    /// Past the joint of body `k`; on the body `junction` the pose is relative to `origin`.
    #[inline(always)]
    pub fn past_from(&mut self, k: usize, junction: Option<usize>, origin: &Vector3<T>) {
        let mut shift = joint_shift(&self.model.bodies[k], self.q);
        self.body = self.model.system.stages[k].parent;
        if self.body == junction {
            // Subtracted before any addition: both vectors are similarly far away, so that the difference is exact.
            shift.lever = less(&shift.lever, origin);
        }
        self.placement = shift.compose(&self.placement);
    }

    /// The pose on the body `junction`, which is reached; relative to `origin` if the frame is on that body.
    #[inline(always)]
    pub fn placement_from(&self, frame: &Frame<T>, junction: Option<usize>, origin: &Vector3<T>) -> RigidShift<T> {
        let mut placement = self.placement;
        if frame.body == junction {
            placement.lever = less(&placement.lever, origin);
        }
        placement
    }
}

/// The pose of a frame on the base at `q`. O(depth).
#[inline(always)]
pub fn placement<T: Real>(model: &Model<T>, q: &[T], frame: &Frame<T>) -> RigidShift<T> {
    let mut path = PathToBase::from(model, q, frame);
    while let Some(k) = path.body {
        path.past(k);
    }
    path.placement
}

/// The poses of bodies on the base at `q`, into `placements`: of the bodies in `needed` and of all bodies inboard of
/// them, which are added to `needed`. Other poses are not changed.
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
    let on_the_way = || (0..stages.len()).filter(|&k| needed[k]);
    for k in on_the_way() {
        placements[k] = joint_shift(&model.bodies[k], q);
    }
    placements_on_base(model, on_the_way(), placements);
}

/// The motion of a frame relative to the base; vectors are (angular, linear), at its origin and in its axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameMotion<T> {
    /// From the frame to the base.
    pub placement: RigidShift<T>,
    /// V = J qd.
    pub velocity: Vector6<T>,
    /// A = J qdd + J' qd, the derivative of V in the axes of the frame, without gravity.
    pub acceleration: Vector6<T>,
}

/// The motion of a frame at q and qd with the accelerations `qdd`, or without them; the acceleration is then J' qd.
/// O(depth).
///
/// With s(k) the contribution of joint k to the velocity, V = sum of s, and s' = (V(k) - V) x s in the axes of the
/// frame, where V - V(k) = sum of s outboard of k. One pass inward therefore suffices, and J' is not formed.
#[inline(always)]
pub fn frame_motion<T: Real>(
    model: &Model<T>,
    q: &[T],
    qd: &[T],
    qdd: Option<&[T]>,
    frame: &Frame<T>,
) -> FrameMotion<T> {
    let mut path = PathToBase::from(model, q, frame);
    let (mut velocity, mut acceleration) = (zero(), zero());
    while let Some(k) = path.body {
        let (body, row) = (&model.bodies[k], model.system.stages[k].first_row);
        let own = path.placement.motion_to_child(&joint_motion(body, row, qd));
        acceleration = sum(&acceleration, &cross_motion(&own, &velocity));
        if let Some(qdd) = qdd {
            acceleration = sum(&acceleration, &path.placement.motion_to_child(&joint_motion(body, row, qdd)));
        }
        velocity = sum(&velocity, &own);
        path.past(k);
    }
    FrameMotion { placement: path.placement, velocity, acceleration }
}

impl<T: Real> FrameMotion<T> {
    /// The velocity, expressed in `reference`.
    #[inline(always)]
    pub fn velocity_in(&self, reference: ReferenceFrame) -> Vector6<T> {
        reference.express(&self.placement, &self.velocity)
    }

    /// The acceleration of the given kind, expressed in `reference`.
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

    /// The time derivative of the velocity as expressed in `reference`: J' qd + J qdd of its Jacobian. In the frame
    /// itself and in the world frame it is the spatial acceleration; in the base axes at the origin of the frame, which
    /// moves, it is the classical acceleration.
    #[inline(always)]
    pub fn rate_in(&self, reference: ReferenceFrame) -> Vector6<T> {
        let turning = cross_motion(&reference.seen_from(&self.velocity), &self.velocity);
        reference.express(&self.placement, &sum(&self.acceleration, &turning))
    }
}
