//! The number of independent rows of each group of the intended linkage, away from singular positions.
//!
//! The group is closed from several starts by steps -J^+ error in the units of [`SizedRows`], without dynamics. The
//! result is the rank at the majority of the closed positions.
//!
//! [`SizedRows`] is the dimensionless J: rows divided by their size without cancellation, translational joints weighted
//! by the reach of the loops.

use super::RowFault;
use super::rows::ConnectionRows;
use crate::accuracy::largest;
use crate::decompositions::singular_values;
use crate::filter::HingeMap;
use crate::kinematics::manifold::advance;
use crate::kinematics::propagation::{Accumulates, tip_to_base};
use crate::model::Model;
use crate::scene::constraint::{Constraints, Mobility, Near};
use crate::spatial::{RigidShift, angular, linear, sum, zero};
use crate::workspace::Workspace;
use nalgebra::{DMatrix, Vector6};

/// Number of starts from the neutral configuration, and from the given one.
const STARTS: usize = 6;

/// The search ends at this number of closed positions.
const ENOUGH: usize = 3;

/// Steps from one start.
const STEPS: usize = 40;

/// The largest change of a coordinate in one step, rad, or m divided by the reach.
const FARTHEST: f64 = 0.5;

/// A dimensionless error below this counts as closed.
const CLOSED: f64 = 1e-9;

/// Singular values above this are not rounding errors of exact linkages.
const NOTABLE: f64 = 1e-11;

/// A closed position of one group.
struct Closed {
    rank: usize,
    near: Option<Near>,
}

/// The ranks of all groups, from the neutral configuration, or from `q` if that cannot be closed.
pub(super) fn mobility(model: &Model<f64>, constraints: &Constraints, q: &[f64]) -> Mobility {
    let mut workspace = Workspace::new(model);
    let mut rows = ConnectionRows::new((model, &workspace.sweeps), constraints);
    let mut found = Mobility::default();
    for group in groups(model, constraints) {
        let mut closed: Vec<Closed> = Vec::new();
        for (from, size) in [(&constraints.neutral[..], 0.5), (q, 0.2)] {
            for start in 0..STARTS {
                if closed.len() < ENOUGH {
                    let start = moved(model, from, &scattered(model.nv(), start, size));
                    closed.extend(close((model, constraints), (&mut rows, &mut workspace), &group, start));
                }
            }
        }
        let votes = |rank: usize| closed.iter().filter(|of| of.rank == rank).count();
        let most = closed.iter().map(|of| of.rank).max_by_key(|&rank| (votes(rank), rank));
        found.ranks.push(most);
        for of in closed.into_iter().filter(|of| Some(of.rank) == most) {
            if let Some(near) = of.near
                && found.near.as_ref().is_none_or(|known| near.value > known.value)
            {
                found.near = Some(near);
            }
        }
    }
    found
}

/// Joint velocities within `size` without a repeating pattern. The first start is not zero, so that a configuration
/// that is already closed counts only if others have the same rank.
pub(super) fn scattered(nv: usize, start: usize, size: f64) -> Vec<f64> {
    #[allow(clippy::cast_precision_loss)] // a few thousand
    let number =
        |i: usize| ((i + 1) as f64 * 0.618_033_988_749_895 + (start + 1) as f64 * 0.754_877_666_246_693).fract();
    (0..nv).map(|i| size * (2.0 * number(i) - 1.0)).collect()
}

/// The configuration that velocities reach in unit time.
pub(super) fn moved(model: &Model<f64>, q: &[f64], velocity: &[f64]) -> Vec<f64> {
    let mut next = q.to_vec();
    advance(model, q, velocity, &mut next);
    next
}

