//! Gradients of inverse dynamics in O(N), without matrices: an outward pass with the co-state of the torques, and an
//! inward pass.
//!
//! With x the cotangent of tau, u = phi* H* x is propagated outward with the velocity V and the acceleration A, which
//! includes gravity; then, inward,
//!
//! - F, the force through a joint; G = M u + sum phi G; Y = B* u + sum R Y, a moment (B as in
//!   [`BodyCoriolis`](super::BodyCoriolis));
//! - e = -`A_p` x* G + `V_p` x* (`V_p` x* G - Y) - `u_p` x* F; `q_bar` = H e;
//! - `qd_bar` = H (Y - (`V_p` + V) x* G) and `qdd_bar` = H G + r x.
//!
//! `V_p`, `A_p` and `u_p` are those of the parent, transported to the joint.

use super::outward::{ABOUT_Z, carried, needed_force, past_joint};
use super::parameters;
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::SweepModel;
use crate::dynamics::sweeps::body::SweepBody;
use crate::dynamics::sweeps::joint::{self, Joint, with_axial};
use crate::dynamics::sweeps::scratch::SweepScratch;
use crate::filter::Rows;
use crate::kinematics::joint_motion;
use crate::model::{Body, Model, Motion as JointMotion};
use crate::scalar::{Real, larger};
use crate::spatial::inertial_parameters::Parameters;
use crate::spatial::transform::Transform;
use crate::spatial::{BodyInertia, angular, cross, cross_add, cross_force, linear, scaled, scaled_add, sum};
use nalgebra::{Vector3, Vector6};

/// The results of the outward pass that the inward pass reads; initialized with NaN.
#[derive(Debug, Clone)]
pub(crate) struct CoStates<T> {
    /// V, A and u in slots outward; the first is the base's.
    motions: Vec<[[T; 6]; 3]>,
    /// One per place in the sweeps: V, A and u of the parent, transported to the joint.
    seen: Vec<[[T; 6]; 3]>,
    /// F, G and Y: first of one body, then the sums over all bodies outboard of its joint.
    forces: Vec<[T; 6]>,
    pulls: Vec<[T; 6]>,
    turns: Vec<[T; 3]>,
    /// The largest tr(I) |u| of a body: the scale of the terms of the moments of G.
    pub terms: T,
}

impl<T: Real> CoStates<T> {
    pub fn new(sweeps: &SweepModel<T>) -> Self {
        let (nan, bodies) = (T::from_f64(f64::NAN), sweeps.bodies.len());
        Self {
            motions: vec![[[nan; 6]; 3]; sweeps.swept_slots.outward],
            seen: vec![[[nan; 6]; 3]; bodies],
            forces: vec![[nan; 6]; bodies],
            pulls: vec![[nan; 6]; bodies],
            turns: vec![[nan; 3]; bodies],
            terms: nan,
        }
    }
}

/// Cotangents of the constants of a motion. An empty slice is not written.
#[derive(Debug)]
pub struct Constants<'a, T> {
    /// Cotangents of the wrenches, one per body, in the body frame.
    pub wrenches: &'a mut [Vector6<T>],
    /// Cotangents of (m, m c, I) of each body about the origin of its frame, in the order (m, m cx, m cy, m cz, Ixx,
    /// Ixy, Iyy, Ixz, Iyz, Izz).
    pub parameters: &'a mut [Parameters<T>],
    /// Cotangents of the armature of each degree of freedom.
    pub armature: &'a mut [T],
    /// Cotangents of gravity in the base frame, three scalars.
    pub gravity: &'a mut [T],
}

/// No cotangents.
impl<T> Default for Constants<'_, T> {
    fn default() -> Self {
        Self { wrenches: &mut [], parameters: &mut [], armature: &mut [], gravity: &mut [] }
    }
}

/// All cotangents of tau at a state, with the rotations and shifts of the joints in the scratch: those of q, qd and qdd
/// one after another, into `out`. On entry the last third of `out` holds x.
#[inline(always)]
pub(crate) fn in_sweeps<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, kept): (&SweepScratch<T>, &mut CoStates<T>),
    state: Motion<'_, T>,
    constants: &mut Constants<'_, T>,
    out: &mut [T],
) {
    let nv = scene.0.nv();
    base_to_tip(scene, scratch, kept, (state, &out[2 * nv..]), constants);
    if let (Some(qdd), false) = (state.qdd, constants.armature.is_empty()) {
        for (i, to) in constants.armature.iter_mut().enumerate() {
            *to = out[2 * nv + i] * qdd[i];
        }
    }
    tip_to_base(scene, scratch, kept, state, (constants, out));
}

