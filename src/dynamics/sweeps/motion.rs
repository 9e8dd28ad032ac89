//! Base to tip: the motion of each body, and the force that this motion needs (1.3, 2.9). Tip to base, open loop: the
//! torques of these forces (1.5).
//!
//! The acceleration is that of the point at the origin of the frame, the spatial one plus w x v: three vectors are
//! propagated instead of four, and no large term is added that would have to cancel. The [spin](Spin) of a body gives
//! the accelerations of all its points relative to that one. Those of the origins of children on revolute joints are
//! computed at the step of the body.

use super::body::SweepBody;
use super::joint::{self, Joint, with_axial, with_joint};
use super::load::Load;
use super::model::SweepModel;
use super::rows::Measures;
use super::scratch::{BodyState, Moving, SweepScratch};
use super::spin::{Spin, coordinates_of, cross, force_of};
use crate::dynamics::forces::{Motion, Needed};
use crate::kinematics::{joint_motion, joint_shift};
use crate::model::{Body, Model, Motion as JointMotion};
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::transform::{Axes, Axial, AxialRotation, Rotates, Transform};
use crate::spatial::{BodyRoot, RigidShift};
use nalgebra::Vector3;

/// The rotation or shift of every joint at `q`; joints are independent. Sines and cosines are computed for one angle
/// per column of `C` at a time.
#[inline(always)]
pub(in crate::dynamics) fn carriers<T: Real, C: ColumnsOf<T>>(
    sweeps: &SweepModel<T>,
    scratch: &mut SweepScratch<T>,
    like: C,
    q: &[T],
) {
    for some in sweeps.turning.chunks(C::COLUMNS) {
        let mut angles = like.constant(0.0);
        // A constant number of iterations, which the compiler unrolls.
        for lane in 0..C::COLUMNS {
            if let Some(turning) = some.get(lane) {
                angles.set_column(lane, q[turning.q]);
            }
        }
        let (s, c) = angles.sin_cos();
        for lane in 0..C::COLUMNS {
            let Some(turning) = some.get(lane) else { break };
            let s = s.column(lane);
            let mut turn = AxialRotation { s: s * s.splat(turning.sense), c: c.column(lane) };
            if let Some([of_s, of_c]) = turning.offset {
                turn = turn.and([s.splat(of_s), s.splat(of_c)]);
            }
            scratch.own[turning.place].turn = turn;
        }
    }
    for (shift, body) in scratch.shifts.iter_mut().zip(&sweeps.shifting) {
        *shift = joint_shift(body, q);
    }
}

/// Base to tip: the force b of every body. With `ROOT` the coordinates y and the rest t of b = L y + t, L being the
/// root of its inertia; t contains wrenches.
#[inline(always)]
pub(super) fn base_to_tip<T: Real, C: ColumnsOf<T>, const ROOT: bool>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    state: Motion<'_, T>,
) {
    carriers(scene.1, scratch, C::zero(), state.q);
    base_to_tip_placed::<T, ROOT>(scene, scratch, state);
}

/// [`base_to_tip`] with the rotations and shifts of the joints at `q` in the scratch.
#[inline(always)]
pub(super) fn base_to_tip_placed<T: Real, const ROOT: bool>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    state: Motion<'_, T>,
) {
    let (needed, g) = (Needed::of(scene.0, state), &scene.0.gravity);
    // The base accelerates upward, so that the weight is part of every force.
    let base = [-g[0], -g[1], -g[2]];
    // The usual case is compiled separately, so that the loop over the bodies does not test for it.
    if needed.velocity && state.wrenches.is_empty() {
        let needed = Needed { velocity: true, acceleration: true };
        forces::<T, ROOT>(scene.1, scratch, base, Motion { wrenches: &[], ..state }, needed);
    } else {
        forces::<T, ROOT>(scene.1, scratch, base, state, needed);
    }
}

