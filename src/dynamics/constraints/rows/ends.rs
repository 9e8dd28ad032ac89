//! The poses and motions of the frames of a connection, relative to the body where its branches meet.

use crate::dynamics::sweeps::{Path, SweepModel, SweepScratch, motions_along, origin_along, placement_along};
use crate::kinematics::FrameMotion;
use crate::kinematics::pair::{Pair, PairRows, RelativeMotion, pair_rows};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{RigidShift, cross_add, less};
use nalgebra::Vector6;

/// The steps of a path on which the forces of a connection act.
pub(super) type Ends = [Option<usize>; 2];

/// The motion of the first frame of a connection relative to the second, and the rows of the pair. None for a rod
/// without direction.
#[inline(always)]
pub(super) fn relative_motion<T: Real>(
    (pair, frames): (Pair, &[RigidShift<T>; 2]),
    (ends, path): (&Ends, &Path),
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    qd: &[T],
    motions: &mut [[[T; 6]; 2]],
) -> Option<(RelativeMotion<T>, PairRows<T>)> {
    motions_along(scene, scratch, (path, qd), motions);
    let [at_c, at_d] = poses_of_ends((ends, path), scene, scratch, frames);
    let c = motion_of_end(scene, (path, &*motions), (ends[0], &frames[0]), at_c);
    let d = motion_of_end(scene, (path, &*motions), (ends[1], &frames[1]), at_d);
    let motion = RelativeMotion::of(&c, &d);
    pair_rows(pair, &motion.place, &motion.velocity).map(|rows| (motion, rows))
}

/// The poses of both frames of a connection in the axes of the body where the branches meet. They do not depend on the
/// distance of the mechanism from the base: both are relative to the point where the branch of the second one begins.
#[inline(always)]
pub(super) fn poses_of_ends<T: Real>(
    (ends, path): (&Ends, &Path),
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    frames: &[RigidShift<T>; 2],
) -> [RigidShift<T>; 2] {
    let on_branch = |end: usize| ends[end].and_then(|step| path.on_branch(step));
    let origin = match on_branch(1) {
        Some(step) => origin_along(scene, scratch, (path, step)),
        None => frames[1].lever.into(),
    };
    let mut poses = *frames;
    for (end, pose) in poses.iter_mut().enumerate() {
        if let Some(step) = on_branch(end) {
            *pose = placement_along(scene, scratch, (path, step), (&frames[end], &origin));
        } else {
            for (lever, &from) in pose.lever.iter_mut().zip(&origin) {
                *lever -= from;
            }
        }
    }
    poses
}

/// The motion of the frame at an end of a path relative to the body where the branches meet, from the motions of the
/// bodies on the path. Without a step on a branch, the frame is on that body.
#[inline(always)]
fn motion_of_end<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    (path, motions): (&Path, &[[[T; 6]; 2]]),
    (end, frame): (Option<usize>, &RigidShift<T>),
    placement: RigidShift<T>,
) -> FrameMotion<T> {
    let mut motion = FrameMotion {
        placement,
        velocity: Vector6::from_element(scene.0.gravity[0].constant(0.0)),
        acceleration: Vector6::from_element(scene.0.gravity[0].constant(0.0)),
    };
    if let Some(step) = end
        && path.on_branch(step).is_some()
    {
        let [velocity, acceleration] = &motions[step];
        motion.velocity = frame.motion_to_child(&Vector6::from(*velocity));
        motion.acceleration = frame.motion_to_child(&Vector6::from(*acceleration));
    }
    motion
}

/// The error of an anchored point, its time derivative and gamma in the frame of its body, from the motion of the body
/// and the point of the base there: at this point u = v + w x p is the velocity of the body, and J' qd = a + dw x p +
/// u x w.
#[inline(always)]
pub(super) fn of_anchored<T: Real>(
    (frame, point): (&RigidShift<T>, &[T; 3]),
    [velocity, acceleration]: &[[T; 6]; 2],
) -> [[T; 3]; 3] {
    let [w, v, dw, a] = [
        [velocity[0], velocity[1], velocity[2]],
        [velocity[3], velocity[4], velocity[5]],
        [acceleration[0], acceleration[1], acceleration[2]],
        [acceleration[3], acceleration[4], acceleration[5]],
    ];
    let (w, dw, here) = (w.into(), dw.into(), (*point).into());
    let moving = cross_add(&w, &here, &v.into());
    let turning = cross_add(&moving, &w, &cross_add(&dw, &here, &a.into()));
    [less(&frame.lever, &here).into(), moving.into(), turning.into()]
}
