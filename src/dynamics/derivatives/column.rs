//! The change of the forces inboard of one degree of freedom, and the matrix entries that result.

use super::effect::Effect;
use super::hinge::{along, moment_along};
use crate::filter::HingeMap;
use crate::scalar::Real;
use crate::spatial::dot;
use nalgebra::Vector6;

/// The contributions of one degree of freedom with the column S to the force through each joint inboard of it: r S (6),
/// B* S (a moment, 3), the derivatives of the force by q (6) and by qd (6), one after another.
pub(super) type Column<T> = [T; 21];

/// Concatenates the four parts.
#[inline(always)]
pub(super) fn column<T: Copy>(
    by_acceleration: &[T; 6],
    moment: &[T; 3],
    by_position: &[T; 6],
    by_rate: &[T; 6],
) -> Column<T> {
    let ([a, b, c, d, e, f], [x, y, z]) = (*by_acceleration, *moment);
    let ([g, h, i, j, k, l], [m, n, o, p, q, r]) = (*by_position, *by_rate);
    [a, b, c, d, e, f, x, y, z, g, h, i, j, k, l, m, n, o, p, q, r]
}

/// Splits a column into its four parts.
#[inline(always)]
pub(super) fn parts<T: Copy>(column: &Column<T>) -> ([T; 6], [T; 3], [T; 6], [T; 6]) {
    let [a, b, c, d, e, f, x, y, z, g, h, i, j, k, l, m, n, o, p, q, r] = *column;
    ([a, b, c, d, e, f], [x, y, z], [g, h, i, j, k, l], [m, n, o, p, q, r])
}

/// The entries of a column in the row of a joint inboard, by q, by qd and by qdd: H times each force.
#[inline(always)]
pub(super) fn in_row<T: Real>(column: &Column<T>, hinge: &HingeMap<T>, sense: T) -> [T; 3] {
    let (by_acceleration, _, by_position, by_rate) = parts(column);
    [sense * along(hinge, &by_position), sense * along(hinge, &by_rate), sense * along(hinge, &by_acceleration)]
}

/// The entries of the column's own row in the columns of that joint, by q and by qd: the forces needed by the changes
/// that the joint causes, projected on S.
#[inline(always)]
pub(super) fn in_column<T: Real>(column: &Column<T>, effect: &Effect<T>, hinge: &HingeMap<T>, sense: T) -> [T; 2] {
    let (by_acceleration, m, _, _) = parts(column);
    let (force, v) = (Vector6::from(by_acceleration), &effect.velocity);
    let turned = m[0].mul_add(v[0], m[1].mul_add(v[1], m[2] * v[2]));
    [
        dot(&force, &Vector6::from(effect.acceleration)) + turned,
        sense.mul_add(moment_along(hinge, &m), dot(&force, &Vector6::from(effect.by_rate))),
    ]
}
