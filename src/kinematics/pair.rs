//! Constraints between two frames C and D, as scalar rows: their error and its time derivative.
//!
//! With (R, p) the pose of C in D, r = R^T p the same vector in the axes of C, and V = (w, v) the velocity of C
//! relative to D, in the axes of C at its origin:
//!
//! ```text
//! origins      error r                              rate v - w x r
//! distance     error |r| - length                   rate (r/|r|) . v
//! frames       error 2 q_v, of the quaternion of R  rate q_w w + q_v x w      (2 sin(t/2) about the axis, t the angle)
//! axes z       error z x u / cos(t/2), u = R^T z    rate along u' = u x w     (2 sin(t/2) again, t between the axes)
//! ```
//!
//! Each rate is a row `E_i` times V, exactly and in every configuration, so that the force of row i on C is `E_i`. The
//! time derivative of the rate is `E_i` V' + `E_i`' V, with V' = A - X `A_D` + V x X `V_D`.

use super::inward::FrameMotion;
use crate::scalar::Real;
use crate::spatial::{RigidShift, angular, cross, cross_motion, less, linear, scaled, scaled_add, spatial, sum};
use nalgebra::{Matrix3, Vector3, Vector6};

/// A constraint between two frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Pair {
    /// Their origins coincide.
    Point,
    /// Their origins and their z axes coincide.
    Axis,
    /// The frames coincide.
    Weld,
    /// The distance of their origins, m.
    Distance(f64),
}

/// The names of the rows of a weld.
const ROWS: [&str; 6] = [
    "rotation about x",
    "rotation about y",
    "rotation about z",
    "position along x",
    "position along y",
    "position along z",
];

impl Pair {
    /// The names of the scalar rows, in their order.
    pub fn row_names(self) -> &'static [&'static str] {
        match self {
            Self::Point => &ROWS[3..],
            Self::Axis => &[ROWS[0], ROWS[1], ROWS[3], ROWS[4], ROWS[5]],
            Self::Weld => &ROWS,
            Self::Distance(_) => &["distance"],
        }
    }
}

/// The rows of a pair at one configuration: angular ones first.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PairRows<T> {
    pub count: usize,
    /// rad (2 sin(t/2)) and m.
    pub error: [T; 6],
    /// E: the rate of the error is E V.
    pub of_motion: [Vector6<T>; 6],
    /// E' V: the second derivative of the error minus E V'.
    pub turning: [T; 6],
    /// Positive if this parametrization of the rows is regular: states in lanes and generated code share one, a single
    /// state uses the best one.
    pub margin: T,
}

impl<T: Real> PairRows<T> {
    #[inline(always)]
    fn push(&mut self, error: T, of_motion: Vector6<T>, turning: T) {
        self.error[self.count] = error;
        self.of_motion[self.count] = of_motion;
        self.turning[self.count] = turning;
        self.count += 1;
    }
}

/// z axes count as opposite if 1 + cos is below this: the nearest common direction is then undefined.
const OPPOSITE: f64 = 1e-12;

/// True if all values use the same parametrization of the rows.
#[inline(always)]
fn is_shared<T: Real>() -> bool {
    T::LANES > 1 || !T::IS_KNOWN
}

/// The rows of a pair, where C has the pose `place` in D and moves with V = `velocity` relative to it. None for a
/// distance between origins that coincide.
#[inline(always)]
pub(crate) fn pair_rows<T: Real>(pair: Pair, place: &RigidShift<T>, velocity: &Vector6<T>) -> Option<PairRows<T>> {
    // Constants from a value: `from_f64` detects the processor for lanes.
    let like = place.lever[0];
    let nothing = like.constant(0.0);
    let (none_yet, no_force) = ([nothing; 6], Vector6::from_element(nothing));
    let mut rows =
        PairRows { count: 0, error: none_yet, of_motion: [no_force; 6], turning: none_yet, margin: like.constant(1.0) };
    let (w, v) = (angular(velocity), linear(velocity));
    let r = place.rotate_back(&place.lever);
    let moving = less(&v, &cross(&w, &r));
    match pair {
        Pair::Weld => turned(&place.rotation, &w, &mut rows),
        Pair::Axis => tilted(&place.rotation, &w, &mut rows),
        Pair::Point => {}
        Pair::Distance(length) => {
            let apart = square(&r).sqrt();
            if is_shared::<T>() {
                rows.margin = apart;
            } else if apart.lane(0) == 0.0 {
                return None;
            }
            let n = times(&r, apart.recip());
            let along = product(&n, &moving);
            let across = (square(&moving) - along * along) / apart;
            let turning = across - product(&n, &cross(&w, &moving));
            rows.push(apart - apart.constant(length), spatial(&none(like), &n), turning);
            return Some(rows);
        }
    }
    let turning = cross(&moving, &w);
    for (i, e) in axes(like).iter().enumerate() {
        rows.push(r[i], spatial(&cross(e, &r), e), turning[i]);
    }
    Some(rows)
}

