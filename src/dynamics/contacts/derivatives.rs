//! Derivatives of the rows of contacts with respect to the configuration and to the planes, in O(N) passes for all
//! contacts together.
//!
//! For impulses f at the contacts and joint velocities w, f* J(q) w is the power of the forces F on the bodies, F V.
//! Let a body rotate by a small angle: its force is fixed in the base frame, and its lever arm to the point nearest to
//! the plane is `center` - R* n r. The power changes by the moment `v_P` x f + r n x (f x w), with the velocity `v_P`
//! of the point. If joint j moves by H* dq, the bodies outboard of it move with it, and their velocity changes by the
//! inboard part of V, which is that of the parent at the joint, `V_p`. With the sums F and N of forces and moments over
//! all bodies outboard of a joint,
//!
//! ```text
//! grad_q f* J w = H (N - V_p x* F)
//! ```

use super::ContactScratch;
use crate::kinematics::propagation::tip_to_base;
use crate::kinematics::velocities_base_to_tip;
use crate::model::Model;
use crate::scene::contact_point::ContactPoint;
use crate::spatial::{angular, cross_force, linear, spatial, zero};
use crate::workspace::Workspace;
use nalgebra::{DVector, Vector3, Vector6};

/// Scratch of the derivatives: per body, the force F and the moment N.
#[derive(Debug, Clone)]
pub(crate) struct RowDerivatives {
    sums: Vec<[Vector6<f64>; 2]>,
}

impl RowDerivatives {
    pub fn new(model: &Model<f64>) -> Self {
        Self { sums: vec![[zero(); 2]; model.bodies.len()] }
    }
}

impl ContactScratch {
    /// M^-1 (torque + J* p) of the contacts `near`, as [`ContactScratch::respond`].
    pub fn respond_to(
        &mut self,
        model: &Model<f64>,
        points: &[ContactPoint],
        workspace: &mut Workspace<f64>,
        torque: &[f64],
        (near, impulses): (&[usize], &DVector<f64>),
    ) {
        self.torque.copy_from_slice(torque);
        self.respond(model, points, workspace, near, impulses);
    }

    /// Adds J* p of the contacts `near` to `out`, (nv). O(N + contacts).
    pub fn add_torques(
        &mut self,
        model: &Model<f64>,
        points: &[ContactPoint],
        (near, impulses): (&[usize], &DVector<f64>),
        out: &mut [f64],
    ) {
        self.state.fill(zero());
        for (at, &i) in near.iter().enumerate() {
            let Some(point) = points.get(i) else {
                let limit = &self.limits[i - points.len()];
                out[limit.row] += limit.sign() * impulses[3 * at + 2];
                continue;
            };
            for (row, unit) in self.units[i].iter().enumerate() {
                self.state[point.body] += unit * impulses[3 * at + row];
            }
        }
        let stages = &model.system.stages;
        tip_to_base(stages, &self.shift, (0..stages.len()).rev(), &mut self.state, |k, force| {
            let stage = &stages[k];
            for entry in 0..stage.rows.count() {
                out[stage.first_row + entry] += stage.rows.row(entry).project(force);
            }
        });
    }

    /// Adds the gradient of p* J(q) w by q, in its tangent space, to `out` (nv), and for each contact of `near` that by
    /// a rotation of its plane about the base origin, in the base frame, to `turns`. O(N + contacts).
    pub fn add_gradient(
        &mut self,
        (model, points): (&Model<f64>, &[ContactPoint]),
        scratch: &mut RowDerivatives,
        (near, impulses, w): (&[usize], &DVector<f64>, &[f64]),
        (out, turns): (&mut [f64], &mut [Vector3<f64>]),
    ) {
        velocities_base_to_tip(model, &self.shift, w, &mut self.velocity);
        scratch.sums.fill([zero(); 2]);
        for (at, &i) in near.iter().enumerate() {
            let Some(point) = points.get(i) else { continue };
            let (place, velocity) = (&self.places[point.body], &self.velocity[point.body]);
            let mut force = zero();
            for (row, unit) in self.units[i].iter().enumerate() {
                force += unit * impulses[3 * at + row];
            }
            let (f, turning) = (linear(&force), angular(velocity));
            let normal = place.rotate_back(&point.normal());
            let arm = point.center - normal * point.radius;
            let speed = linear(velocity) + turning.cross(&arm);
            let moment = speed.cross(&f) + normal.cross(&f.cross(&turning)) * point.radius;
            let [forces, moments] = &mut scratch.sums[point.body];
            *forces += force;
            *moments += spatial(&moment, &Vector3::zeros());
            turns[i] -= place.rotate(&moment);
        }
        let (stages, shift, velocity) = (&model.system.stages, &self.shift, &self.velocity);
        tip_to_base(stages, shift, (0..stages.len()).rev(), &mut scratch.sums, |k, [force, moment]| {
            let stage = &stages[k];
            let inboard = stage.parent.map_or_else(zero, |parent| shift[k].motion_to_child(&velocity[parent]));
            let along = *moment - cross_force(&inboard, force);
            for entry in 0..stage.rows.count() {
                out[stage.first_row + entry] += stage.rows.row(entry).project(&along);
            }
        });
    }

    /// Center of the sphere of a contact in the base frame, m, at the configuration of [`ContactScratch::place`].
    pub fn center(&self, point: &ContactPoint) -> Vector3<f64> {
        let place = &self.places[point.body];
        place.rotate(&point.center) + place.lever
    }
}

#[cfg(test)]
mod tests;
