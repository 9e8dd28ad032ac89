//! The rank of the rows of the connections by geometry: which combinations of rows move no joint.
//!
//! Let `a_i` be the size of row i of J without cancellation: 1 for a moment, the reach of the loop for a force. With
//! translational joints weighted by the reach, the rows `J_i / a_i` are dimensionless, and their singular values are
//! angles. A linkage whose axes are parallel to within 4e-6 rad has singular values of about 4e-6 where the intended
//! linkage has zeros. With the left singular vectors U of the singular values above the tolerance, and A = diag(a), the
//! rows
//!
//! ```text
//! Q J,     Q = A U U* A^-1
//! ```
//!
//! are the rows of the intended linkage to within the tolerance. These rows are kept; the combinations (1 - Q) J are
//! dropped.

use super::RowFault;
use super::gram_inverse::Relaxed;
use super::mobility::{Group, SizedRows, groups};
use super::mobility::{mobility, moved, scattered};
use super::scratch::ConstraintScratch;
use crate::decompositions::singular_values;
use crate::error::Error;
use crate::model::Model;
use crate::scene::Scene;
use crate::scene::constraint::Constraints;
use crate::spatial::RigidShift;
use crate::workspace::Workspace;
use nalgebra::{DMatrix, DVector, RowDVector};

/// Singular values below this are zeros with rounding errors; they require no relaxation.
const ZERO: f64 = 1e-13;

/// Singular values up to this multiple of the tolerance count as zeros if the rank at other positions implies it.
const UNSURE: f64 = 10.0;

/// A kept singular value below this multiple of the largest dropped one indicates a singular position.
const SINGULAR: f64 = 1e3;

/// Distance of the nearby configurations, rad or m.
const NEARBY: f64 = 0.2;

/// The largest error of dropped rows, as a multiple of the tolerance.
const ALLOWED: f64 = 10.0;

impl ConstraintScratch {
    /// The combinations of rows that are kept, from the unit forces of the rows and phi of every body in `shift`.
    /// Rows with compliance are always kept.
    pub(super) fn relax(
        &mut self,
        (model, constraints): (&Model<f64>, &Constraints),
        shift: &[RigidShift<f64>],
        q: &[f64],
        compliance: &[f64],
    ) -> Result<(), RowFault> {
        let (m, tolerance) = (constraints.rows, constraints.tolerance);
        self.relaxed = Relaxed::default();
        if !(tolerance > 0.0) || m == 0 {
            return Ok(());
        }
        let sized = SizedRows::of(&self.rows, (model, constraints), shift)?;
        let is_rigid = |i: usize| compliance.get(i).is_none_or(|&compliance| compliance == 0.0);
        let mut relaxed = Relaxed { sizes: sized.sizes.clone(), ..Relaxed::default() };
        let mut projector = DMatrix::identity(m, m);
        let mut basis: Vec<RowDVector<f64>> = Vec::new();
        let mut is_relaxed = false;
        for (at, group) in groups(model, constraints).into_iter().enumerate() {
            let (all, rows) = (group.rows.len(), group.rows.iter().copied().filter(|&i| is_rigid(i)));
            let rows: Vec<usize> = rows.collect();
            let count = rows.len();
            let unit = |i: usize| RowDVector::from_fn(m, |_, j| if i == j { 1.0 } else { 0.0 });
            basis.extend(group.rows.iter().copied().filter(|&i| !is_rigid(i)).map(unit));
            if count == 0 {
                continue;
            }
            let Some((mut u, values)) = left_vectors(sized.part(&rows, &group)) else {
                basis.extend(rows.iter().copied().map(unit));
                continue;
            };
            let mut order: Vec<usize> = (0..count).collect();
            order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
            let mut meant = order.iter().filter(|&&i| values[i] <= tolerance).count();
            if count == all && values.iter().any(|&value| ZERO < value && value <= UNSURE * tolerance) {
                // The intended linkage has the same number of zeros at other positions. A singular position has more;
                // these are distinguished by rounding.
                let ranks = &constraints.mobility.get_or_init(|| mobility(model, constraints, q)).ranks;
                meant = ranks.get(at).copied().flatten().map_or(meant, |rank| count.saturating_sub(rank));
            }
            let mut dropped: Vec<usize> = order
                .into_iter()
                .enumerate()
                .filter(|&(place, i)| values[i] <= ZERO || place < meant && values[i] <= UNSURE * tolerance)
                .map(|(_, i)| i)
                .collect();
            if dropped.iter().all(|&k| values[k] <= ZERO) {
                basis.extend(rows.iter().copied().map(unit));
                continue;
            }
            is_relaxed = true;
            let largest = dropped.iter().map(|&k| values[k]).fold(0.0, f64::max);
            let is_near = |k: usize| !dropped.contains(&k) && values[k] < SINGULAR * largest;
            if (0..count).any(is_near) {
                // Near a singular position, a kept row can be as small as the dropped ones and mix with them. At nearby
                // configurations it is larger. Rows that are constant, such as those normal to a plane, give the same
                // small combinations at all of them.
                let wide = self.around((model, constraints), q, (&sized, &rows, &group));
                if let Some((others, wide)) = left_vectors(wide) {
                    let mut order: Vec<usize> = (0..count).collect();
                    order.sort_by(|&i, &j| wide[i].total_cmp(&wide[j]));
                    if order.get(dropped.len() - 1).is_some_and(|&k| wide[k] <= tolerance.max(5.0 * largest)) {
                        u = others;
                        dropped = order[..dropped.len()].to_vec();
                    }
                }
            }
            for k in 0..count {
                if dropped.contains(&k) {
                    for (i, &row) in rows.iter().enumerate() {
                        for (j, &column) in rows.iter().enumerate() {
                            let scale = relaxed.sizes[row] / relaxed.sizes[column];
                            projector[(row, column)] -= u[(i, k)] * u[(j, k)] * scale;
                        }
                    }
                } else {
                    let mut combination = RowDVector::zeros(m);
                    for (i, &row) in rows.iter().enumerate() {
                        combination[row] = u[(i, k)] / relaxed.sizes[row];
                    }
                    basis.push(combination);
                }
            }
        }
        if is_relaxed {
            relaxed.projector = Some(projector);
            // Near a dead point, it can be that no combination is kept.
            relaxed.basis = DMatrix::from_fn(basis.len(), m, |i, j| basis[i][j]);
            relaxed.allowed = ALLOWED * tolerance;
        }
        self.relaxed = relaxed;
        Ok(())
    }

