//! Predicted reading of a sensor, and its derivatives.

use super::settings::{Plan, Reader, Source};
use crate::kinematics::derivatives::{acceleration_derivatives, velocity_derivatives};
use crate::kinematics::{AccelerationKind, ReferenceFrame, frame_motion, local_jacobian};
use crate::model::Model;
use crate::scene::Scene;
use crate::spatial::linear;
use nalgebra::{Matrix6, Rotation3, UnitQuaternion, Vector3, Vector6};
#[cfg(feature = "python")]
use {super::settings::Sensor, crate::error::Error};

/// Predicted reading without bias, and its derivatives at constant qdd, by columns of `size` entries per degree of
/// freedom.
#[derive(Debug)]
pub(crate) struct SensorRows {
    nv: usize,
    pub size: usize,
    pub value: Vec<f64>,
    pub by_q: Vec<f64>,
    pub by_qd: Vec<f64>,
    /// Zero if not `has_qdd`.
    pub by_qdd: Vec<f64>,
    /// By the torque noise of the step; zero if not `has_noise`.
    pub by_noise: Vec<f64>,
    pub has_qdd: bool,
    pub has_noise: bool,
    /// A matrix of the tree, for scenes with joints that follow others.
    of_tree: Vec<f64>,
    /// Derivatives of the motion of a frame by q, qd and qdd, (3 x 6 x nv) of the tree.
    of_frame: Vec<f64>,
}

impl SensorRows {
    /// Room for a sensor of at most `size` components.
    pub fn new(size: usize, scene: &Scene) -> Self {
        let nv = scene.nv();
        // Derivatives of links are those of the tree before they are reduced.
        let zeros = || vec![0.0; size * scene.model().nv()];
        Self {
            nv,
            size,
            value: vec![f64::NAN; size],
            by_q: zeros(),
            by_qd: zeros(),
            by_qdd: zeros(),
            by_noise: zeros(),
            has_qdd: false,
            has_noise: false,
            of_tree: zeros(),
            of_frame: vec![0.0; 18 * scene.model().nv()],
        }
    }

    /// A sensor that belongs to no observer, at a state; without `qdd`, the results that depend on it are NaN.
    ///
    /// # Errors
    ///
    /// Unknown names, and a rotation that is none.
    #[cfg(feature = "python")]
    pub(crate) fn predict(
        scene: &Scene,
        sensor: &Sensor,
        states: impl Iterator<Item = [Vec<f64>; 4]>,
        mut each: impl FnMut(&Self),
    ) -> Result<(), Error> {
        let reader = Reader::unplaced(scene, sensor)?;
        let nv = scene.nv();
        let mut rows = Self::new(reader.range.len(), scene);
        for [q, qd, qdd, tau] in states {
            scene.check_coordinates("q", &q)?;
            for (name, values) in [("qd", &qd), ("qdd", &qdd), ("tau", &tau)] {
                crate::error::check_length(name, values.len(), nv)?;
            }
            rows.evaluate(scene, &reader, (&q, &qd, &qdd), &tau);
            each(&rows);
        }
        Ok(())
    }

    /// The sensor at a state; only accelerometers read `qdd`.
    pub(super) fn evaluate(
        &mut self,
        scene: &Scene,
        sensor: &Reader,
        (q, qd, qdd): (&[f64], &[f64], &[f64]),
        tau: &[f64],
    ) {
        let size = sensor.range.len();
        self.size = size;
        (self.has_qdd, self.has_noise) = (false, false);
        for matrix in [&mut self.by_q, &mut self.by_qd, &mut self.by_qdd, &mut self.by_noise] {
            matrix.fill(0.0);
        }
        match &sensor.source {
            Source::Encoder(joints) => {
                for (i, &(coordinate, row)) in joints.iter().enumerate() {
                    self.value[i] = q[coordinate];
                    self.by_q[row * size + i] = 1.0;
                }
            }
            Source::JointTorque(joints) => {
                self.has_noise = true;
                for (i, &row) in joints.iter().enumerate() {
                    self.value[i] = tau[row];
                    self.by_noise[row * size + i] = 1.0;
                }
            }
            source => {
                // Links move with all joints of the tree.
                let Some(coupling) = scene.coupling() else {
                    return self.on_link(scene.model(), source, (q, qd, qdd));
                };
                let (q, qd, qdd) = (coupling.configuration(q), coupling.rates(qd), coupling.rates(qdd));
                self.on_link(scene.model(), source, (&q, &qd, &qdd));
                for matrix in [&mut self.by_q, &mut self.by_qd, &mut self.by_qdd] {
                    std::mem::swap(matrix, &mut self.of_tree);
                    coupling.reduce_rows(&self.of_tree[..size * scene.model().nv()], size, matrix);
                }
            }
        }
    }

