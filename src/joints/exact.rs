//! Operations on checked configurations of one state, with branches on values that keep full precision for small
//! angles.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// A quaternion of a configuration, normalized.
pub(super) fn quaternion(q: &[f64]) -> UnitQuaternion<f64> {
    UnitQuaternion::new_normalize(Quaternion::new(q[3], q[0], q[1], q[2]))
}

/// sin(x)/x.
fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-4 { 1.0 - x * x / 6.0 } else { x.sin() / x }
}

/// The unit quaternion of a rotation vector.
pub(super) fn exponential(w: &Vector3<f64>) -> UnitQuaternion<f64> {
    let half = 0.5 * w.norm();
    let vector = w * (0.5 * sinc(half));
    UnitQuaternion::new_normalize(Quaternion::from_parts(half.cos(), vector))
}

/// The rotation vector of a unit quaternion, with norm at most pi.
pub(super) fn logarithm(q: &UnitQuaternion<f64>) -> Vector3<f64> {
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

/// Displacement of a body that rotates by `w` while it moves by `v` in its body frame: (1 + b w~ + c w~ w~) v.
pub(super) fn left_jacobian_times(w: &Vector3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    let (b, c) = screw_coefficients(w.norm());
    let once = w.cross(v);
    v + once * b + w.cross(&once) * c
}

/// The inverse of [`left_jacobian_times`] in `v`: (1 - w~/2 + d w~ w~) u.
pub(super) fn left_jacobian_inverse_times(w: &Vector3<f64>, u: &Vector3<f64>) -> Vector3<f64> {
    let (b, c) = screw_coefficients(w.norm());
    // d = (1 - a/(2b))/t^2 with a = sinc t = 1 - c t^2 and 2 b = sinc(t/2)^2, written without the division by t^2.
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
