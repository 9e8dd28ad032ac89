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
//! At rest, with qdd = w, the function is r* J(q) w.

use super::RowFault;
use crate::kinematics::pair::{Pair, RelativeMotion, pair_cotangents};
use crate::kinematics::propagation::tip_to_base;
use crate::kinematics::{Frame, FrameMotion, joint_motion};
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::constraint::{Constraint, Constraints, Tie};
use crate::spatial::{RigidShift, cross_force, cross_motion, scaled, scaled_add, sum, zero};
use nalgebra::Vector6;

/// Scratch of the gradients.
#[derive(Debug, Clone)]
pub(crate) struct RowGradients<T = f64> {
    /// The frames of each connection; `None` for joint coordinates.
    frames: Vec<Option<[Frame<T>; 2]>>,
    /// V and A of the bodies of a loop, relative to the body where its branches meet.
    motions: Vec<[Vector6<T>; 2]>,
    /// n, c and F per body.
    sums: Vec<[Vector6<T>; 3]>,
    /// Joint velocities of zero, and gradients by the velocities that are not needed.
    rest: Vec<T>,
    unused: Vec<T>,
}

impl<T: Real> RowGradients<T> {
    pub fn new((model, constraints): (&Model<T>, &Constraints)) -> Self {
        let (bodies, nv) = (model.bodies.len(), model.nv());
        let frames = |of: &Constraint| match &of.tie {
            Tie::Frames { frames, .. } => Some(frames.map(|frame| frame.cast())),
            Tie::Coordinates(_) => None,
        };
        Self {
            frames: constraints.all.iter().map(frames).collect(),
            motions: vec![[zero(); 2]; bodies],
            sums: vec![[zero(); 3]; bodies],
            rest: vec![T::zero(); nv],
            unused: vec![T::zero(); nv],
        }
    }

