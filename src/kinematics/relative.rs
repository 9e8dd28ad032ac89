//! Two frames against the body where their ways to the base meet: the joints that move both alike do not enter.
//!
//! The origin of the placements is where the branch of the second frame begins, so that the distance of a mechanism
//! from the base, which both would carry, does not enter either: at 10 km it would leave 1e-12 m of rounding in the
//! place of one frame in the other.

use super::frame::Frame;
use super::inward::{FrameMotion, PathToBase, motion_along};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::RigidShift;
use nalgebra::Vector3;

/// Placements of frames C and D in the axes of the body `junction`, from a common origin.
#[inline(always)]
pub(crate) fn placements_from<T: Real>(
    model: &Model<T>,
    q: &[T],
    [c, d]: [&Frame<T>; 2],
    junction: Option<usize>,
) -> [RigidShift<T>; 2] {
    let origin = origin_of(model, q, d, junction);
    [c, d].map(|frame| {
        let mut path = PathToBase::from(model, q, frame);
        while path.body != junction {
            let Some(k) = path.body else { break };
            path.past_from(k, junction, &origin);
        }
        path.placement_from(frame, junction, &origin)
    })
}

/// Motions of frames C and D against the body `junction`, as [`frame_motion`](super::frame_motion) has them against the
/// base; placements are those of [`placements_from`].
#[inline(always)]
pub(crate) fn motions_from<T: Real>(
    model: &Model<T>,
    (q, qd, qdd): (&[T], &[T], Option<&[T]>),
    [c, d]: [&Frame<T>; 2],
    junction: Option<usize>,
) -> [FrameMotion<T>; 2] {
    let origin = origin_of(model, q, d, junction);
    [c, d].map(|frame| motion_along(model, (q, qd, qdd), frame, (junction, &origin)))
}

/// Where the branch of a frame begins, in the axes of the body `junction`: the origin of its first body, or of the
/// frame itself on the junction.
#[inline(always)]
fn origin_of<T: Real>(model: &Model<T>, q: &[T], frame: &Frame<T>, junction: Option<usize>) -> Vector3<T> {
    let (mut body, mut origin) = (frame.body, frame.placement.lever);
    while body != junction {
        let Some(k) = body else { break };
        body = model.system.stages[k].parent;
        if body == junction {
            origin = super::outward::joint_shift(&model.bodies[k], q).lever;
        }
    }
    origin
}
