//! Free joint: position, then quaternion (x, y, z, w). Joint velocities are the linear, then the angular velocity in
//! the child frame.

use super::quaternion::{exponential, multiply, normalized, quaternion_rotation, rotation, turn_between};
use super::vectors::{cross, plus, triple, write};
use super::{exact, spherical};
use crate::scalar::Real;
use crate::spatial::{RigidShift, product};
use nalgebra::Vector3;

/// phi at this position and quaternion.
#[inline(always)]
pub(super) fn shift<T: Real>(tree: &RigidShift<T>, q: &[T]) -> RigidShift<T> {
    RigidShift {
        rotation: product(&tree.rotation, &quaternion_rotation(&q[3..7])),
        lever: tree.rotate(&Vector3::new(q[0], q[1], q[2])) + tree.lever,
    }
}

/// dq/dt: the linear velocity in parent axes, and half the quaternion times the angular velocity.
pub(super) fn coordinate_rates<T: Real>(q: &[T], v: &[T], rates: &mut [T]) {
    let turned = rotation(&q[3..7]).rotate(&triple(v));
    rates[..3].copy_from_slice(turned.as_slice());
    spherical::coordinate_rates(&q[3..7], &v[3..6], &mut rates[3..7]);
}

/// Moves along the screw of the twist v for unit time; the resulting quaternion has unit norm.
#[inline(always)]
pub(super) fn advance<T: Real>(q: &[T], v: &[T], out: &mut [T]) {
    let (linear, angular) = (triple(v), triple(&v[3..]));
    let (turn, b, c) = exponential(&angular);
    let once = cross(&angular, &linear);
    let along = plus(&plus(&linear, b, &once), c, &cross(&angular, &once));
    let moved = rotation(&q[3..7]).rotate(&along);
    write(out, &plus(&triple(q), q[0].constant(1.0), &moved));
    out[3..7].copy_from_slice(&normalized(&multiply(&[q[3], q[4], q[5], q[6]], &turn)));
}

/// The time derivative of an increment x for the body velocity v: see
/// [`Motion::carry_back`](super::Motion::carry_back).
#[inline(always)]
pub(super) fn carry_back<T: Real>(x: &[T], v: &mut [T]) {
    let (a, w) = (triple(x), triple(&x[3..]));
    let (linear, angular) = (triple(v), triple(&v[3..]));
    let one = linear[0].constant(1.0);
    let (half, twelfth) = (one.constant(0.5), one.constant(1.0 / 12.0));
    // [(a, w), (b, u)] = (w x b + a x u, w x u).
    let (once, turned) = (plus(&cross(&w, &linear), one, &cross(&a, &angular)), cross(&w, &angular));
    let (twice, twice_turned) = (plus(&cross(&w, &once), one, &cross(&a, &turned)), cross(&w, &turned));
    write(v, &plus(&plus(&linear, half, &once), twelfth, &twice));
    write(&mut v[3..], &plus(&plus(&angular, half, &turned), twelfth, &twice_turned));
}

/// The displacement from rest, then the rotation vector, in the child frame.
#[inline(always)]
pub(super) fn displacement<T: Real>(rest: &[T], q: &[T], out: &mut [T]) {
    let moved = plus(&triple(q), q[0].constant(-1.0), &triple(rest));
    write(out, &rotation(&q[3..7]).rotate_back(&moved));
    write(&mut out[3..], &turn_between(&rest[3..7], &q[3..7]));
}

/// As [`advance`], for a checked configuration.
pub(super) fn integrate(q: &[f64], v: &[f64], out: &mut [f64]) {
    let (linear, angular) = (Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5]));
    let start = exact::quaternion(&q[3..]);
    let moved = Vector3::new(q[0], q[1], q[2]) + start * exact::left_jacobian_times(&angular, &linear);
    out[..3].copy_from_slice(moved.as_slice());
    out[3..].copy_from_slice((start * exact::exponential(&angular)).coords.normalize().as_slice());
}

/// The inverse of [`integrate`] in v; rotations take the shortest path.
pub(super) fn difference(q0: &[f64], q1: &[f64], out: &mut [f64]) {
    let start = exact::quaternion(&q0[3..]);
    let angular = exact::logarithm(&(start.inverse() * exact::quaternion(&q1[3..])));
    let moved = Vector3::new(q1[0] - q0[0], q1[1] - q0[1], q1[2] - q0[2]);
    let linear = exact::left_jacobian_inverse_times(&angular, &(start.inverse() * moved));
    out[..3].copy_from_slice(linear.as_slice());
    out[3..].copy_from_slice(angular.as_slice());
}
