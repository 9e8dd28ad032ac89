//! The change of inverse or forward dynamics along one direction, in O(N) and without matrices: an outward pass for the
//! changes of the motion, and an inward pass for the changes of the forces.
//!
//! With eta = S dq, and `V_p`, `A_p` the motion of the parent transported to the joint, gravity included:
//!
//! - dV = phi* dV + `V_p` x eta + S dqd; dA = phi* dA + `A_p` x eta + S dqdd + dV x S qd + V x S dqd;
//! - dF = d(M A + V x* M V) - dw + sum phi (dF + eta x* F); dtau = H dF + r dqdd + dr qdd.
//!
//! For forward dynamics, the outward pass uses dqdd = 0. The difference between dtau and the resulting torques is then
//! one more right-hand side of the filter: z is dF, and z^+ + eta x* F is propagated to the parent. The changes of the
//! gains do not contribute to first order, because the estimates are a stationary point.

use super::outward::{ABOUT_Z, carried, needed_force, past_axial, past_joint};
use super::parameters::constants_of;
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::SweepModel;
use crate::dynamics::sweeps::body::SweepBody;
use crate::dynamics::sweeps::joint::{self, Joint, with_axial, with_rows};
use crate::dynamics::sweeps::rows::Measures;
use crate::dynamics::sweeps::scratch::SweepScratch;
use crate::filter::riccati::Measured;
use crate::kinematics::joint_motion;
use crate::model::{Body, Model, Motion as JointMotion};
use crate::scalar::{Real, largest_of};
use crate::spatial::inertial_parameters::{Parameters, inertia};
use crate::spatial::transform::Transform;
use crate::spatial::{BodyInertia, angular, cross, cross_add, cross_force, cross_motion, linear, spatial, sum};
use nalgebra::{Vector3, Vector6};

/// One direction: changes of q in its tangent space, of qd, and of qdd (or of tau, in forward dynamics), (nv) each. A
/// slice of constants that do not change is empty.
#[derive(Debug, Clone, Copy)]
pub struct Directions<'a, T> {
    /// Change of q, in its tangent space.
    pub q: &'a [T],
    /// Change of qd.
    pub qd: &'a [T],
    /// Change of qdd, or of tau.
    pub u: &'a [T],
    /// Changes of the wrenches, one per body, in the body frame.
    pub wrenches: &'a [Vector6<T>],
    /// Changes of (m, m c, I) of each body about the origin of its frame, in the order of [`Parameters`].
    pub parameters: &'a [Parameters<T>],
    /// Change of the armature of each degree of freedom.
    pub armature: &'a [T],
    /// Change of gravity in the base frame, three scalars.
    pub gravity: &'a [T],
}

impl<'a, T: Real> Directions<'a, T> {
    /// The direction in the seed of a product. Changes of the constants follow u in the third vector; `wrenches` is
    /// scratch.
    pub(crate) fn of_seed([q, qd, third]: [&'a [T]; 3], bodies: usize, wrenches: &'a mut Vec<Vector6<T>>) -> Self {
        let (u, rest) = third.split_at(q.len());
        if rest.is_empty() {
            return Self { q, qd, u, ..Self::default() };
        }
        let [armature, gravity, forces, parameters] = constants_of(rest, q.len(), bodies);
        wrenches.clear();
        wrenches.extend(forces.as_chunks().0.iter().map(|&force: &[T; 6]| Vector6::from(force)));
        Self { q, qd, u, wrenches, parameters: parameters.as_chunks().0, armature, gravity }
    }
}

/// The direction without changes.
impl<T> Default for Directions<'_, T> {
    fn default() -> Self {
        Self { q: &[], qd: &[], u: &[], wrenches: &[], parameters: &[], armature: &[], gravity: &[] }
    }
}

/// The results of the outward pass that the inward pass reads; initialized with NaN.
#[derive(Debug, Clone)]
pub(crate) struct Changes<T> {
    /// V, A, dV and dA in slots outward; the first is the base's.
    motions: Vec<[[T; 6]; 4]>,
    /// One per place in the sweeps: F and dF, first of a body, then the sums over all bodies outboard of its joint.
    forces: Vec<[T; 6]>,
    forces_change: Vec<[T; 6]>,
    /// True if the error of a solution is estimated, by the test vector of the factor of M.
    pub judges: bool,
    /// The estimated square of w* d(dqdd), over eps^2: the effect of the rounding of dF, as in
    /// [`cancellation`](crate::filter::cancellation).
    noise: T,
}