/// A closed position of a group near a start, if there is one.
fn close(
    (model, constraints): (&Model<f64>, &Constraints),
    (rows, workspace): (&mut ConnectionRows<f64>, &mut Workspace<f64>),
    group: &Group,
    mut q: Vec<f64>,
) -> Option<Closed> {
    let rest = vec![0.0; model.nv()];
    let mut velocity = vec![0.0; model.nv()];
    for _ in 0..STEPS {
        rows.place(model, workspace, (&q, &rest)).ok()?;
        let sized = SizedRows::of(rows, (model, constraints), &workspace.store.shifts).ok()?;
        let svd = singular_values(sized.part(&group.rows, group), true, true)?;
        let (u, v) = (svd.u.as_ref()?, svd.v_t.as_ref()?);
        velocity.fill(0.0);
        let mut open = 0.0_f64;
        for (k, &value) in svd.singular_values.iter().enumerate().filter(|(_, value)| **value > constraints.tolerance) {
            let along: f64 =
                group.rows.iter().zip(&u.column(k)).map(|(&i, u)| u * rows.all[i].error / sized.sizes[i]).sum();
            open = open.max(along.abs());
            for (j, &column) in group.columns.iter().enumerate() {
                velocity[column] -= v[(k, j)] * along / value;
            }
        }
        if open <= CLOSED {
            // Dropped combinations must also hold, to within the tolerance.
            let slack =
                |&i: &usize| rows.all[i].error.abs() <= (CLOSED + 10.0 * constraints.tolerance) * sized.sizes[i];
            let rank = svd.singular_values.iter().filter(|&&value| value > constraints.tolerance).count();
            let small = svd.singular_values.iter().enumerate();
            let near = small
                .filter(|&(_, &value)| value > NOTABLE && value <= constraints.tolerance)
                .max_by(|a, b| a.1.total_cmp(b.1))
                .map(|(k, &value)| Near { row: group.rows[u.column(k).iamax()], value, q: q.clone() });
            return group.rows.iter().all(slack).then_some(Closed { rank, near });
        }
        let longest = largest(&velocity);
        let share = if longest > FARTHEST { FARTHEST / longest } else { 1.0 };
        for (v, weight) in velocity.iter_mut().zip(&sized.weights) {
            *v *= share * weight;
        }
        q = moved(model, &q, &velocity);
    }
    None
}

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
    /// From the unit forces of the rows, with phi of every body in `shift`.
    pub fn of(
        rows: &ConnectionRows<f64>,
        (model, constraints): (&Model<f64>, &Constraints),
        shift: &[RigidShift<f64>],
    ) -> Result<Self, RowFault> {
        let (m, nv) = (constraints.rows, model.nv());
        let mut jacobian = DMatrix::zeros(m, nv);
        // The largest moment, and the largest force at a translational joint.
        let (mut turning, mut pushing) = (vec![0.0_f64; m], vec![0.0_f64; m]);
        let hinges: Vec<HingeMap<f64>> = model
            .system
            .stages
            .iter()
            .flat_map(|stage| (0..stage.rows.count()).map(|row| stage.rows.row(row)))
            .collect();
        let translates = |v: usize| matches!(hinges[v], HingeMap::Axis(axis) if axis >= 3);
        let mut reach = 0.0_f64;
        let mut state = vec![SizedForce::none(); model.bodies.len()];
        each_entry(rows, (model, constraints), (shift, &mut state), |(i, v), entry, at| {
            jacobian[(i, v)] += entry;
            let Some(SizedForce { force, moment }) = at else {
                let size = if translates(v) { &mut pushing[i] } else { &mut turning[i] };
                *size = size.max(entry.abs());
                return;
            };
            let push = linear(force).norm();
            match hinges[v] {
                HingeMap::Axis(axis) if axis < 3 => turning[i] = turning[i].max(*moment),
                HingeMap::Axis(_) => pushing[i] = pushing[i].max(push),
                HingeMap::Screw(pitch) => turning[i] = turning[i].max(moment + pitch.abs() * push),
            }
            if push > 0.0 {
                reach = reach.max(turning[i]);
            }
        });
        let reach = if reach > 0.0 { reach } else { 1.0 };
        let weights: Vec<f64> = (0..nv).map(|v| if translates(v) { reach } else { 1.0 }).collect();
        let size = |i: usize| turning[i].max(pushing[i] * reach);
        let sizes: Vec<f64> = (0..m).map(|i| if size(i) > 0.0 { size(i) } else { 1.0 }).collect();
        for i in 0..m {
            for j in 0..nv {
                jacobian[(i, j)] *= weights[j] / sizes[i];
            }
            let row = jacobian.row(i);
            if let Some(&wrong) = row.iter().chain(&sizes[i..=i]).find(|entry| !entry.is_finite()) {
                return Err(RowFault::NotFinite(i, wrong));
            }
        }
        Ok(Self { jacobian, sizes, weights })
    }

    /// The rows and columns of a group, restricted to the given rows.
    pub fn part(&self, rows: &[usize], group: &Group) -> DMatrix<f64> {
        DMatrix::from_fn(rows.len(), group.columns.len(), |i, j| self.jacobian[(rows[i], group.columns[j])])
    }
}

