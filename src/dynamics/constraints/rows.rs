//! The rows of the connections at one state, on any scalar: errors, unit forces, J qd, J' qd, W and G.
//!
//! The configuration, and for W and G the factor of M, are those in the scratch of the
//! [sweeps](crate::dynamics::sweeps). One state uses the general model, whose frames are those of the bodies; lanes and
//! generated code use the model of the kernels.

mod ends;
mod errors;

use super::RowFault;
use crate::dynamics::sweeps::{
    Forces, MOST_FORCES, Path, PathRows, SweepModel, SweepScratch, WhitenedRows, accelerations_along, frame_here,
    motions_along, point_along,
};
use crate::kinematics::Frame;
use crate::kinematics::pair::{Pair, PairRows, RelativeMotion};
use crate::kinematics::placements_base_to_tip;
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::constraint::{Constraint, Constraints, Coupled, Tie};
use crate::spatial::{RigidShift, angular, column, cross, dot, linear, scaled, square, sum3};
use crate::workspace::Workspace;
use ends::{Ends, of_anchored, relative_motion};
use nalgebra::Vector6;

/// The geometry of a connection, in the scalar of the rows.
#[derive(Debug, Clone)]
enum RowTie<T> {
    /// Frames on the bodies, relative to the body frames of the sweeps.
    Frames(Pair, [RigidShift<T>; 2]),
    /// A point of a body on a point of the base: the frame on the body, and the point of the base.
    Anchored(RigidShift<T>, [T; 3]),
    /// A row of joint coordinates, and its values at the current configuration.
    Joints(Coupled, JointRow<T>),
}

/// A row of joint coordinates x = P(y) at one configuration.
#[derive(Debug, Clone)]
struct JointRow<T> {
    /// The torques of a unit force: 1 and -P'(y), with their indices in qd.
    torques: [Option<(usize, T)>; 2],
    /// P''(y).
    curvature: T,
}

/// One connection.
#[derive(Debug, Clone)]
struct Connection<T> {
    tie: RowTie<T>,
    /// The steps of its path on which the forces act, and their bodies.
    ends: Ends,
    bodies: [Option<usize>; 2],
}

/// A row of a connection at one state.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row<T> {
    /// The forces on the bodies at the ends of its path, in the frames of the sweeps, and the sums of the absolute
    /// values of their angular and linear parts.
    forces: [[T; 6]; 2],
    sizes: [[T; 2]; 2],
    /// Squares that bound the terms of the moments.
    moments: [T; 2],
    /// J' qd.
    pub gamma: T,
    /// The error, m or rad, and its time derivative J qd.
    pub error: T,
    pub rate: T,
}

/// The rows of the connections of one scene at the current states; initialized with NaN.
#[derive(Debug, Clone)]
pub(crate) struct ConnectionRows<T> {
    connections: Vec<Connection<T>>,
    pub all: Vec<Row<T>>,
    /// W and G; one path per connection.
    pub whitened: WhitenedRows<T>,
    /// One per step of the longest path.
    forces: Vec<Forces<T>>,
    motions: Vec<[[T; 6]; 2]>,
    accelerations: Vec<[T; 6]>,
    /// Torques of a unit force.
    torque: Vec<T>,
    /// The connection whose rows have no direction.
    undirected: Option<usize>,
}