/// [`base_to_tip`] with the rotations and shifts of the joints in the scratch, on a base that accelerates by `base` and
/// does not rotate.
#[inline(always)]
pub(super) fn forces<T: Real, const ROOT: bool>(
    sweeps: &SweepModel<T>,
    scratch: &mut SweepScratch<T>,
    base: [T; 3],
    state: Motion<'_, T>,
    needed: Needed,
) {
    let (o, bodies) = (T::zero(), sweeps.swept());
    let SweepScratch { motions, own, added, shifts, .. } = scratch;
    motions[0] = [[o; 3], [o; 3], base];
    // Of the same length, so that the compiler omits bounds checks.
    let state = Motion { qdd: state.qdd.map(|qdd| &qdd[..state.qd.len()]), ..state };
    let own = &mut own[..bodies.len()];
    for (place, body) in bodies.iter().enumerate() {
        let (load, root) = (sweeps.load(body), if ROOT { Some(&sweeps.roots[place]) } else { None });
        let [w, dw, _] = motions[body.places.parent_outward];
        let rest = if ROOT {
            added[place] = [o; 6];
            sweeps.has_rests.then_some(&mut added[place])
        } else {
            None
        };
        if T::GENERAL_JOINTS {
            let (at, parent) = (body.index, motions[body.places.parent_outward]);
            let moving = shifted(&sweeps.shifting[at], body.row, &shifts[at], &parent, state, needed);
            keep((bodies, load, place), (root, rest), moving, needed, (motions, own));
        } else {
            // Complete in each arm: code after the match would pass the motion through memory.
            match body.joint {
                Joint::Axial(axis) => {
                    with_axial!(copies, axis, own[place].turn, sweeps, body.offset, transform, {
                        let joint = (state.qd, state.qdd);
                        let moving = if body.parent.is_none() {
                            on_base(body, transform, base, joint, needed)
                        } else {
                            let [x, y, z, ..] = own[place].force;
                            turned(body, transform, [w, dw, [x, y, z]], joint, needed)
                        };
                        keep((bodies, load, place), (root, rest), moving, needed, (motions, own));
                    });
                }
                Joint::Free(at) => {
                    let moving = floating(body.row, &shifts[at], &base, state, needed);
                    keep((bodies, load, place), (root, rest), moving, needed, (motions, own));
                }
                Joint::Prismatic(at, _) | Joint::General(at) => {
                    let parent = motions[body.places.parent_outward];
                    let moving = shifted(&sweeps.shifting[at], body.row, &shifts[at], &parent, state, needed);
                    keep((bodies, load, place), (root, rest), moving, needed, (motions, own));
                }
            }
        }
        let outside = if ROOT { &mut added[place] } else { &mut own[place].force };
        if !state.wrenches.is_empty() {
            for (f, given) in outside.iter_mut().zip(body.frame.apply(&state.wrenches[body.index])) {
                *f -= given;
            }
        }
    }
}

/// Stores the force of a body, its motion if it has children, and the accelerations of the origins of children on
/// revolute joints, in the frame of the body and in the place of their forces.
#[inline(always)]
fn keep<T: Real>(
    (bodies, load, place): (&[SweepBody<T::Parameter>], &Load<T>, usize),
    (root, rest): (Option<&BodyRoot<T::Parameter>>, Option<&mut [T; 6]>),
    moving: Moving<T>,
    needed: Needed,
    (motions, own): (&mut [Moving<T>], &mut [BodyState<T>]),
) {
    let (body, [w, dw, a]) = (&bodies[place], moving);
    let spin = Spin::of(w, dw, needed);
    if !body.is_leaf {
        let to = &mut motions[body.places.outward];
        (to[0], to[1]) = (w, dw);
        if body.carries_others {
            to[2] = a;
        }
        let mut next = body.first_axial;
        while let Some(child) = next.checked_sub(1) {
            let child_body = &bodies[child];
            let there = spin.at(&child_body.offset_at_parent, a);
            let to = &mut own[child].force;
            (to[0], to[1], to[2]) = (there[0], there[1], there[2]);
            next = child_body.next_axial;
        }
    }
    if let (Some(root), Some(rest)) = (root, rest) {
        spin.add_rest(root, rest);
    }
    own[place].force = match root {
        _ if !needed.acceleration => [a[0].constant(0.0); 6],
        Some(root) => coordinates_of(root, &spin, a),
        None => force_of(load, &spin, a),
    };
}

/// The motion past a revolute joint on a base that accelerates by `a` and does not rotate.
#[inline(always)]
fn on_base<T: Real>(
    body: &SweepBody<T::Parameter>,
    transform: &Axial<T, impl Rotates<T>, impl Axes>,
    a: [T; 3],
    (qd, qdd): (&[T], Option<&[T]>),
    needed: Needed,
) -> Moving<T> {
    let (o, sense) = (a[0].constant(0.0), a[0].splat(body.sense));
    let rate = if needed.velocity { qd[body.row] * sense } else { o };
    let acceleration = qdd.map_or(o, |qdd| qdd[body.row] * sense);
    let [a] = transform.free_to_child([a]);
    [[o, o, rate], [o, o, acceleration], a]
}

/// The motion past a revolute joint, from the rotation of the parent and the acceleration of the body's origin in the
/// frame of the parent.
#[inline(always)]
fn turned<T: Real>(
    body: &SweepBody<T::Parameter>,
    transform: &Axial<T, impl Rotates<T>, impl Axes>,
    [w, dw, a]: Moving<T>,
    (qd, qdd): (&[T], Option<&[T]>),
    needed: Needed,
) -> Moving<T> {
    let [mut w, mut dw, a] = if needed.velocity {
        transform.free_to_child([w, dw, a])
    } else {
        let [dw, a] = transform.free_to_child([dw, a]);
        [w, dw, a]
    };
    if needed.velocity {
        let rate = qd[body.row] * w[0].splat(body.sense);
        dw = [w[1].mul_add(rate, dw[0]), dw[1].minus_product(w[0], rate), dw[2]];
        w[2] += rate;
    }
    if let Some(qdd) = qdd {
        dw[2] = qdd[body.row].mul_add(dw[0].splat(body.sense), dw[2]);
    }
    [w, dw, a]
}

