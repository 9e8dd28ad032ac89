//! Spherical joint: quaternion (x, y, z, w); joint velocities are the angular velocity in the child frame.

use super::exact;
use super::quaternion::{exponential, multiply, normalized, quaternion_rotation, turn_between};
use super::vectors::{cross, plus, triple, write};
use crate::scalar::Real;
use crate::spatial::{RigidShift, product};
use nalgebra::Vector3;

/// phi at this quaternion.
#[inline(always)]
pub(super) fn shift<T: Real>(tree: &RigidShift<T>, q: &[T]) -> RigidShift<T> {
    RigidShift { rotation: product(&tree.rotation, &quaternion_rotation(q)), lever: tree.lever }
}

/// dq/dt for this angular velocity: half of q times it.
pub(super) fn coordinate_rates<T: Real>(q: &[T], w: &[T], rates: &mut [T]) {
    let half = T::from_f64(0.5);
    rates[0] = half * (q[3] * w[0] + q[1] * w[2] - q[2] * w[1]);
    rates[1] = half * (q[3] * w[1] + q[2] * w[0] - q[0] * w[2]);
    rates[2] = half * (q[3] * w[2] + q[0] * w[1] - q[1] * w[0]);
    rates[3] = -(half * (q[0] * w[0] + q[1] * w[1] + q[2] * w[2]));
}

/// q exp(v), normalized.
#[inline(always)]
pub(super) fn advance<T: Real>(q: &[T], v: &[T], out: &mut [T]) {
    let (turn, _, _) = exponential(&triple(v));
    out[..4].copy_from_slice(&normalized(&multiply(&[q[0], q[1], q[2], q[3]], &turn)));
}

/// The time derivative of an increment x for the angular velocity v: see
/// [`Motion::carry_back`](super::Motion::carry_back).
#[inline(always)]
pub(super) fn carry_back<T: Real>(x: &[T], v: &mut [T]) {
    let (w, u) = (triple(x), triple(v));
    let once = cross(&w, &u);
    let half = plus(&u, u[0].constant(0.5), &once);
    write(v, &plus(&half, u[0].constant(1.0 / 12.0), &cross(&w, &once)));
}

/// The rotation vector from rest, with norm at most pi.
#[inline(always)]
pub(super) fn displacement<T: Real>(rest: &[T], q: &[T], out: &mut [T]) {
    write(out, &turn_between(rest, q));
}

/// As [`advance`], for a checked configuration.
pub(super) fn integrate(q: &[f64], v: &[f64], out: &mut [f64]) {
    let turned = exact::quaternion(q) * exact::exponential(&Vector3::new(v[0], v[1], v[2]));
    out.copy_from_slice(turned.coords.normalize().as_slice());
}

/// The inverse of [`integrate`] in v, along the shortest path.
pub(super) fn difference(q0: &[f64], q1: &[f64], out: &mut [f64]) {
    let between = exact::quaternion(q0).inverse() * exact::quaternion(q1);
    out.copy_from_slice(exact::logarithm(&between).as_slice());
}
