//! Base to tip: the motion of a state, and what a unit of each degree of freedom lets the bodies outboard of it feel.

use super::coriolis::BodyCoriolis;
use super::felt::Felt;
use super::{Kept, Matrices};
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::SweepModel;
use crate::dynamics::sweeps::joint::{self, Joint, with_axial};
use crate::dynamics::sweeps::scratch::SweepScratch;
use crate::filter::{HingeMap, Rows};
use crate::kinematics::{joint_motion, motion_past_joint};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::transform::Transform;
use nalgebra::Vector6;

/// A revolute joint's row, about its z.
pub(super) const ABOUT_Z: usize = 2;

/// Of every body, turns and shifts being there: the force that it needs, its inertia, B(k), and what each degree of freedom lets it feel.
#[inline(always)]
pub(super) fn base_to_tip<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    kept: &mut Kept<T>,
    state: Motion<'_, T>,
    matrices: Matrices,
) {
    let (o, g) = (T::zero(), &model.gravity);
    let Kept { motions, composites, coriolis, forces, felt } = kept;
    motions[0] = [[o; 6], [o, o, o, -g[0], -g[1], -g[2]]];
    for (place, body) in sweeps.swept().iter().enumerate() {
        let [v, a] = motions[body.places.parent_outward];
        let (seen, own) = match body.joint {
            Joint::Axial(axis) => {
                let seen = with_axial!(axis, scratch.own[place].turn, sweeps, body.offset, transform, {
                    [transform.carry_motion(&v), transform.carry_motion(&a)]
                });
                (seen, past_axial(&seen, body.row, o.splat(body.sense), state))
            }
            Joint::Prismatic(at, _) | Joint::Free(at) | Joint::General(at) => {
                let shift = &scratch.shifts[at];
                let seen = [shift.carry_motion(&v), shift.carry_motion(&a)];
                let (carried, body_at) = ((Vector6::from(seen[0]), Vector6::from(seen[1])), &sweeps.shifting[at]);
                let (v, mut a) = motion_past_joint(body_at, body.row, &carried, state.qd);
                if let Some(qdd) = state.qdd {
                    a += joint_motion(body_at, body.row, qdd);
                }
                (seen, [v.into(), a.into()])
            }
        };
        let inertia = body.inertia(o);
        let velocity = Vector6::from(own[0]);
        let mut force: [T; 6] = inertia.bias_force(&velocity, &Vector6::from(own[1])).into();
        if !state.wrenches.is_empty() {
            for (f, given) in force.iter_mut().zip(body.frame.apply(&state.wrenches[body.index])) {
                *f -= given;
            }
        }
        if let Joint::Axial(_) = body.joint {
            let row = (&HingeMap::Axis(ABOUT_Z), o.splat(body.sense));
            felt[body.row] = Felt::new(row, &seen, &own[0], matrices);
        } else {
            let rows: &Rows<T> = &model.system.stages[body.index].rows;
            for i in 0..rows.count() {
                felt[body.row + i] = Felt::new((&rows.row(i), o.constant(1.0)), &seen, &own[0], matrices);
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

/// Past a revolute joint: the body's velocity and acceleration from its parent's as seen at the joint.
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
