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

mod ends;
mod gram;
mod projection;

use super::faults::IN_CALLS;
use super::solution::{NO_ROUNDING, weight};
use crate::dynamics::sweeps::{
    Forces, MOST_FORCES, Path, PathRows, SweepModel, SweepScratch, WhitenedRows, accelerations_along, frame_here,
    motions_along, point_along,
};
use crate::kinematics::Frame;
use crate::kinematics::pair::{Pair, PairRows, RelativeMotion};
use crate::model::Model;
use crate::scalar::{Real, larger, largest_of};
use crate::scene::constraint::{Constraint, Constraints, Tie};
use crate::spatial::{RigidShift, angular, cross, dot, linear, scaled};
use ends::{axis_of, less, relative_motion, set_anchored};
use nalgebra::Vector3;

pub(crate) use projection::Residuals;

/// A residual of a row below this number of units in the last place of its terms is rounding and is not corrected.
const ROUNDING: f64 = 8.0;

/// Rows count as independent in this kernel only if they are independent to within the geometric tolerance times this.
const UNSURE: f64 = 10.0;

/// The connections, in the scalar of the kernel.
#[derive(Debug)]
enum LaneTie<T> {
    /// Frames on the bodies, relative to the body frames of the sweeps.
    Frames(Pair, [RigidShift<T>; 2]),
    /// A point of a body on a point of the base: the frame on the body, and the point of the base.
    Anchored(RigidShift<T>, [T; 3]),
    /// Rows of joint coordinates, and their torques for a unit force.
    Joints([Option<(usize, T)>; 2], Followed<T>),
}

/// The error of a row of joint coordinates: the sum of coordinates times factors, minus an offset.
#[derive(Debug)]
struct Followed<T> {
    coordinates: [Option<(usize, T)>; 2],
    offset: T,
}

/// One connection.
#[derive(Debug)]
struct Connection<T> {
    tie: LaneTie<T>,
    /// The steps of its path on which the forces act.
    ends: [Option<usize>; 2],
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
    /// The error, m or rad, and its time derivative J qd.
    error: T,
    rate: T,
}

