//! Gradients of the rows of the connections with respect to the configuration and the velocities, in O(depth) per
//! connection.
//!
//! For multipliers r of the rows of a connection between the frames C and D, r* (J qdd + J' qd) is a function h of the
//! pose of C in D, of the relative velocity V and of the relative acceleration V', all in the axes of C. Its cotangents
//! are forces: n by a twist of C relative to D, v by V, and F = E* r by V'. With V = `V_C` - X `V_D` and V' = `A_C` - X
//! `A_D` + V x X `V_D`, those of the motions of the two frames are
//!
//! ```text
//! of V_C: c = v + X V_D x* F      of X V_D: d = -c - V x* F      of A_C: F      of X A_D: -F
//! of a twist of C: n - X V_D x* d + X A_D x* F                   of a twist of D: the opposite
//! ```
//!
//! These forces are propagated inward over the bodies of the loop. At the joint of a body with velocity V, where `V_p`
//! and `A_p` are the velocity and the acceleration of its parent, all relative to the body where the branches meet,
//!
//! ```text
//! c += S qd x* F,    grad_q = H (n - V_p x* c - A_p x* F),    grad_qd = H (c - V x* F)
//! ```
//!
//! At rest, with qdd = w, the function is r* J(q) w. The cotangents n and v of one pair of frames are computed with
//! dual numbers, except for points.

use super::RowFault;
use crate::kinematics::joint_motion;
use crate::kinematics::pair::{Pair, PairRows, RelativeMotion, pair_rows};
use crate::kinematics::propagation::tip_to_base;
use crate::kinematics::relative::motions_from;
use crate::model::Model;
use crate::scalar::{Dual, Real};
use crate::scene::constraint::{Constraint, Constraints, Tie};
use crate::spatial::{
    RigidShift, angular, cross, cross_force, cross_motion, dot, linear, scaled_add, spatial, sum, zero,
};
use nalgebra::{Matrix3, Vector3, Vector6};

/// Scratch of the gradients, in any scalar of one lane.
#[derive(Debug, Clone)]
pub(crate) struct RowGradients<T = f64> {
    /// V and A of the bodies of a loop, relative to the body where its branches meet.
    motions: Vec<[Vector6<T>; 2]>,
    /// n, c and F per body.
    sums: Vec<[Vector6<T>; 3]>,
    /// Joint velocities of zero, and gradients by the velocities that are not needed.
    rest: Vec<T>,
    unused: Vec<T>,
}

impl<T: Real<Parameter = T>> RowGradients<T> {
    pub fn new(model: &Model<T>) -> Self {
        let (bodies, nv) = (model.bodies.len(), model.nv());
        Self {
            motions: vec![[zero(); 2]; bodies],
            sums: vec![[zero(); 3]; bodies],
            rest: vec![T::zero(); nv],
            unused: vec![T::zero(); nv],
        }
    }

    /// Adds the gradient of multipliers* J(q) w by q, in its tangent space, to `out`, (nv), for the rows of all
    /// connections. `shifts`: phi of every body at `q`.
    pub fn add_row_gradient(
        &mut self,
        system: (&Model<T>, &Constraints),
        shifts: &[RigidShift<T>],
        (q, w): (&[T], &[T]),
        multipliers: &[T],
        out: &mut [T],
    ) -> Result<(), RowFault> {
        let (rest, mut unused) = (std::mem::take(&mut self.rest), std::mem::take(&mut self.unused));
        let added = self.add_acceleration_gradient(system, shifts, (q, &rest, w), multipliers, [out, &mut unused]);
        (self.rest, self.unused) = (rest, unused);
        added
    }

    /// Adds the gradients of multipliers* (J qdd + J' qd) by q, in its tangent space, and by qd to `by_q` and `by_qd`,
    /// (nv) each, for the rows of all connections. `shifts`: phi of every body at `q`.
    pub fn add_acceleration_gradient(
        &mut self,
        (model, constraints): (&Model<T>, &Constraints),
        shifts: &[RigidShift<T>],
        state: (&[T], &[T], &[T]),
        multipliers: &[T],
        [by_q, by_qd]: [&mut [T]; 2],
    ) -> Result<(), RowFault> {
        for (index, constraint) in constraints.all.iter().enumerate() {
            let multipliers = &multipliers[constraint.rows()];
            // Rows of joint coordinates are constant.
            if multipliers.iter().all(|r| *r == T::zero()) || matches!(constraint.tie, Tie::Coordinates { .. }) {
                continue;
            }
            self.begin(model, (index, constraint), state, multipliers)?;
            self.move_bodies(model, shifts, constraint, state);
            let Self { motions, sums, .. } = self;
            let stages = &model.system.stages;
            tip_to_base(stages, shifts, constraint.branches.iter().copied(), sums, |k, [n, c, f]| {
                let stage = &stages[k];
                let [of_parent, acceleration_of_parent] = seen(motions, shifts, stage.parent, constraint, k);
                let own = joint_motion(&model.bodies[k], stage.first_row, state.1);
                *c = sum(c, &cross_force(&own, f));
                let along = *n - cross_force(&of_parent, c) - cross_force(&acceleration_of_parent, f);
                let moving = *c - cross_force(&motions[k][0], f);
                for entry in 0..stage.rows.count() {
                    by_q[stage.first_row + entry] += stage.rows.row(entry).project(&along);
                    by_qd[stage.first_row + entry] += stage.rows.row(entry).project(&moving);
                }
            });
        }
        Ok(())
    }

