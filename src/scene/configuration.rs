//! Configurations as a manifold: the neutral one, steps along velocities, and the velocity between two.

use super::{Joint, JointKind, Scene};
use crate::error::{Error, check_length};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

impl Scene {
    /// The neutral configuration: zero everywhere, the identity for quaternions.
    #[must_use]
    pub fn neutral(&self) -> Vec<f64> {
        self.joints().iter().flat_map(|joint| joint.kind.neutral()).collect()
    }

    /// The configuration reached from `q` by the constant velocity `v` in unit time; quaternions come out unit.
    ///
    /// A spherical joint turns by exp of its rate in its own frame; a free joint moves along the screw of its twist (SE(3)).
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn integrate(&self, q: &[f64], v: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.check_configuration("q", q)?;
        self.check_rates("v", v)?;
        check_length("out", out.len(), self.nq())?;
        for joint in self.joints() {
            integrate_joint(joint, &q[joint.q.clone()], &v[joint.v.clone()], &mut out[joint.q.clone()]);
        }
        Ok(())
    }

    /// The velocity that takes `q0` to `q1` in unit time, the inverse of [`Scene::integrate`]; rotations the short way.
    ///
    /// # Errors
    ///
    /// Wrong lengths and numbers that are not finite.
    pub fn difference(&self, q0: &[f64], q1: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.check_configuration("q0", q0)?;
        self.check_configuration("q1", q1)?;
        check_length("out", out.len(), self.nv())?;
        for joint in self.joints() {
            difference_joint(joint, &q0[joint.q.clone()], &q1[joint.q.clone()], &mut out[joint.v.clone()]);
        }
        Ok(())
    }
}

fn quaternion(q: &[f64]) -> UnitQuaternion<f64> {
    UnitQuaternion::new_normalize(Quaternion::new(q[3], q[0], q[1], q[2]))
}

fn integrate_joint(joint: &Joint, q: &[f64], v: &[f64], out: &mut [f64]) {
    match joint.kind {
        JointKind::Spherical => {
            let turned = quaternion(q) * exponential(&Vector3::new(v[0], v[1], v[2]));
            out.copy_from_slice(turned.coords.normalize().as_slice());
        }
        JointKind::Floating => {
            let (linear, angular) = (Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5]));
            let start = quaternion(&q[3..]);
            let moved = Vector3::new(q[0], q[1], q[2]) + start * left_jacobian_times(&angular, &linear);
            out[..3].copy_from_slice(moved.as_slice());
            out[3..].copy_from_slice((start * exponential(&angular)).coords.normalize().as_slice());
        }
        _ => {
            for ((out, q), v) in out.iter_mut().zip(q).zip(v) {
                *out = q + v;
            }
        }
    }
}

fn difference_joint(joint: &Joint, q0: &[f64], q1: &[f64], out: &mut [f64]) {
    match joint.kind {
        JointKind::Spherical => {
            out.copy_from_slice(logarithm(&(quaternion(q0).inverse() * quaternion(q1))).as_slice());
        }
        JointKind::Floating => {
            let start = quaternion(&q0[3..]);
            let angular = logarithm(&(start.inverse() * quaternion(&q1[3..])));
            let moved = Vector3::new(q1[0] - q0[0], q1[1] - q0[1], q1[2] - q0[2]);
            let linear = left_jacobian_inverse_times(&angular, &(start.inverse() * moved));
            out[..3].copy_from_slice(linear.as_slice());
            out[3..].copy_from_slice(angular.as_slice());
        }
        _ => {
            for ((out, q0), q1) in out.iter_mut().zip(q0).zip(q1) {
                *out = q1 - q0;
            }
        }
    }
}

/// sin(x)/x.
fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-4 { 1.0 - x * x / 6.0 } else { x.sin() / x }
}

/// The unit quaternion of a rotation vector.
fn exponential(w: &Vector3<f64>) -> UnitQuaternion<f64> {
    let half = 0.5 * w.norm();
    let vector = w * (0.5 * sinc(half));
    UnitQuaternion::new_normalize(Quaternion::from_parts(half.cos(), vector))
}

/// The rotation vector of a unit quaternion, of length at most pi.
fn logarithm(q: &UnitQuaternion<f64>) -> Vector3<f64> {
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    let vector = q.imag() * sign;
    let sine = vector.norm();
    let angle = 2.0 * sine.atan2(q.w * sign);
    // angle / sin(angle / 2) tends to 2.
    if sine < 1e-9 { vector * 2.0 } else { vector * (angle / sine) }
}

/// (1 - cos t)/t^2 and (t - sin t)/t^3.
fn screw_coefficients(t: f64) -> (f64, f64) {
    let half = sinc(0.5 * t);
    let second = 0.5 * half * half;
    let third = if t < 0.1 {
        let t2 = t * t;
        1.0 / 6.0 - t2 / 120.0 * (1.0 - t2 / 42.0 * (1.0 - t2 / 72.0 * (1.0 - t2 / 110.0)))
    } else {
        (t - t.sin()) / (t * t * t)
    };
    (second, third)
}

/// The displacement of a body that turns by `w` while its own frame moves by `v`: (1 + b w~ + c w~ w~) v.
fn left_jacobian_times(w: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    let (b, c) = screw_coefficients(w.norm());
    let once = w.cross(v);
    v + once * b + w.cross(&once) * c
}

/// The inverse of [`left_jacobian_times`] in `v`: (1 - w~/2 + d w~ w~) u.
fn left_jacobian_inverse_times(w: &Vector3<f64>, u: &Vector3<f64>) -> Vector3<f64> {
    let (b, c) = screw_coefficients(w.norm());
    // d = (1 - a/(2b))/t^2 with a = sinc t = 1 - c t^2 and 2 b = sinc(t/2)^2; written without the division by t^2.
    let d = (2.0 * c - squared_defect(w.norm())) / (4.0 * b);
    let once = w.cross(u);
    u - once * 0.5 + w.cross(&once) * d
}

/// (1 - 2 b)/t^2 times 2, with 2 b = sinc(t/2)^2.
fn squared_defect(t: f64) -> f64 {
    if t < 0.1 {
        let t2 = t * t;
        1.0 / 6.0 - t2 / 180.0 * (1.0 - t2 / 56.0 * (1.0 - t2 / 90.0))
    } else {
        let half = sinc(0.5 * t);
        2.0 * (1.0 - half * half) / (t * t)
    }
}
