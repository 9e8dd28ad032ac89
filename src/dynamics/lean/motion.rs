//! Base to tip: how each body moves, and the force that this motion needs.
//!
//! The acceleration here is that of the point at the frame's origin, a + w x v of the spatial one: three vectors are carried instead of
//! four, and nothing large is added that would have to cancel again.

use super::afloat;
use super::body::{Carrier, LeanBody, LeanModel};
use super::scratch::{LeanScratch, Moving, Own};
use super::turn::{Axis, Turn, about};
use crate::dynamics::forces::{Motion, Needed};
use crate::kinematics::{joint_motion, joint_shift};
use crate::scalar::{ColumnsOf, Real};
use crate::scene::{self, Model};
use crate::spatial::BodyRoot;
use nalgebra::Vector3;

/// a x k + c, k in every lane.
#[inline(always)]
pub(super) fn cross_number<T: Real>(a: [T; 3], k: [T::Parameter; 3], c: [T; 3]) -> [T; 3] {
    let (x, y, z) = (a[0].everywhere(k[0]), a[0].everywhere(k[1]), a[0].everywhere(k[2]));
    [
        a[1].mul_add(z, c[0].minus_product(a[2], y)),
        a[2].mul_add(x, c[1].minus_product(a[0], z)),
        a[0].mul_add(y, c[2].minus_product(a[1], x)),
    ]
}

/// c - a x k, k in every lane.
#[inline(always)]
pub(super) fn minus_cross_number<T: Real>(a: [T; 3], k: [T::Parameter; 3], c: [T; 3]) -> [T; 3] {
    let (x, y, z) = (a[0].everywhere(k[0]), a[0].everywhere(k[1]), a[0].everywhere(k[2]));
    [
        a[2].mul_add(y, c[0].minus_product(a[1], z)),
        a[0].mul_add(z, c[1].minus_product(a[2], x)),
        a[1].mul_add(x, c[2].minus_product(a[0], y)),
    ]
}

/// a x k, k in every lane.
#[inline(always)]
fn crossed_number<T: Real>(a: [T; 3], k: [T::Parameter; 3]) -> [T; 3] {
    let (x, y, z) = (a[0].everywhere(k[0]), a[0].everywhere(k[1]), a[0].everywhere(k[2]));
    [(a[1] * z).minus_product(a[2], y), (a[2] * x).minus_product(a[0], z), (a[0] * y).minus_product(a[1], x)]
}

/// a x b + c.
#[inline(always)]
pub(super) fn cross<T: Real>(a: [T; 3], b: [T; 3], c: [T; 3]) -> [T; 3] {
    [
        a[1].mul_add(b[2], c[0].minus_product(a[2], b[1])),
        a[2].mul_add(b[0], c[1].minus_product(a[0], b[2])),
        a[0].mul_add(b[1], c[2].minus_product(a[1], b[0])),
    ]
}

/// I v, I symmetric, in every lane.
#[inline(always)]
fn inertia_times<T: Real>(i: [T::Parameter; 6], v: [T; 3]) -> [T; 3] {
    let [xx, xy, xz, yy, yz, zz] = i;
    let o = v[0];
    [
        v[0].mul_add(o.everywhere(xx), v[1].mul_add(o.everywhere(xy), v[2] * o.everywhere(xz))),
        v[0].mul_add(o.everywhere(xy), v[1].mul_add(o.everywhere(yy), v[2] * o.everywhere(yz))),
        v[0].mul_add(o.everywhere(xz), v[1].mul_add(o.everywhere(yz), v[2] * o.everywhere(zz))),
    ]
}

/// The turn or shift of every body at `q`: they wait for nothing. Sines and cosines of as many angles at once as `C` holds.
#[inline(always)]
pub(super) fn carriers<T: Real, C: ColumnsOf<T>>(lean: &LeanModel<T>, scratch: &mut LeanScratch<T>, like: C, q: &[T]) {
    for some in lean.turning.chunks(C::COLUMNS) {
        let mut angles = like.constant(0.0);
        // By a number of lanes that the compiler knows.
        for lane in 0..C::COLUMNS {
            if let Some(turning) = some.get(lane) {
                angles.set_column(lane, q[turning.q]);
            }
        }
        let (s, c) = angles.sin_cos();
        for lane in 0..C::COLUMNS {
            let Some(turning) = some.get(lane) else { break };
            let s = s.column(lane);
            let mut turn = Turn { s: s * s.everywhere(turning.sense), c: c.column(lane) };
            if let Some([of_s, of_c]) = turning.offset {
                turn = turn.and([s.everywhere(of_s), s.everywhere(of_c)]);
            }
            scratch.own[turning.place].turn = turn;
        }
    }
    for (shift, body) in scratch.shifts.iter_mut().zip(&lean.shifting) {
        *shift = joint_shift(body, q);
    }
}

