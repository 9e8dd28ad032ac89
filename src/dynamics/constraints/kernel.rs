//! Forward dynamics through connections, for states in lanes and for one state, when only the result is required.
//!
//! With the factor of M in the scratch of the [sweeps](crate::dynamics::sweeps) and the innovations e^- of the tree
//! (4.2):
//!
//! ```text
//! w_i     innovations of a unit force along row i, over its path only
//! G_ij    = sum of w_i w_j / D
//! lambda  = -(G + compliance)^-1 (sum of w e^- / D + gamma)      J qdd0 is the sum: it needs no smoother
//! e^-     + sum of w_i lambda_i                   one pass outward through the smoother (4.9 to 4.11)
//! ```
//!
//! The residual of J qdd + gamma at the resulting accelerations is corrected once if it exceeds rounding. A row that
//! moves no joint is skipped. If the other rows are dependent, or if a residual above rounding remains, the state needs
//! a fallback: [`constrained_dynamics`](super::constrained_dynamics) determines the rank.

use super::faults::IN_CALLS;
use super::gram_inverse::{NOTHING, REGULAR};
use super::solution::{NO_ROUNDING, weight};
use crate::dynamics::sweeps::{
    Forces, MOST_FORCES, Path, SweepModel, SweepScratch, accelerations_along, frame_here, innovations_along,
    motions_along, origin_along, placement_along,
};
use crate::kinematics::pair::{Pair, RelativeMotion, pair_rows};
use crate::kinematics::{Frame, FrameMotion};
use crate::model::Model;
use crate::scalar::{Real, larger};
use crate::scene::constraint::{Constraint, Constraints, Tie};
use crate::spatial::{RigidShift, angular, dot, linear, scaled};
use nalgebra::{Vector3, Vector6};
use std::ops::Range;

/// A residual of a row below this number of units in the last place of its terms is rounding and is not corrected.
const ROUNDING: f64 = 8.0;

/// Rows count as independent in this kernel only if they are independent to within the geometric tolerance times this.
const UNSURE: f64 = 10.0;

/// The connections, in the scalar of the kernel.
#[derive(Debug)]
enum LaneTie<T> {
    /// Frames on the bodies, relative to the body frames of the sweeps.
    Frames(Pair, [RigidShift<T>; 2]),
    /// Rows of joint coordinates, and their torques for a unit force.
    Joints([Option<(usize, T)>; 2]),
}

/// One connection.
#[derive(Debug)]
struct Connection<T> {
    tie: LaneTie<T>,
    rows: Range<usize>,
    path: Path,
    /// The steps of the path on which the forces act.
    ends: [Option<usize>; 2],
    /// For this connection and each later one, the joint rows that both paths share.
    shared: Vec<Vec<Range<usize>>>,
}

/// A row of a connection at one state.
#[derive(Debug, Clone, Copy)]
struct Row<T> {
    /// The forces on the bodies at the ends of its path, in the frames of the sweeps, and the sums of the absolute
    /// values of their angular and linear parts.
    forces: [[T; 6]; 2],
    sizes: [[T; 2]; 2],
    /// J' qd.
    gamma: T,
}

