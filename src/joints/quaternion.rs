//! Vectorized operations on rotations as quaternions (x, y, z, w): without branches on values, and with sums, products,
//! quotients, square roots, sines and cosines only.

use crate::scalar::Real;
use crate::spatial::RigidShift;
use nalgebra::{Matrix3, Vector3};

/// Largest accepted deviation of the norm of a quaternion from 1.
pub const QUATERNION_SLACK: f64 = 1e-3;

/// Rotation matrix of a quaternion (x, y, z, w), normalized by its squared norm.
#[inline(always)]
pub fn quaternion_rotation<T: Real>(q: &[T]) -> Matrix3<T> {
    let (x, y, z, w) = (q[0], q[1], q[2], q[3]);
    let one = x.constant(1.0);
    let two = one + one;
    let s = two / (x * x + y * y + z * z + w * w);
    Matrix3::new(
        one - s * (y * y + z * z),
        s * (x * y - z * w),
        s * (x * z + y * w),
        s * (x * y + z * w),
        one - s * (x * x + z * z),
        s * (y * z - x * w),
        s * (x * z - y * w),
        s * (y * z + x * w),
        one - s * (x * x + y * y),
    )
}

/// A quaternion.
pub type Quaternion<T> = [T; 4];

/// x / y, and `limit` where y is zero.
#[inline(always)]
pub(super) fn quotient<T: Real>(x: T, y: T, limit: f64) -> T {
    let o = y.one_if_zero();
    (x + o * x.constant(limit)) / (y + o)
}

/// The product of two quaternions (x, y, z, w).
#[inline(always)]
pub(super) fn multiply<T: Real>(a: &Quaternion<T>, b: &Quaternion<T>) -> Quaternion<T> {
    [
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    ]
}

#[inline(always)]
pub(super) fn normalized<T: Real>(q: &Quaternion<T>) -> Quaternion<T> {
    let s = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt().recip();
    [q[0] * s, q[1] * s, q[2] * s, q[3] * s]
}

/// The quaternion of a rotation vector, and b = (1 - cos t)/t^2, c = (t - sin t)/t^3 for its norm t.
///
/// The cancellation in c for small t is harmless, because c is always multiplied by t^2.
#[inline(always)]
pub(super) fn exponential<T: Real>(w: &Vector3<T>) -> (Quaternion<T>, T, T) {
    let half = w[0].constant(0.5);
    let t = (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]).sqrt();
    let (sine, cosine) = (half * t).sin_cos();
    let sinc = quotient(sine, half * t, 1.0);
    let scale = half * sinc;
    let b = half * sinc * sinc;
    // sin t from the half angle.
    let c = quotient(t - (sine + sine) * cosine, t * t * t, 0.0);
    ([w[0] * scale, w[1] * scale, w[2] * scale, cosine], b, c)
}

/// The rotation of a quaternion, with a zero lever.
#[inline(always)]
pub(crate) fn rotation<T: Real>(q: &[T]) -> RigidShift<T> {
    let o = q[0].constant(0.0);
    RigidShift { rotation: quaternion_rotation(q), lever: Vector3::new(o, o, o) }
}

/// Number of halvings of an angle before the series of the arc tangent is used.
const HALVINGS: usize = 4;

/// The rotation vector from one quaternion to another along the shortest path.
///
/// For the quaternion (v, w) between them with w >= 0, the angle is 2 atan2(|v|, w). Each halving replaces (v, w) by
/// (v, w + 1); the series of the arc tangent evaluates the remaining tangent, which is below 1/10.
#[inline(always)]
pub(super) fn turn_between<T: Real>(from: &[T], to: &[T]) -> Vector3<T> {
    let one = to[0].constant(1.0);
    let [x, y, z, w] = normalized(&multiply(&[-from[0], -from[1], -from[2], from[3]], &[to[0], to[1], to[2], to[3]]));
    let sign = quotient(w, w.abs(), 1.0);
    let (mut v, mut w) = (Vector3::new(x * sign, y * sign, z * sign), w.abs());
    for _ in 0..HALVINGS {
        // (v, w + 1) is parallel to the square root of a unit quaternion; its squared norm is 2 (w + 1).
        let scale = (w + one + w + one).sqrt().recip();
        w = (w + one) * scale;
        v = Vector3::new(v[0] * scale, v[1] * scale, v[2] * scale);
    }
    let over = w.recip();
    let v = Vector3::new(v[0] * over, v[1] * over, v[2] * over);
    let square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    // atan(x)/x = 1 - x^2/3 + x^4/5 - ..., x^2 < 0.0098.
    let mut series = one.constant(1.0 / 17.0);
    for odd in [-15.0, 13.0, -11.0, 9.0, -7.0, 5.0, -3.0, 1.0] {
        series = series.mul_add(square, one.constant(1.0 / odd));
    }
    let scale = series * one.constant(f64::from(2 << HALVINGS));
    Vector3::new(v[0] * scale, v[1] * scale, v[2] * scale)
}