    /// Writes the derivatives along (dq, dqd) of J qdd + J' qd, (m), and of J* multipliers, (nv). O(m depth + N).
    ///
    /// J* multipliers is linear in J, and multipliers* J'(q, v) v is a quadratic form in v: its gradient by v is the
    /// derivative of J* multipliers along v plus the gradient of multipliers* J v by q.
    pub fn along(
        &mut self,
        system: (&Model<T>, &Constraints),
        shifts: &[RigidShift<T>],
        state: (&[T], &[T], &[T]),
        ([dq, dqd], multipliers): ([&[T]; 2], &[T]),
        [of_rows, of_torques]: [&mut [T]; 2],
    ) -> Result<(), RowFault> {
        let (model, constraints) = system;
        let zeros = vec![T::zero(); dq.len()];
        let (mut by_q, mut by_qd, mut unit) = (zeros.clone(), zeros.clone(), vec![T::zero(); constraints.rows]);
        of_rows.fill(T::zero());
        for constraint in &constraints.all {
            for row in constraint.rows() {
                unit[row] = T::one();
                self.add_acceleration_gradient(system, shifts, state, &unit, [&mut by_q, &mut by_qd])?;
                unit[row] = T::zero();
                for stage in constraint.branches.iter().map(|&k| &model.system.stages[k]) {
                    for i in stage.first_row..stage.first_row + stage.rows.count() {
                        of_rows[row] += by_q[i] * dq[i] + by_qd[i] * dqd[i];
                        (by_q[i], by_qd[i]) = (T::zero(), T::zero());
                    }
                }
            }
        }
        of_torques.fill(T::zero());
        self.add_acceleration_gradient(system, shifts, (state.0, dq, &zeros), multipliers, [&mut by_qd, of_torques])?;
        self.add_row_gradient(system, shifts, (state.0, dq), multipliers, &mut by_q)?;
        of_torques.iter_mut().zip(&by_q).for_each(|(sum, more)| *sum -= *more);
        Ok(())
    }

    /// Sets the forces n, c and F on the bodies of the two frames of a connection, and zero on the others of its path.
    fn begin(
        &mut self,
        model: &Model<T>,
        (index, constraint): (usize, &Constraint),
        (q, qd, qdd): (&[T], &[T], &[T]),
        multipliers: &[T],
    ) -> Result<(), RowFault> {
        for &k in &constraint.path {
            self.sums[k] = [zero(); 3];
        }
        let Tie::Frames { pair, frames: [c, d] } = &constraint.tie else { return Ok(()) };
        let [c, d] = [c.cast::<T>(), d.cast()];
        let [of_c, of_d] = motions_from(model, (q, qd, Some(qdd)), [&c, &d], constraint.junction);
        let motion = RelativeMotion::of(&of_c, &of_d);
        let [by_place, by_velocity, force] =
            of_pair(*pair, &motion, multipliers).ok_or(RowFault::NoDirection(index))?;
        let velocity = motion.place.motion_to_child(&of_d.velocity);
        let acceleration = motion.place.motion_to_child(&of_d.acceleration);
        let on_c = sum(&by_velocity, &cross_force(&velocity, &force));
        let on_d = -on_c - cross_force(&motion.velocity, &force);
        let turning = by_place - cross_force(&velocity, &on_d) + cross_force(&acceleration, &force);
        for (frame, forces) in [
            (&c, [turning, on_c, force]),
            (&d, [-turning, on_d, -force].map(|force| motion.place.force_to_parent(&force))),
        ] {
            let Some(k) = frame.body else { continue };
            for (sum, force) in self.sums[k].iter_mut().zip(&forces) {
                *sum += frame.placement.force_to_parent(force);
            }
        }
        Ok(())
    }

