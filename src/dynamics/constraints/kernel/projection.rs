//! Positions and velocities projected onto the connections by steps of least kinetic energy, with the factor of G that
//! forward dynamics uses.

use super::ends::{axis_of, less, poses_of_ends, product, relative_motion, set_anchored};
use super::{ConstraintKernel, Followed, LaneTie, joints_rate};
use crate::dynamics::sweeps::{SweepModel, SweepScratch, motions_along, point_along};
use crate::kinematics::pair::{pair_rows, place_between};
use crate::model::Model;
use crate::scalar::{Real, larger};
use nalgebra::Vector6;

/// The residuals that a step of the projection removes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Residuals {
    /// Errors, m and rad.
    Errors,
    /// Their time derivatives.
    Rates,
}

impl<T: Real> ConstraintKernel<T> {
    /// Computes the errors of every row at `q`, which is that of the rotations and shifts in the scratch. Everything
    /// else remains that of the last [`ConstraintKernel::factor`].
    #[inline(always)]
    pub fn errors_at(&mut self, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>, q: &[T]) {
        let still = Vector6::from_element(self.weight.constant(0.0));
        let Self { connections, whitened, rows, .. } = &mut *self;
        for (connection, of) in connections.iter().zip(&whitened.paths) {
            match &connection.tie {
                LaneTie::Joints(..) => {}
                LaneTie::Anchored(frame, anchor) => {
                    let apart = less(&frame.lever, &point_along(scene, scratch, &of.path, *anchor));
                    for (i, row) in rows[of.rows.clone()].iter_mut().enumerate() {
                        row.error = product(&axis_of(frame, i), &apart);
                    }
                }
                LaneTie::Frames(pair, frames) => {
                    let [c, d] = poses_of_ends((connection, &of.path), scene, scratch, frames);
                    let Some(of_pair) = pair_rows(*pair, &place_between(&c, &d), &still) else { continue };
                    for (row, &error) in rows[of.rows.clone()].iter_mut().zip(&of_pair.error) {
                        row.error = error;
                    }
                }
            }
        }
        self.joint_errors(q);
    }

    /// Computes the errors of rows of joint coordinates at `q`; those of frames are known from
    /// [`ConstraintKernel::factor`].
    #[inline(always)]
    pub fn joint_errors(&mut self, q: &[T]) {
        for (connection, of) in self.connections.iter().zip(&self.whitened.paths) {
            let LaneTie::Joints(_, Followed { coordinates, offset }) = &connection.tie else { continue };
            let row = &mut self.rows[of.rows.start];
            row.error = -*offset;
            for &(at, factor) in coordinates.iter().flatten() {
                row.error = factor.mul_add(q[at], row.error);
            }
        }
    }

    /// Computes gamma and J qd of every row at other velocities and the same q.
    #[inline(always)]
    pub fn at_velocities(&mut self, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>, qd: &[T]) {
        let zero = scene.0.gravity[0].constant(0.0);
        let Self { connections, whitened, rows, motions, .. } = self;
        for (connection, of) in connections.iter().zip(&whitened.paths) {
            if let LaneTie::Joints(torques, _) = &connection.tie {
                rows[of.rows.start].rate = joints_rate(torques, qd, zero);
            }
            let on_path = (connection, &of.path);
            if let LaneTie::Anchored(frame, anchor) = &connection.tie {
                motions_along(scene, scratch, (&of.path, qd), motions);
                let point = point_along(scene, scratch, &of.path, *anchor);
                let step = connection.ends[0].unwrap_or_default();
                set_anchored((frame, &point), &motions[step], &mut rows[of.rows.clone()]);
                continue;
            }
            let Some((motion, of_pair)) = relative_motion(on_path, scene, scratch, qd, motions) else { continue };
            for (i, to) in rows[of.rows.clone()].iter_mut().enumerate() {
                to.set(&motion, &of_pair, i);
            }
        }
    }

    /// The largest residual of a row.
    #[inline(always)]
    pub fn largest(&self, which: Residuals) -> T {
        let zero = self.weight.constant(0.0);
        let mut most = zero;
        for row in &self.rows {
            let left = if which == Residuals::Errors { row.error } else { row.rate };
            most = larger(most, left.abs());
        }
        most
    }

    /// The innovations of the forces -G^-1 residual, which remove the residuals to first order, into `innovations`.
    #[inline(always)]
    pub fn step_against(&mut self, which: Residuals, innovations: &mut [T]) {
        for (step, row) in self.step.iter_mut().zip(&self.rows) {
            *step = if which == Residuals::Errors { row.error } else { row.rate };
        }
        self.solve();
        let zero = self.weight.constant(0.0);
        innovations.fill(zero);
        self.whitened.add(&self.step, innovations);
    }
}