/// The data of the kernel for one scene and the current states; initialized with NaN.
#[derive(Debug)]
pub(crate) struct ConstraintKernel<T> {
    connections: Vec<Connection<T>>,
    nv: usize,
    rows: Vec<Row<T>>,
    /// One per step of the longest path.
    forces: Vec<Forces<T>>,
    motions: Vec<[[T; 6]; 2]>,
    accelerations: Vec<[T; 6]>,
    /// Torques of a unit force.
    torque: Vec<T>,
    /// w, (m x nv), and w / D.
    innovations: Vec<T>,
    weighted: Vec<T>,
    /// The squares of the rows of w / sqrt(D) without cancellation.
    sizes: Vec<T>,
    /// G, its diagonal scaled to one, then its Cholesky factor in the lower triangle, (m x m).
    gram: Vec<T>,
    /// The inverse square roots of the diagonal of G; zero for a row that moves no joint.
    scale: Vec<T>,
    pivot_inverses: Vec<T>,
    step: Vec<T>,
    /// Rows that depend on each other to within this, squared, need the rank by geometry.
    unsure: f64,
    /// The compliance of each row as measurement noise; zero for rigid rows.
    pub compliance: Vec<T>,
    /// The scale of the rounding errors of each row.
    terms: Vec<T>,
    /// The size of a row times this bounds the effect of the robot's weight on the row; and the same for weight and
    /// torques.
    weight: T,
    pushing: T,
    /// The largest |J qd| of a row for a state that meets the connections.
    fastest: T,
    /// lambda.
    pub forces_of_rows: Vec<T>,
    /// The number of rows that move a joint.
    pub rank: T,
    /// The largest residual of a row, rad/s^2 or m/s^2.
    pub residual: T,
}

impl<T: Real> ConstraintKernel<T> {
    pub fn new((model, sweeps): (&Model<T>, &SweepModel<T>), constraints: &Constraints) -> Self {
        let (nan, zero, m, nv) = (T::from_f64(f64::NAN), T::zero(), constraints.rows, model.nv());
        let mut connections: Vec<_> = constraints.all.iter().map(|all| Connection::new(sweeps, all)).collect();
        for at in 0..connections.len() {
            let (own, after) = (&connections[at].path, &connections[at..]);
            connections[at].shared = after.iter().map(|other| own.rows_shared(&other.path, model)).collect();
        }
        let longest = connections.iter().map(|connection| connection.path.len()).max().unwrap_or_default();
        Self {
            connections,
            nv,
            rows: vec![Row { forces: [[zero; 6]; 2], sizes: [[zero; 2]; 2], gamma: nan }; m],
            forces: vec![Forces { z: [[nan; 6]; MOST_FORCES], moments: [nan; MOST_FORCES] }; longest],
            motions: vec![[[nan; 6]; 2]; longest],
            accelerations: vec![[nan; 6]; longest],
            torque: vec![zero; nv],
            innovations: vec![zero; m * nv],
            weighted: vec![zero; m * nv],
            sizes: vec![nan; m],
            gram: vec![nan; m * m],
            scale: vec![nan; m],
            pivot_inverses: vec![nan; m],
            step: vec![nan; m],
            unsure: (UNSURE * constraints.tolerance).powi(2),
            compliance: vec![zero; m],
            terms: vec![nan; m],
            weight: T::from_f64(weight(model)),
            pushing: nan,
            fastest: nan,
            forces_of_rows: vec![nan; m],
            rank: nan,
            residual: nan,
        }
    }

    /// Computes the rows, w, G and its factor at the q of the scratch and at `qd`, and the first step of lambda.
    /// `innovations` are those of the tree. Returns a value that is negative or NaN in lanes whose rows are dependent
    /// or need the general form of the rows.
    #[inline(always)]
    pub fn begin(
        &mut self,
        scene: (&Model<T>, &SweepModel<T>),
        scratch: &SweepScratch<T>,
        (qd, tau): (&[T], &[T]),
        innovations: &[T],
    ) -> T {
        let zero = scene.0.gravity[0].constant(0.0);
        self.sizes.fill(zero);
        self.pushing = self.weight;
        for (row, &tau) in tau.iter().enumerate() {
            self.pushing = tau.abs().mul_add(scratch.pivot_inverse(row).sqrt(), self.pushing);
        }
        let speed = qd.iter().fold(zero.constant(1.0), |most, v| larger(most, v.abs()));
        self.fastest = speed * zero.constant(IN_CALLS);
        let mut regular = zero.constant(1.0);
        for at in 0..self.connections.len() {
            regular = regular.worst(self.rows_of(at, scene, scratch, qd));
            self.innovations_of(at, scene, scratch);
        }
        self.gram(zero);
        regular = regular.worst(self.scaled(zero));
        regular = regular.worst(self.factorise(zero));
        self.forces_of_rows.fill(zero);
        let Self { step, terms, rows, connections, weighted, nv, .. } = self;
        for connection in &*connections {
            for i in connection.rows.clone() {
                let own = &weighted[i * *nv..(i + 1) * *nv];
                let (mut sum, mut size) = (rows[i].gamma, rows[i].gamma.abs());
                for range in &connection.shared[0] {
                    for (&own, &e) in own[range.clone()].iter().zip(&innovations[range.clone()]) {
                        let term = own * e;
                        sum += term;
                        size += term.abs();
                    }
                }
                step[i] = sum;
                terms[i] = size;
            }
        }
        self.solve();
        regular
    }

