//! The mass matrix as the covariance of the measurements, M = H R H* (5.1), from the composite inertias r(k) (3.4, 3.5).

use super::columns::{Block, Columns, body_of_row, put, put_row, spread_hinge, spread_shift};
use crate::kinematics::placements_base_to_tip;
use crate::scalar::{ColumnsOf, Real};
use crate::scene::Model;
use crate::workspace::Workspace;

/// M at `q` into `out`, (nv x nv) row by row, full and symmetric, armature on the diagonal.
///
/// r(k) runs tip to base; column k of R H* is r(k) H*(k) carried inward (3.4). O(N depth).
pub fn mass_matrix<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, q: &[T], out: &mut [T]) {
    let mut columns = std::mem::replace(&mut workspace.columns, Columns::new(0));
    mass_matrix_in_columns(model, workspace, &mut columns, q, out);
    workspace.columns = columns;
}

/// [`mass_matrix`], as many columns side by side as `C` holds.
#[inline(always)]
pub fn mass_matrix_in_columns<T: Real, C: ColumnsOf<T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    columns: &mut Columns<C>,
    q: &[T],
    out: &mut [T],
) {
    placements_base_to_tip(model, q, &mut workspace.shift);
    composite_inertias_tip_to_base(model, workspace);
    out.fill(T::zero());
    let nv = model.nv();
    let mut first = 0;
    while first < nv {
        let block = Block::from(first, C::COLUMNS, nv);
        first = block.end;
        // No column of the block has anything further out than this.
        let last = body_of_row(model, block.end - 1);
        columns.clear(last);
        let like = columns.at[0][0];
        for k in (0..=last).rev() {
            let stage = &model.system.stages[k];
            let rows = stage.first_row..stage.first_row + stage.rows.count();
            if columns.active[k] {
                // Columns further out: their forces have come this far.
                for row in rows.clone() {
                    let hinge = spread_hinge(like, stage.rows.row(row - rows.start));
                    put_row(out, nv, row, (block, block.between(rows.end, nv)), &hinge.project(&columns.at[k]));
                }
            }
            for column in block.between(rows.start, rows.end) {
                let axis = stage.rows.row(column - rows.start).to_column();
                let force = workspace.composite[k].mul_motion(&axis);
                for row in rows.start..=column {
                    put(out, nv, (row, column), stage.rows.row(row - rows.start).project(&force));
                }
                out[column * nv + column] += model.system.noise[column];
                columns.insert(k, column - block.first, &force);
            }
            if columns.active[k]
                && let Some(parent) = stage.parent
            {
                let carried = spread_shift(like, &workspace.shift[k]).force_to_parent(&columns.at[k]);
                columns.add(parent, &carried);
            }
        }
    }
}

/// Tip to base: r(k) = M(k) + sum over children of phi r phi* (3.5); a composite of rigid bodies is a rigid body.
#[inline(always)]
pub(crate) fn composite_inertias_tip_to_base<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>) {
    for (composite, body) in workspace.composite.iter_mut().zip(&model.bodies) {
        *composite = body.inertia;
    }
    for (k, stage) in model.system.stages.iter().enumerate().rev() {
        if let Some(parent) = stage.parent {
            let carried = workspace.composite[k].to_parent(&workspace.shift[k]);
            workspace.composite[parent] = workspace.composite[parent].add(&carried);
        }
    }
}

/// log det M = sum of log D(k), with the factor already in the workspace; f64, since no scalar here has a logarithm.
#[must_use]
pub fn log_det_mass_matrix<T: Real>(workspace: &Workspace<T>) -> f64 {
    workspace.measured.iter().map(|m| m.pivot.lane(0).ln()).sum()
}
