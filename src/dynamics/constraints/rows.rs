//! The rows of the connections at one state: errors, J, J qd, and J qdd + J' qd.

use super::RowFault;
use super::scratch::ConstraintScratch;
use super::scratch::{SizedForce, UnitRow};
use crate::kinematics::pair::{PairRows, RelativeMotion, pair_rows};
use crate::kinematics::propagation::tip_to_base;
use crate::kinematics::relative::motions_from;
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::constraint::{Constraint, Constraints, Tie};
use crate::spatial::{RigidShift, dot};

/// A pair of frames with its motion and its rows; None for joint coordinates.
#[allow(clippy::type_complexity)] // none, or one of two kinds
pub(super) fn pair_at<T: Real>(
    model: &Model<T>,
    (index, constraint): (usize, &Constraint),
    (q, qd): (&[T], &[T]),
    qdd: Option<&[T]>,
) -> Result<Option<(RelativeMotion<T>, PairRows<T>)>, RowFault> {
    let Tie::Frames { pair, frames: [c, d] } = &constraint.tie else { return Ok(None) };
    let [c, d] = motions_from(model, (q, qd, qdd), [&c.cast(), &d.cast()], constraint.junction);
    let motion = RelativeMotion::of(&c, &d);
    let rows = pair_rows(*pair, &motion.place, &motion.velocity).ok_or(RowFault::NoDirection(index))?;
    // The direction of a rod whose length overflows would be zero.
    match rows.error.iter().position(|error| !error.lane(0).is_finite()) {
        Some(i) => Err(RowFault::NotFinite(constraint.rows().start + i, rows.error[i].lane(0))),
        None => Ok(Some((motion, rows))),
    }
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

/// J qd of each row, the time derivative of its error, into `out`. O(m depth).
pub(crate) fn rates_of_rows(
    model: &Model<f64>,
    constraints: &Constraints,
    (q, qd): (&[f64], &[f64]),
    out: &mut [f64],
) -> Result<(), RowFault> {
    for (index, constraint) in constraints.all.iter().enumerate() {
        let out = &mut out[constraint.rows()];
        match pair_at(model, (index, constraint), (q, qd), None)? {
            Some((motion, rows)) => {
                for (out, row) in out.iter_mut().zip(&rows.of_motion) {
                    *out = dot(row, &motion.velocity);
                }
            }
            None => out[0] = coupled(constraint, qd),
        }
    }
    Ok(())
}

/// J qdd + J' qd of each row, the second time derivative of its error, into `out`; without `qdd`, J' qd. `terms`
/// receives the sum of the absolute terms of each row. O(m depth).
pub(crate) fn accelerations_of_rows(
    model: &Model<f64>,
    constraints: &Constraints,
    (q, qd): (&[f64], &[f64]),
    qdd: Option<&[f64]>,
    (out, terms): (&mut [f64], &mut [f64]),
) -> Result<(), RowFault> {
    for (index, constraint) in constraints.all.iter().enumerate() {
        let (out, terms) = (&mut out[constraint.rows()], &mut terms[constraint.rows()]);
        if let Some((motion, rows)) = pair_at(model, (index, constraint), (q, qd), qdd)? {
            for (i, row) in rows.of_motion.iter().take(rows.count).enumerate() {
                out[i] = dot(row, &motion.acceleration) + rows.turning[i];
                let reach = row.fixed_rows::<3>(0).norm() * motion.terms[0];
                terms[i] = reach + row.fixed_rows::<3>(3).norm() * motion.terms[1] + rows.turning[i].abs();
            }
        } else if let Tie::Coordinates { first, second, multiplier, .. } = &constraint.tie {
            let of = |v: usize| qdd.map_or(0.0, |qdd| qdd[v]);
            out[0] = qdd.map_or(0.0, |qdd| coupled(constraint, qdd));
            terms[0] = of(first.v).abs() + second.map_or(0.0, |second| (multiplier * of(second.v)).abs());
        }
    }
    Ok(())
}

/// The row of a coupling times velocities or accelerations.
fn coupled(constraint: &Constraint, u: &[f64]) -> f64 {
    let Tie::Coordinates { first, second, multiplier, .. } = &constraint.tie else { return 0.0 };
    u[first.v] - second.map_or(0.0, |second| multiplier * u[second.v])
}

/// J* of every row at `q`, as forces and torques.
pub(super) fn units_of_rows(
    model: &Model<f64>,
    constraints: &Constraints,
    (q, rest): (&[f64], &[f64]),
    units: &mut [UnitRow],
) -> Result<(), RowFault> {
    for (index, constraint) in constraints.all.iter().enumerate() {
        let units = &mut units[constraint.rows()];
        match &constraint.tie {
            Tie::Frames { frames: [c, d], .. } => {
                let Some((motion, rows)) = pair_at(model, (index, constraint), (q, rest), None)? else { continue };
                for (unit, force) in units.iter_mut().zip(&rows.of_motion) {
                    *unit = UnitRow::between([c, d], &motion.place, force);
                }
            }
            Tie::Coordinates { first, second, multiplier, .. } => {
                let torques = [Some((first.v, 1.0)), second.map(|second| (second.v, -multiplier))];
                units[0] = UnitRow { torques, ..UnitRow::default() };
            }
        }
    }
    Ok(())
}

/// J at `q`, (m x nv) row by row, with phi of every body in `shift`: a unit force along each row is propagated inward,
/// and its torque at each joint is an entry. O(m depth), plus the zeros.
pub(crate) fn jacobian_of_rows(
    model: &Model<f64>,
    constraints: &Constraints,
    scratch: &mut ConstraintScratch,
    shift: &[RigidShift<f64>],
    (q, rest): (&[f64], &[f64]),
    out: &mut [f64],
) -> Result<(), RowFault> {
    let ConstraintScratch { units, state, .. } = scratch;
    units_of_rows(model, constraints, (q, rest), units)?;
    out.fill(0.0);
    let nv = model.nv();
    for constraint in &constraints.all {
        for i in constraint.rows() {
            begin(constraint, &units[i], state, 1.0);
            let out = &mut out[i * nv..(i + 1) * nv];
            let stages = &model.system.stages;
            tip_to_base(stages, shift, constraint.branches.iter().copied(), state, |k, z| {
                for row in 0..stages[k].rows.count() {
                    out[stages[k].first_row + row] = stages[k].rows.row(row).project(&z.force);
                }
            });
            for (v, torque) in units[i].torques.into_iter().flatten() {
                out[v] += torque;
            }
        }
    }
    Ok(())
}

/// Sets the forces of a unit row times `sign`, and the sizes of their moments, on the bodies of its path, and zero on
/// its other bodies.
pub(super) fn begin(constraint: &Constraint, unit: &UnitRow, state: &mut [SizedForce], sign: f64) {
    for &k in &constraint.path {
        state[k] = SizedForce::zero();
    }
    for (force, moment) in unit.forces.iter().zip(unit.moments) {
        if let Some((k, force)) = *force {
            state[k].force += force * sign;
            state[k].moment += moment;
        }
    }
}
