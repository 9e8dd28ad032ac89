//! Derivatives of the rows of contacts with respect to the configuration and to the planes, in O(N) passes for all
//! contacts together.
//!
//! For impulses f at the contacts and joint velocities w, f* J(q) w is the power of the forces F on the bodies, F V.
//! The sphere of radius r on body b touches the surface of body o (or of the base) with the normal n at P = C - r n; B
//! is the derivative of n by the center C relative to the surface, and s the velocity of b relative to o at P. The axes
//! t1, t2 turn with n by n x dn: only n and P have derivatives, because the contact law does not depend on the choice
//! of t1 and t2. If b moves by a small displacement, with its velocity fixed in its own frame, the power changes by the
//! force g at C and the moment m,
//!
//! ```text
//! g = w_o x f + B* a,   a = (f x s) x n + r (w_b - w_o) x f
//! m = v_C x f - r w_b x (n x f)
//! ```
//!
//! A displacement of o changes it by the opposite force and moment, for it does not change if both move together, and a
//! change of the normal of a plane by a. If joint j moves by H* dq, the bodies outboard of it move with it, and their
//! velocity changes by the inboard part of V, which is that of the parent at the joint, `V_p`. With the sums F and N of
//! the forces and of (m, g) over all bodies outboard of a joint,
//!
//! ```text
//! grad_q f* J w = H (N - V_p x* F)
//! ```

use super::{ContactScratch, UnitForces};
use crate::kinematics::propagation::tip_to_base;
use crate::kinematics::velocities_base_to_tip;
use crate::model::Model;
use crate::scene::contact_point::ContactPoint;
use crate::spatial::{RigidShift, angular, cross_force, linear, spatial, zero};
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
            for (k, units) in [Some(point.body), point.other_body()].into_iter().zip(&self.units[i].0) {
                let Some(k) = k else { continue };
                for (row, unit) in units.iter().enumerate() {
                    self.state[k] += unit * impulses[3 * at + row];
                }
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

    /// Adds the gradient of p* J(q) w by q, in its tangent space, to `out` (nv), and for each contact of `near` with a
    /// plane that by its normal, in the frame of the body that carries the plane (or the base frame), to `normals`. O(N
    /// + contacts).
    pub fn add_gradient(
        &mut self,
        (model, points): (&Model<f64>, &[ContactPoint]),
        scratch: &mut RowDerivatives,
        (near, impulses, w): (&[usize], &DVector<f64>, &[f64]),
        (out, normals): (&mut [f64], &mut [Vector3<f64>]),
    ) {
        velocities_base_to_tip(model, &self.shift, w, &mut self.velocity);
        scratch.sums.fill([zero(); 2]);
        for (at, &i) in near.iter().enumerate() {
            let Some(point) = points.get(i) else { continue };
            let (place, other) = (&self.places[point.body], self.other_place(point));
            let (center, axes) = (self.center(point), &self.axes[i]);
            let normal = axes.row(2).transpose();
            let (arm, _) = point.arm(Some(place), &normal);
            let roll = |x: &Vector3<f64>| point.roll(place, &normal, x);
            let f = axes.tr_mul(&impulses.fixed_rows::<3>(3 * at));
            let velocity = &self.velocity[point.body];
            let turning = place.rotate(&angular(velocity));
            let speed = place.rotate(&(linear(velocity) + angular(velocity).cross(&point.center)));
            let (other_turning, other_speed) = point.other_body().map_or_else(Default::default, |k| {
                let (velocity, arm) = (&self.velocity[k], other.rotate_back(&(center + arm - other.lever)));
                (other.rotate(&angular(velocity)), other.rotate(&(linear(velocity) + angular(velocity).cross(&arm))))
            });
            let (slip, relative) = (speed + turning.cross(&arm) - other_speed, turning - other_turning);
            let by_normal = f.cross(&slip).cross(&normal) + roll(&relative.cross(&f));
            let push = other_turning.cross(&f) + point.bending(place, &other).tr_mul(&by_normal);
            let by_arm = f.cross(&relative);
            let moment =
                speed.cross(&f) + turning.cross(&arm.cross(&f)) + arm.cross(&by_arm) + normal.cross(&roll(&by_arm));
            let mut add =
                |k: usize, place: &RigidShift<f64>, arm: &Vector3<f64>, sign: f64, units: &[Vector6<f64>; 3]| {
                    let [forces, moments] = &mut scratch.sums[k];
                    let (push, moment) = (place.rotate_back(&push) * sign, place.rotate_back(&moment) * sign);
                    for (row, unit) in units.iter().enumerate() {
                        *forces += unit * impulses[3 * at + row];
                    }
                    *moments += spatial(&(moment + arm.cross(&push)), &push);
                };
            let UnitForces([units, opposite]) = &self.units[i];
            add(point.body, place, &point.center, 1.0, units);
            if let Some(k) = point.other_body() {
                add(k, &other, &other.rotate_back(&(center - other.lever)), -1.0, opposite);
            }
            if point.is_plane() {
                normals[i] += other.rotate_back(&by_normal);
            }
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
    fn center(&self, point: &ContactPoint) -> Vector3<f64> {
        let place = &self.places[point.body];
        place.rotate(&point.center) + place.lever
    }

    /// The pose of the body that carries the surface of a contact.
    fn other_place(&self, point: &ContactPoint) -> RigidShift<f64> {
        point.other_body().map_or_else(RigidShift::identity, |k| self.places[k])
    }

    /// Center of the sphere of a contact in the frame of the body that carries its surface, m.
    pub fn center_at_surface(&self, point: &ContactPoint) -> Vector3<f64> {
        let other = self.other_place(point);
        other.rotate_back(&(self.center(point) - other.lever))
    }
}

#[cfg(test)]
mod tests;
