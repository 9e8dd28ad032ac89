//! Forces that act on one body or two: they affect only the bodies between these and the base.
//!
//! They are propagated inward through the measurements of each joint like the mean force of the
//! [filter](super::filter), and the accelerations on the path are summed outward. The factor of M is in the scratch.

use super::joint::{self, Joint, with_joint};
use super::model::SweepModel;
use super::rows::Measures;
use super::scratch::SweepScratch;
use crate::model::Model;
use crate::scalar::{Real, larger};
use crate::spatial::RigidShift;
use crate::spatial::transform::Transform;
use nalgebra::{Matrix3, Vector3, Vector6};
use std::ops::Range;

/// The largest number of forces that are propagated along a path at once.
pub(crate) const MOST_FORCES: usize = 6;

/// The bodies between one or two bodies and the base, outermost first.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Path {
    steps: Vec<Step>,
}

/// One body of the path.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Step {
    /// Its index.
    body: usize,
    /// Its place in the order of the sweeps.
    place: usize,
    /// The step of the body inward of it.
    parent: Option<usize>,
    /// True if this step is the first to propagate a force to its parent, and no force acts on the parent.
    begins: bool,
    /// True for bodies on a branch of a loop; the motion of other bodies is taken as zero.
    is_on_branch: bool,
}

/// The forces of up to six right-hand sides on a body, and squares that bound the terms of their moments.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Forces<T> {
    pub z: [[T; 6]; MOST_FORCES],
    pub moments: [T; MOST_FORCES],
}

impl Path {
    /// A path over these bodies, in decreasing order of index, with forces on `act_on`. Motions and poses are those of
    /// the branches, relative to the body where they meet.
    pub fn new<T: Real>(sweeps: &SweepModel<T>, (bodies, branches): (&[usize], &[usize]), act_on: &[usize]) -> Self {
        let at = |k: usize| bodies.iter().position(|&body| body == k);
        let mut has_begun: Vec<bool> = bodies.iter().map(|body| act_on.contains(body)).collect();
        let steps = bodies.iter().map(|&body| {
            let place = sweeps.swept().iter().position(|swept| swept.index == body).unwrap_or_default();
            let parent = sweeps.swept()[place].parent.and_then(at);
            let begins = parent.is_some_and(|parent| !std::mem::replace(&mut has_begun[parent], true));
            Step { body, place, parent, begins, is_on_branch: branches.contains(&body) }
        });
        Self { steps: steps.collect() }
    }

    /// Number of bodies.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// The step of a body.
    pub fn step_of(&self, body: usize) -> Option<usize> {
        self.steps.iter().position(|step| step.body == body)
    }

    /// The step itself if its body is on a branch.
    pub fn on_branch(&self, step: usize) -> Option<usize> {
        self.steps[step].is_on_branch.then_some(step)
    }

    /// The joint rows shared with another path, as ranges of adjacent rows.
    pub fn rows_shared<T: Real>(&self, other: &Self, model: &Model<T>) -> Vec<Range<usize>> {
        let shared = self.steps.iter().rev().filter(|step| other.steps.iter().any(|o| o.body == step.body));
        let mut all: Vec<Range<usize>> = Vec::new();
        for stage in shared.map(|step| &model.system.stages[step.body]) {
            let end = stage.first_row + stage.rows.count();
            match all.last_mut() {
                Some(last) if last.end == stage.first_row => last.end = end,
                _ => all.push(stage.first_row..end),
            }
        }
        all
    }
}

