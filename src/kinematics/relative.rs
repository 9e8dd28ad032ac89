//! Two frames relative to the body where their paths to the base meet: joints that move both frames alike have no
//! effect.
//!
//! The origin of the poses is the beginning of the branch of the second frame, so that the distance of a mechanism from
//! the base has no effect either. At 10 km it would cause a rounding error of 1e-12 m in the relative position.

use super::frame::Frame;
use super::inward::PathToBase;
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::RigidShift;
use nalgebra::Vector3;

/// The poses of frames C and D in the axes of the body `junction`, from a common origin.
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

/// The beginning of the branch of a frame, in the axes of the body `junction`: the origin of its first body, or of the
/// frame itself if it is on the junction.
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
