//! The derivatives of the rows of one connection and of their forces, in closed form in the axes of its frame C.
//!
//! For multipliers r of the rows of a connection between the frames C and D, r* (J qdd + J' qd) is a function of the
//! pose of C in D, of the relative velocity V and of the relative acceleration V', all in the axes of C. Its cotangents
//! are forces: n by a twist of C relative to D, v by V, and F = E* r by V'. With V = `V_C` - `V_D` and V' = `A_C` -
//! `A_D` + V x `V_D`, those of the motions of the two frames are
//!
//! ```text
//! of V_C: c = v + V_D x* F      of V_D: d = -c - V x* F      of A_C: F      of A_D: -F
//! of a twist of C: n - V_D x* d + A_D x* F                   of a twist of D: the opposite
//! ```
//!
//! All motions are in the axes of C, at its origin, so that these forces are neither propagated nor turned. With the
//! unit twists S of the degrees of freedom of the loop, V and A of the bodies relative to the body where the branches
//! meet, and the forces n, c and F at an end with velocity `V_e`, a joint with `V_p` and `A_p` of its parent and V of
//! its body has
//!
//! ```text
//! c' = c + (V_e - V_p) x* F,    J* r = S* F,    by_q = S* (n - V_p x* c' - A_p x* F),    by_qd = S* (c' - V x* F)
//! d(J* r)/dq, row of S_i:  S* (n - S_i x* F) outboard of joint i on its branch, S* n elsewhere
//! ```
//!
//! The last line is for the motion at rest with the acceleration `S_i`.

use super::RowFault;
use crate::kinematics::pair::{Pair, RelativeMotion, pair_cotangents, place_between};
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::constraint::{Constraint, Constraints, Coupled, Tie};
use crate::spatial::{RigidShift, cross_force, cross_motion, dot, scaled, scaled_add, sum};
use nalgebra::Vector6;
use std::ops::Range;

/// A connection and the degrees of freedom that move its rows; motions are initialized with NaN.
#[derive(Debug, Clone)]
pub(super) struct Loop<T: Real> {
    index: usize,
    pub rows: Range<usize>,
    pub columns: Vec<usize>,
    tie: LoopTie<T>,
}

#[derive(Debug, Clone)]
enum LoopTie<T: Real> {
    Frames(Box<Frames<T>>),
    Joints(Coupled),
}

/// A connection of two frames.
#[derive(Debug, Clone)]
struct Frames<T: Real> {
    pair: Pair,
    /// C and D on their bodies.
    placements: [RigidShift<T>; 2],
    /// The bodies of the branch of C, then those of D, outermost first.
    bodies: Vec<LoopBody<T>>,
    of_c: usize,
    motion: RelativeMotion<T>,
    /// V and A of C and of D.
    ends: [[Vector6<T>; 2]; 2],
}

/// A body of a loop.
#[derive(Debug, Clone)]
struct LoopBody<T: Real> {
    body: usize,
    first_row: usize,
    /// H of each degree of freedom in the frame of the body, and S.
    hinges: Vec<Vector6<T>>,
    axes: Vec<Vector6<T>>,
    /// The pose of C in the frame of the body.
    place: RigidShift<T>,
    /// V and A of the parent, and V.
    of_parent: [Vector6<T>; 2],
    velocity: Vector6<T>,
}

impl<T: Real> Loop<T> {
    /// The loops of all connections.
    pub fn all((model, constraints): (&Model<T>, &Constraints)) -> Vec<Self> {
        constraints.all.iter().enumerate().map(|(index, of)| Self::new(model, index, of)).collect()
    }

    fn new(model: &Model<T>, index: usize, constraint: &Constraint) -> Self {
        let tie = match &constraint.tie {
            Tie::Coordinates(coupled) => LoopTie::Joints(*coupled),
            Tie::Frames { pair, frames } => {
                let mut bodies = Vec::new();
                let [of_c, _] = frames.map(|frame| {
                    let mut body = frame.body;
                    while let Some(k) = body.filter(|_| body != constraint.junction) {
                        bodies.push(LoopBody::new(model, k));
                        body = model.system.stages[k].parent;
                    }
                    bodies.len()
                });
                let still = [Vector6::from_element(T::from_f64(f64::NAN)); 2];
                LoopTie::Frames(Box::new(Frames {
                    pair: *pair,
                    placements: frames.map(|frame| frame.placement.cast()),
                    bodies,
                    of_c,
                    motion: RelativeMotion {
                        place: RigidShift::identity(),
                        velocity: still[0],
                        acceleration: still[0],
                    },
                    ends: [still; 2],
                }))
            }
        };
        Self { index, rows: constraint.rows(), columns: constraint.columns(model), tie }
    }