/// A force on a body with those that were propagated to it, and the size of the terms of its moment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SizedForce {
    force: Vector6<f64>,
    moment: f64,
}

impl SizedForce {
    pub fn none() -> Self {
        Self { force: zero(), moment: 0.0 }
    }
}

impl Accumulates<f64> for SizedForce {
    fn propagated(&self, shift: &RigidShift<f64>) -> Self {
        let Self { force, moment } = self;
        // A lever parallel to a force gives a moment that is only rounding; it does not count as a moment.
        let moment = angular(force).norm().max(*moment) + shift.lever.norm() * linear(force).norm();
        Self { force: shift.force_to_parent(force), moment }
    }

    fn plus(&self, other: &Self) -> Self {
        Self { force: sum(&self.force, &other.force), moment: self.moment + other.moment }
    }
}

/// Calls `at` with the indices and the value of each entry of J, and with the force at the joint: a unit force along
/// each row is propagated inward over the branches of its loop. Torques of the row at a joint come without a force.
fn each_entry(
    rows: &ConnectionRows<f64>,
    (model, constraints): (&Model<f64>, &Constraints),
    (shift, state): (&[RigidShift<f64>], &mut [SizedForce]),
    mut at: impl FnMut((usize, usize), f64, Option<&SizedForce>),
) {
    let stages = &model.system.stages;
    for (index, constraint) in constraints.all.iter().enumerate() {
        for i in constraint.rows() {
            for &k in &constraint.path {
                state[k] = SizedForce::none();
            }
            for (k, force, moment) in rows.on_bodies(index, i) {
                state[k] = state[k].plus(&SizedForce { force, moment: moment.sqrt() });
            }
            tip_to_base(stages, shift, constraint.branches.iter().copied(), state, |k, z| {
                for row in 0..stages[k].rows.count() {
                    at((i, stages[k].first_row + row), stages[k].rows.row(row).project(&z.force), Some(z));
                }
            });
            for (v, torque) in rows.on_joints(index) {
                at((i, v), torque, None);
            }
        }
    }
}

/// J, (m x nv) row by row, from the unit forces of the rows, with phi of every body and scratch for their forces. O(m
/// depth), plus the zeros.
pub(crate) fn jacobian_of_rows(
    rows: &ConnectionRows<f64>,
    system: (&Model<f64>, &Constraints),
    shift_and_state: (&[RigidShift<f64>], &mut [SizedForce]),
    out: &mut [f64],
) {
    out.fill(0.0);
    each_entry(rows, system, shift_and_state, |(i, v), entry, _| out[i * system.0.nv() + v] += entry);
}

/// Rows that share joints, directly or through other rows, with these joints.
pub(super) fn groups(model: &Model<f64>, constraints: &Constraints) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    for constraint in &constraints.all {
        let mut own = Group { rows: constraint.rows().collect(), columns: constraint.columns(model) };
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
