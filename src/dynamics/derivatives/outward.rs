//! Base to tip: the motion of a state, and what a unit of each degree of freedom lets the bodies outboard of it feel.

use super::DerivativeScratch;
use super::coriolis::BodyCoriolis;
use super::hinge::motion_cross_hinge;
use crate::dynamics::forces::Motion;
use crate::filter::HingeMap;
use crate::kinematics::{base_acceleration, joint_motion, joint_shift, motion_past_joint};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{angular, cross_motion, scaled_add, sum, zero};
use crate::workspace::Workspace;
use nalgebra::{Vector3, Vector6};

/// Of one degree of freedom with the column S, at its body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Felt<T> {
    /// The angular half of Psi1 = `V_p` x S, a velocity by q; its linear half nobody reads.
    pub velocity: Vector3<T>,
    /// Psi2 = `A_p` x S + `V_p` x Psi1, an acceleration by q.
    pub acceleration: Vector6<T>,
    /// Psi1 + V x S, an acceleration by qd.
    pub by_rate: Vector6<T>,
}

impl<T: Real> Felt<T> {
    pub fn filled(value: T) -> Self {
        let vector = Vector6::from_element(value);
        Self { velocity: Vector3::from_element(value), acceleration: vector, by_rate: vector }
    }

    /// From the parent's motion as seen at the joint, weight included, and the body's own velocity.
    #[inline(always)]
    fn new(hinge: &HingeMap<T>, (velocity, acceleration): &(Vector6<T>, Vector6<T>), own: &Vector6<T>) -> Self {
        let turned = motion_cross_hinge(velocity, hinge);
        Self {
            velocity: angular(&turned),
            acceleration: sum(&motion_cross_hinge(acceleration, hinge), &cross_motion(velocity, &turned)),
            by_rate: sum(&turned, &motion_cross_hinge(own, hinge)),
        }
    }
}

/// phi, the force that each body needs (into `workspace.z`), B(k), and what each degree of freedom lets its body feel.
#[inline(always)]
pub(super) fn base_to_tip<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    state: Motion<'_, T>,
) {
    let (still, base) = (zero(), base_acceleration(model));
    for (k, (body, stage)) in model.bodies.iter().zip(&model.system.stages).enumerate() {
        let shift = joint_shift(body, state.q);
        let parent = match stage.parent {
            Some(parent) => (
                shift.motion_to_child(&workspace.velocity[parent]),
                shift.motion_to_child(&workspace.acceleration[parent]),
            ),
            None => (still, shift.motion_to_child(&base)),
        };
        let (velocity, mut acceleration) = motion_past_joint(body, stage.first_row, &parent, state.qd);
        if let Some(qdd) = state.qdd {
            acceleration = sum(&acceleration, &joint_motion(body, stage.first_row, qdd));
        }
        let mut force = body.inertia.bias_force(&velocity, &acceleration);
        if !state.wrenches.is_empty() {
            force = scaled_add(&state.wrenches[k], force[0].constant(-1.0), &force);
        }
        for i in 0..stage.rows.count() {
            scratch.felt[stage.first_row + i] = Felt::new(&stage.rows.row(i), &parent, &velocity);
        }
        scratch.coriolis[k] = BodyCoriolis::new(&body.inertia, &velocity);
        workspace.shift[k] = shift;
        workspace.velocity[k] = velocity;
        workspace.acceleration[k] = acceleration;
        workspace.z[k] = force;
    }
}