    /// A sensor on a link, at a state of the tree.
    fn on_link(&mut self, model: &Model<f64>, source: &Source, (q, qd, qdd): (&[f64], &[f64], &[f64])) {
        let (nv, local) = (model.nv(), ReferenceFrame::Local);
        match source {
            Source::Encoder(_) | Source::JointTorque(_) => {}
            Source::Gyro(frame) | Source::Contact(frame) => {
                let first = if matches!(source, Source::Gyro(_)) { 0 } else { 3 };
                let velocity = frame_motion(model, q, qd, None, frame).velocity;
                self.value[..3].copy_from_slice(&velocity.as_slice()[first..first + 3]);
                velocity_derivatives(model, (q, qd), frame, local, &mut self.of_frame[..12 * nv]);
                self.take(2, first, nv);
            }
            Source::Pose(frame, _) => {
                let placement = local_jacobian(model, q, frame, &mut self.of_frame[..6 * nv]);
                // By the quaternion: the axis and the cosine of the matrix lose the smallest and largest angles.
                let turned = Rotation3::from_matrix_unchecked(placement.rotation);
                let turned = UnitQuaternion::from_rotation_matrix(&turned).scaled_axis();
                self.value[..3].copy_from_slice(turned.as_slice());
                self.value[3..6].copy_from_slice(placement.lever.as_slice());
                self.take(1, 0, nv);
            }
            Source::Accelerometer(frame) => {
                self.has_qdd = true;
                let (kind, motion) = (AccelerationKind::Classical, frame_motion(model, q, qd, Some(qdd), frame));
                let g = motion.placement.rotate_back(&model.gravity);
                let proper = linear(&motion.acceleration_in(local, kind)) - g;
                self.value[..3].copy_from_slice(proper.as_slice());
                acceleration_derivatives(model, (q, qd, qdd), frame, (local, kind), &mut self.of_frame);
                self.take(3, 3, nv);
                for (k, by_q) in self.by_q.chunks_exact_mut(3).enumerate().take(nv) {
                    let turn = Vector3::from_fn(|i, _| self.of_frame[(12 + i) * nv + k]);
                    by_q.iter_mut().zip(&turn.cross(&g)).for_each(|(by_q, change)| *by_q += change);
                }
            }
        }
    }

    /// The components from `first` of the first `count` derivatives of the motion of a frame.
    fn take(&mut self, count: usize, first: usize, nv: usize) {
        let matrices = [&mut self.by_q, &mut self.by_qd, &mut self.by_qdd];
        for (m, matrix) in matrices.into_iter().enumerate().take(count) {
            for (k, column) in matrix.chunks_exact_mut(self.size).enumerate().take(nv) {
                for (i, entry) in column.iter_mut().enumerate() {
                    *entry = self.of_frame[(6 * m + first + i) * nv + k];
                }
            }
        }
    }

    /// The difference of a measured pose from the prediction, (rotation, position) in the axes of the predicted frame,
    /// and the derivatives, both in units of the deviations that the covariance has: changes value and `by_q`.
    pub(super) fn whiten_pose(&mut self, readings: &[f64], inverse: &Matrix6<f64>) {
        let turned = |x: &[f64]| UnitQuaternion::new(Vector3::new(x[0], x[1], x[2]));
        let back = turned(&self.value).inverse();
        let moved = Vector3::from_fn(|i, _| readings[3 + i] - self.value[3 + i]);
        let (rotation, position) = ((back * turned(readings)).scaled_axis(), back * moved);
        let error = Vector6::from_fn(|i, _| if i < 3 { rotation[i] } else { position[i - 3] });
        let white = inverse * error;
        // The error is the reading minus the value.
        self.value.iter_mut().zip(readings.iter().zip(&white)).for_each(|(value, (read, white))| *value = read - white);
        for column in self.by_q.chunks_exact_mut(6) {
            let white = inverse * Vector6::from_column_slice(column);
            column.copy_from_slice(white.as_slice());
        }
    }

    /// Adds the derivatives of component `i` by error and torque noise to a row of H, which is stored by columns.
    /// `flow` holds the derivatives of qdd.
    pub(super) fn write(&self, plan: &Plan, i: usize, flow: &[f64], (row, stride): (&mut [f64], usize)) {
        for k in 0..self.nv {
            let at = k * self.size + i;
            row[(plan.q() + k) * stride] += self.by_q[at];
            row[(plan.qd() + k) * stride] += self.by_qd[at];
            if self.has_noise {
                row[(plan.states + k) * stride] += self.by_noise[at];
            }
        }
        if self.has_qdd {
            for (column, by) in flow.chunks_exact(plan.flow_stride().max(1)).enumerate() {
                let along: f64 = (0..self.nv).map(|k| self.by_qdd[k * self.size + i] * by[k]).sum();
                row[column * stride] += along;
            }
        }
    }
}
