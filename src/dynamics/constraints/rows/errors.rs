//! Errors and rates of the rows at other configurations and velocities, for projections onto the connections.

use super::ends::{axis_of, less, poses_of_ends, product};
use super::{ConnectionRows, Followed, RowTie};
use crate::dynamics::sweeps::{SweepModel, SweepScratch, point_along};
use crate::kinematics::pair::{pair_rows, place_between};
use crate::model::Model;
use crate::scalar::Real;
use nalgebra::Vector6;

impl<T: Real> ConnectionRows<T> {
    /// Computes the errors of every row at `q`, which is that of the rotations and shifts in the scratch. Everything
    /// else remains that of the last [`ConnectionRows::whiten`].
    #[inline(always)]
    pub fn errors_at(&mut self, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>, q: &[T]) {
        let still = Vector6::from_element(scene.0.gravity[0].constant(0.0));
        let Self { connections, whitened, all, .. } = &mut *self;
        for (connection, of) in connections.iter().zip(&whitened.paths) {
            match &connection.tie {
                RowTie::Joints(..) => {}
                RowTie::Anchored(frame, anchor) => {
                    let apart = less(&frame.lever, &point_along(scene, scratch, &of.path, *anchor));
                    for (i, row) in all[of.rows.clone()].iter_mut().enumerate() {
                        row.error = product(&axis_of(frame, i), &apart);
                    }
                }
                RowTie::Frames(pair, frames) => {
                    let [c, d] = poses_of_ends((connection, &of.path), scene, scratch, frames);
                    let Some(of_pair) = pair_rows(*pair, &place_between(&c, &d), &still) else { continue };
                    for (row, &error) in all[of.rows.clone()].iter_mut().zip(&of_pair.error) {
                        row.error = error;
                    }
                }
            }
        }
        self.joint_errors(q);
    }

    /// Computes the errors of rows of joint coordinates at `q`; those of frames are known from
    /// [`ConnectionRows::whiten`].
    #[inline(always)]
    pub fn joint_errors(&mut self, q: &[T]) {
        for (connection, of) in self.connections.iter().zip(&self.whitened.paths) {
            let RowTie::Joints(_, Followed { coordinates, offset }) = &connection.tie else { continue };
            let row = &mut self.all[of.rows.start];
            row.error = -*offset;
            for &(at, factor) in coordinates.iter().flatten() {
                row.error = factor.mul_add(q[at], row.error);
            }
        }
    }

    /// Computes gamma and J qd of every row at other velocities and the same q.
    #[inline(always)]
    pub fn at_velocities(&mut self, scene: (&Model<T>, &SweepModel<T>), scratch: &SweepScratch<T>, qd: &[T]) {
        let unbound = scene.0.gravity[0].constant(f64::INFINITY);
        for at in 0..self.connections.len() {
            self.rows_of(at, scene, scratch, qd, [unbound; 2]);
        }
    }
}
