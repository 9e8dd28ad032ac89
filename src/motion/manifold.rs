//! Configurations in lanes: steps along velocities, displacements, and velocities seen from where a step began.
//!
//! [`Scene::integrate`](crate::Scene::integrate) and [`Scene::difference`](crate::Scene::difference) are the same for one checked state; here
//! nothing branches on values, and only sums, products, quotients, roots, sines and cosines are used.

use crate::kinematics::quaternion_rotation;
use crate::model::{Model, Motion};
use crate::scalar::Real;
use crate::spatial::RigidShift;
use nalgebra::Vector3;

type Quaternion<T> = [T; 4];

/// Three numbers of a slice as a vector.
#[inline(always)]
pub(super) fn triple<T: Real>(x: &[T]) -> Vector3<T> {
    Vector3::new(x[0], x[1], x[2])
}

#[inline(always)]
pub(super) fn cross<T: Real>(a: &Vector3<T>, b: &Vector3<T>) -> Vector3<T> {
    Vector3::new(
        (a[1] * b[2]).minus_product(a[2], b[1]),
        (a[2] * b[0]).minus_product(a[0], b[2]),
        (a[0] * b[1]).minus_product(a[1], b[0]),
    )
}

/// a + s b.
#[inline(always)]
pub(super) fn plus<T: Real>(a: &Vector3<T>, s: T, b: &Vector3<T>) -> Vector3<T> {
    Vector3::new(s.mul_add(b[0], a[0]), s.mul_add(b[1], a[1]), s.mul_add(b[2], a[2]))
}

#[inline(always)]
pub(super) fn write<T: Real>(to: &mut [T], x: &Vector3<T>) {
    to[0] = x[0];
    to[1] = x[1];
    to[2] = x[2];
}

/// x / y, and `limit` where y is zero.
#[inline(always)]
fn quotient<T: Real>(x: T, y: T, limit: f64) -> T {
    let o = y.one_if_zero();
    (x + o * x.constant(limit)) / (y + o)
}

/// The product of two quaternions (x, y, z, w).
#[inline(always)]
fn multiply<T: Real>(a: &Quaternion<T>, b: &Quaternion<T>) -> Quaternion<T> {
    [
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    ]
}

#[inline(always)]
fn normalised<T: Real>(q: &Quaternion<T>) -> Quaternion<T> {
    let s = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt().recip();
    [q[0] * s, q[1] * s, q[2] * s, q[3] * s]
}

/// A rotation vector's quaternion, and b = (1 - cos t)/t^2, c = (t - sin t)/t^3 of its length t.
///
/// What cancels in c for a small t is multiplied by t^2 wherever c is used.
#[inline(always)]
fn exponential<T: Real>(w: &Vector3<T>) -> (Quaternion<T>, T, T) {
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

/// q exp(v), joint by joint: from `q` (nq) along `v` (nv) for unit time; quaternions come out unit.
#[inline(always)]
pub fn advance<T: Real>(model: &Model<T>, q: &[T], v: &[T], out: &mut [T]) {
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        let (at, row) = (body.q, stage.first_row);
        match body.motion {
            Motion::Fixed => {}
            Motion::Spherical => {
                let (turn, _, _) = exponential(&triple(&v[row..]));
                let turned = normalised(&multiply(&[q[at], q[at + 1], q[at + 2], q[at + 3]], &turn));
                out[at..at + 4].copy_from_slice(&turned);
            }
            Motion::Free => {
                let (linear, angular) = (triple(&v[row..]), triple(&v[row + 3..]));
                let (turn, b, c) = exponential(&angular);
                let once = cross(&angular, &linear);
                let along = plus(&plus(&linear, b, &once), c, &cross(&angular, &once));
                let moved = rotation(&q[at + 3..at + 7]).rotate(&along);
                write(&mut out[at..], &plus(&triple(&q[at..]), q[at].constant(1.0), &moved));
                let start = [q[at + 3], q[at + 4], q[at + 5], q[at + 6]];
                out[at + 3..at + 7].copy_from_slice(&normalised(&multiply(&start, &turn)));
            }
            _ => out[at] = q[at] + v[row],
        }
    }
}

