//! The dimensionless J: rows divided by their size without cancellation, translational joints weighted by the reach of
//! the loops.

use super::rows::begin;
use super::scratch::ConstraintScratch;
use crate::filter::HingeMap;
use crate::kinematics::propagation::tip_to_base;
use crate::model::Model;
use crate::scene::constraint::{Constraints, Tie};
use crate::spatial::{RigidShift, linear};
use nalgebra::DMatrix;

/// Rows that share joints, and these joints.
pub(super) struct Group {
    pub rows: Vec<usize>,
    pub columns: Vec<usize>,
}

/// The dimensionless J of all rows.
pub(super) struct SizedRows {
    /// (m x nv).
    pub jacobian: DMatrix<f64>,
    /// Divisor of each row; one for rows that can move no joint.
    pub sizes: Vec<f64>,
    /// Factor of each column.
    pub weights: Vec<f64>,
}

impl SizedRows {
    /// From the rows' unit forces in the scratch, with phi of every body in `shift`.
    pub fn of(
        scratch: &mut ConstraintScratch,
        (model, constraints): (&Model<f64>, &Constraints),
        shift: &[RigidShift<f64>],
    ) -> Self {
        let ConstraintScratch { units, state, .. } = scratch;
        let (m, nv) = (constraints.rows, model.nv());
        let mut jacobian = DMatrix::zeros(m, nv);
        // The largest moment, and the largest force at a translational joint.
        let (mut turning, mut pushing) = (vec![0.0_f64; m], vec![0.0_f64; m]);
        let hinges =
            model.system.stages.iter().flat_map(|stage| (0..stage.rows.count()).map(|row| stage.rows.row(row)));
        let translates: Vec<bool> = hinges.map(|hinge| matches!(hinge, HingeMap::Axis(axis) if axis >= 3)).collect();
        let mut reach = 0.0_f64;
        for constraint in &constraints.all {
            for i in constraint.rows() {
                begin(constraint, &units[i], state, 1.0);
                let stages = &model.system.stages;
                tip_to_base(stages, shift, constraint.branches.iter().copied(), state, |k, z| {
                    let (stage, push) = (&stages[k], linear(&z.force).norm());
                    for row in 0..stage.rows.count() {
                        let (hinge, column) = (stage.rows.row(row), stage.first_row + row);
                        jacobian[(i, column)] = hinge.project(&z.force);
                        match hinge {
                            HingeMap::Axis(axis) if axis < 3 => turning[i] = turning[i].max(z.moment),
                            HingeMap::Axis(_) => pushing[i] = pushing[i].max(push),
                            HingeMap::Screw(pitch) => turning[i] = turning[i].max(z.moment + pitch.abs() * push),
                        }
                    }
                    if push > 0.0 {
                        reach = reach.max(turning[i]);
                    }
                });
                for (v, torque) in units[i].torques.into_iter().flatten() {
                    jacobian[(i, v)] += torque;
                    let size = if translates[v] { &mut pushing[i] } else { &mut turning[i] };
                    *size = size.max(torque.abs());
                }
            }
        }
        let reach = if reach > 0.0 { reach } else { 1.0 };
        let weights: Vec<f64> = translates.iter().map(|&translates| if translates { reach } else { 1.0 }).collect();
        let size = |i: usize| turning[i].max(pushing[i] * reach);
        let sizes: Vec<f64> = (0..m).map(|i| if size(i) > 0.0 { size(i) } else { 1.0 }).collect();
        for i in 0..m {
            for j in 0..nv {
                jacobian[(i, j)] *= weights[j] / sizes[i];
            }
        }
        Self { jacobian, sizes, weights }
    }

    /// The rows and columns of a group, restricted to the given rows.
    pub fn part(&self, rows: &[usize], group: &Group) -> DMatrix<f64> {
        DMatrix::from_fn(rows.len(), group.columns.len(), |i, j| self.jacobian[(rows[i], group.columns[j])])
    }
}

/// Rows that share joints, directly or through other rows, with these joints.
pub(super) fn groups(model: &Model<f64>, constraints: &Constraints) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    for constraint in &constraints.all {
        let joints = constraint.branches.iter().flat_map(|&k| {
            let stage = &model.system.stages[k];
            stage.first_row..stage.first_row + stage.rows.count()
        });
        let mut own = Group { rows: constraint.rows().collect(), columns: joints.collect() };
        if let Tie::Coordinates { first, second, .. } = &constraint.tie {
            own.columns = [Some(first.v), second.map(|second| second.v)].into_iter().flatten().collect();
        }
        let shares = |group: &Group| group.columns.iter().any(|column| own.columns.contains(column));
        let (shared, others) = groups.into_iter().partition(shares);
        groups = others;
        for group in shared {
            let Group { rows, columns } = group;
            own.rows.extend(rows);
            own.columns.extend(columns);
        }
        own.rows.sort_unstable();
        own.columns.sort_unstable();
        own.columns.dedup();
        groups.push(own);
    }
    groups
}