impl<T: Real> ConnectionRows<T> {
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
        let row = Row {
            forces: [[zero; 6]; 2],
            sizes: [[zero; 2]; 2],
            moments: [zero; 2],
            gamma: nan,
            error: nan,
            rate: nan,
        };
        Self {
            connections,
            whitened,
            all: vec![row; m],
            forces: vec![Forces { z: [[nan; 6]; MOST_FORCES], moments: [nan; MOST_FORCES] }; longest],
            motions: vec![[[nan; 6]; 2]; longest],
            accelerations: vec![[nan; 6]; longest],
            torque: vec![zero; nv],
            undirected: None,
        }
    }

    /// Computes the rows, W and G at q, which is that of the scratch, and at qd. Returns a value that is positive where
    /// the usual form of the rows applies and no error and no rate exceeds its bound.
    #[inline(always)]
    pub fn whiten(
        &mut self,
        scene: (&Model<T>, &SweepModel<T>),
        scratch: &SweepScratch<T>,
        (q, qd): (&[T], &[T]),
        bounds: [T; 2],
    ) -> T {
        let zero = scene.0.gravity[0].constant(0.0);
        self.whitened.sizes.fill(zero);
        self.undirected = None;
        self.joint_rows(q);
        let mut regular = zero.constant(1.0);
        for at in 0..self.connections.len() {
            regular = regular.worst(self.rows_of(at, scene, scratch, qd, bounds));
            self.begin(at, scratch, zero);
            self.whitened.innovations_of(at, scene, scratch, (&mut self.forces, &self.torque));
            if let RowTie::Joints(_, JointRow { torques, .. }) = &self.connections[at].tie {
                for &(row, unit) in torques.iter().flatten() {
                    self.torque[row] = unit.constant(0.0);
                }
            }
        }
        self.whitened.multiply(zero);
        regular
    }

    /// Computes the unit forces of one connection and J' qd of its rows. Returns a value that is positive where the
    /// usual form of the rows applies and the state meets them to within the bounds.
    #[inline(always)]
    fn rows_of(
        &mut self,
        at: usize,
        scene: (&Model<T>, &SweepModel<T>),
        scratch: &SweepScratch<T>,
        qd: &[T],
        [slack, fastest]: [T; 2],
    ) -> T {
        let zero = slack.constant(0.0);
        let Self { connections, all, whitened, motions, undirected, .. } = self;
        let Connection { tie, ends, .. } = &connections[at];
        let PathRows { path, rows, .. } = &whitened.paths[at];
        let own = &mut all[rows.clone()];
        let mut usual = zero.constant(1.0);
        match tie {
            RowTie::Anchored(frame, anchor) => {
                let point = point_along(scene, scratch, path, *anchor);
                motions_along(scene, scratch, (path, qd), motions);
                let [apart, moving, turning] = of_anchored((frame, &point), &motions[ends[0].unwrap_or_default()]);
                let reach = square(&frame.lever) + square(&apart.into());
                for (i, to) in own.iter_mut().enumerate() {
                    let axis = column(&frame.rotation, i);
                    (to.error, to.rate, to.gamma) = (sum3(axis, apart), sum3(axis, moving), sum3(axis, turning));
                    let force = axis.into();
                    let [x, y, z] = cross(&point.into(), &force).into();
                    to.forces[0] = [x, y, z, force[0], force[1], force[2]];
                    to.sizes[0] = halves(&to.forces[0]);
                    to.moments[0] = reach;
                }
            }
            RowTie::Joints(coupled, JointRow { torques, curvature }) => {
                (own[0].gamma, own[0].rate) = (zero, zero);
                if let Some(second) = &coupled.second {
                    own[0].gamma = zero.minus_product(*curvature, qd[second.v] * qd[second.v]);
                }
                for &(row, torque) in torques.iter().flatten() {
                    own[0].rate = torque.mul_add(qd[row], own[0].rate);
                }
            }
            RowTie::Frames(pair, frames) => {
                let found = relative_motion((*pair, frames), (ends, path), scene, scratch, qd, motions);
                let Some((motion, of_pair)) = found else {
                    *undirected = Some(at);
                    return zero.constant(-1.0);
                };
                usual = of_pair.margin;
                for (i, to) in own.iter_mut().enumerate() {
                    let force = &of_pair.of_motion[i];
                    to.set(&motion, &of_pair, i);
                    for (end, (step, frame)) in ends.iter().zip(frames).enumerate() {
                        if step.is_none() {
                            continue;
                        }
                        let (force, reach) = if end == 0 {
                            (*force, square(&frame.lever))
                        } else {
                            let back = motion.place.force_to_parent(force);
                            (scaled(&back, zero.constant(-1.0)), square(&frame.lever) + square(&motion.place.lever))
                        };
                        let (moment, push) = (square(&angular(&force)), square(&linear(&force)));
                        to.forces[end] = frame.force_to_parent(&force).into();
                        to.sizes[end] = halves(&to.forces[end]);
                        to.moments[end] = reach.mul_add(push, moment);
                    }
                }
            }
        }
        for row in &*own {
            usual = usual.worst(slack - row.error.abs()).worst(fastest - row.rate.abs());
        }
        usual
    }

    /// Sets the forces of the rows of one connection on the bodies at its ends, and its torques. The forces on other
    /// bodies of its path are set by the first that they receive.
    #[inline(always)]
    fn begin(&mut self, at: usize, scratch: &SweepScratch<T>, zero: T) {
        let Self { connections, all, whitened, forces, torque, .. } = self;
        let Connection { tie, ends, .. } = &connections[at];
        let rows = &whitened.paths[at].rows;
        for &step in ends.iter().flatten() {
            let on = &mut forces[step];
            for i in 0..rows.len() {
                (on.z[i], on.moments[i]) = ([zero; 6], zero);
            }
        }
        if let RowTie::Joints(_, JointRow { torques, .. }) = tie {
            for &(row, unit) in torques.iter().flatten() {
                torque[row] = unit;
                let size = &mut whitened.sizes[rows.start];
                *size = (unit * unit).mul_add(scratch.pivot_inverse(row), *size);
            }
            return;
        }
        for (end, &step) in ends.iter().enumerate() {
            let Some(step) = step else { continue };
            let on = &mut forces[step];
            for (i, row) in all[rows.clone()].iter().enumerate() {
                // A force on a body reduces the force that its joint transmits.
                for (z, &force) in on.z[i].iter_mut().zip(&row.forces[end]) {
                    *z -= force;
                }
                on.moments[i] += row.moments[end];
            }
        }
    }

    /// J x of every row, with `BIASED` plus J' qd, and the sums of the absolute values of the terms.
    #[inline(always)]
    pub fn times<const BIASED: bool>(
        &mut self,
        scene: (&Model<T>, &SweepModel<T>),
        scratch: &SweepScratch<T>,
        x: &[T],
        (out, terms): (&mut [T], &mut [T]),
    ) {
        let zero = scene.0.gravity[0].constant(0.0);
        let Self { connections, all, whitened, accelerations, .. } = self;
        for (connection, of) in connections.iter().zip(&whitened.paths) {
            if !matches!(connection.tie, RowTie::Joints(..)) {
                accelerations_along(scene, scratch, (&of.path, x), accelerations);
            }
            for i in of.rows.clone() {
                let row = &all[i];
                let (mut sum, mut size) = if BIASED { (row.gamma, row.gamma.abs()) } else { (zero, zero) };
                match &connection.tie {
                    RowTie::Frames(..) | RowTie::Anchored(..) => {
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
                    RowTie::Joints(_, JointRow { torques, .. }) => {
                        for &(row, torque) in torques.iter().flatten() {
                            let term = x[row] * torque;
                            sum += term;
                            size += term.abs();
                        }
                    }
                }
                (out[i], terms[i]) = (sum, size);
            }
        }
    }

    /// Computes the rows at (q, qd), without W and G.
    pub fn place(
        &mut self,
        model: &Model<T>,
        workspace: &mut Workspace<T>,
        (q, qd): (&[T], &[T]),
    ) -> Result<(), RowFault> {
        placements_base_to_tip(model, q, &mut workspace.store.shifts);
        self.undirected = None;
        self.joint_rows(q);
        self.at_velocities((model, &workspace.sweeps), &workspace.store, qd);
        self.check()
    }

    /// An error for rows that do not exist.
    pub fn check(&self) -> Result<(), RowFault> {
        if let Some(at) = self.undirected {
            return Err(RowFault::NoDirection(at));
        }
        // The direction of a rod whose length overflows would be zero.
        let errors = self.all.iter().map(|row| row.error.lane(0));
        errors
            .enumerate()
            .find(|(_, error)| !error.is_finite())
            .map_or(Ok(()), |(i, error)| Err(RowFault::NotFinite(i, error)))
    }

    /// The unit forces of row `i` of a connection: bodies, forces in the frames of the sweeps, and squares that bound
    /// the terms of their moments.
    pub fn on_bodies(&self, at: usize, i: usize) -> impl Iterator<Item = (usize, Vector6<T>, T)> + '_ {
        let Connection { tie, bodies, .. } = &self.connections[at];
        let bodies = if matches!(tie, RowTie::Joints(..)) { [None; 2] } else { *bodies };
        let Row { forces, moments, .. } = &self.all[i];
        let ends = bodies.into_iter().zip(forces).zip(moments);
        ends.filter_map(|((body, &force), &moment)| body.map(|k| (k, force.into(), moment)))
    }

    /// The torques of a unit force along the row of a connection.
    pub fn on_joints(&self, at: usize) -> impl Iterator<Item = (usize, T)> + '_ {
        let RowTie::Joints(_, JointRow { torques, .. }) = &self.connections[at].tie else {
            return [None; 2].into_iter().flatten();
        };
        (*torques).into_iter().flatten()
    }

    /// Adds J* lambda: the forces on bodies to `forces`, and the torques at joints, times `sign`, to `torque`.
    pub fn add_forces(&self, lambda: &[T], (forces, torque): (&mut [Vector6<T>], &mut [T]), sign: T) {
        for (at, of) in self.whitened.paths.iter().enumerate() {
            for i in of.rows.clone() {
                for (k, force, _) in self.on_bodies(at, i) {
                    forces[k] += force * lambda[i];
                }
                for (v, unit) in self.on_joints(at) {
                    torque[v] += sign * unit * lambda[i];
                }
            }
        }
    }
}