    /// Computes the unit forces of one connection and J' qd of its rows. Returns a value that is positive where the
    /// usual form of the rows applies and the state meets them.
    #[inline(always)]
    fn rows_of(&mut self, at: usize, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>, qd: &[T]) -> T {
        let zero = scene.0.gravity[0].constant(0.0);
        let Connection { tie, rows, path, ends, .. } = &self.connections[at];
        for forces in &mut self.forces[..path.len()] {
            for i in 0..rows.len() {
                (forces.z[i], forces.moments[i]) = ([zero; 6], zero);
            }
        }
        let (pair, frames) = match tie {
            LaneTie::Joints(torques) => {
                let mut rate = zero;
                for &(row, torque) in torques.iter().flatten() {
                    rate = torque.mul_add(qd[row], rate);
                    self.torque[row] = torque;
                    let size = &mut self.sizes[rows.start];
                    *size = (torque * torque).mul_add(scratch.pivot_inverse(row), *size);
                }
                self.rows[rows.start].gamma = zero;
                return self.fastest - rate.abs();
            }
            LaneTie::Frames(pair, frames) => (*pair, frames),
        };
        motions_along(scene, scratch, (path, qd), &mut self.motions);
        let on_branch = ends.map(|end| end.and_then(|step| path.on_branch(step)));
        // The result does not depend on the distance of the mechanism from the base: both frames are located relative
        // to the point at which the branch of the second one begins.
        let origin =
            on_branch[1].map_or_else(|| frames[1].lever.into(), |step| origin_along(scene, scratch, (path, step)));
        let along = (path, &self.motions[..], &origin);
        let c = motion_of_end(scene, scratch, along, (on_branch[0], &frames[0]));
        let d = motion_of_end(scene, scratch, along, (on_branch[1], &frames[1]));
        let motion = RelativeMotion::of(&c, &d);
        let Some(of_pair) = pair_rows(pair, &motion.place, &motion.velocity) else {
            return zero.constant(-1.0);
        };
        let mut usual = of_pair.margin;
        for (i, to) in self.rows[rows.clone()].iter_mut().enumerate() {
            let force = &of_pair.of_motion[i];
            usual = usual.worst(zero.constant(IN_CALLS) - of_pair.error[i].abs());
            usual = usual.worst(self.fastest - dot(force, &motion.velocity).abs());
            to.gamma = dot(force, &motion.acceleration) + of_pair.turning[i];
            for (end, (&step, frame)) in ends.iter().zip(frames).enumerate() {
                let Some(step) = step else { continue };
                let (force, reach) = if end == 0 {
                    (*force, square(&frame.lever))
                } else {
                    let back = motion.place.force_to_parent(force);
                    (scaled(&back, zero.constant(-1.0)), square(&frame.lever) + square(&motion.place.lever))
                };
                let (moment, push) = (square(&angular(&force)), square(&linear(&force)));
                let on_body: [T; 6] = frame.force_to_parent(&force).into();
                // A force on a body reduces the force that its joint transmits.
                let on = &mut self.forces[step];
                for (z, &force) in on.z[i].iter_mut().zip(&on_body) {
                    *z -= force;
                }
                on.moments[i] += reach.mul_add(push, moment);
                to.sizes[end] = halves(&on_body);
                to.forces[end] = on_body;
            }
        }
        usual
    }