/// The rotation of a quaternion, without a lever.
#[inline(always)]
fn rotation<T: Real>(q: &[T]) -> RigidShift<T> {
    let o = q[0].constant(0.0);
    RigidShift { rotation: quaternion_rotation(q), lever: Vector3::new(o, o, o) }
}

/// The rate of the increment x, q = q0 exp(x), where the body moves with the velocity `v` at q: the inverse of the exponential's
/// derivative, v + [x, v]/2 + [x, [x, v]]/12, exact to the third power of x. In place; joints whose motions commute have it as it is.
#[inline(always)]
pub(super) fn carry_back<T: Real>(model: &Model<T>, x: &[T], v: &mut [T]) {
    for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
        let row = stage.first_row;
        match body.motion {
            Motion::Spherical => {
                let (w, u) = (triple(&x[row..]), triple(&v[row..]));
                let once = cross(&w, &u);
                let half = plus(&u, u[0].constant(0.5), &once);
                write(&mut v[row..], &plus(&half, u[0].constant(1.0 / 12.0), &cross(&w, &once)));
            }
            Motion::Free => {
                let (a, w) = (triple(&x[row..]), triple(&x[row + 3..]));
                let (linear, angular) = (triple(&v[row..]), triple(&v[row + 3..]));
                let one = linear[0].constant(1.0);
                let (half, twelfth) = (one.constant(0.5), one.constant(1.0 / 12.0));
                // [(a, w), (b, u)] = (w x b + a x u, w x u).
                let (once, turned) = (plus(&cross(&w, &linear), one, &cross(&a, &angular)), cross(&w, &angular));
                let (twice, twice_turned) = (plus(&cross(&w, &once), one, &cross(&a, &turned)), cross(&w, &turned));
                write(&mut v[row..], &plus(&plus(&linear, half, &once), twelfth, &twice));
                write(&mut v[row + 3..], &plus(&plus(&angular, half, &turned), twelfth, &twice_turned));
            }
            _ => {}
        }
    }
}

/// How far one joint is from rest, in the child's frame: a difference of coordinates; the rotation vector from rest, at most pi
/// long; for a free joint the displacement, then that vector. Minus this is the gradient of half its square.
#[inline(always)]
pub fn displacement<T: Real>(motion: &Motion<T>, rest: &[T], q: &[T], out: &mut [T]) {
    match motion {
        Motion::Fixed => {}
        Motion::Spherical => write(out, &turn_between(rest, q)),
        Motion::Free => {
            let minus_one = q[0].constant(-1.0);
            let moved = plus(&triple(q), minus_one, &triple(rest));
            write(out, &rotation(&q[3..7]).rotate_back(&moved));
            write(&mut out[3..], &turn_between(&rest[3..7], &q[3..7]));
        }
        _ => out[0] = q[0] - rest[0],
    }
}

/// Halvings of an angle before its tangent's series is used.
const HALVINGS: usize = 4;

/// The rotation vector from one quaternion to another, the short way.
///
/// With (v, w) the quaternion between them, w not negative, the angle is 2 atan2(|v|, w): each halving takes (v, w) to
/// (v, w + 1), and what is left, a tangent below 1/10, goes through the series of the arc tangent.
#[inline(always)]
fn turn_between<T: Real>(from: &[T], to: &[T]) -> Vector3<T> {
    let one = to[0].constant(1.0);
    let [x, y, z, w] = normalised(&multiply(&[-from[0], -from[1], -from[2], from[3]], &[to[0], to[1], to[2], to[3]]));
    let sign = quotient(w, w.abs(), 1.0);
    let (mut v, mut w) = (Vector3::new(x * sign, y * sign, z * sign), w.abs());
    for _ in 0..HALVINGS {
        // (v, w + 1) is along the root of a unit quaternion; its square is 2 (w + 1).
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