impl<T: Real> Changes<T> {
    pub fn new(sweeps: &SweepModel<T>) -> Self {
        let (nan, bodies) = (T::from_f64(f64::NAN), sweeps.bodies.len());
        Self {
            motions: vec![[[nan; 6]; 4]; sweeps.swept_slots.outward],
            forces: vec![[nan; 6]; bodies],
            forces_change: vec![[nan; 6]; bodies],
            judges: false,
            noise: nan,
        }
    }

    /// The estimated error of a solution minus the tolerance, in eps of its largest entry: positive or NaN if it
    /// exceeds the tolerance.
    #[inline(always)]
    pub fn lost(&self, accepted: T, out: &[T]) -> T {
        let size = largest_of(out, self.noise.constant(0.0));
        self.noise.sqrt().minus_product(size, accepted)
    }
}

/// The sum of the absolute entries.
#[inline(always)]
fn total<T: Real>(x: &Vector3<T>) -> T {
    x[0].abs() + x[1].abs() + x[2].abs()
}

/// Bounds on the terms of the moment and of the force of [`change_of`].
#[inline(always)]
fn terms_of_change<T: Real>(inertia: &BodyInertia<T>, velocity: &Vector6<T>, [dv, da]: [&[T; 6]; 2]) -> [T; 2] {
    let (dv, da) = (Vector6::from(*dv), Vector6::from(*da));
    let (w, u, dw, du) =
        (total(&angular(velocity)), total(&linear(velocity)), total(&angular(&dv)), total(&linear(&dv)));
    let turned = total(&angular(&da)) + (w * dw + w * dw);
    let moved = w.mul_add(du, dw.mul_add(u, total(&linear(&da))));
    let ([xx, _, _, yy, _, zz], h) = (inertia.rotational.entries, total(&inertia.first_moment));
    [h.mul_add(moved, (xx + yy + zz) * turned), h.mul_add(turned, inertia.mass * moved)]
}

/// The square of the effect on w* d(dqdd) of one unit in the last place of a moment and a force of this size, over
/// eps^2.
#[inline(always)]
fn noise_of<T: Real>([moment, force]: [T; 2], nu: &[T; 6]) -> T {
    let of_moment = moment * (nu[0].abs() + nu[1].abs() + nu[2].abs());
    let of_force = force * (nu[3].abs() + nu[4].abs() + nu[5].abs());
    of_moment.mul_add(of_moment, of_force * of_force)
}

/// Base to tip: F and dF of every body without its children. `along.u` is the change of qdd, or empty for zero.
#[inline(always)]
pub(super) fn base_to_tip<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    kept: &mut Changes<T>,
    (state, along): (Motion<'_, T>, &Directions<'_, T>),
    gravity: &Vector3<T>,
) {
    let o = T::zero();
    debug_assert_eq!(model.nv(), along.q.len());
    let Changes { motions, forces, forces_change, judges, noise } = kept;
    *noise = o;
    let mut base = [[o; 6]; 4];
    for i in 0..3 {
        base[1][3 + i] = -gravity[i];
        if let Some(&change) = along.gravity.get(i) {
            base[3][3 + i] = -change;
        }
    }
    motions[0] = base;
    for (place, body) in sweeps.swept().iter().enumerate() {
        let seen = carried((sweeps, scratch), (place, body), motions[body.places.parent_outward]);
        let row = (body.row, o.splat(body.sense));
        let own = match body.joint {
            Joint::Axial(_) => about_z(row, &seen, state, along),
            Joint::Prismatic(at, _) | Joint::Free(at) | Joint::General(at) => {
                let at_joint = &sweeps.shifting[at];
                if at_joint.motion == JointMotion::Revolute {
                    about_z(row, &seen, state, along)
                } else {
                    of_any((sweeps, body, at_joint), &seen, (state, along))
                }
            }
        };
        let inertia_of = sweeps.load(body).inertia();
        let [velocity, acceleration] = [Vector6::from(own[0]), Vector6::from(own[1])];
        let mut change = change_of(&inertia_of, &velocity, [&own[2], &own[3]]);
        if let Some(wrench) = along.wrenches.get(body.index) {
            change = but(&change, &body.frame.apply(wrench));
        }
        if let Some(parameters) = along.parameters.get(body.index) {
            change = sum(&change, &inertia(&body.frame.parameters(parameters)).bias_force(&velocity, &acceleration));
        }
        if *judges {
            let terms = terms_of_change(&inertia_of, &velocity, [&own[2], &own[3]]);
            *noise += noise_of(terms, &scratch.test_co_state(place));
        }
        forces[place] = needed_force(body, &inertia_of, &[own[0], own[1]], state);
        forces_change[place] = change.into();
        if !body.is_leaf {
            motions[body.places.outward] = own;
        }
    }
}

