//! Base to tip: the motion of a state, and its change in the bodies outboard per unit of each degree of freedom.

use super::coriolis::BodyCoriolis;
use super::hinge::Effect;
use super::{Kept, Matrices};
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::SweepModel;
use crate::dynamics::sweeps::body::SweepBody;
use crate::dynamics::sweeps::joint::{self, Joint, with_axial};
use crate::dynamics::sweeps::scratch::SweepScratch;
use crate::filter::{HingeMap, Rows};
use crate::kinematics::{joint_motion, motion_past_joint};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::transform::Transform;
use crate::spatial::{BodyInertia, sum};
use nalgebra::Vector6;

/// A revolute joint's row, about its z.
pub(super) const ABOUT_Z: usize = 2;

/// For every body, with the rotations and shifts of the joints in the scratch: the force that it needs, its inertia,
/// B(k), and the change of its motion per unit of each degree of freedom.
#[inline(always)]
pub(super) fn base_to_tip<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    kept: &mut Kept<T>,
    state: Motion<'_, T>,
    matrices: Matrices,
) {
    let (o, g) = (T::zero(), &model.gravity);
    let Kept { motions, composites, coriolis, forces, effect } = kept;
    motions[0] = [[o; 6], [o, o, o, -g[0], -g[1], -g[2]]];
    for (place, body) in sweeps.swept().iter().enumerate() {
        let seen = carried((sweeps, scratch), (place, body), motions[body.places.parent_outward]);
        let own = past_joint(sweeps, body, &seen, state);
        let inertia = sweeps.load(body).inertia();
        let velocity = Vector6::from(own[0]);
        let force = needed_force(body, &inertia, &own, state);
        if let Joint::Axial(_) = body.joint {
            let row = (&HingeMap::Axis(ABOUT_Z), o.splat(body.sense));
            effect[body.row] = Effect::new(row, &seen, &own[0], matrices);
        } else {
            let rows: &Rows<T> = &model.system.stages[body.index].rows;
            for i in 0..rows.count() {
                effect[body.row + i] = Effect::new((&rows.row(i), o.constant(1.0)), &seen, &own[0], matrices);
            }
        }
        let of_body = BodyCoriolis::new(&inertia, &velocity);
        coriolis[place] = if matrices == Matrices::Coriolis { of_body.half() } else { of_body };
        (composites[place], forces[place]) = (inertia, force);
        if !body.is_leaf {
            motions[body.places.outward] = own;
        }
    }
}

/// phi* of the motion of the parent: transported to the joint.
#[inline(always)]
pub(super) fn carried<T: Real, const N: usize>(
    (sweeps, scratch): (&SweepModel<T>, &SweepScratch<T>),
    (place, body): (usize, &SweepBody<T::Parameter>),
    mut motions: [[T; 6]; N],
) -> [[T; 6]; N] {
    match body.joint {
        Joint::Axial(axis) => with_axial!(axis, scratch.own[place].turn, sweeps, body.offset, transform, {
            for motion in &mut motions {
                *motion = transform.carry_motion(motion);
            }
        }),
        Joint::Prismatic(at, _) | Joint::Free(at) | Joint::General(at) => {
            for motion in &mut motions {
                *motion = scratch.shifts[at].carry_motion(motion);
            }
        }
    }
    motions
}

/// The velocity and acceleration of the body, from those of its parent transported to the joint.
#[inline(always)]
pub(super) fn past_joint<T: Real>(
    sweeps: &SweepModel<T>,
    body: &SweepBody<T::Parameter>,
    seen: &[[T; 6]; 2],
    state: Motion<'_, T>,
) -> [[T; 6]; 2] {
    match body.joint {
        Joint::Axial(_) => past_axial(seen, body.row, seen[0][0].splat(body.sense), state),
        Joint::Prismatic(at, _) | Joint::Free(at) | Joint::General(at) => {
            let (both, at_joint) = ((Vector6::from(seen[0]), Vector6::from(seen[1])), &sweeps.shifting[at]);
            let (velocity, mut acceleration) = motion_past_joint(at_joint, body.row, &both, state.qd);
            if let Some(qdd) = state.qdd {
                acceleration = sum(&acceleration, &joint_motion(at_joint, body.row, qdd));
            }
            [velocity.into(), acceleration.into()]
        }
    }
}

/// M A + V x* (M V) - w: the force that the motion of a body needs in addition to the wrench on it.
#[inline(always)]
pub(super) fn needed_force<T: Real>(
    body: &SweepBody<T::Parameter>,
    inertia: &BodyInertia<T>,
    [velocity, acceleration]: &[[T; 6]; 2],
    state: Motion<'_, T>,
) -> [T; 6] {
    let mut force: [T; 6] = inertia.bias_force(&Vector6::from(*velocity), &Vector6::from(*acceleration)).into();
    if !state.wrenches.is_empty() {
        for (f, given) in force.iter_mut().zip(body.frame.apply(&state.wrenches[body.index])) {
            *f -= given;
        }
    }
    force
}

/// Past a revolute joint: the velocity and acceleration of the body from those of its parent transported to the joint.
#[inline(always)]
pub(super) fn past_axial<T: Real>([v, a]: &[[T; 6]; 2], row: usize, sense: T, state: Motion<'_, T>) -> [[T; 6]; 2] {
    let (rate, mut velocity, mut acceleration) = (state.qd[row] * sense, *v, *a);
    velocity[ABOUT_Z] += rate;
    // V x S qd.
    acceleration[0] = v[1].mul_add(rate, a[0]);
    acceleration[1] = a[1].minus_product(v[0], rate);
    acceleration[3] = v[4].mul_add(rate, a[3]);
    acceleration[4] = a[4].minus_product(v[3], rate);
    if let Some(qdd) = state.qdd {
        acceleration[ABOUT_Z] = qdd[row].mul_add(sense, acceleration[ABOUT_Z]);
    }
    [velocity, acceleration]
}
