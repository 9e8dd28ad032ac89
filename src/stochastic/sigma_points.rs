//! Sigma points: the columns of +-sqrt(n) S, propagated through T = H phi W, have exactly M as their covariance.

use super::model::{RandomModel, used_columns};
use crate::error::Error;
use crate::interrupt;
use crate::kinematics::propagation::inward_along_path;
use nalgebra::Vector6;

impl RandomModel {
    /// The mass matrix from the sigma points, (nv x nv) row by row, into `out`. Returns the number of points.
    ///
    /// n is the number of random numbers per sample. The weights 1/(2n) and the squares of sqrt(n) cancel, and a point
    /// and its mirror image contribute equally, so half of the points are propagated without scaling. Each affects only
    /// the joints between its body and the base. O(N depth^2). Fails at an interruption.
    pub(super) fn sigma_points(&self, out: &mut [f64]) -> Result<usize, Error> {
        let nv = self.nv();
        out.fill(0.0);
        let mut path: Vec<(usize, f64)> = Vec::with_capacity(nv);
        for (k, root) in self.roots.iter().enumerate() {
            for column in used_columns(root) {
                self.push_inward(k, root.column(column).into(), &mut path);
                for (at, &(i, t)) in path.iter().enumerate() {
                    interrupt::check_at(at, 256)?;
                    for &(j, other) in &path {
                        out[i * nv + j] += t * other;
                    }
                }
            }
        }
        for (row, &armature) in self.system.noise.iter().enumerate() {
            out[row * nv + row] += armature;
        }
        Ok(2 * self.dimension())
    }

    /// The torques of a force on body `k`, by row.
    fn push_inward(&self, k: usize, force: Vector6<f64>, path: &mut Vec<(usize, f64)>) {
        path.clear();
        let stages = &self.system.stages;
        inward_along_path(stages, &self.shift, [Some(k), None], force, |body, force| {
            let stage = &stages[body];
            path.extend((0..stage.rows.count()).map(|i| (stage.first_row + i, stage.rows.row(i).project(force))));
        });
    }
}