#[inline(always)]
fn axes<T: Real>(like: T) -> [Vector3<T>; 3] {
    let (one, no) = (like.constant(1.0), like.constant(0.0));
    [Vector3::new(one, no, no), Vector3::new(no, one, no), Vector3::new(no, no, one)]
}

#[inline(always)]
fn none<T: Real>(like: T) -> Vector3<T> {
    Vector3::from_element(like.constant(0.0))
}

#[inline(always)]
fn plus<T: Real>(a: &Vector3<T>, b: &Vector3<T>) -> Vector3<T> {
    Vector3::new(a[0] + b[0], a[1] + b[1], a[2] + b[2])
}

#[inline(always)]
fn times<T: Real>(a: &Vector3<T>, s: T) -> Vector3<T> {
    Vector3::new(a[0] * s, a[1] * s, a[2] * s)
}

#[inline(always)]
fn product<T: Real>(a: &Vector3<T>, b: &Vector3<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn square<T: Real>(a: &Vector3<T>) -> T {
    product(a, a)
}

/// The quaternion (vector, scalar) of a rotation, with nonnegative scalar, computed from its largest component to avoid
/// cancellation.
#[inline(always)]
fn quaternion<T: Real>(r: &Matrix3<T>) -> (Vector3<T>, T) {
    let (x, y, z) = (r[(0, 0)], r[(1, 1)], r[(2, 2)]);
    let one = x.constant(1.0);
    // Four times the squares of x, y, z and w.
    let squares = [one + x - y - z, one - x + y - z, one - x - y + z, one + x + y + z];
    let mut largest = 3;
    if !is_shared::<T>() {
        for i in 0..3 {
            if squares[i].lane(0) > squares[largest].lane(0) {
                largest = i;
            }
        }
    }
    let twice = squares[largest].sqrt();
    let (half, share) = (twice * one.constant(0.5), (twice + twice).recip());
    let (a, b, c) = (r[(2, 1)] - r[(1, 2)], r[(0, 2)] - r[(2, 0)], r[(1, 0)] - r[(0, 1)]);
    let (d, e, f) = (r[(0, 1)] + r[(1, 0)], r[(0, 2)] + r[(2, 0)], r[(1, 2)] + r[(2, 1)]);
    let (v, w) = match largest {
        0 => (Vector3::new(half, d * share, e * share), a * share),
        1 => (Vector3::new(d * share, half, f * share), b * share),
        2 => (Vector3::new(e * share, f * share, half), c * share),
        _ => (Vector3::new(a * share, b * share, c * share), half),
    };
    if !is_shared::<T>() && w.lane(0) < 0.0 { (times(&v, -one), -w) } else { (v, w) }
}

/// The rows of coinciding orientations.
#[inline(always)]
fn turned<T: Real>(rotation: &Matrix3<T>, w: &Vector3<T>, rows: &mut PairRows<T>) {
    let (q_v, q_w) = quaternion(rotation);
    if is_shared::<T>() {
        rows.margin = rotation[(0, 0)] + rotation[(1, 1)] + rotation[(2, 2)];
    }
    let turning = q_w.constant(-0.5) * square(w);
    for (i, e) in axes(q_w).iter().enumerate() {
        let of_motion = spatial(&plus(&times(e, q_w), &cross(e, &q_v)), &none(q_w));
        rows.push(q_v[i] + q_v[i], of_motion, turning * q_v[i]);
    }
}

/// The rows of a common z axis.
#[inline(always)]
fn tilted<T: Real>(rotation: &Matrix3<T>, w: &Vector3<T>, rows: &mut PairRows<T>) {
    // D's z axis in C's axes.
    let u = Vector3::new(rotation[(2, 0)], rotation[(2, 1)], rotation[(2, 2)]);
    let like = u[0];
    let [x, y, z] = axes(like);
    if is_shared::<T>() {
        rows.margin = u[2];
    } else if 1.0 + u[2].lane(0) < OPPOSITE {
        rows.push(like.constant(2.0), spatial(&x, &none(like)), like.constant(0.0));
        rows.push(like.constant(0.0), spatial(&y, &none(like)), like.constant(0.0));
        return;
    }
    // 1 / cos(t/2), and its first two time derivatives.
    let s = (like.constant(2.0) / (like.constant(1.0) + u[2])).sqrt();
    let by_u = like.constant(-0.25) * s * s * s;
    let first = cross(&u, w);
    let second = cross(&first, w);
    let s_1 = by_u * first[2];
    let s_2 = like.constant(-0.75) * s * s * s_1 * first[2] + by_u * second[2];
    for (i, axis, sign) in [(1, y, like.constant(1.0)), (0, x, -like.constant(1.0))] {
        let of_w = plus(&times(&cross(&axis, &u), s * sign), &times(&cross(&z, &u), u[i] * by_u * sign));
        let turning = second[i] * s + like.constant(2.0) * first[i] * s_1 + u[i] * s_2;
        rows.push(sign * u[i] * s, spatial(&of_w, &none(like)), sign * turning);
    }
}

/// The cotangents of multipliers* (E V' + E' V): by a twist of C relative to D, by V and by V', forces on C in its
/// axes. None where [`pair_rows`] is.
///
/// Each kind writes the second derivative of its error with vectors in the axes of C, which rotate with w.
#[inline(always)]
pub(crate) fn pair_cotangents<T: Real>(
    pair: Pair,
    motion: &RelativeMotion<T>,
    multipliers: &[T],
) -> Option<[Vector6<T>; 3]> {
    let rows = pair_rows(pair, &motion.place, &motion.velocity)?;
    let like = motion.place.lever[0];
    let mut force = Vector6::from_element(like.constant(0.0));
    for (row, &r) in rows.of_motion.iter().zip(multipliers) {
        force = scaled_add(row, r, &force);
    }
    let p = motion.place.rotate_back(&motion.place.lever);
    let (w, v) = (angular(&motion.velocity), linear(&motion.velocity));
    let (dw, moving) = (angular(&motion.acceleration), less(&v, &cross(&w, &p)));
    if let Pair::Distance(_) = pair {
        let [by_p, by_w, by_v] = apart_cotangents((&p, &moving), &w, &linear(&motion.acceleration));
        let [place, velocity] = [spatial(&cross(&by_p, &p), &by_p), spatial(&by_w, &by_v)];
        return Some([scaled(&place, multipliers[0]), scaled(&velocity, multipliers[0]), force]);
    }
    let [by_turn, by_own_w] = match pair {
        Pair::Weld => turned_cotangents(&motion.place.rotation, (&w, &dw), multipliers),
        Pair::Axis => tilted_cotangents(&motion.place.rotation, (&w, &dw), multipliers),
        _ => [none(like); 2],
    };
    // r* (v' - w' x p + (v - w x p) x w).
    let last = rows.count - 3;
    let r = Vector3::new(multipliers[last], multipliers[last + 1], multipliers[last + 2]);
    let by_v = cross(&w, &r);
    let by_p = plus(&cross(&dw, &r), &less(&times(&w, product(&w, &r)), &times(&r, square(&w))));
    let by_w = plus(&cross(&r, &moving), &cross(&by_v, &p));
    Some([spatial(&plus(&by_turn, &cross(&by_p, &p)), &by_p), spatial(&plus(&by_own_w, &by_w), &by_v), force])
}

/// For a distance: of n* (v' - w x m) + |m across n|^2 / d by p, w and v, with n = p / d and m = v - w x p.
#[inline(always)]
fn apart_cotangents<T: Real>((p, m): (&Vector3<T>, &Vector3<T>), w: &Vector3<T>, dv: &Vector3<T>) -> [Vector3<T>; 3] {
    let inverse = square(p).sqrt().recip();
    let n = times(p, inverse);
    let across = |x: &Vector3<T>| less(x, &times(&n, product(&n, x)));
    let turning = times(&across(m), inverse);
    let by_m = less(&plus(&turning, &turning), &cross(&n, w));
    let bent = less(&times(&across(&less(dv, &cross(w, m))), inverse), &times(&n, square(&turning)));
    let along = product(&n, m) * inverse;
    let by_p = less(&less(&bent, &times(&plus(&turning, &turning), along)), &cross(&by_m, w));
    [by_p, -plus(&cross(p, &by_m), &cross(m, &n)), by_m]
}

/// For coinciding orientations: of r* (`q_w` w' + `q_v` x w' - |w|^2/2 `q_v`) by a rotation and by w.
#[inline(always)]
fn turned_cotangents<T: Real>(
    rotation: &Matrix3<T>,
    (w, dw): (&Vector3<T>, &Vector3<T>),
    multipliers: &[T],
) -> [Vector3<T>; 2] {
    let (q_v, q_w) = quaternion(rotation);
    let r = Vector3::new(multipliers[0], multipliers[1], multipliers[2]);
    let half = q_w.constant(0.5);
    let by_v = less(&cross(dw, &r), &times(&r, half * square(w)));
    let by_turn = less(&plus(&times(&by_v, q_w), &cross(&by_v, &q_v)), &times(&q_v, product(&r, dw)));
    [times(&by_turn, half), times(w, -product(&r, &q_v))]
}

/// For a common z axis: of r* (u'' s + 2 u' s' + u s'') by a rotation and by w, with u' = u x w and the function s of
/// `u_z`, 1 / cos(t/2).
#[inline(always)]
fn tilted_cotangents<T: Real>(
    rotation: &Matrix3<T>,
    (w, dw): (&Vector3<T>, &Vector3<T>),
    multipliers: &[T],
) -> [Vector3<T>; 2] {
    let u = Vector3::new(rotation[(2, 0)], rotation[(2, 1)], rotation[(2, 2)]);
    let like = u[0];
    if !is_shared::<T>() && 1.0 + u[2].lane(0) < OPPOSITE {
        return [none(like); 2];
    }
    let two = like.constant(2.0);
    let [_, _, z] = axes(like);
    let r = Vector3::new(-multipliers[1], multipliers[0], like.constant(0.0));
    let s = (two / (like.constant(1.0) + u[2])).sqrt();
    let square_of_s = s * s;
    // The derivatives of s by u_z.
    let s_1 = like.constant(-0.25) * s * square_of_s;
    let s_2 = like.constant(-0.75) * square_of_s * s_1;
    let s_3 = like.constant(-1.25) * square_of_s * s_2;
    let first = cross(&u, w);
    let second = plus(&cross(&first, w), &cross(&u, dw));
    let [on_u, on_first, on_second] = [&u, &first, &second].map(|x| product(&r, x));
    let by_second = plus(&times(&r, s), &times(&z, s_1 * on_u));
    let by_first = plus(&times(&r, s_1 * first[2]), &times(&z, s_1 * on_first + s_2 * first[2] * on_u));
    let by_first = plus(&times(&by_first, two), &cross(w, &by_second));
    let curved = s_2 * first[2] * first[2] + s_1 * second[2];
    let by_s = s_1 * on_second + two * s_2 * first[2] * on_first + on_u * (s_3 * first[2] * first[2] + s_2 * second[2]);
    let by_u = plus(&times(&r, curved), &times(&z, by_s));
    let by_u = plus(&by_u, &plus(&cross(w, &by_first), &cross(dw, &by_second)));
    [cross(&by_u, &u), plus(&cross(&by_first, &u), &cross(&by_second, &first))]
}

/// The motion of one frame relative to another, in its own axes at its own origin.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RelativeMotion<T: Real> {
    /// From the frame to the other.
    pub place: RigidShift<T>,
    /// V.
    pub velocity: Vector6<T>,
    /// V', the derivative of V in the axes of the frame.
    pub acceleration: Vector6<T>,
}

/// The pose of frame C in frame D. Origins are subtracted first, while both are similarly far away.
#[inline(always)]
pub(crate) fn place_between<T: Real>(c: &RigidShift<T>, d: &RigidShift<T>) -> RigidShift<T> {
    let none = RigidShift { rotation: d.rotation, lever: none(d.lever[0]) };
    let turned = RigidShift { rotation: c.rotation, lever: less(&c.lever, &d.lever) };
    none.inverse().compose(&turned)
}

impl<T: Real> RelativeMotion<T> {
    /// The motion of frame C relative to frame D.
    #[inline(always)]
    pub fn of(c: &FrameMotion<T>, d: &FrameMotion<T>) -> Self {
        let place = place_between(&c.placement, &d.placement);
        let (seen, felt) = (place.motion_to_child(&d.velocity), place.motion_to_child(&d.acceleration));
        let minus_one = c.velocity[0].constant(-1.0);
        let velocity = scaled_add(&seen, minus_one, &c.velocity);
        let acceleration = sum(&scaled_add(&felt, minus_one, &c.acceleration), &cross_motion(&velocity, &seen));
        Self { place, velocity, acceleration }
    }
}
