//! The joint torque regressor: torques are linear in the inertial parameters, tau = Y(q, qd, qdd) pi + armature qdd.
//!
//! The row of degree of freedom i for body k is Y* u, where u is the motion of k for a unit velocity of i. Each body
//! has one such motion per ancestor: O(N depth).

use super::outward::{ABOUT_Z, carried, past_joint};
use super::parameters;
use crate::dynamics::forces::Motion;
use crate::dynamics::sweeps::SweepModel;
use crate::dynamics::sweeps::joint::Joint;
use crate::dynamics::sweeps::motion::carriers;
use crate::dynamics::sweeps::scratch::SweepScratch;
use crate::kinematics::joint_motion;
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::inertial_parameters::Parameters;
use nalgebra::Vector6;
use std::ops::Range;

/// Scratch of [`joint_torque_regressor`] in any scalar of one lane, and the constants of the model; initialized with
/// NaN.
#[derive(Debug)]
pub struct RegressorScratch<T: Real<Parameter = T>> {
    sweeps: SweepModel<T>,
    sweep_scratch: SweepScratch<T>,
    /// Velocity and acceleration of each body, gravity included, by slots outward; the first is that of the base.
    motions: Vec<[[T; 6]; 2]>,
    /// The degrees of freedom from the base to each body, including its own: ranges of `rows` and `columns`, one per
    /// place in the sweeps.
    paths: Vec<Range<usize>>,
    rows: Vec<usize>,
    /// The motion of the body for a unit velocity of each degree of freedom.
    columns: Vec<[T; 6]>,
    /// Zeros, except for the current degree of freedom.
    unit: Vec<T>,
    identity: u64,
}

impl<T: Real<Parameter = T>> RegressorScratch<T> {
    /// Scratch for `model`.
    #[must_use]
    pub fn new(model: &Model<T>) -> Self {
        let (nan, nv, sweeps) = (T::from_f64(f64::NAN), model.nv(), SweepModel::general(model));
        let (mut paths, mut rows) = (Vec::<Range<usize>>::new(), Vec::new());
        for body in sweeps.swept() {
            let start = rows.len();
            if let Some(parent) = body.places.parent.checked_sub(1) {
                rows.extend_from_within(paths[parent].clone());
            }
            rows.extend(body.row..body.row + model.system.stages[body.index].rows.count());
            paths.push(start..rows.len());
        }
        Self {
            sweep_scratch: SweepScratch::new(model, &sweeps),
            motions: vec![[[nan; 6]; 2]; sweeps.swept_slots.outward],
            columns: vec![[nan; 6]; rows.len()],
            unit: vec![T::zero(); nv],
            identity: model.identity(),
            paths,
            rows,
            sweeps,
        }
    }

    /// Identity of the model of this scratch.
    pub(crate) fn identity(&self) -> u64 {
        self.identity
    }
}

/// The derivative of the torques of [`inverse_dynamics`](crate::dynamics::inverse_dynamics) with respect to the
/// parameters of each body in its frame, (nv x bodies x 10) into `out`. The order is (m, m cx, m cy, m cz, Ixx, Ixy,
/// Iyy, Ixz, Iyz, Izz), with I about the origin of the frame. Entries of bodies that are not outboard of the joint are
/// zero. O(N depth).
///
/// `q` (nq), `qd`, `qdd` (nv), SI units.
pub fn joint_torque_regressor<T: Real<Parameter = T>>(
    model: &Model<T>,
    scratch: &mut RegressorScratch<T>,
    (q, qd, qdd): (&[T], &[T], &[T]),
    out: &mut [T],
) {
    let RegressorScratch { sweeps, sweep_scratch, motions, paths, rows, columns, unit, .. } = scratch;
    carriers(sweeps, sweep_scratch, T::zero(), q);
    let (o, one, g) = (T::zero(), T::from_f64(1.0), &model.gravity);
    let state = Motion { q, qd, qdd: Some(qdd), wrenches: &[] };
    let bodies = model.bodies.len();
    out.fill(o);
    motions[0] = [[o; 6], [o, o, o, -g[0], -g[1], -g[2]]];
    for (place, body) in sweeps.swept().iter().enumerate() {
        let seen = carried((sweeps, sweep_scratch), (place, body), motions[body.places.parent_outward]);
        let own = past_joint(sweeps, body, &seen, state);
        let path = paths[place].clone();
        let inherited = body.places.parent.checked_sub(1).map_or(0..0, |parent| paths[parent].clone());
        let first_own = path.start + inherited.len();
        for (to, from) in (path.start..first_own).zip(inherited) {
            [columns[to]] = carried((sweeps, sweep_scratch), (place, body), [columns[from]]);
        }
        for at in first_own..path.end {
            columns[at] = match body.joint {
                Joint::Axial(_) => {
                    let mut about_z = [o; 6];
                    about_z[ABOUT_Z] = body.sense;
                    about_z
                }
                Joint::Prismatic(joint, _) | Joint::Free(joint) | Joint::General(joint) => {
                    unit[rows[at]] = one;
                    let column = joint_motion(&sweeps.shifting[joint], body.row, unit);
                    unit[rows[at]] = o;
                    column.into()
                }
            };
        }
        let [velocity, acceleration] = own.map(Vector6::from);
        for at in path {
            let of_force = parameters::of_force(&[velocity, acceleration, Vector6::from(columns[at])]);
            let to: &mut Parameters<T> = &mut out.as_chunks_mut::<10>().0[rows[at] * bodies + body.index];
            *to = parameters::from_sweeps(body, &of_force);
        }
        if !body.is_leaf {
            motions[body.places.outward] = own;
        }
    }
}