    /// Sets V and A of the bodies of a loop.
    fn move_bodies(
        &mut self,
        model: &Model<T>,
        shifts: &[RigidShift<T>],
        constraint: &Constraint,
        (_, qd, qdd): (&[T], &[T], &[T]),
    ) {
        for &k in constraint.branches.iter().rev() {
            let (body, stage) = (&model.bodies[k], &model.system.stages[k]);
            let [velocity, acceleration] = seen(&self.motions, shifts, stage.parent, constraint, k);
            let own = joint_motion(body, stage.first_row, qd);
            let velocity = sum(&velocity, &own);
            let more = sum(&joint_motion(body, stage.first_row, qdd), &cross_motion(&velocity, &own));
            self.motions[k] = [velocity, sum(&acceleration, &more)];
        }
    }
}

/// V and A of the parent of body `k`, in the frame of the body.
fn seen<T: Real>(
    motions: &[[Vector6<T>; 2]],
    shifts: &[RigidShift<T>],
    parent: Option<usize>,
    constraint: &Constraint,
    k: usize,
) -> [Vector6<T>; 2] {
    let moving = parent.filter(|_| parent != constraint.junction);
    moving.map_or([zero(); 2], |parent| motions[parent].map(|motion| shifts[k].motion_to_child(&motion)))
}

/// The cotangents of multipliers* (E V' + E' V) by a twist of the first frame relative to the second, by V and by V'.
fn of_pair<T: Real<Parameter = T>>(
    pair: Pair,
    motion: &RelativeMotion<T>,
    multipliers: &[T],
) -> Option<[Vector6<T>; 3]> {
    let rows = pair_rows(pair, &motion.place, &motion.velocity)?;
    let mut force = zero();
    for (row, &r) in rows.of_motion.iter().zip(multipliers) {
        force = scaled_add(row, r, &force);
    }
    if pair == Pair::Point {
        let [by_place, by_velocity] = of_point(motion, &Vector3::from_column_slice(&multipliers[..3]));
        return Some([by_place, by_velocity, force]);
    }
    let RigidShift { rotation, lever } = &motion.place;
    let place = RigidShift { rotation: rotation.map(Dual::constant_of), lever: lever.map(Dual::constant_of) };
    let [velocity, acceleration] = [motion.velocity, motion.acceleration].map(|x| x.map(Dual::constant_of));
    let slope = |rows: &PairRows<Dual<T>>| -> T {
        let each = rows.of_motion.iter().zip(&rows.turning).zip(multipliers);
        each.fold(T::zero(), |sum, ((row, &turning), &r)| sum + r * (dot(row, &acceleration) + turning).tangent)
    };
    let unit = |axis: usize| Vector3::from_fn(|i, _| if i == axis { T::one() } else { T::zero() });
    let (mut by_place, mut by_velocity) = (zero(), zero());
    for i in 0..6 {
        // R (d x) for a rotation, R d for a translation.
        let along = unit(i % 3);
        let mut twisted = place;
        if i < 3 {
            let turned = rotation * Matrix3::from_fn(|row, column| cross(&along, &unit(column))[row]);
            twisted.rotation.zip_apply(&turned, |entry, change| entry.tangent = change);
        } else {
            let shifted = rotation * along;
            twisted.lever.zip_apply(&shifted, |entry, change| entry.tangent = change);
        }
        by_place[i] = slope(&pair_rows(pair, &twisted, &velocity)?);
        if motion.velocity != zero() {
            let mut faster = velocity;
            faster[i].tangent = T::one();
            by_velocity[i] = slope(&pair_rows(pair, &place, &faster)?);
        }
    }
    Some([by_place, by_velocity, force])
}

/// The cotangents of [`of_pair`] for coinciding origins, by a twist and by V: with the position p of the origin of the
/// first frame and V = (w, v), V' = (w', v') in its axes, the rows are v' - w' x p + (v - w x p) x w.
fn of_point<T: Real>(motion: &RelativeMotion<T>, r: &Vector3<T>) -> [Vector6<T>; 2] {
    let p = motion.place.rotate_back(&motion.place.lever);
    let (w, v) = (angular(&motion.velocity), linear(&motion.velocity));
    let by_p = angular(&motion.acceleration).cross(r) + w * w.dot(r) - r * w.dot(&w);
    let moving = v - w.cross(&p);
    let by_w = r.cross(&moving) + w.cross(r).cross(&p);
    [spatial(&by_p.cross(&p), &by_p), spatial(&by_w, &w.cross(r))]
}

#[cfg(test)]
mod tests;
