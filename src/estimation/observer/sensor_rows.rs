//! Predicted reading of a sensor, and its derivatives.

use super::link_motion::{LinkMotion, LinkPath};
use super::settings::{Plan, Reader, Source};
use crate::kinematics::{Frame, local_jacobian};
use crate::scene::Scene;
use nalgebra::{Matrix6, Rotation3, Vector3, Vector6};
use std::borrow::Cow;
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
    /// Jacobian of a frame, (6 x nv) of the tree.
    jacobian: Vec<f64>,
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
            jacobian: vec![0.0; 6 * scene.model().nv()],
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
        let (mut rows, mut motion) = (Self::new(reader.range.len(), scene), LinkMotion::new(scene.model().nv()));
        for [q, qd, qdd, tau] in states {
            scene.check_coordinates("q", &q)?;
            for (name, values) in [("qd", &qd), ("qdd", &qdd), ("tau", &tau)] {
                crate::error::check_length(name, values.len(), nv)?;
            }
            rows.evaluate(scene, &mut motion, &reader, (&q, &qd, &qdd), &tau);
            each(&rows);
        }
        Ok(())
    }

    /// The sensor at a state; only accelerometers read `qdd`.
    pub(super) fn evaluate(
        &mut self,
        scene: &Scene,
        motion: &mut LinkMotion<f64>,
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
        let coupling = scene.coupling();
        let mut moving = |frame: &Frame<f64>, path: &LinkPath, qdd: Option<&[f64]>| match coupling {
            None => motion.evaluate(scene.model(), (frame, path), (q, qd, qdd)),
            Some(coupling) => {
                let (q, qd, qdd) = (coupling.configuration(q), coupling.rates(qd), qdd.map(|x| coupling.rates(x)));
                motion.evaluate(scene.model(), (frame, path), (&q, &qd, qdd.as_deref()));
            }
        };
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
            Source::Gyro(frame, path) => {
                moving(frame, path, None);
                self.velocity(motion, path, 0);
            }
            Source::Contact(frame, path) => {
                moving(frame, path, None);
                self.velocity(motion, path, 3);
            }
            Source::Pose(frame, _) => {
                let q = coupling.map_or(Cow::Borrowed(q), |coupling| Cow::Owned(coupling.configuration(q)));
                let nv = scene.model().nv();
                let placement = local_jacobian(scene.model(), &q, frame, &mut self.jacobian);
                let turned = Rotation3::from_matrix_unchecked(placement.rotation).scaled_axis();
                self.value[..3].copy_from_slice(turned.as_slice());
                self.value[3..6].copy_from_slice(placement.lever.as_slice());
                for (i, row) in self.jacobian.chunks_exact(nv.max(1)).enumerate() {
                    for (k, entry) in row.iter().enumerate() {
                        self.by_q[6 * k + i] = *entry;
                    }
                }
            }
            Source::Accelerometer(frame, path) => {
                moving(frame, path, Some(qdd));
                self.has_qdd = true;
                self.value[..3].copy_from_slice(motion.acceleration.as_slice());
                for (p, &row) in path.rows.iter().enumerate() {
                    let at = 3 * row..3 * row + 3;
                    self.by_q[at.clone()].copy_from_slice(motion.acceleration_by_q[p].as_slice());
                    self.by_qd[at.clone()].copy_from_slice(motion.acceleration_by_qd[p].as_slice());
                    self.by_qdd[at].copy_from_slice(&motion.columns[p].as_slice()[3..]);
                }
            }
        }
        // Encoders and joint torques are those of the joints of the scene, and links move with all joints of the tree.
        let on_link = !matches!(sensor.source, Source::Encoder(..) | Source::JointTorque(..));
        if let Some(coupling) = coupling.filter(|_| on_link) {
            for matrix in [&mut self.by_q, &mut self.by_qd, &mut self.by_qdd] {
                std::mem::swap(matrix, &mut self.of_tree);
                coupling.reduce_rows(&self.of_tree[..size * scene.model().nv()], size, matrix);
            }
        }
    }

    /// The difference of a measured pose from the prediction, (rotation, position) in the axes of the predicted frame,
    /// and the derivatives, both in units of the deviations that the covariance has: changes value and `by_q`.
    pub(super) fn whiten_pose(&mut self, readings: &[f64], inverse: &Matrix6<f64>) {
        let turned = |x: &[f64]| Rotation3::new(Vector3::new(x[0], x[1], x[2]));
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

    /// The angular (first = 0) or linear (3) half of the velocity.
    fn velocity(&mut self, motion: &LinkMotion<f64>, path: &LinkPath, first: usize) {
        let half = first..first + 3;
        self.value[..3].copy_from_slice(&motion.velocity.as_slice()[half.clone()]);
        for (p, &row) in path.rows.iter().enumerate() {
            let at = 3 * row..3 * row + 3;
            self.by_q[at.clone()].copy_from_slice(&motion.velocity_by_q[p].as_slice()[half.clone()]);
            self.by_qd[at].copy_from_slice(&motion.columns[p].as_slice()[half.clone()]);
        }
    }

    /// Adds the derivatives of component `i` by error and torque noise to a row of H, which is stored by columns. `flow`
    /// holds the derivatives of qdd.
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