/// The motion of a floating body on a base that accelerates by `base` and does not rotate.
#[inline(always)]
fn floating<T: Real>(
    row: usize,
    shift: &RigidShift<T>,
    base: &[T; 3],
    state: Motion<'_, T>,
    needed: Needed,
) -> Moving<T> {
    let o = base[0].constant(0.0);
    let felt = shift.rotate_back(&Vector3::new(base[0], base[1], base[2]));
    let (mut w, mut dw, mut a) = ([o; 3], [o; 3], [felt[0], felt[1], felt[2]]);
    if needed.velocity {
        let qd = &state.qd[row..row + 6];
        w = [qd[3], qd[4], qd[5]];
        a = cross(w, [qd[0], qd[1], qd[2]], a);
    }
    if let Some(qdd) = state.qdd {
        let qdd = &qdd[row..row + 6];
        dw = [qdd[3], qdd[4], qdd[5]];
        a = [a[0] + qdd[0], a[1] + qdd[1], a[2] + qdd[2]];
    }
    [w, dw, a]
}

/// The motion past any joint.
#[inline(always)]
fn shifted<T: Real>(
    body: &Body<T>,
    row: usize,
    shift: &RigidShift<T>,
    parent: &Moving<T>,
    state: Motion<'_, T>,
    needed: Needed,
) -> Moving<T> {
    let [w, dw, a] = *parent;
    let l = [shift.lever[0], shift.lever[1], shift.lever[2]];
    let mut carried = cross(dw, l, a);
    let o = w[0].constant(0.0);
    if needed.velocity {
        carried = cross(w, cross(w, l, [o; 3]), carried);
    }
    let mut dw = back(shift, dw);
    let mut a = back(shift, carried);
    let mut w = w;
    if needed.velocity {
        w = back(shift, w);
        if let JointMotion::Revolute = body.motion {
            let rate = state.qd[row];
            dw = [w[1].mul_add(rate, dw[0]), dw[1].minus_product(w[0], rate), dw[2]];
            w[2] += rate;
        } else {
            let joint = joint_motion(body, row, state.qd);
            let (turning, moving) = ([joint[0], joint[1], joint[2]], [joint[3], joint[4], joint[5]]);
            let before = w;
            w = [w[0] + turning[0], w[1] + turning[1], w[2] + turning[2]];
            dw = cross(before, turning, dw);
            let both = [before[0] + w[0], before[1] + w[1], before[2] + w[2]];
            a = cross(both, moving, a);
        }
    }
    if let Some(qdd) = state.qdd {
        let joint = joint_motion(body, row, qdd);
        for i in 0..3 {
            dw[i] += joint[i];
            a[i] += joint[3 + i];
        }
    }
    [w, dw, a]
}

/// Rotates a free vector from the parent to the child.
#[inline(always)]
fn back<T: Real>(shift: &RigidShift<T>, v: [T; 3]) -> [T; 3] {
    let turned = shift.rotate_back(&Vector3::new(v[0], v[1], v[2]));
    [turned[0], turned[1], turned[2]]
}

/// The torque H z of every row, z propagated inward (1.5). With `KEEP` the whole force z(k) that each body transmits is
/// stored in the place of its own.
#[inline(always)]
pub(super) fn tip_to_base<T: Real, const KEEP: bool>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    torques: &mut [T],
) {
    let SweepScratch { own, shifts, .. } = scratch;
    let bodies = sweeps.swept();
    let own = &mut own[..bodies.len()];
    // The force that is propagated to the next body stays in registers.
    let (mut sent, mut is_next) = ([T::zero(); 6], false);
    for (place, body) in bodies.iter().enumerate().rev() {
        let BodyState { turn, mut force } = own[place];
        if is_next {
            force = added(force, &sent);
        }
        if KEEP {
            own[place].force = force;
        }
        let parent = body.places.parent;
        with_joint!(body, turn, (model, sweeps, shifts), transform, rows, {
            rows.project(&force, torques);
            if parent > 0 {
                transform.send_force(&force, true, &mut sent);
            }
        });
        is_next = parent > 0 && parent == place;
        if parent > 0 && !is_next {
            let to = &mut own[parent - 1].force;
            *to = added(*to, &sent);
        }
    }
}

#[inline(always)]
fn added<T: Real>(mut force: [T; 6], other: &[T; 6]) -> [T; 6] {
    for (f, &other) in force.iter_mut().zip(other) {
        *f += other;
    }
    force
}
