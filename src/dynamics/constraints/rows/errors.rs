//! Errors and rates of the rows at other configurations and velocities, for projections onto the connections.

use super::ends::poses_of_ends;
use super::{ConnectionRows, JointRow, RowTie};
use crate::dynamics::sweeps::{SweepModel, SweepScratch, point_along};
use crate::kinematics::pair::{pair_rows, place_between};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{column, less, sum3};
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
                RowTie::Joints(coupled, _) => all[of.rows.start].error = coupled.error(q),
                RowTie::Anchored(frame, anchor) => {
                    let point = point_along(scene, scratch, &of.path, *anchor);
                    let apart = less(&frame.lever, &point.into());
                    for (i, row) in all[of.rows.clone()].iter_mut().enumerate() {
                        row.error = sum3(column(&frame.rotation, i), apart.into());
                    }
                }
                RowTie::Frames(pair, frames) => {
                    let [c, d] = poses_of_ends((&connection.ends, &of.path), scene, scratch, frames);
                    let Some(of_pair) = pair_rows(*pair, &place_between(&c, &d), &still) else { continue };
                    for (row, &error) in all[of.rows.clone()].iter_mut().zip(&of_pair.error) {
                        row.error = error;
                    }
                }
            }
        }
    }

    /// Computes the errors and the torques of the rows of joint coordinates at `q`.
    #[inline(always)]
    pub(super) fn joint_rows(&mut self, q: &[T]) {
        for (connection, of) in self.connections.iter_mut().zip(&self.whitened.paths) {
            let RowTie::Joints(coupled, JointRow { torques: [_, torque], curvature }) = &mut connection.tie else {
                continue;
            };
            self.all[of.rows.start].error = coupled.error(q);
            if let (Some(second), Some((_, torque))) = (&coupled.second, torque) {
                let y = q[second.q];
                *torque = -coupled.polynomial.derivative(1, y);
                *curvature = coupled.polynomial.derivative(2, y);
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