/// For every body: V, A and u, its contributions to F, G and Y, and the cotangents that do not depend on its children.
#[inline(always)]
fn base_to_tip<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    kept: &mut CoStates<T>,
    (state, cotangent): (Motion<'_, T>, &[T]),
    constants: &mut Constants<'_, T>,
) {
    let (o, g) = (T::zero(), &model.gravity);
    let CoStates { motions, seen: seen_at, forces, pulls, turns, terms } = kept;
    *terms = o;
    motions[0] = [[o; 6], [o, o, o, -g[0], -g[1], -g[2]], [o; 6]];
    for (place, body) in sweeps.swept().iter().enumerate() {
        let seen = carried((sweeps, scratch), (place, body), motions[body.places.parent_outward]);
        let [velocity, acceleration] = past_joint(sweeps, body, &[seen[0], seen[1]], state);
        let mut co_state = seen[2];
        match body.joint {
            Joint::Axial(_) => {
                co_state[ABOUT_Z] = cotangent[body.row].mul_add(o.splat(body.sense), co_state[ABOUT_Z]);
            }
            Joint::Prismatic(at, _) | Joint::Free(at) | Joint::General(at) => {
                let at_joint = joint_motion(&sweeps.shifting[at], body.row, cotangent);
                co_state = sum(&Vector6::from(co_state), &at_joint).into();
            }
        }
        let own = [velocity, acceleration, co_state];
        let inertia = sweeps.load(body).inertia();
        let vectors = [Vector6::from(own[0]), Vector6::from(own[1]), Vector6::from(own[2])];
        let [velocity, _, co_state] = &vectors;
        forces[place] = needed_force(body, &inertia, &[own[0], own[1]], state);
        pulls[place] = inertia.mul_motion(co_state).into();
        turns[place] = turn(&inertia, velocity, co_state);
        let [xx, _, _, yy, _, zz] = inertia.rotational.entries;
        *terms = larger(*terms, (xx + yy + zz) * (co_state[0].abs() + co_state[1].abs() + co_state[2].abs()));
        seen_at[place] = seen;
        if let Some(to) = constants.wrenches.get_mut(body.index) {
            *to = scaled(&body.frame.back(&own[2]), o.constant(-1.0));
        }
        if let Some(to) = constants.parameters.get_mut(body.index) {
            *to = parameters::from_sweeps(body, &parameters::of_force(&vectors));
        }
        if !body.is_leaf {
            motions[body.places.outward] = own;
        }
    }
}

/// B* u of one body, a moment: 2 Sigma (w x a) - 2 v x (h x a) + 2 p x c, with u = (a, c), Sigma = tr(I)/2 - I and the
/// momentum p = m v + w x h.
#[inline(always)]
fn turn<T: Real>(inertia: &BodyInertia<T>, velocity: &Vector6<T>, co_state: &Vector6<T>) -> [T; 3] {
    let (w, v) = (angular(velocity), linear(velocity));
    let (a, c) = (angular(co_state), linear(co_state));
    let (h, m) = (&inertia.first_moment, inertia.mass);
    let two = m.constant(2.0);
    let momentum = cross_add(&w, h, &Vector3::new(m * v[0], m * v[1], m * v[2]));
    let pushed = cross_add(&momentum, &c, &cross(&cross(h, &a), &v));
    let across = cross(&w, &a);
    let [xx, _, _, yy, _, zz] = inertia.rotational.entries;
    let (half_trace, turned) = ((xx + yy + zz) * m.constant(0.5), inertia.rotational.mul_vector(&across));
    [
        two * half_trace.mul_add(across[0], pushed[0] - turned[0]),
        two * half_trace.mul_add(across[1], pushed[1] - turned[1]),
        two * half_trace.mul_add(across[2], pushed[2] - turned[2]),
    ]
}

/// The cotangents of q, qd and qdd, and of gravity.
#[inline(always)]
fn tip_to_base<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    kept: &mut CoStates<T>,
    state: Motion<'_, T>,
    (constants, out): (&mut Constants<'_, T>, &mut [T]),
) {
    let (nv, o) = (model.nv(), T::zero());
    constants.gravity.fill(o);
    let (by_q, rest) = out.split_at_mut(nv);
    let (by_qd, by_qdd) = rest.split_at_mut(nv);
    let mut to = Cotangents { by_q, by_qd, by_qdd, noise: &model.system.noise };
    for (place, body) in sweeps.swept().iter().enumerate().rev() {
        match body.joint {
            Joint::Axial(axis) => {
                to.about_z(body, kept, place);
                with_axial!(axis, scratch.own[place].turn, sweeps, body.offset, transform, {
                    send((place, body), transform, kept, constants.gravity);
                });
            }
            Joint::Prismatic(at, _) | Joint::Free(at) | Joint::General(at) => {
                let at_joint = &sweeps.shifting[at];
                if at_joint.motion == JointMotion::Revolute {
                    to.about_z(body, kept, place);
                } else {
                    let rows = &model.system.stages[body.index].rows;
                    to.any((at_joint, rows), body.row, kept, (place, state));
                }
                send((place, body), &scratch.shifts[at], kept, constants.gravity);
            }
        }
    }
}