    /// Adds the gradient of multipliers* J(q) w by q, in its tangent space, to `out`, (nv), for the rows of all
    /// connections. `shifts`: phi of every body at `q`.
    #[inline(always)]
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
    #[inline(always)]
    pub fn add_acceleration_gradient(
        &mut self,
        (model, constraints): (&Model<T>, &Constraints),
        shifts: &[RigidShift<T>],
        state: (&[T], &[T], &[T]),
        multipliers: &[T],
        [by_q, by_qd]: [&mut [T]; 2],
    ) -> Result<(), RowFault> {
        let (zero, minus) = (model.gravity[0].constant(0.0), model.gravity[0].constant(-1.0));
        for (index, constraint) in constraints.all.iter().enumerate() {
            let multipliers = &multipliers[constraint.rows()];
            if multipliers.iter().all(|r| *r == zero) {
                continue;
            }
            let pair = match &constraint.tie {
                Tie::Frames { pair, .. } => *pair,
                Tie::Coordinates(coupled) => {
                    coupled.add_acceleration_gradient(state, multipliers[0], [&mut *by_q, &mut *by_qd]);
                    continue;
                }
            };
            self.move_bodies(model, shifts, constraint, state);
            self.begin((model, shifts), (index, constraint), pair, multipliers)?;
            let Self { motions, sums, .. } = self;
            let stages = &model.system.stages;
            tip_to_base(stages, shifts, constraint.branches.iter().copied(), sums, |k, [n, c, f]| {
                let stage = &stages[k];
                let [of_parent, acceleration_of_parent] = seen(motions, shifts, stage.parent, constraint, k);
                let own = joint_motion(&model.bodies[k], stage.first_row, state.1);
                *c = sum(c, &cross_force(&own, f));
                let turned = sum(&cross_force(&of_parent, c), &cross_force(&acceleration_of_parent, f));
                let along = scaled_add(&turned, minus, n);
                let moving = scaled_add(&cross_force(&motions[k][0], f), minus, c);
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
            let columns = constraint.columns(model);
            for row in constraint.rows() {
                unit[row] = T::one();
                self.add_acceleration_gradient(system, shifts, state, &unit, [&mut by_q, &mut by_qd])?;
                unit[row] = T::zero();
                for &i in &columns {
                    of_rows[row] += by_q[i] * dq[i] + by_qd[i] * dqd[i];
                    (by_q[i], by_qd[i]) = (T::zero(), T::zero());
                }
            }
        }
        of_torques.fill(T::zero());
        self.add_acceleration_gradient(system, shifts, (state.0, dq, &zeros), multipliers, [&mut by_qd, of_torques])?;
        self.add_row_gradient(system, shifts, (state.0, dq), multipliers, &mut by_q)?;
        of_torques.iter_mut().zip(&by_q).for_each(|(sum, more)| *sum -= *more);
        Ok(())
    }

    /// Sets the forces n, c and F on the bodies of the two frames of a connection, and zero on the others of its path,
    /// from V and A of the bodies.
    #[inline(always)]
    fn begin(
        &mut self,
        (model, shifts): (&Model<T>, &[RigidShift<T>]),
        (index, constraint): (usize, &Constraint),
        pair: Pair,
        multipliers: &[T],
    ) -> Result<(), RowFault> {
        let Self { motions, sums, frames, .. } = self;
        let zero = Vector6::from_element(model.gravity[0].constant(0.0));
        for &k in &constraint.path {
            sums[k] = [zero; 3];
        }
        let Some([c, d]) = &frames[index] else { return Ok(()) };
        // Closures would be compiled without the instructions of the kernel.
        let of_c = frame_motion((model, shifts), motions, constraint.junction, c);
        let of_d = frame_motion((model, shifts), motions, constraint.junction, d);
        let motion = RelativeMotion::of(&of_c, &of_d);
        let [by_place, by_velocity, force] =
            pair_cotangents(pair, &motion, multipliers).ok_or(RowFault::NoDirection(index))?;
        let velocity = motion.place.motion_to_child(&of_d.velocity);
        let acceleration = motion.place.motion_to_child(&of_d.acceleration);
        let on_c = sum(&by_velocity, &cross_force(&velocity, &force));
        let minus = zero[0].constant(-1.0);
        let on_d = scaled(&sum(&on_c, &cross_force(&motion.velocity, &force)), minus);
        let turning = scaled_add(&cross_force(&velocity, &on_d), minus, &by_place);
        let turning = sum(&turning, &cross_force(&acceleration, &force));
        for (frame, forces, sign) in
            [(c, [turning, on_c, force], None), (d, [turning, scaled(&on_d, minus), force], Some(minus))]
        {
            let Some(k) = frame.body else { continue };
            for (to, force) in sums[k].iter_mut().zip(&forces) {
                let force = match sign {
                    Some(minus) => scaled(&motion.place.force_to_parent(force), minus),
                    None => *force,
                };
                *to = sum(to, &frame.placement.force_to_parent(&force));
            }
        }
        Ok(())
    }

    /// Sets V and A of the bodies of a loop.
    #[inline(always)]
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
#[inline(always)]
fn seen<T: Real>(
    motions: &[[Vector6<T>; 2]],
    shifts: &[RigidShift<T>],
    parent: Option<usize>,
    constraint: &Constraint,
    k: usize,
) -> [Vector6<T>; 2] {
    let Some(parent) = parent.filter(|_| parent != constraint.junction) else {
        return [Vector6::from_element(shifts[k].lever[0].constant(0.0)); 2];
    };
    let [velocity, acceleration] = &motions[parent];
    [shifts[k].motion_to_child(velocity), shifts[k].motion_to_child(acceleration)]
}

/// The motion of a frame relative to the body `junction`, in whose axes its pose is.
#[inline(always)]
fn frame_motion<T: Real>(
    (model, shifts): (&Model<T>, &[RigidShift<T>]),
    motions: &[[Vector6<T>; 2]],
    junction: Option<usize>,
    frame: &Frame<T>,
) -> FrameMotion<T> {
    let still = Vector6::from_element(model.gravity[0].constant(0.0));
    let mut of = FrameMotion { placement: frame.placement, velocity: still, acceleration: still };
    let mut body = frame.body.filter(|_| frame.body != junction);
    if let Some(k) = body {
        of.velocity = frame.placement.motion_to_child(&motions[k][0]);
        of.acceleration = frame.placement.motion_to_child(&motions[k][1]);
    }
    while let Some(k) = body {
        of.placement = shifts[k].compose(&of.placement);
        body = model.system.stages[k].parent.filter(|&parent| Some(parent) != junction);
    }
    of
}

#[cfg(test)]
mod tests;