impl<T: Real> Connection<T> {
    /// The connection and its path.
    fn new(sweeps: &SweepModel<T>, constraint: &Constraint) -> (Self, Path) {
        let bodies = constraint.tie.bodies();
        let act_on: Vec<usize> = bodies.into_iter().flatten().collect();
        let path = Path::new(sweeps, (&constraint.path, &constraint.branches), &act_on);
        let ends = bodies.map(|end| end.and_then(|body| path.step_of(body)));
        let tie = match &constraint.tie {
            Tie::Frames { pair, frames: [c, d] } => {
                let here = |frame: &Frame<f64>, step: Option<usize>| {
                    let placement = frame.placement.cast();
                    step.map_or(placement, |step| frame_here(sweeps, (&path, step), &placement))
                };
                let frames = [here(c, ends[0]), here(d, ends[1])];
                if *pair == Pair::Point && ends[0].is_some() && ends[1].is_none() {
                    let [frame, on_base] = frames;
                    RowTie::Anchored(frame, on_base.lever.into())
                } else {
                    RowTie::Frames(*pair, frames)
                }
            }
            Tie::Coordinates(coupled) => {
                let nan = T::from_f64(f64::NAN);
                let torques = [Some((coupled.first.v, T::one())), coupled.second.map(|second| (second.v, nan))];
                RowTie::Joints(*coupled, JointRow { torques, curvature: nan })
            }
        };
        (Self { tie, ends, bodies }, path)
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

/// The sums of the absolute values of the angular and the linear part.
#[inline(always)]
fn halves<T: Real>(v: &[T; 6]) -> [T; 2] {
    [v[0].abs() + v[1].abs() + v[2].abs(), v[3].abs() + v[4].abs() + v[5].abs()]
}

/// The error of each row at `q`, into `out`: rad (2 sin(t/2)) and m. O(m depth).
pub(crate) fn errors_of_rows(
    model: &Model<f64>,
    constraints: &Constraints,
    q: &[f64],
    out: &mut [f64],
) -> Result<(), RowFault> {
    for (index, constraint) in constraints.all.iter().enumerate() {
        constraint.error(model, q, &mut out[constraint.rows()]).ok_or(RowFault::NoDirection(index))?;
    }
    Ok(())
}

#[cfg(test)]
pub(super) mod tests;
