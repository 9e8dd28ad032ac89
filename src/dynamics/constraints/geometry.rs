//! The rank of the rows of the connections by geometry: which combinations of rows move no joint.
//!
//! With a_i the size that row i of J would have if nothing in it cancelled (1 for a moment, the reach of the loop for a force), and joints that translate weighed by the reach,
//! the rows J_i / a_i have no unit. Their singular values are angles: a linkage whose axes are parallel to within 4e-6 rad has singular values of about 4e-6 where the linkage that is
//! meant has zeros. With U those above the tolerance, and A = diag(a), the rows
//!
//! ```text
//! Q J,     Q = A U U* A^-1
//! ```
//!
//! are those of the linkage that is meant, to within the tolerance. They are kept, the combinations (1 - Q) J are not.

use super::mobility::mobility;
use super::relaxed::Relaxed;
use super::rows::units_of_rows;
use super::scratch::ConstraintScratch;
use super::sized_rows::{SizedRows, groups};
use crate::error::Error;
use crate::kinematics::placements_base_to_tip;
use crate::model::Model;
use crate::scene::Scene;
use crate::scene::constraint::Constraints;
use crate::spatial::RigidShift;
use nalgebra::{DMatrix, RowDVector};

/// Singular values below this are zeros with rounding, for which nothing has to be relaxed.
const ZERO: f64 = 1e-13;

/// Singular values up to the tolerance times this are of the linkage as it is drawn where the rank elsewhere says so.
const UNSURE: f64 = 10.0;

/// How far rows that are not kept may be from holding, over the tolerance.
const ALLOWED: f64 = 10.0;

impl ConstraintScratch {
    /// The combinations of rows that are kept, with the rows' unit forces in `units` and phi of every body in `shift`. Rows that give way are.
    pub(super) fn relax(
        &mut self,
        (model, constraints): (&Model<f64>, &Constraints),
        shift: &[RigidShift<f64>],
        q: &[f64],
        compliance: &[f64],
    ) {
        let (m, tolerance) = (constraints.rows, constraints.tolerance);
        self.relaxed = Relaxed::default();
        if !(tolerance > 0.0) || m == 0 {
            return;
        }
        let sized = SizedRows::of(self, (model, constraints), shift);
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
            // Square, so that all left singular vectors are there: more rows than columns leave zeros, which have some too.
            let own = sized.part(&rows, &group);
            let square = if own.ncols() > count {
                own.transpose().qr().r().transpose()
            } else {
                own.resize_horizontally(count, 0.0)
            };
            let svd = square.svd(true, false);
            let Some(u) = &svd.u else {
                basis.extend(rows.iter().copied().map(unit));
                continue;
            };
            let values = &svd.singular_values;
            let mut order: Vec<usize> = (0..count).collect();
            order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
            let mut meant = order.iter().filter(|&&i| values[i] <= tolerance).count();
            if count == all && values.iter().any(|&value| ZERO < value && value <= UNSURE * tolerance) {
                // The linkage that is meant has as many elsewhere. A singular position has more, which are judged by rounding.
                let ranks = &constraints.mobility.get_or_init(|| mobility(model, constraints, q)).ranks;
                meant = ranks.get(at).copied().flatten().map_or(meant, |rank| count.saturating_sub(rank));
            }
            let dropped: Vec<usize> = order
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
            relaxed.basis = DMatrix::from_rows(&basis);
            relaxed.allowed = ALLOWED * tolerance;
        }
        self.relaxed = relaxed;
    }
}

/// The combinations of rows that are kept at `q`.
pub(crate) fn relaxed_at(scene: &Scene, q: &[f64]) -> Result<Relaxed, Error> {
    let (model, constraints) = (scene.model(), scene.constraints());
    let mut scratch = ConstraintScratch::new(model, constraints);
    let mut shift = vec![RigidShift::identity(); model.bodies.len()];
    placements_base_to_tip(model, q, &mut shift);
    let rest = vec![0.0; model.nv()];
    units_of_rows(model, constraints, (q, &rest), &mut scratch.units).map_err(|at| scene.no_direction(at))?;
    scratch.relax((model, constraints), &shift, q, &[]);
    Ok(scratch.relaxed)
}