/// The data of the kernel for one scene and the current states; initialized with NaN.
#[derive(Debug)]
pub(crate) struct ConstraintKernel<T> {
    connections: Vec<Connection<T>>,
    rows: Vec<Row<T>>,
    /// W, and G, then its factor L D L*; one path per connection.
    whitened: WhitenedRows<T>,
    /// One per step of the longest path.
    forces: Vec<Forces<T>>,
    motions: Vec<[[T; 6]; 2]>,
    accelerations: Vec<[T; 6]>,
    /// Torques of a unit force.
    torque: Vec<T>,
    /// One for each row, zero for a row that moves no joint; and the diagonal of G, one for such rows.
    kept: Vec<T>,
    diagonal: Vec<T>,
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
    /// The largest error of a row, m or rad, and the largest |J qd| for joint velocities of at most 1, that count as
    /// meeting the connections.
    pub slack: f64,
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
        let all = constraints.all.iter();
        let (connections, paths): (Vec<_>, Vec<_>) = all
            .map(|of| {
                let (connection, path) = Connection::new(sweeps, of);
                (connection, (path, of.rows()))
            })
            .unzip();
        let whitened = WhitenedRows::new(model, paths);
        let longest = whitened.longest();
        Self {
            connections,
            whitened,
            rows: vec![Row { forces: [[zero; 6]; 2], sizes: [[zero; 2]; 2], gamma: nan, error: nan, rate: nan }; m],
            forces: vec![Forces { z: [[nan; 6]; MOST_FORCES], moments: [nan; MOST_FORCES] }; longest],
            motions: vec![[[nan; 6]; 2]; longest],
            accelerations: vec![[nan; 6]; longest],
            torque: vec![zero; nv],
            kept: vec![nan; m],
            diagonal: vec![nan; m],
            pivot_inverses: vec![nan; m],
            step: vec![nan; m],
            unsure: (UNSURE * constraints.tolerance).powi(2),
            compliance: vec![zero; m],
            terms: vec![nan; m],
            weight: T::from_f64(weight(model)),
            pushing: nan,
            slack: IN_CALLS,
            fastest: nan,
            forces_of_rows: vec![nan; m],
            rank: nan,
            residual: nan,
        }
    }

    /// Computes the rows, w, G and its factor at the q of the scratch and at `qd`. Returns a value that is negative or
    /// NaN in lanes whose rows are dependent or need the general form of the rows.
    #[inline(always)]
    pub fn factor(&mut self, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>, qd: &[T]) -> T {
        let zero = scene.0.gravity[0].constant(0.0);
        self.whitened.sizes.fill(zero);
        let speed = largest_of(qd, zero.constant(1.0));
        self.fastest = speed * zero.constant(self.slack);
        let mut regular = zero.constant(1.0);
        for at in 0..self.connections.len() {
            regular = regular.worst(self.rows_of(at, scene, scratch, qd));
            self.whitened.innovations_of(at, scene, scratch, (&mut self.forces, &self.torque));
            if let LaneTie::Joints(torques, _) = &self.connections[at].tie {
                for &(row, unit) in torques.iter().flatten() {
                    self.torque[row] = unit.constant(0.0);
                }
            }
        }
        self.whitened.multiply(zero);
        regular = regular.worst(self.prepare(zero));
        regular.worst(self.factorise(zero))
    }

    /// The first step of lambda, from the innovations of the tree. The scales of rounding errors are needed only if the
    /// residual [is looked at](ConstraintKernel::look).
    #[inline(always)]
    pub fn first_step(&mut self, scratch: &SweepScratch<T>, tau: &[T], innovations: &[T], is_watched: bool) {
        let zero = self.weight.constant(0.0);
        self.forces_of_rows.fill(zero);
        let Self { step, terms, rows, whitened, pushing, weight, .. } = self;
        if is_watched {
            *pushing = *weight;
            for (row, &tau) in tau.iter().enumerate() {
                *pushing = tau.abs().mul_add(scratch.pivot_inverse(row).sqrt(), *pushing);
            }
        }
        for of in &whitened.paths {
            for i in of.rows.clone() {
                let gamma = rows[i].gamma;
                if is_watched {
                    (step[i], terms[i]) = whitened.times(of, i, innovations, (gamma, gamma.abs()));
                } else {
                    step[i] = whitened.product(of, i, innovations, gamma);
                }
            }
        }
        self.solve();
    }

    /// Computes the unit forces of one connection and J' qd of its rows. Returns a value that is positive where the
    /// usual form of the rows applies and the state meets them.
    #[inline(always)]
    fn rows_of(&mut self, at: usize, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>, qd: &[T]) -> T {
        let zero = scene.0.gravity[0].constant(0.0);
        let Connection { tie, ends } = &self.connections[at];
        let PathRows { path, rows, .. } = &self.whitened.paths[at];
        // The forces on other bodies of the path are set by the first that they receive.
        for &step in ends.iter().flatten() {
            let forces = &mut self.forces[step];
            for i in 0..rows.len() {
                (forces.z[i], forces.moments[i]) = ([zero; 6], zero);
            }
        }
        let frames = match tie {
            LaneTie::Anchored(frame, anchor) => {
                let step = ends[0].unwrap_or_default();
                let point = point_along(scene, scratch, path, *anchor);
                motions_along(scene, scratch, (path, qd), &mut self.motions);
                let own = &mut self.rows[rows.clone()];
                set_anchored((frame, &point), &self.motions[step], own);
                let mut usual = zero.constant(1.0);
                let on = &mut self.forces[step];
                let apart = less(&frame.lever, &point);
                let reach = square(&frame.lever) + square(&apart);
                for (i, to) in own.iter_mut().enumerate() {
                    usual = usual.worst(zero.constant(self.slack) - to.error.abs());
                    usual = usual.worst(self.fastest - to.rate.abs());
                    let force = axis_of(frame, i);
                    let [x, y, z] = cross(&point.into(), &force).into();
                    to.forces[0] = [x, y, z, force[0], force[1], force[2]];
                    to.sizes[0] = halves(&to.forces[0]);
                    // A force on a body reduces the force that its joint transmits.
                    on.z[i] = [-x, -y, -z, -force[0], -force[1], -force[2]];
                    on.moments[i] = reach;
                }
                return usual;
            }
            LaneTie::Joints(torques, _) => {
                for &(row, torque) in torques.iter().flatten() {
                    self.torque[row] = torque;
                    let size = &mut self.whitened.sizes[rows.start];
                    *size = (torque * torque).mul_add(scratch.pivot_inverse(row), *size);
                }
                let rate = joints_rate(torques, qd, zero);
                (self.rows[rows.start].gamma, self.rows[rows.start].rate) = (zero, rate);
                return self.fastest - rate.abs();
            }
            LaneTie::Frames(_, frames) => frames,
        };
        let Some((motion, of_pair)) =
            relative_motion((&self.connections[at], path), scene, scratch, qd, &mut self.motions)
        else {
            return zero.constant(-1.0);
        };
        let mut usual = of_pair.margin;
        for (i, to) in self.rows[rows.clone()].iter_mut().enumerate() {
            let force = &of_pair.of_motion[i];
            to.set(&motion, &of_pair, i);
            usual = usual.worst(zero.constant(self.slack) - to.error.abs());
            usual = usual.worst(self.fastest - to.rate.abs());
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

    /// The next accelerations meet J qdd = 0, as at rest.
    #[inline(always)]
    pub fn rest(&mut self) {
        for row in &mut self.rows {
            row.gamma = row.gamma.constant(0.0);
        }
    }

    /// The last step of lambda.
    pub fn step(&self) -> &[T] {
        &self.step
    }

    /// Adds the step to lambda, and its effect to the innovations of the tree.
    #[inline(always)]
    pub fn take(&mut self, innovations: &mut [T]) {
        for (lambda, &step) in self.forces_of_rows.iter_mut().zip(&self.step) {
            *lambda += step;
        }
        self.whitened.add(&self.step, innovations);
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
            diagonal,
            whitened,
            pushing,
            residual,
            ..
        } = self;
        let (mut most, mut near, mut far) = (zero, zero.constant(1.0), zero.constant(1.0));
        // The row of bodies in static equilibrium is a sum of rounding errors. It is compared with the forces that act
        // on the bodies: sqrt(G_jj) |lambda_j| for connection forces.
        let mut acting = *pushing;
        for (&lambda, &diagonal) in forces_of_rows.iter().zip(&*diagonal) {
            // Skipped rows contribute zero.
            acting = lambda.abs().mul_add(diagonal.sqrt(), acting);
        }
        for (connection, of) in connections.iter().zip(&whitened.paths) {
            if !matches!(connection.tie, LaneTie::Joints(..)) {
                accelerations_along(scene, scratch, (&of.path, qdd), accelerations);
            }
            for i in of.rows.clone() {
                let row = &rows[i];
                let (mut sum, mut size) = (row.gamma, row.gamma.abs());
                let given_way = compliance[i] * forces_of_rows[i];
                match &connection.tie {
                    LaneTie::Frames(..) | LaneTie::Anchored(..) => {
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
                    LaneTie::Joints(torques, _) => {
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
                let unit = whitened.sizes[i].sqrt().mul_add(acting, terms[i]) * zero.constant(f64::EPSILON);
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
    /// The connection and its path.
    fn new(sweeps: &SweepModel<T>, constraint: &Constraint) -> (Self, Path) {
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
                let frames = [here(c, ends[0]), here(d, ends[1])];
                if *pair == Pair::Point && ends[0].is_some() && ends[1].is_none() {
                    let [frame, on_base] = frames;
                    LaneTie::Anchored(frame, on_base.lever.into())
                } else {
                    LaneTie::Frames(*pair, frames)
                }
            }
            Tie::Coordinates { first, second, multiplier, offset } => {
                let factor = T::from_f64(-multiplier);
                let coordinates = [Some((first.q, T::one())), second.map(|second| (second.q, factor))];
                LaneTie::Joints(
                    [Some((first.v, T::one())), second.map(|second| (second.v, factor))],
                    Followed { coordinates, offset: T::from_f64(*offset) },
                )
            }
        };
        (Self { tie, ends }, path)
    }
}

impl<T: Real> Row<T> {
    /// Sets the error, its time derivative and gamma of row `i` of a pair.
    #[inline(always)]
    fn set(&mut self, motion: &RelativeMotion<T>, of_pair: &PairRows<T>, i: usize) {
        let force = &of_pair.of_motion[i];
        self.error = of_pair.error[i];
        self.rate = dot(force, &motion.velocity);
        self.gamma = dot(force, &motion.acceleration) + of_pair.turning[i];
    }
}

/// J qd of a row of joint coordinates.
#[inline(always)]
fn joints_rate<T: Real>(torques: &[Option<(usize, T)>; 2], qd: &[T], zero: T) -> T {
    let mut rate = zero;
    for &(row, torque) in torques.iter().flatten() {
        rate = torque.mul_add(qd[row], rate);
    }
    rate
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