    /// w of one connection, from its unit forces, and w / D.
    #[inline(always)]
    fn innovations_of(&mut self, at: usize, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>) {
        let Self { connections, innovations, weighted, forces, torque, sizes, nv, .. } = self;
        let Connection { tie, rows, path, shared, .. } = &connections[at];
        let out = &mut innovations[rows.start * *nv..rows.end * *nv];
        let sizes = &mut sizes[rows.clone()];
        innovations_along(scene, scratch, (path, rows.len()), (forces, torque), (out, sizes));
        let width = (*nv).max(1);
        for (own, weighted) in out.chunks_exact(width).zip(weighted[rows.start * *nv..].chunks_exact_mut(width)) {
            for range in &shared[0] {
                for row in range.start..range.end {
                    weighted[row] = own[row] * scratch.pivot_inverse(row);
                }
            }
        }
        if let LaneTie::Joints(torques) = tie {
            for &(row, unit) in torques.iter().flatten() {
                torque[row] = unit.constant(0.0);
            }
        }
    }

    /// The lower triangle of G: sums over the joints that both paths share.
    #[inline(always)]
    fn gram(&mut self, zero: T) {
        let Self { connections, innovations, weighted, gram, nv, rows, .. } = self;
        let (m, nv) = (rows.len(), *nv);
        for (at, first) in connections.iter().enumerate() {
            for (second, shared) in connections[at..].iter().zip(&first.shared) {
                for j in second.rows.start..second.rows.end {
                    let second = &innovations[j * nv..(j + 1) * nv];
                    for i in first.rows.start..first.rows.end.min(j + 1) {
                        let first = &weighted[i * nv..(i + 1) * nv];
                        let mut sum = zero;
                        for range in shared {
                            for (&a, &b) in first[range.clone()].iter().zip(&second[range.clone()]) {
                                sum = a.mul_add(b, sum);
                            }
                        }
                        gram[j * m + i] = sum;
                    }
                }
            }
        }
    }

    /// Scales the diagonal of G to one. Rows that move no joint get a one on the diagonal and zeros elsewhere; they do
    /// not count for the rank.
    #[inline(always)]
    fn scaled(&mut self, zero: T) -> T {
        let Self { gram, scale, sizes, rank, compliance, unsure, .. } = self;
        let (m, one, nothing) = (scale.len(), zero.constant(1.0), zero.constant(NOTHING * NOTHING));
        let mut count = zero;
        let mut finite = one;
        for i in 0..m {
            // A negative compliance is rejected like a value that is not finite.
            finite = finite.worst((compliance[i] - compliance[i].abs()).mul_add(zero.constant(f64::MAX), one));
            let square = gram[i * m + i] + compliance[i];
            let left_out = larger(square.minus_product(nothing, sizes[i]), zero).one_if_zero();
            scale[i] = (one - left_out) * (square + left_out).sqrt().recip();
            // A very small row may be a row that moves no joint in the intended linkage.
            let margin = square.minus_product(zero.constant(*unsure), sizes[i]);
            finite = finite.worst(left_out.mul_add(sizes[i] + one, margin));
            count += one - left_out;
            finite = finite.worst(scale[i] + one);
        }
        for i in 0..m {
            for j in 0..i {
                gram[i * m + j] *= scale[i] * scale[j];
            }
            gram[i * m + i] = one;
        }
        *rank = count;
        finite
    }