/// F, G and Y on to the parent; at the base, the force of G against gravity.
#[inline(always)]
fn send<T: Real>(
    (place, body): (usize, &SweepBody<T::Parameter>),
    transform: &impl Transform<T>,
    kept: &mut CoStates<T>,
    gravity: &mut [T],
) {
    let (force, pull, turn) = (kept.forces[place], kept.pulls[place], kept.turns[place]);
    let Some(parent) = body.places.parent.checked_sub(1) else {
        if !gravity.is_empty() {
            for (to, along) in gravity.iter_mut().zip(transform.rotate_to_parent([pull[3], pull[4], pull[5]])) {
                *to -= along;
            }
        }
        return;
    };
    transform.send_force(&force, false, &mut kept.forces[parent]);
    transform.send_force(&pull, false, &mut kept.pulls[parent]);
    for (to, along) in kept.turns[parent].iter_mut().zip(transform.rotate_to_parent(turn)) {
        *to += along;
    }
}

/// The outputs for the cotangents of a state. The one of qdd holds x until its row is computed.
struct Cotangents<'a, T> {
    by_q: &'a mut [T],
    by_qd: &'a mut [T],
    by_qdd: &'a mut [T],
    noise: &'a [T],
}

impl<T: Real> Cotangents<'_, T> {
    /// Of a revolute joint: the moments about its z alone.
    #[inline(always)]
    fn about_z(&mut self, body: &SweepBody<T::Parameter>, kept: &CoStates<T>, place: usize) {
        let CoStates { seen, forces, pulls, turns, .. } = kept;
        let [v, a, u] = &seen[place];
        let (f, g, y) = (&forces[place], &pulls[place], &turns[place]);
        let (row, sense) = (body.row, y[0].splat(body.sense));
        // V_p x* G; of what Y is taken from its moment, two entries.
        let h = [
            v[1].mul_add(g[2], v[4].mul_add(g[5], (-y[0]).minus_product(v[2], g[1]).minus_product(v[5], g[4]))),
            v[2].mul_add(g[0], v[5].mul_add(g[3], (-y[1]).minus_product(v[0], g[2]).minus_product(v[3], g[5]))),
            moment_about_z(v, g),
            (v[1] * g[5]).minus_product(v[2], g[4]),
            (v[2] * g[3]).minus_product(v[0], g[5]),
        ];
        let e = v[0].mul_add(h[1], v[3].mul_add(h[4], -(v[1].mul_add(h[0], v[4] * h[3]))));
        let e = e - (moment_about_z(a, g) + moment_about_z(u, f));
        self.by_q[row] = sense * e;
        self.by_qd[row] = sense * (y[ABOUT_Z] - (h[2] + h[2]));
        let x = self.by_qdd[row];
        self.by_qdd[row] = sense.mul_add(g[ABOUT_Z], self.noise[row] * x);
    }

    /// Of any joint.
    #[inline(always)]
    fn any(
        &mut self,
        (at_joint, rows): (&Body<T>, &Rows<T>),
        row: usize,
        kept: &CoStates<T>,
        (place, state): (usize, Motion<'_, T>),
    ) {
        if rows.count() == 0 {
            return;
        }
        let [v, a, u] = &kept.seen[place];
        let (v, a, u) = (Vector6::from(*v), Vector6::from(*a), Vector6::from(*u));
        let (f, g, y) = (Vector6::from(kept.forces[place]), Vector6::from(kept.pulls[place]), kept.turns[place]);
        let minus = y[0].constant(-1.0);
        let carried = cross_force(&v, &g);
        let mut h = carried;
        for (h, y) in h.iter_mut().zip(y) {
            *h -= y;
        }
        let e = cross_force(&v, &h);
        let e = scaled_add(&sum(&cross_force(&a, &g), &cross_force(&u, &f)), minus, &e);
        // Y - (2 V_p + S qd) x* G.
        let own = cross_force(&joint_motion(at_joint, row, state.qd), &g);
        let d = scaled(&sum(&sum(&h, &carried), &own), minus);
        for entry in 0..rows.count() {
            let (hinge, at) = (rows.row(entry), row + entry);
            self.by_q[at] = hinge.project(&e);
            self.by_qd[at] = hinge.project(&d);
            let x = self.by_qdd[at];
            self.by_qdd[at] = self.noise[at].mul_add(x, hinge.project(&g));
        }
    }
}

/// The moment about z of v x* f.
#[inline(always)]
fn moment_about_z<T: Real>(v: &[T; 6], f: &[T; 6]) -> T {
    v[0].mul_add(f[1], v[3].mul_add(f[4], -(v[1].mul_add(f[0], v[4] * f[3]))))
}