/// Base to tip: the force b of every body; where `ROOT` the coordinates y of its root, b = L y + t, and t, what wrenches bring.
#[inline(always)]
pub(super) fn base_to_tip<T: Real, C: ColumnsOf<T>, const ROOT: bool>(
    scene: (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    state: Motion<'_, T>,
) {
    carriers(scene.1, scratch, C::zero(), state.q);
    let needed = Needed::of(scene.0, state);
    if needed.velocity && state.wrenches.is_empty() {
        // Mostly: what is known of all bodies is not asked at each.
        let needed = Needed { velocity: true, acceleration: true };
        forces::<T, ROOT>(scene, scratch, Motion { wrenches: &[], ..state }, needed);
    } else {
        forces::<T, ROOT>(scene, scratch, state, needed);
    }
}

/// The same, turns and shifts being there: compiled once for what is mostly needed, and once for anything else.
#[inline(always)]
fn forces<T: Real, const ROOT: bool>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    state: Motion<'_, T>,
    needed: Needed,
) {
    let o = T::zero();
    let g = &model.gravity;
    let LeanScratch { motions, own, added, shifts, .. } = scratch;
    let base = [-g[0], -g[1], -g[2]];
    motions[0] = [[o; 3], [o; 3], base];
    // Of one length, for the compiler to see: a row of one is a row of the other.
    let state = Motion { qdd: state.qdd.map(|qdd| &qdd[..state.qd.len()]), ..state };
    for ((place, body), own) in lean.swept().iter().enumerate().zip(own) {
        let parent = motions[body.places.parent_outward];
        let root = if ROOT { Some(&lean.roots[place]) } else { None };
        // All of it in each arm: after them the motion would come by way of memory.
        let to = (&mut motions[..], &mut *own);
        match body.carrier {
            Carrier::Turn(axis) => about!(axis, X, Y, Z, {
                let [w, dw, a] = parent;
                let there = [[w[X], w[Y], w[Z]], [dw[X], dw[Y], dw[Z]], [a[X], a[Y], a[Z]]];
                let joint = (state.qd, state.qdd);
                let moving = if body.parent.is_none() {
                    on_base(body, to.1.turn, there[2], joint, needed)
                } else {
                    turned(body, to.1.turn, there, joint, needed)
                };
                keep((body, root), moving, needed, to);
            }),
            Carrier::Shift(at) if body.is_afloat => {
                keep((body, root), afloat::moving(body.row, &shifts[at], &base, state, needed), needed, to);
            }
            Carrier::Shift(at) => {
                let moving = shifted(&lean.shifting[at], body.row, &shifts[at], &parent, state, needed);
                keep((body, root), moving, needed, to);
            }
        }
        let outside = if ROOT { &mut added[place] } else { &mut own.force };
        if ROOT {
            *outside = [o; 6];
        }
        if !state.wrenches.is_empty() {
            for (f, given) in outside.iter_mut().zip(body.frame.apply(&state.wrenches[body.index])) {
                *f -= given;
            }
        }
    }
}

/// The force, and the motion where a body hangs on this one.
#[inline(always)]
fn keep<T: Real>(
    (body, root): (&LeanBody<T::Parameter>, Option<&BodyRoot<T::Parameter>>),
    moving: Moving<T>,
    needed: Needed,
    (motions, own): (&mut [Moving<T>], &mut Own<T>),
) {
    own.force = load_of((body, root), &moving, needed);
    if !body.is_leaf {
        motions[body.places.outward] = moving;
    }
}

/// Across a turn of a base that accelerates by `a`, in the joint's frame, and does not turn.
#[inline(always)]
fn on_base<T: Real>(
    body: &LeanBody<T::Parameter>,
    turn: Turn<T>,
    a: [T; 3],
    (qd, qdd): (&[T], Option<&[T]>),
    needed: Needed,
) -> Moving<T> {
    let (o, sense) = (a[0].constant(0.0), a[0].everywhere(body.sense));
    let rate = if needed.velocity { qd[body.row] * sense } else { o };
    let acceleration = qdd.map_or(o, |qdd| qdd[body.row] * sense);
    [[o, o, rate], [o, o, acceleration], turn.rotate_back(a)]
}