    /// Poses, S, V and A at a motion (q, qd, qdd), with phi of every body at q.
    #[inline(always)]
    pub fn follow(&mut self, shifts: &[RigidShift<T>], (_, qd, qdd): (&[T], &[T], &[T])) {
        if let LoopTie::Frames(frames) = &mut self.tie {
            frames.follow(shifts, (qd, qdd));
        }
    }

    /// Adds the gradients of r* (J qdd + J' qd) by q, in its tangent space, and by qd, (nv) each, and J* r if it is
    /// requested, for the multipliers r of its own rows, at the motion of [`Loop::follow`].
    #[inline(always)]
    pub fn add_row(
        &self,
        state: (&[T], &[T], &[T]),
        multipliers: &[T],
        [by_q, by_qd]: [&mut [T]; 2],
        jacobian: Option<&mut [T]>,
    ) -> Result<(), RowFault> {
        match &self.tie {
            LoopTie::Frames(frames) => frames.add_row(multipliers, [by_q, by_qd], jacobian).ok_or(self.undirected()),
            LoopTie::Joints(coupled) => {
                coupled.add_acceleration_gradient(state, multipliers[0], [by_q, by_qd]);
                if let Some(jacobian) = jacobian {
                    coupled.add_torques(state.0, multipliers[0], jacobian);
                }
                Ok(())
            }
        }
    }

    /// Adds d(J* r)/dq of the multipliers r of its own rows to a matrix (nv x nv), row by row.
    #[inline(always)]
    pub fn add_forces(&self, q: &[T], multipliers: &[T], nv: usize, out: &mut [T]) -> Result<(), RowFault> {
        match &self.tie {
            LoopTie::Frames(frames) => frames.add_forces(multipliers, nv, out).ok_or(self.undirected()),
            LoopTie::Joints(coupled) => {
                if let Some((v, curvature)) = coupled.curvature(q) {
                    let entry = &mut out[v * nv + v];
                    *entry = entry.minus_product(multipliers[0], curvature);
                }
                Ok(())
            }
        }
    }

    fn undirected(&self) -> RowFault {
        RowFault::NoDirection(self.index)
    }
}

impl<T: Real> LoopBody<T> {
    fn new(model: &Model<T>, body: usize) -> Self {
        let (stage, nan) = (&model.system.stages[body], Vector6::from_element(T::from_f64(f64::NAN)));
        let hinges: Vec<_> = (0..stage.rows.count()).map(|row| stage.rows.row(row).to_column()).collect();
        Self {
            body,
            first_row: stage.first_row,
            axes: vec![nan; hinges.len()],
            hinges,
            place: RigidShift::identity(),
            of_parent: [nan; 2],
            velocity: nan,
        }
    }
}

impl<T: Real> Frames<T> {
    #[inline(always)]
    fn follow(&mut self, shifts: &[RigidShift<T>], (qd, qdd): (&[T], &[T])) {
        let Self { placements, bodies, of_c, motion, ends, .. } = self;
        let zero = placements[0].lever[0].constant(0.0);
        let still = Vector6::from_element(zero);
        let (of_c, of_d) = bodies.split_at_mut(*of_c);
        let mut poses = *placements;
        for (branch, pose) in [&mut *of_c, &mut *of_d].into_iter().zip(&mut poses) {
            for of in branch {
                of.place = *pose;
                *pose = shifts[of.body].compose(pose);
            }
        }
        let place = place_between(&poses[0], &poses[1]);
        for of in &mut *of_d {
            of.place = of.place.compose(&place);
        }
        for (branch, end) in [of_c, of_d].into_iter().zip(&mut *ends) {
            let [mut velocity, mut acceleration] = [still; 2];
            for of in branch.iter_mut().rev() {
                of.of_parent = [velocity, acceleration];
                let (mut turning, mut more) = (still, still);
                for (i, (axis, hinge)) in of.axes.iter_mut().zip(&of.hinges).enumerate() {
                    *axis = of.place.motion_to_child(hinge);
                    turning = scaled_add(axis, qd[of.first_row + i], &turning);
                    more = scaled_add(axis, qdd[of.first_row + i], &more);
                }
                velocity = sum(&velocity, &turning);
                acceleration = sum(&acceleration, &sum(&more, &cross_motion(&velocity, &turning)));
                of.velocity = velocity;
            }
            *end = [velocity, acceleration];
        }
        let [of_c, of_d] = ends;
        let minus = zero.constant(-1.0);
        let velocity = scaled_add(&of_d[0], minus, &of_c[0]);
        let apart = scaled_add(&of_d[1], minus, &of_c[1]);
        *motion = RelativeMotion { place, velocity, acceleration: sum(&apart, &cross_motion(&velocity, &of_d[0])) };
    }