    /// The rows of a group at this configuration and at two nearby ones, concatenated.
    fn around(
        &self,
        (model, constraints): (&Model<f64>, &Constraints),
        q: &[f64],
        (here, rows, group): (&SizedRows, &[usize], &Group),
    ) -> DMatrix<f64> {
        let n = group.columns.len();
        let mut wide = here.part(rows, group).resize_horizontally(3 * n, 0.0);
        let rest = vec![0.0; model.nv()];
        let (mut workspace, mut rows_there) = (Workspace::new(model), self.rows.clone());
        for place in 1..3 {
            let other = moved(model, q, &scattered(model.nv(), place, NEARBY));
            let found = rows_there.place(model, &mut workspace, (&other, &rest));
            let sized = found.and_then(|()| SizedRows::of(&rows_there, (model, constraints), &workspace.store.shifts));
            wide.columns_mut(place * n, n).copy_from(&sized.as_ref().unwrap_or(here).part(rows, group));
        }
        wide
    }
}

/// The left singular vectors of a matrix, all of them, and the singular values.
fn left_vectors(matrix: DMatrix<f64>) -> Option<(DMatrix<f64>, DVector<f64>)> {
    // A square matrix: with more rows than columns, the left singular vectors of zero are included.
    let count = matrix.nrows();
    let square = if matrix.ncols() > count {
        matrix.transpose().qr().r().transpose()
    } else {
        matrix.resize_horizontally(count, 0.0)
    };
    let svd = singular_values(square, true, false)?;
    svd.u.map(|u| (u, svd.singular_values))
}

/// The combinations of rows that are kept at `q`.
pub(crate) fn relaxed_at(scene: &Scene, q: &[f64]) -> Result<Relaxed, Error> {
    let (model, constraints) = (scene.model(), scene.constraints());
    let (mut workspace, mut scratch) = (Workspace::new(model), ConstraintScratch::new(model, constraints));
    let rest = vec![0.0; model.nv()];
    let placed = scratch.rows.place(model, &mut workspace, (q, &rest));
    let relaxed = placed.and_then(|()| scratch.relax((model, constraints), &workspace.store.shifts, q, &[]));
    relaxed.map_err(|at| scene.row_fault(at))?;
    Ok(scratch.relaxed)
}
