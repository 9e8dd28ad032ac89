//! Tip to base: the columns of a degree of freedom, and the entries that it shares with all that is inboard of it.

use super::hinge::hinge_cross_force;
use super::outward::Felt;
use super::{AT_A_TIME, DerivativeScratch, InverseDerivatives};
use crate::filter::HingeMap;
use crate::filter::Stage;
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{RigidShift, dot, sum};
use crate::watch;
use crate::workspace::Workspace;
use nalgebra::{Vector3, Vector6};

/// What one degree of freedom, with the column S, makes of the force through each joint inboard of it.
struct Columns<T> {
    /// r S, by its acceleration.
    by_acceleration: Vector6<T>,
    /// B* S; no force on it by what is inboard.
    moment: Vector3<T>,
    /// By q.
    by_position: Vector6<T>,
    /// By qd.
    by_rate: Vector6<T>,
}

impl<T: Real> Columns<T> {
    /// In the parent's frame.
    #[inline(always)]
    fn to_parent(&self, shift: &RigidShift<T>) -> Self {
        Self {
            by_acceleration: shift.force_to_parent(&self.by_acceleration),
            moment: shift.rotate(&self.moment),
            by_position: shift.force_to_parent(&self.by_position),
            by_rate: shift.force_to_parent(&self.by_rate),
        }
    }

    /// The derivatives of this degree of freedom's own torque by q and by qd of another, inboard: what that lets this one's bodies feel.
    #[inline(always)]
    fn torque_by(&self, felt: &Felt<T>, hinge: &HingeMap<T>) -> (T, T) {
        let (m, v) = (&self.moment, &felt.velocity);
        let turned = m[0].mul_add(v[0], m[1].mul_add(v[1], m[2] * v[2]));
        let along = match *hinge {
            HingeMap::Axis(i) if i < 3 => m[i],
            HingeMap::Axis(_) => m[0].constant(0.0),
            HingeMap::Screw(_) => m[2],
        };
        (dot(&self.by_acceleration, &felt.acceleration) + turned, dot(&self.by_acceleration, &felt.by_rate) + along)
    }
}

/// All entries, from the composites r(k) and forces F(k) in the workspace and B(k) in the scratch, which is summed up here. Told to stop, it stops: whoever
/// checks next says so.
#[inline(always)]
pub(super) fn tip_to_base<T: Real>(
    model: &Model<T>,
    workspace: &Workspace<T>,
    scratch: &mut DerivativeScratch<T>,
    out: &mut InverseDerivatives<'_, T>,
) {
    let zero = T::zero();
    for matrix in [&mut out.dtau_dq, &mut out.dtau_dqd, &mut out.mass_matrix] {
        // Between branches nothing is written.
        matrix.fill(zero);
    }
    for k in (0..model.bodies.len()).rev() {
        if watch::check_at(k + 1, AT_A_TIME).is_err() {
            return;
        }
        let stage = &model.system.stages[k];
        for i in 0..stage.rows.count() {
            let own = at_own_joint(model, workspace, scratch, (k, i), out);
            to_base(model, workspace, scratch, (k, stage.first_row + i), own, out);
        }
        if let Some(parent) = stage.parent {
            let carried = scratch.coriolis[k].to_parent(&workspace.shift[k]);
            scratch.coriolis[parent] = scratch.coriolis[parent].add(&carried);
        }
    }
}

/// The columns of row `i` of body `k` there, and the entries in the rows of its own joint.
#[inline(always)]
fn at_own_joint<T: Real>(
    model: &Model<T>,
    workspace: &Workspace<T>,
    scratch: &DerivativeScratch<T>,
    (k, i): (usize, usize),
    out: &mut InverseDerivatives<'_, T>,
) -> Columns<T> {
    let stage = &model.system.stages[k];
    let (hinge, column) = (stage.rows.row(i), stage.first_row + i);
    let (composite, coriolis, felt) = (&workspace.composite[k], &scratch.coriolis[k], &scratch.felt[column]);
    let mut columns = Columns {
        by_acceleration: hinge.covariance_column(&composite.to_symmetric()),
        moment: coriolis.moment(&hinge),
        by_position: sum(&composite.mul_motion(&felt.acceleration), &coriolis.mul_angular(&felt.velocity)),
        by_rate: sum(&composite.mul_motion(&felt.by_rate), &coriolis.column(&hinge)),
    };
    entries(stage, model.nv(), column, &columns, out);
    out.mass_matrix[column * (model.nv() + 1)] += model.system.noise[column];
    // The frame that hands F inward moves with the joint; its own rows turn with it, and do not see that.
    columns.by_position = sum(&columns.by_position, &hinge_cross_force(&hinge, &workspace.z[k]));
    columns
}

/// The entries of a column in the rows of one joint: H times each.
#[inline(always)]
fn entries<T: Real>(
    stage: &Stage<T>,
    nv: usize,
    column: usize,
    columns: &Columns<T>,
    out: &mut InverseDerivatives<'_, T>,
) {
    for i in 0..stage.rows.count() {
        let (hinge, row) = (stage.rows.row(i), stage.first_row + i);
        out.dtau_dq[row * nv + column] = hinge.project(&columns.by_position);
        out.dtau_dqd[row * nv + column] = hinge.project(&columns.by_rate);
        out.mass_matrix[row * nv + column] = hinge.project(&columns.by_acceleration);
    }
}

/// From body `k` to the base: the entries of a column in the rows of every joint inboard, and of its row in their columns.
#[inline(always)]
fn to_base<T: Real>(
    model: &Model<T>,
    workspace: &Workspace<T>,
    scratch: &DerivativeScratch<T>,
    (k, own): (usize, usize),
    mut columns: Columns<T>,
    out: &mut InverseDerivatives<'_, T>,
) {
    let nv = model.nv();
    let mut child = k;
    while let Some(parent) = model.system.stages[child].parent {
        columns = columns.to_parent(&workspace.shift[child]);
        let stage = &model.system.stages[parent];
        entries(stage, nv, own, &columns, out);
        for i in 0..stage.rows.count() {
            let other = stage.first_row + i;
            let at = own * nv + other;
            (out.dtau_dq[at], out.dtau_dqd[at]) = columns.torque_by(&scratch.felt[other], &stage.rows.row(i));
            out.mass_matrix[at] = out.mass_matrix[other * nv + own];
        }
        child = parent;
    }
}
