//! J, and the derivatives of the rows of the connections and of their forces, as matrices.
//!
//! All motions of a connection between the frames C and D are in the axes of C, at its origin, so that they are neither
//! propagated nor turned. With the unit twists S of the degrees of freedom of its loop, V and A of the bodies relative
//! to the body where the branches meet, and the forces n, c and F of [`products`](super::products) at an end with
//! velocity `V_e`, a joint with `V_p` and `A_p` of its parent and V of its body has
//!
//! ```text
//! c' = c + (V_e - V_p) x* F,    J = S* F,    by_q = S* (n - V_p x* c' - A_p x* F),    by_qd = S* (c' - V x* F)
//! d(J* lambda)/dq, row of S_i:  S* (n - S_i x* F) outboard of joint i on its branch, S* n elsewhere
//! ```
//!
//! for a unit multiplier of each row, and in the last line for the multipliers lambda at rest with the acceleration
//! `S_i`.

use super::RowFault;
use crate::kinematics::pair::{Pair, RelativeMotion, pair_cotangents, place_between};
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real, larger};
use crate::scene::constraint::{Constraint, Constraints, Coupled, Tie};
use crate::spatial::{RigidShift, cross_force, cross_motion, dot, scaled, scaled_add, sum};
use nalgebra::Vector6;
use std::ops::Range;

/// The matrices at one motion; initialized with NaN, and with zeros where they have no entries.
#[derive(Debug)]
pub(crate) struct RowMatrices<T: Real> {
    loops: Vec<Loop<T>>,
    /// J, and the derivatives of J qdd + J' qd by q, in its tangent space, and by qd: (m x nv), row by row.
    jacobian: Vec<T>,
    pub by_q: Vec<T>,
    pub by_qd: Vec<T>,
    /// d(J* lambda)/dq, (nv x nv), row by row.
    of_forces: Vec<T>,
    solutions: RowSolutions<T>,
    rest: Vec<T>,
    unit: Vec<T>,
    nv: usize,
}

/// J M^-1 and G^-1 J M^-1, (m x nv), row by row.
#[derive(Debug)]
pub(crate) struct RowSolutions<T> {
    pub response: Vec<T>,
    pub solved: Vec<T>,
}

/// A connection and the degrees of freedom that move its rows.
#[derive(Debug)]
struct Loop<T: Real> {
    index: usize,
    rows: Range<usize>,
    columns: Vec<usize>,
    tie: LoopTie<T>,
}

#[derive(Debug)]
enum LoopTie<T: Real> {
    Frames(Box<Frames<T>>),
    Joints(Coupled),
}

/// A connection of two frames.
#[derive(Debug)]
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

impl<T: Real> RowMatrices<T> {
    pub fn new((model, constraints): (&Model<T>, &Constraints)) -> Self {
        let (nan, zero, m, nv) = (T::from_f64(f64::NAN), T::zero(), constraints.rows, model.nv());
        let matrix = || vec![zero; m * nv];
        Self {
            loops: constraints.all.iter().enumerate().map(|(i, of)| Loop::new(model, i, of)).collect(),
            jacobian: matrix(),
            by_q: matrix(),
            by_qd: matrix(),
            of_forces: vec![zero; nv * nv],
            solutions: RowSolutions { response: vec![nan; m * nv], solved: vec![nan; m * nv] },
            rest: vec![zero; nv],
            unit: vec![zero; m.max(nv)],
            nv,
        }
    }

    /// Computes J, its changes and those of J* `forces` at the motion (q, qd, qdd), with phi of every body at q.
    #[inline(always)]
    pub fn compute(
        &mut self,
        model: &Model<T>,
        shifts: &[RigidShift<T>],
        state: (&[T], &[T], &[T]),
        forces: &[T],
    ) -> Result<(), RowFault> {
        let (zero, one) = (model.gravity[0].constant(0.0), model.gravity[0].constant(1.0));
        let Self { loops, jacobian, by_q, by_qd, of_forces, rest, unit, nv, .. } = self;
        of_forces.fill(zero);
        for Loop { index, rows, columns, tie } in loops {
            for i in rows.clone() {
                for &column in &*columns {
                    for matrix in [&mut *jacobian, by_q, by_qd] {
                        matrix[i * *nv + column] = zero;
                    }
                }
            }
            let own = &forces[rows.clone()];
            match tie {
                LoopTie::Joints(coupled) => {
                    let row = rows.start * *nv..(rows.start + 1) * *nv;
                    coupled.add_torques(state.0, one, &mut jacobian[row.clone()]);
                    coupled.add_acceleration_gradient(state, one, [&mut by_q[row.clone()], &mut by_qd[row.clone()]]);
                    for &column in &*columns {
                        unit[column] = one;
                        let to = &mut of_forces[column * *nv..][..*nv];
                        // The gradient by velocities is zero at rest.
                        let at_rest = (state.0, &rest[..], &unit[..*nv]);
                        coupled.add_acceleration_gradient(at_rest, own[0], [to, &mut by_qd[row.clone()]]);
                        unit[column] = zero;
                    }
                }
                LoopTie::Frames(frames) => {
                    frames.follow(shifts, (state.1, state.2), zero);
                    let failed = || RowFault::NoDirection(*index);
                    for i in rows.clone() {
                        unit[i] = one;
                        let row = i * *nv..(i + 1) * *nv;
                        let to = [&mut *jacobian, by_q, by_qd].map(|matrix| &mut matrix[row.clone()]);
                        let done = frames.row(&unit[rows.clone()], to);
                        unit[i] = zero;
                        done.ok_or_else(failed)?;
                    }
                    frames.add_forces(own, *nv, of_forces).ok_or_else(failed)?;
                }
            }
        }
        Ok(())
    }

