//! Products with a row of H*, which has one entry of 1 (a screw has two entries): most of them are permutations.

use crate::filter::HingeMap;
use crate::scalar::Real;

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