    /// The two branches.
    #[inline(always)]
    fn branches(&self) -> [&[LoopBody<T>]; 2] {
        let (of_c, of_d) = self.bodies.split_at(self.of_c);
        [of_c, of_d]
    }

    /// None for a rod without a direction.
    #[inline(always)]
    fn add_row(&self, multipliers: &[T], [by_q, by_qd]: [&mut [T]; 2], mut jacobian: Option<&mut [T]>) -> Option<()> {
        let Self { pair, motion, ends, .. } = self;
        let [by_place, by_velocity, force] = pair_cotangents(*pair, motion, multipliers)?;
        let minus = force[0].constant(-1.0);
        let [_, [seen, felt]] = ends;
        let on_c = sum(&by_velocity, &cross_force(seen, &force));
        let on_d = scaled(&sum(&on_c, &cross_force(&motion.velocity, &force)), minus);
        let turning = sum(&scaled_add(&cross_force(seen, &on_d), minus, &by_place), &cross_force(felt, &force));
        let of_ends = [(turning, on_c, force), (scaled(&turning, minus), on_d, scaled(&force, minus))];
        for ((branch, [end, _]), (n, c, f)) in self.branches().into_iter().zip(ends).zip(of_ends) {
            for LoopBody { first_row, axes, of_parent: [inboard, acceleration], velocity, .. } in branch {
                let c = sum(&c, &cross_force(&scaled_add(inboard, minus, end), &f));
                let turned = sum(&cross_force(inboard, &c), &cross_force(acceleration, &f));
                let along = scaled_add(&turned, minus, &n);
                let moving = scaled_add(&cross_force(velocity, &f), minus, &c);
                for (i, axis) in axes.iter().enumerate() {
                    if let Some(jacobian) = &mut jacobian {
                        jacobian[first_row + i] += dot(axis, &f);
                    }
                    by_q[first_row + i] += dot(axis, &along);
                    by_qd[first_row + i] += dot(axis, &moving);
                }
            }
        }
        Some(())
    }

    /// None for a rod without a direction.
    #[inline(always)]
    fn add_forces(&self, multipliers: &[T], nv: usize, out: &mut [T]) -> Option<()> {
        let like = self.motion.velocity[0];
        let (still, minus) = (Vector6::from_element(like.constant(0.0)), like.constant(-1.0));
        for (from, branch) in self.branches().into_iter().enumerate() {
            for (inboard, LoopBody { first_row, axes, .. }) in branch.iter().enumerate() {
                for (i, own) in axes.iter().enumerate() {
                    let (acceleration, felt) = if from == 0 { (*own, still) } else { (scaled(own, minus), *own) };
                    let motion = RelativeMotion { place: self.motion.place, velocity: still, acceleration };
                    let [by_place, _, force] = pair_cotangents(self.pair, &motion, multipliers)?;
                    let turning = sum(&by_place, &cross_force(&felt, &force));
                    let of_ends = [(turning, force), (scaled(&turning, minus), scaled(&force, minus))];
                    let row = &mut out[(first_row + i) * nv..][..nv];
                    for (to, (other, (n, f))) in self.branches().into_iter().zip(of_ends).enumerate() {
                        let moved = scaled_add(&cross_force(own, &f), minus, &n);
                        for (at, LoopBody { first_row, axes, .. }) in other.iter().enumerate() {
                            let along = if to == from && at < inboard { &moved } else { &n };
                            for (j, axis) in axes.iter().enumerate() {
                                row[first_row + j] += dot(axis, along);
                            }
                        }
                    }
                }
            }
        }
        Some(())
    }
}