    /// Subtracts d(J* lambda)/dq from a matrix (nv x nv).
    #[inline(always)]
    pub fn subtract_forces<C: ColumnsOf<T>>(&self, by_q: &mut [C::Entry]) {
        for (entry, &of_forces) in by_q.iter_mut().zip(&self.of_forces) {
            *entry = C::kept(C::taken(*entry) - of_forces);
        }
    }

    /// Computes J M^-1 from M^-1, and writes the largest entry of each row of M^-1 to `largest`. The caller computes
    /// G^-1 J M^-1.
    #[inline(always)]
    pub fn respond<C: ColumnsOf<T>>(&mut self, inverse: &[C::Entry], largest: &mut [T]) -> &mut RowSolutions<T> {
        let Self { loops, jacobian, solutions, nv, .. } = self;
        let response = &mut solutions.response;
        let nv = *nv;
        for (largest, row) in largest.iter_mut().zip(inverse.chunks_exact(nv.max(1))) {
            *largest = C::taken(row[0]).abs();
            for &entry in &row[1..] {
                *largest = larger(*largest, C::taken(entry).abs());
            }
        }
        for Loop { rows, columns, .. } in loops {
            for i in rows.clone() {
                let (row, to) = (&jacobian[i * nv..][..nv], &mut response[i * nv..][..nv]);
                for (at, &k) in columns.iter().enumerate() {
                    for (to, &entry) in to.iter_mut().zip(&inverse[k * nv..][..nv]) {
                        let before = if at == 0 { to.constant(0.0) } else { *to };
                        *to = row[k].mul_add(C::taken(entry), before);
                    }
                }
            }
        }
        solutions
    }

    /// Replaces M^-1 by Mc = M^-1 - (J M^-1)* G^-1 J M^-1.
    #[inline(always)]
    pub fn reduce<C: ColumnsOf<T>>(&self, inverse: &mut [C::Entry]) {
        let Self { solutions: RowSolutions { response, solved }, nv, .. } = self;
        for (i, row) in inverse.chunks_exact_mut((*nv).max(1)).enumerate() {
            for (of, solved) in response.chunks_exact((*nv).max(1)).zip(solved.chunks_exact((*nv).max(1))) {
                for (entry, &solved) in row.iter_mut().zip(solved) {
                    *entry = C::kept(C::taken(*entry).minus_product(of[i], solved));
                }
            }
        }
    }

    /// Subtracts N times the changes of the rows from the matrices by q and by qd, (nv x nv) each.
    #[inline(always)]
    pub fn subtract_changes<C: ColumnsOf<T>>(&self, both: &mut [C::Entry]) {
        let Self { loops, by_q, by_qd, solutions: RowSolutions { solved, .. }, nv, .. } = self;
        let (of_q, of_qd) = both.split_at_mut(nv * nv);
        for (matrix, changes) in [(of_q, by_q), (of_qd, by_qd)] {
            for (i, row) in matrix.chunks_exact_mut((*nv).max(1)).enumerate() {
                for Loop { rows, columns, .. } in loops {
                    for r in rows.clone() {
                        let (factor, changes) = (solved[r * nv + i], &changes[r * nv..][..*nv]);
                        for &column in columns {
                            row[column] = C::kept(C::taken(row[column]).minus_product(factor, changes[column]));
                        }
                    }
                }
            }
        }
    }
}

impl<T: Real> Loop<T> {
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
    /// Poses, S, V and A at a motion.
    #[inline(always)]
    fn follow(&mut self, shifts: &[RigidShift<T>], (qd, qdd): (&[T], &[T]), zero: T) {
        let Self { placements, bodies, of_c, motion, ends, .. } = self;
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

    /// Adds J and the gradients of the rows with these multipliers. None for a rod without a direction.
    #[inline(always)]
    fn row(&self, multipliers: &[T], [jacobian, by_q, by_qd]: [&mut [T]; 3]) -> Option<()> {
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
                    jacobian[first_row + i] += dot(axis, &f);
                    by_q[first_row + i] += dot(axis, &along);
                    by_qd[first_row + i] += dot(axis, &moving);
                }
            }
        }
        Some(())
    }

    /// Adds d(J* lambda)/dq of these multipliers to a matrix (nv x nv). None for a rod without a direction.
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