/// x - y.
#[inline(always)]
fn but<T: Real>(x: &Vector6<T>, y: &[T; 6]) -> Vector6<T> {
    Vector6::new(x[0] - y[0], x[1] - y[1], x[2] - y[2], x[3] - y[3], x[4] - y[4], x[5] - y[5])
}

/// Past a revolute joint: V, A, dV and dA of the body from those of its parent transported to the joint.
#[inline(always)]
fn about_z<T: Real>(
    (row, sense): (usize, T),
    [v, a, dv, da]: &[[T; 6]; 4],
    state: Motion<'_, T>,
    along: &Directions<'_, T>,
) -> [[T; 6]; 4] {
    let (turn, rate, dqd) = (along.q[row] * sense, state.qd[row] * sense, along.qd[row] * sense);
    let [velocity, acceleration] = past_axial(&[*v, *a], row, sense, state);
    let mut dv = [
        v[1].mul_add(turn, dv[0]),
        dv[1].minus_product(v[0], turn),
        dv[2],
        v[4].mul_add(turn, dv[3]),
        dv[4].minus_product(v[3], turn),
        dv[5],
    ];
    let mut da = [
        dv[1].mul_add(rate, v[1].mul_add(dqd, a[1].mul_add(turn, da[0]))),
        da[1].minus_product(a[0], turn).minus_product(v[0], dqd).minus_product(dv[0], rate),
        da[2],
        dv[4].mul_add(rate, v[4].mul_add(dqd, a[4].mul_add(turn, da[3]))),
        da[4].minus_product(a[3], turn).minus_product(v[3], dqd).minus_product(dv[3], rate),
        da[5],
    ];
    dv[ABOUT_Z] += dqd;
    if let Some(dqdd) = along.u.get(row) {
        da[ABOUT_Z] = dqdd.mul_add(sense, da[ABOUT_Z]);
    }
    [velocity, acceleration, dv, da]
}

/// The same past any joint.
#[inline(always)]
fn of_any<T: Real>(
    (sweeps, body, at_joint): (&SweepModel<T>, &SweepBody<T::Parameter>, &Body<T>),
    seen: &[[T; 6]; 4],
    (state, along): (Motion<'_, T>, &Directions<'_, T>),
) -> [[T; 6]; 4] {
    let (row, [v, a, dv, da]) = (body.row, seen.map(Vector6::from));
    let [own_velocity, acceleration] = past_joint(sweeps, body, &[seen[0], seen[1]], state);
    let velocity = Vector6::from(own_velocity);
    let (eta, rate) = (joint_motion(at_joint, row, along.q), joint_motion(at_joint, row, along.qd));
    let dv = sum(&sum(&dv, &rate), &cross_motion(&v, &eta));
    let of_rates = sum(&cross_motion(&dv, &joint_motion(at_joint, row, state.qd)), &cross_motion(&velocity, &rate));
    let mut da = sum(&sum(&da, &cross_motion(&a, &eta)), &of_rates);
    if !along.u.is_empty() {
        da = sum(&da, &joint_motion(at_joint, row, along.u));
    }
    [own_velocity, acceleration, dv.into(), da.into()]
}

/// d(M A + V x* M V), grouped as in [`BodyInertia::bias_force`].
#[inline(always)]
fn change_of<T: Real>(inertia: &BodyInertia<T>, velocity: &Vector6<T>, [dv, da]: [&[T; 6]; 2]) -> Vector6<T> {
    let (dv, da) = (Vector6::from(*dv), Vector6::from(*da));
    let (w, u, dw, du) = (angular(velocity), linear(velocity), angular(&dv), linear(&dv));
    let at_origin = cross_add(&dw, &u, &cross_add(&w, &du, &linear(&da)));
    let needed = inertia.mul_motion(&spatial(&angular(&da), &at_origin));
    let (momentum, change) = (inertia.rotational.mul_vector(&w), inertia.rotational.mul_vector(&dw));
    let h = &inertia.first_moment;
    let (swung, swung_change) = (cross(&w, h), cross(&dw, h));
    spatial(
        &cross_add(&dw, &momentum, &cross_add(&w, &change, &angular(&needed))),
        &cross_add(&dw, &swung, &cross_add(&w, &swung_change, &linear(&needed))),
    )
}

