//! One degree of freedom: products with its row of H*, which has one entry of 1 (a screw has two entries), so that most
//! of them are permutations; the changes of the motion of the bodies outboard of it per unit of it, in the frames of
//! those bodies ([`Effect`]); and the change of the forces inboard of it, with the matrix entries that result
//! ([`Column`]).

use crate::filter::HingeMap;
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::{cross_motion, dot};
use nalgebra::Vector6;

/// w x `e_i`.
#[inline(always)]
pub(super) fn cross_axis<T: Real>(w: [T; 3], i: usize) -> [T; 3] {
    let o = w[0].constant(0.0);
    match i {
        0 => [o, w[2], -w[1]],
        1 => [-w[2], o, w[0]],
        _ => [w[1], -w[0], o],
    }
}

/// -a.
#[inline(always)]
pub(super) fn minus<T: Real>([x, y, z]: [T; 3]) -> [T; 3] {
    [-x, -y, -z]
}

/// a + s b.
#[inline(always)]
pub(super) fn plus<T: Real>(a: [T; 3], s: T, b: [T; 3]) -> [T; 3] {
    [s.mul_add(b[0], a[0]), s.mul_add(b[1], a[1]), s.mul_add(b[2], a[2])]
}

/// A vector from its two halves.
#[inline(always)]
pub(super) fn whole<T: Copy>(angular: [T; 3], linear: [T; 3]) -> [T; 6] {
    [angular[0], angular[1], angular[2], linear[0], linear[1], linear[2]]
}

/// The angular and the linear half.
#[inline(always)]
pub(super) fn halves<T: Copy>(x: &[T; 6]) -> ([T; 3], [T; 3]) {
    ([x[0], x[1], x[2]], [x[3], x[4], x[5]])
}

/// H f.
#[inline(always)]
pub(super) fn along<T: Real>(hinge: &HingeMap<T>, f: &[T; 6]) -> T {
    match *hinge {
        HingeMap::Axis(i) => f[i],
        HingeMap::Screw(pitch) => pitch.mul_add(f[5], f[2]),
    }
}

/// H (n, 0): of a moment.
#[inline(always)]
pub(super) fn moment_along<T: Real>(hinge: &HingeMap<T>, n: &[T; 3]) -> T {
    match *hinge {
        HingeMap::Axis(i) if i < 3 => n[i],
        HingeMap::Axis(_) => n[0].constant(0.0),
        HingeMap::Screw(_) => n[2],
    }
}

/// v x S of a motion v, S the row as a column.
#[inline(always)]
pub(super) fn motion_cross_hinge<T: Real>(v: &[T; 6], hinge: &HingeMap<T>) -> [T; 6] {
    let (w, u) = halves(v);
    match *hinge {
        HingeMap::Axis(i) if i < 3 => whole(cross_axis(w, i), cross_axis(u, i)),
        HingeMap::Axis(i) => whole([w[0].constant(0.0); 3], cross_axis(w, i - 3)),
        HingeMap::Screw(pitch) => {
            let turn = cross_axis(w, 2);
            whole(turn, plus(cross_axis(u, 2), pitch, turn))
        }
    }
}

/// S x* f of a force f.
#[inline(always)]
pub(super) fn hinge_cross_force<T: Real>(hinge: &HingeMap<T>, f: &[T; 6]) -> [T; 6] {
    let (n, p) = halves(f);
    match *hinge {
        HingeMap::Axis(i) if i < 3 => whole(minus(cross_axis(n, i)), minus(cross_axis(p, i))),
        HingeMap::Axis(i) => whole(minus(cross_axis(p, i - 3)), [n[0].constant(0.0); 3]),
        HingeMap::Screw(pitch) => {
            let push = cross_axis(p, 2);
            whole(minus(plus(cross_axis(n, 2), pitch, push)), minus(push))
        }
    }
}

/// The matrices that the columns form.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Matrices {
    /// dtau/dq and dtau/dqd.
    Derivatives,
    /// The Coriolis matrix in the place of dtau/dqd: B/2 for B, and V x S for Psi1 + V x S. The place of dtau/dq is
    /// undefined.
    Coriolis,
}

/// The effect of one degree of freedom with the column S, at its body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Effect<T> {
    /// The angular half of Psi1 = `V_p` x S, the derivative of the velocity by q. The linear half is not used.
    pub velocity: [T; 3],
    /// Psi2 = `A_p` x S + `V_p` x Psi1, the derivative of the acceleration by q.
    pub acceleration: [T; 6],
    /// Psi1 + V x S, the derivative of the acceleration by qd. For the Coriolis matrix V x S only.
    pub by_rate: [T; 6],
}

impl<T: Real> Effect<T> {
    pub fn filled(value: T) -> Self {
        Self { velocity: [value; 3], acceleration: [value; 6], by_rate: [value; 6] }
    }

    /// From the motion of the parent transported to the joint, gravity included, and the velocity of the body. S is
    /// `sense` times the row.
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
        let mut changed = [sense; 6];
        for i in 0..6 {
            changed[i] = sense * (at_base[i] + twice[i]);
            if matrices == Matrices::Derivatives {
                by_rate[i] += turned[i];
            }
            by_rate[i] *= sense;
        }
        let ([x, y, z], _) = halves(&turned);
        Self { velocity: [sense * x, sense * y, sense * z], acceleration: changed, by_rate }
    }

    /// The same for a block of columns.
    #[inline(always)]
    pub fn spread<C: ColumnsOf<T>>(&self, like: C) -> Effect<C> {
        let mut spread = Effect::filled(like);
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