    /// Replaces G by its Cholesky factor. Returns the difference of its smallest pivot and the bound above which G is
    /// regular.
    #[inline(always)]
    fn factorise(&mut self, zero: T) -> T {
        let Self { gram, pivot_inverses, unsure, .. } = self;
        let m = pivot_inverses.len();
        let mut least = zero.constant(1.0);
        for j in 0..m {
            let (before, own) = gram.split_at_mut(j * m);
            let own = &mut own[..m];
            for i in 0..j {
                let other = &before[i * m..i * m + i];
                let mut sum = own[i];
                for (&a, &b) in own[..i].iter().zip(other) {
                    sum = sum.minus_product(a, b);
                }
                own[i] = sum * pivot_inverses[i];
            }
            let mut pivot = own[j];
            for &entry in &own[..j] {
                pivot = pivot.minus_product(entry, entry);
            }
            least = least.worst(pivot);
            pivot_inverses[j] = pivot.sqrt().recip();
        }
        least - zero.constant(REGULAR.max(*unsure))
    }

    /// step := -G^-1 step.
    #[inline(always)]
    fn solve(&mut self) {
        let Self { gram, pivot_inverses, scale, step, .. } = self;
        let m = step.len();
        for i in 0..m {
            let mut sum = step[i] * scale[i];
            for (&entry, &x) in gram[i * m..i * m + i].iter().zip(&step[..i]) {
                sum = sum.minus_product(entry, x);
            }
            step[i] = sum * pivot_inverses[i];
        }
        for i in (0..m).rev() {
            let own = step[i] * pivot_inverses[i];
            for (&entry, x) in gram[i * m..i * m + i].iter().zip(&mut step[..i]) {
                *x = x.minus_product(entry, own);
            }
            step[i] = -(own * scale[i]);
        }
    }

    /// Adds the step to lambda, and its effect to the innovations of the tree.
    #[inline(always)]
    pub fn take(&mut self, innovations: &mut [T]) {
        let Self { connections, step, innovations: w, forces_of_rows, nv, .. } = self;
        for (lambda, &step) in forces_of_rows.iter_mut().zip(&*step) {
            *lambda += step;
        }
        for connection in &*connections {
            for i in connection.rows.clone() {
                let own = &w[i * *nv..(i + 1) * *nv];
                for range in &connection.shared[0] {
                    for (e, &own) in innovations[range.clone()].iter_mut().zip(&own[range.clone()]) {
                        *e = own.mul_add(step[i], *e);
                    }
                }
            }
        }
    }

    /// The residuals of the rows at these accelerations, and the step that corrects them. Returns the margins to the
    /// bound on rounding and to the bound on what can be rounding; negative where a residual exceeds the bound.
    #[inline(always)]
    pub fn look(&mut self, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>, qdd: &[T]) -> [T; 2] {
        let zero = scene.0.gravity[0].constant(0.0);
        let Self {
            connections,
            rows,
            accelerations,
            step,
            compliance,
            terms,
            forces_of_rows,
            scale,
            sizes,
            pushing,
            residual,
            ..
        } = self;
        let (mut most, mut near, mut far) = (zero, zero.constant(1.0), zero.constant(1.0));
        // The row of bodies in static equilibrium is a sum of rounding errors. It is compared with the forces that act
        // on the bodies: sqrt(G_jj) |lambda_j| for connection forces.
        let mut acting = *pushing;
        for (&lambda, &scale) in forces_of_rows.iter().zip(&*scale) {
            // Skipped rows contribute zero.
            acting = lambda.abs().mul_add((scale + scale.one_if_zero()).recip(), acting);
        }
        for connection in &*connections {
            if matches!(connection.tie, LaneTie::Frames(..)) {
                accelerations_along(scene, scratch, (&connection.path, qdd), accelerations);
            }
            for i in connection.rows.clone() {
                let row = &rows[i];
                let (mut sum, mut size) = (row.gamma, row.gamma.abs());
                let given_way = compliance[i] * forces_of_rows[i];
                match &connection.tie {
                    LaneTie::Frames(..) => {
                        for (end, &step) in connection.ends.iter().enumerate() {
                            let Some(step) = step else { continue };
                            let motion = &accelerations[step];
                            for (&a, &force) in motion.iter().zip(&row.forces[end]) {
                                sum = a.mul_add(force, sum);
                            }
                            for (&a, &force) in halves(motion).iter().zip(&row.sizes[end]) {
                                size = a.mul_add(force, size);
                            }
                        }
                    }
                    LaneTie::Joints(torques) => {
                        for &(row, torque) in torques.iter().flatten() {
                            let term = qdd[row] * torque;
                            sum += term;
                            size += term.abs();
                        }
                    }
                }
                most = larger(most, sum.abs());
                sum += given_way;
                terms[i] = larger(terms[i], size + given_way.abs());
                step[i] = sum;
                let unit = terms[i] * zero.constant(f64::EPSILON);
                near = near.worst(unit.mul_add(zero.constant(ROUNDING), -sum.abs()));
                let unit = sizes[i].sqrt().mul_add(acting, terms[i]) * zero.constant(f64::EPSILON);
                far = far.worst(unit.mul_add(zero.constant(NO_ROUNDING), -sum.abs()));
            }
        }
        *residual = most;
        self.solve();
        [near, far]
    }