/// Tip to base: dtau of inverse dynamics into `out`, without armature. With `FILTERS`: e^- of the filter, from D and g
/// of each row and the given dtau.
#[inline(always)]
pub(super) fn tip_to_base<T: Real, const FILTERS: bool>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    (shifts_of, measured): (&SweepScratch<T>, &[Measured<T>]),
    kept: &mut Changes<T>,
    (along, torque): (&Directions<'_, T>, &[T]),
    out: &mut [T],
) {
    for (place, body) in sweeps.swept().iter().enumerate().rev() {
        let (force, mut change) = (kept.forces[place], kept.forces_change[place]);
        if FILTERS && kept.judges {
            let nu = shifts_of.test_co_state(place);
            for (&change, nu) in change.iter().zip(nu) {
                kept.noise = (change * nu).mul_add(change * nu, kept.noise);
            }
        }
        with_rows!(body, model, rows, {
            if FILTERS {
                rows.filter(measured, torque, &mut change, out);
            } else {
                rows.project(&change, out);
            }
        });
        let Some(parent) = body.places.parent.checked_sub(1) else { continue };
        match body.joint {
            Joint::Axial(axis) => {
                turned((body, along), &force, &mut change);
                with_axial!(axis, shifts_of.own[place].turn, sweeps, body.offset, transform, {
                    send(transform, parent, (&force, &change), kept);
                });
            }
            Joint::Prismatic(at, _) | Joint::Free(at) | Joint::General(at) => {
                let at_joint = &sweeps.shifting[at];
                if at_joint.motion == JointMotion::Revolute {
                    turned((body, along), &force, &mut change);
                } else {
                    let eta = joint_motion(at_joint, body.row, along.q);
                    change = sum(&Vector6::from(change), &cross_force(&eta, &Vector6::from(force))).into();
                }
                send(&shifts_of.shifts[at], parent, (&force, &change), kept);
            }
        }
    }
}

/// Adds eta x* F of a revolute joint.
#[inline(always)]
fn turned<T: Real>((body, along): (&SweepBody<T::Parameter>, &Directions<'_, T>), force: &[T; 6], change: &mut [T; 6]) {
    let turn = along.q[body.row] * force[0].splat(body.sense);
    change[0] = change[0].minus_product(turn, force[1]);
    change[1] = turn.mul_add(force[0], change[1]);
    change[3] = change[3].minus_product(turn, force[4]);
    change[4] = turn.mul_add(force[3], change[4]);
}

/// Propagates F and dF to the parent.
#[inline(always)]
fn send<T: Real>(
    transform: &impl Transform<T>,
    parent: usize,
    (force, change): (&[T; 6], &[T; 6]),
    kept: &mut Changes<T>,
) {
    transform.send_force(force, false, &mut kept.forces[parent]);
    transform.send_force(change, false, &mut kept.forces_change[parent]);
}

/// dtau - dr qdd: the part of the right-hand side of the filter without forces.
#[inline(always)]
pub(super) fn right_side<T: Real>((state, along): (Motion<'_, T>, &Directions<'_, T>), right: &mut [T]) {
    right.copy_from_slice(along.u);
    if let Some(qdd) = state.qdd {
        for ((right, &change), &qdd) in right.iter_mut().zip(along.armature).zip(qdd) {
            *right = right.minus_product(change, qdd);
        }
    }
}

/// r dqdd + dr qdd, the contribution of armature to dtau.
#[inline(always)]
pub(super) fn add_armature<T: Real>(
    model: &Model<T>,
    (state, along): (Motion<'_, T>, &Directions<'_, T>),
    out: &mut [T],
) {
    for (i, out) in out.iter_mut().enumerate() {
        *out = model.system.noise[i].mul_add(along.u[i], *out);
        if let (Some(&change), Some(qdd)) = (along.armature.get(i), state.qdd) {
            *out = change.mul_add(qdd[i], *out);
        }
    }
}