/// Across a turn, the parent's motion in the joint's frame: along the lever, about z, and the joint's own.
#[inline(always)]
fn turned<T: Real>(
    body: &LeanBody<T::Parameter>,
    turn: Turn<T>,
    [w, dw, mut a]: Moving<T>,
    (qd, qdd): (&[T], Option<&[T]>),
    needed: Needed,
) -> Moving<T> {
    let still = w;
    if body.has_lever {
        // What waits longest, the parent's own acceleration, comes in last.
        let mut moved = crossed_number(dw, body.lever);
        if needed.velocity {
            moved = cross(w, crossed_number(w, body.lever), moved);
        }
        a = [a[0] + moved[0], a[1] + moved[1], a[2] + moved[2]];
    }
    let mut dw = turn.rotate_back(dw);
    let w = if needed.velocity {
        let rate = qd[body.row] * still[0].everywhere(body.sense);
        let [x, y, z] = turn.rotate_back(w);
        dw = [y.mul_add(rate, dw[0]), dw[1].minus_product(x, rate), dw[2]];
        [x, y, z + rate]
    } else {
        still
    };
    if let Some(qdd) = qdd {
        dw[2] = qdd[body.row].mul_add(still[0].everywhere(body.sense), dw[2]);
    }
    [w, dw, turn.rotate_back(a)]
}

/// Across any joint.
#[inline(always)]
fn shifted<T: Real>(
    body: &scene::Body<T>,
    row: usize,
    shift: &crate::spatial::RigidShift<T>,
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
        if let scene::Motion::Revolute = body.motion {
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

/// A free vector, parent to child.
#[inline(always)]
fn back<T: Real>(shift: &crate::spatial::RigidShift<T>, v: [T; 3]) -> [T; 3] {
    let turned = shift.rotate_back(&Vector3::new(v[0], v[1], v[2]));
    [turned[0], turned[1], turned[2]]
}

/// (I dw + w x I w + m p x a, m a + dw x m p + w x (w x m p)).
#[inline(always)]
fn force_of<T: Real>(body: &LeanBody<T::Parameter>, [w, dw, a]: &Moving<T>, needed: Needed, like: T) -> [T; 6] {
    let h = body.first_moment;
    let m = like.everywhere(body.mass);
    let mut force = cross_number(*dw, h, [m * a[0], m * a[1], m * a[2]]);
    let mut moment = inertia_times(body.rotational, *dw);
    if needed.velocity {
        force = cross(*w, crossed_number(*w, h), force);
        moment = cross(*w, inertia_times(body.rotational, *w), moment);
    }
    let moment = minus_cross_number(*a, h, moment);
    [moment[0], moment[1], moment[2], force[0], force[1], force[2]]
}

/// The force; with a root, its coordinates.
#[inline(always)]
fn load_of<T: Real>(
    (body, root): (&LeanBody<T::Parameter>, Option<&BodyRoot<T::Parameter>>),
    moving: &Moving<T>,
    needed: Needed,
) -> [T; 6] {
    let like = moving[2][0];
    if body.needs_no_force || !needed.acceleration {
        return [like.constant(0.0); 6];
    }
    match root {
        Some(root) => coordinates_of(root, moving, needed, like),
        None => force_of(body, moving, needed, like),
    }
}

/// y of the force L y that a body of this motion needs, as [`BodyRoot::coordinates`] gives it: linear entries first.
#[inline(always)]
fn coordinates_of<T: Real>(root: &BodyRoot<T::Parameter>, [w, dw, a]: &Moving<T>, needed: Needed, like: T) -> [T; 6] {
    let o = like.constant(0.0);
    let centre = root.centre.into();
    // The acceleration of the mass centre.
    let mut at_centre = cross_number(*dw, centre, *a);
    if needed.velocity {
        at_centre = cross(*w, crossed_number(*w, centre), at_centre);
    }
    let (mass, c) = (like.everywhere(root.mass), &root.central);
    let turned = [
        like.everywhere(c[(2, 0)]).mul_add(dw[2], like.everywhere(c[(1, 0)]).mul_add(dw[1], dw[0])),
        like.everywhere(c[(2, 1)]).mul_add(dw[2], dw[1]),
        dw[2],
    ];
    let [wx, wy, wz] = *w;
    let mut y = [mass * at_centre[0], mass * at_centre[1], mass * at_centre[2], o, o, o];
    for i in 0..3 {
        y[3 + i] = like.everywhere(root.weights[i]) * turned[i];
    }
    if needed.velocity {
        let products = [wx * wx, wy * wy, wz * wz, wx * wy, wx * wz, wy * wz];
        for i in 0..3 {
            for (j, &product) in products.iter().enumerate() {
                y[3 + i] = like.everywhere(root.spin[(i, j)]).mul_add(product, y[3 + i]);
            }
        }
    }
    y
}