    /// Sets the step to zero where `kept` is zero.
    #[inline(always)]
    pub fn mask(&mut self, kept: T) {
        for step in &mut self.step {
            *step *= kept;
        }
    }
}

impl<T: Real> Connection<T> {
    fn new(sweeps: &SweepModel<T>, constraint: &Constraint) -> Self {
        let ends = constraint.tie.bodies();
        let act_on: Vec<usize> = ends.into_iter().flatten().collect();
        let path = Path::new(sweeps, (&constraint.path, &constraint.branches), &act_on);
        let ends = ends.map(|end| end.and_then(|body| path.step_of(body)));
        let tie = match &constraint.tie {
            Tie::Frames { pair, frames: [c, d] } => {
                let here = |frame: &Frame<f64>, step: Option<usize>| {
                    let placement = frame.placement.cast();
                    step.map_or(placement, |step| frame_here(sweeps, (&path, step), &placement))
                };
                LaneTie::Frames(*pair, [here(c, ends[0]), here(d, ends[1])])
            }
            Tie::Coordinates { first, second, multiplier, .. } => {
                LaneTie::Joints([Some((first.v, T::one())), second.map(|second| (second.v, T::from_f64(-multiplier)))])
            }
        };
        Self { tie, rows: constraint.rows(), path, ends, shared: Vec::new() }
    }
}

/// A path, the motions of its bodies, and the origin of the poses.
type Along<'a, T> = (&'a Path, &'a [[[T; 6]; 2]], &'a [T; 3]);

/// The motion of the frame at an end of a path relative to the body where the branches meet, from the motions of the
/// bodies on the path. Without a step on a branch, the frame is on that body.
#[inline(always)]
fn motion_of_end<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    (path, motions, from): Along<'_, T>,
    (step, frame): (Option<usize>, &RigidShift<T>),
) -> FrameMotion<T> {
    let Some(step) = step else {
        let none = Vector6::from_element(scene.0.gravity[0].constant(0.0));
        let mut placement = *frame;
        for (lever, &from) in placement.lever.iter_mut().zip(from) {
            *lever -= from;
        }
        return FrameMotion { placement, velocity: none, acceleration: none };
    };
    let [velocity, acceleration] = &motions[step];
    FrameMotion {
        placement: placement_along(scene, scratch, (path, step), (frame, from)),
        velocity: frame.motion_to_child(&Vector6::from(*velocity)),
        acceleration: frame.motion_to_child(&Vector6::from(*acceleration)),
    }
}

#[inline(always)]
fn square<T: Real>(v: &Vector3<T>) -> T {
    v[0].mul_add(v[0], v[1].mul_add(v[1], v[2] * v[2]))
}

/// The sums of the absolute values of the angular and the linear part.
#[inline(always)]
fn halves<T: Real>(v: &[T; 6]) -> [T; 2] {
    [v[0].abs() + v[1].abs() + v[2].abs(), v[3].abs() + v[4].abs() + v[5].abs()]
}