/// The innovations of the first `count` forces of each body along the path, into `out`, entry r of row i at i width +
/// r, for the measurements `torque`, which are mostly zero. `forces` are b(k) - w of each step and are overwritten.
/// `sizes` receives squares: the bound on each row of `out` over the root of D without cancellation of moments, without
/// torques.
#[inline(always)]
pub(crate) fn innovations_along<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    (path, count): (&Path, usize),
    (forces, torque): (&mut [Forces<T>], &[T]),
    ((out, width), sizes): ((&mut [T], usize), &mut [T]),
) {
    let SweepScratch { own, shifts, measured, .. } = scratch;
    for (at, step) in path.steps.iter().enumerate() {
        let body = &sweeps.swept()[step.place];
        with_joint!(body, own[step.place].turn, (model, sweeps, shifts), transform, rows, {
            // The weights of the squares of a moment and of a force.
            let [of_moment, of_force] = rows.weights(measured);
            for i in 0..count {
                let (mut z, moment) = (forces[at].z[i], forces[at].moments[i]);
                sizes[i] = moment.mul_add(of_moment, square(&z[3..]).mul_add(of_force, sizes[i]));
                rows.filter(measured, torque, &mut z, &mut out[i * width..]);
                let Some(parent) = step.parent else { continue };
                let to = &mut forces[parent];
                transform.send_force(&z, step.begins, &mut to.z[i]);
                // An offset parallel to a force gives a moment that is only rounding; it does not count as a moment.
                let sent = transform.offset_square().mul_add(square(&z[3..]), larger(square(&z[..3]), moment));
                to.moments[i] = if step.begins { sent } else { to.moments[i] + sent };
            }
        });
    }
}

/// The velocity of each body of a path, and the part of its acceleration that joint velocities cause, without gravity,
/// into `motions`, one per step.
#[inline(always)]
pub(crate) fn motions_along<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    (path, qd): (&Path, &[T]),
    motions: &mut [[[T; 6]; 2]],
) {
    let SweepScratch { own, shifts, .. } = scratch;
    for (at, step) in path.steps.iter().enumerate().rev() {
        let body = &sweeps.swept()[step.place];
        let zero = [model.gravity[0].constant(0.0); 6];
        if !step.is_on_branch {
            motions[at] = [zero; 2];
            continue;
        }
        let (mut velocity, mut acceleration) = (zero, zero);
        with_joint!(body, own[step.place].turn, (model, sweeps, shifts), transform, rows, {
            if let Some(parent) = step.parent {
                let [of_parent, its_acceleration] = &motions[parent];
                velocity = transform.carry_motion(of_parent);
                acceleration = transform.carry_motion(its_acceleration);
            }
            rows.spread_moving(qd, &mut velocity, &mut acceleration);
        });
        motions[at] = [velocity, acceleration];
    }
}

/// The origin of the joint of a step on the body inboard of it.
#[inline(always)]
fn offset_of<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    SweepScratch { own, shifts, .. }: &SweepScratch<T>,
    step: &Step,
) -> [T; 3] {
    let body = &sweeps.swept()[step.place];
    match body.joint {
        Joint::Free(shift) | Joint::General(shift) | Joint::Prismatic(shift, _) => shifts[shift].lever.into(),
        Joint::Axial(_) => with_joint!(body, own[step.place].turn, (model, sweeps, shifts), transform, _rows, {
            transform.offset_at_parent()
        }),
    }
}

/// The origin of the branch of a step, in the axes of the body where the branches meet.
#[inline(always)]
pub(crate) fn origin_along<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    (path, step): (&Path, usize),
) -> [T; 3] {
    let mut at = step;
    while let Some(parent) = path.steps[at].parent.and_then(|parent| path.on_branch(parent)) {
        at = parent;
    }
    offset_of(scene, scratch, &path.steps[at])
}

