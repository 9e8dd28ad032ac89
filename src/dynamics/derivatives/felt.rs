//! What a unit of one degree of freedom lets all bodies outboard of it feel.

use super::Matrices;
use super::hinge::{along, halves, moment_along, motion_cross_hinge};
use crate::filter::HingeMap;
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::{cross_motion, dot};
use nalgebra::Vector6;

/// Of one degree of freedom with the column S, at its body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Felt<T> {
    /// The angular half of Psi1 = `V_p` x S, a velocity by q; its linear half nobody reads.
    pub velocity: [T; 3],
    /// Psi2 = `A_p` x S + `V_p` x Psi1, an acceleration by q.
    pub acceleration: [T; 6],
    /// Psi1 + V x S, an acceleration by qd. Of the Coriolis matrix V x S alone.
    pub by_rate: [T; 6],
}

impl<T: Real> Felt<T> {
    pub fn filled(value: T) -> Self {
        Self { velocity: [value; 3], acceleration: [value; 6], by_rate: [value; 6] }
    }

    /// From the parent's motion as seen at the joint, weight included, and the body's own velocity; S is `sense` times the row.
    #[inline(always)]
    pub fn new(
        (hinge, sense): (&HingeMap<T>, T),
        [velocity, acceleration]: &[[T; 6]; 2],
        own: &[T; 6],
        matrices: Matrices,
    ) -> Self {
        let turned = motion_cross_hinge(velocity, hinge);
        let twice = cross_motion(&Vector6::from(*velocity), &Vector6::from(turned));
        let (at_base, mut by_rate) = (motion_cross_hinge(acceleration, hinge), motion_cross_hinge(own, hinge));
        let mut felt = [sense; 6];
        for i in 0..6 {
            felt[i] = sense * (at_base[i] + twice[i]);
            if matrices == Matrices::Derivatives {
                by_rate[i] += turned[i];
            }
            by_rate[i] *= sense;
        }
        let ([x, y, z], _) = halves(&turned);
        Self { velocity: [sense * x, sense * y, sense * z], acceleration: felt, by_rate }
    }

    /// The same for columns side by side.
    #[inline(always)]
    pub fn spread<C: ColumnsOf<T>>(&self, like: C) -> Felt<C> {
        let mut spread = Felt::filled(like);
        for i in 0..3 {
            spread.velocity[i] = like.spread(self.velocity[i]);
        }
        for i in 0..6 {
            spread.acceleration[i] = like.spread(self.acceleration[i]);
            spread.by_rate[i] = like.spread(self.by_rate[i]);
        }
        spread
    }
}

/// What one degree of freedom, with the column S, makes of the force through each joint inboard of it: r S (6), B* S (a moment, 3), the force by q (6) and the force
/// by qd (6), one after another.
pub(super) type Column<T> = [T; 21];

/// Those four as one.
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

/// The four of one.
#[inline(always)]
pub(super) fn parts<T: Copy>(column: &Column<T>) -> ([T; 6], [T; 3], [T; 6], [T; 6]) {
    let [a, b, c, d, e, f, x, y, z, g, h, i, j, k, l, m, n, o, p, q, r] = *column;
    ([a, b, c, d, e, f], [x, y, z], [g, h, i, j, k, l], [m, n, o, p, q, r])
}

/// The entries that a column has in the row of a joint inboard, by q, by qd and by qdd: H of each force.
#[inline(always)]
pub(super) fn in_row<T: Real>(column: &Column<T>, hinge: &HingeMap<T>, sense: T) -> [T; 3] {
    let (by_acceleration, _, by_position, by_rate) = parts(column);
    [sense * along(hinge, &by_position), sense * along(hinge, &by_rate), sense * along(hinge, &by_acceleration)]
}

/// The entries that a column's own row has in the columns of that joint, by q and by qd: what that lets this one's bodies feel.
#[inline(always)]
pub(super) fn in_column<T: Real>(column: &Column<T>, felt: &Felt<T>, hinge: &HingeMap<T>, sense: T) -> [T; 2] {
    let (by_acceleration, m, _, _) = parts(column);
    let (force, v) = (Vector6::from(by_acceleration), &felt.velocity);
    let turned = m[0].mul_add(v[0], m[1].mul_add(v[1], m[2] * v[2]));
    [
        dot(&force, &Vector6::from(felt.acceleration)) + turned,
        sense.mul_add(moment_along(hinge, &m), dot(&force, &Vector6::from(felt.by_rate))),
    ]
}