/// The pose of a frame on the body of a branch step, in the axes of the body where the branches meet and relative to
/// `origin` there. `frame` is expressed in the body's frame in the sweeps.
#[inline(always)]
pub(crate) fn placement_along<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    (path, step): (&Path, usize),
    (frame, from): (&RigidShift<T>, &[T; 3]),
) -> RigidShift<T> {
    let SweepScratch { own, shifts, .. } = scratch;
    let r = &frame.rotation;
    // The columns of the rotation, and the origin.
    let mut vectors = [
        [r[(0, 0)], r[(1, 0)], r[(2, 0)]],
        [r[(0, 1)], r[(1, 1)], r[(2, 1)]],
        [r[(0, 2)], r[(1, 2)], r[(2, 2)]],
        [frame.lever[0], frame.lever[1], frame.lever[2]],
    ];
    let mut at = Some(step);
    while let Some(here) = at {
        let step = &path.steps[here];
        let body = &sweeps.swept()[step.place];
        if let Joint::Free(shift) | Joint::General(shift) | Joint::Prismatic(shift, _) = body.joint {
            let shift = &shifts[shift];
            for vector in &mut vectors {
                let turned = shift.rotate(&Vector3::new(vector[0], vector[1], vector[2]));
                *vector = [turned[0], turned[1], turned[2]];
            }
        } else {
            with_joint!(body, own[step.place].turn, (model, sweeps, shifts), transform, _rows, {
                for vector in &mut vectors {
                    *vector = transform.rotate_to_parent(*vector);
                }
            });
        }
        at = step.parent.and_then(|parent| path.on_branch(parent));
        let mut offset = offset_of((model, sweeps), scratch, step);
        if at.is_none() {
            // Subtracted before any addition: both vectors are similarly far away, so that the difference is exact.
            for (offset, &from) in offset.iter_mut().zip(from) {
                *offset -= from;
            }
        }
        for (origin, offset) in vectors[3].iter_mut().zip(offset) {
            *origin += offset;
        }
    }
    let [x, y, z, origin] = vectors;
    RigidShift {
        rotation: Matrix3::new(x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]),
        lever: Vector3::new(origin[0], origin[1], origin[2]),
    }
}

/// A point of the base in the frame of the body of the outermost step, for a path of one branch that begins at the
/// base. The vectors from the base are subtracted first: both are similarly long.
#[inline(always)]
pub(crate) fn point_along<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    path: &Path,
    mut point: [T; 3],
) -> [T; 3] {
    let SweepScratch { own, shifts, .. } = scratch;
    for step in path.steps.iter().rev() {
        let body = &sweeps.swept()[step.place];
        for (point, offset) in point.iter_mut().zip(offset_of((model, sweeps), scratch, step)) {
            *point -= offset;
        }
        point = if let Joint::Free(shift) | Joint::General(shift) | Joint::Prismatic(shift, _) = body.joint {
            shifts[shift].rotate_to_child(point)
        } else {
            with_joint!(body, own[step.place].turn, (model, sweeps, shifts), transform, _rows, {
                transform.rotate_to_child(point)
            })
        };
    }
    point
}

/// A frame on the body of a step, converted from the body's frame in the model to its frame in the sweeps.
pub(crate) fn frame_here<T: Real>(
    sweeps: &SweepModel<T>,
    (path, step): (&Path, usize),
    frame: &RigidShift<T>,
) -> RigidShift<T> {
    let axis_permutation = &sweeps.swept()[path.steps[step].place].frame;
    let here = |v: [T; 3]| {
        let [x, y, z, ..] = axis_permutation.apply(&Vector6::new(v[0], v[1], v[2], v[0], v[1], v[2]));
        Vector3::new(x, y, z)
    };
    let axis = |i: usize| here([frame.rotation[(0, i)], frame.rotation[(1, i)], frame.rotation[(2, i)]]);
    RigidShift { rotation: Matrix3::from_columns(&[axis(0), axis(1), axis(2)]), lever: here(frame.lever.into()) }
}

/// The accelerations of the bodies of a path for joint accelerations `qdd`, without the terms of velocities and
/// gravity, into `motions`, one per step; and for joint velocities the velocities of the bodies.
#[inline(always)]
pub(crate) fn accelerations_along<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    (path, qdd): (&Path, &[T]),
    motions: &mut [[T; 6]],
) {
    let SweepScratch { own, shifts, .. } = scratch;
    for (at, step) in path.steps.iter().enumerate().rev() {
        let body = &sweeps.swept()[step.place];
        let mut motion = [model.gravity[0].constant(0.0); 6];
        if !step.is_on_branch {
            motions[at] = motion;
            continue;
        }
        with_joint!(body, own[step.place].turn, (model, sweeps, shifts), transform, rows, {
            if let Some(parent) = step.parent {
                motion = transform.carry_motion(&motions[parent]);
            }
            rows.spread(qdd, &mut motion);
        });
        motions[at] = motion;
    }
}

#[inline(always)]
fn square<T: Real>(v: &[T]) -> T {
    v[0].mul_add(v[0], v[1].mul_add(v[1], v[2] * v[2]))
}
