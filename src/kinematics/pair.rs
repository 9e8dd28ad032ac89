//! What holds between two frames C and D, as scalar rows: how far it is from holding, and how fast that changes.
//!
//! With (R, p) the place of C in D's axes, r = R^T p the same vector in C's axes, and V = (w, v) the velocity of C against D, in C's axes at C's origin:
//!
//! ```text
//! origins      error r                              rate v - w x r
//! distance     error |r| - length                   rate (r/|r|) . v
//! frames       error 2 q_v, of the quaternion of R  rate q_w w + q_v x w      (2 sin(t/2) about the axis, t the angle)
//! axes z       error z x u / cos(t/2), u = R^T z    rate along u' = u x w     (2 sin(t/2) again, t the angle between them)
//! ```
//!
//! Each rate is a row `E_i` times V, exactly and everywhere, so that the force of row i on C is `E_i`. Its own rate is `E_i` V' + `E_i`' V with V' =
//! A - X `A_D` + V x X `V_D`.

use super::inward::FrameMotion;
use crate::spatial::{RigidShift, angular, cross, cross_motion, linear, spatial};
use nalgebra::{Rotation3, UnitQuaternion, Vector3, Vector6};

/// What holds between two frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Pair {
    /// Their origins coincide.
    Point,
    /// Their origins and their z axes coincide.
    Axis,
    /// They coincide.
    Weld,
    /// Their origins are so far apart, m.
    Distance(f64),
}

impl Pair {
    /// How many scalar rows.
    pub fn rows(self) -> usize {
        match self {
            Self::Point => 3,
            Self::Axis => 5,
            Self::Weld => 6,
            Self::Distance(_) => 1,
        }
    }
}

/// The rows of a pair at one configuration: angular ones first.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PairRows {
    pub count: usize,
    /// rad (2 sin(t/2)) and m.
    pub error: [f64; 6],
    /// E: the rate of the error is E V.
    pub of_motion: [Vector6<f64>; 6],
    /// E' V: what the rate of the rate has beside E V'.
    pub turning: [f64; 6],
}

/// Opposite z axes, to within this of 1 + cos: there is no direction in which they are nearest.
const OPPOSITE: f64 = 1e-12;

/// The rows of a pair where C is at `place` in D's axes and moves with V = `velocity` against it; none for a distance between origins that coincide.
pub(crate) fn pair_rows(pair: Pair, place: &RigidShift<f64>, velocity: &Vector6<f64>) -> Option<PairRows> {
    let none = Vector6::zeros();
    let mut rows = PairRows { count: 0, error: [0.0; 6], of_motion: [none; 6], turning: [0.0; 6] };
    let mut push = |error: f64, of_motion: Vector6<f64>, turning: f64| {
        rows.error[rows.count] = error;
        rows.of_motion[rows.count] = of_motion;
        rows.turning[rows.count] = turning;
        rows.count += 1;
    };
    let (w, v) = (angular(velocity), linear(velocity));
    let r = place.rotate_back(&place.lever);
    let moving = v - cross(&w, &r);
    match pair {
        Pair::Weld => turned(&place.rotation, &w, &mut push),
        Pair::Axis => tilted(&place.rotation, &w, &mut push),
        Pair::Point => {}
        Pair::Distance(length) => {
            let apart = r.norm();
            if apart == 0.0 {
                return None;
            }
            let n = r / apart;
            let along = n.dot(&moving);
            let across = (moving.norm_squared() - along * along) / apart;
            push(apart - length, spatial(&Vector3::zeros(), &n), across - n.dot(&cross(&w, &moving)));
            return Some(rows);
        }
    }
    let turning = -cross(&w, &moving);
    for (i, e) in axes().iter().enumerate() {
        push(r[i], spatial(&cross(e, &r), e), turning[i]);
    }
    Some(rows)
}

fn axes() -> [Vector3<f64>; 3] {
    [Vector3::x(), Vector3::y(), Vector3::z()]
}

/// The rows of equal axes.
fn turned(rotation: &nalgebra::Matrix3<f64>, w: &Vector3<f64>, push: &mut impl FnMut(f64, Vector6<f64>, f64)) {
    let quaternion = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation));
    let sign = if quaternion.w < 0.0 { -1.0 } else { 1.0 };
    let (q_v, q_w) = (quaternion.imag() * sign, quaternion.w * sign);
    for (i, e) in axes().iter().enumerate() {
        let of_motion = spatial(&(e * q_w + cross(e, &q_v)), &Vector3::zeros());
        push(2.0 * q_v[i], of_motion, -0.5 * w.norm_squared() * q_v[i]);
    }
}

/// The rows of a z axis that both have.
fn tilted(rotation: &nalgebra::Matrix3<f64>, w: &Vector3<f64>, push: &mut impl FnMut(f64, Vector6<f64>, f64)) {
    // D's z axis in C's axes.
    let u = Vector3::new(rotation[(2, 0)], rotation[(2, 1)], rotation[(2, 2)]);
    let [x, y, z] = axes();
    if 1.0 + u[2] < OPPOSITE {
        push(2.0, spatial(&x, &Vector3::zeros()), 0.0);
        push(0.0, spatial(&y, &Vector3::zeros()), 0.0);
        return;
    }
    // 1 / cos(t/2), and its first two derivatives by time.
    let s = (2.0 / (1.0 + u[2])).sqrt();
    let by_u = -0.25 * s * s * s;
    let first = cross(&u, w);
    let second = cross(&first, w);
    let s_1 = by_u * first[2];
    let s_2 = -0.75 * s * s * s_1 * first[2] + by_u * second[2];
    for (i, axis, sign) in [(1, y, 1.0), (0, x, -1.0)] {
        let of_w = cross(&axis, &u) * (s * sign) + cross(&z, &u) * (u[i] * by_u * sign);
        let turning = second[i] * s + 2.0 * first[i] * s_1 + u[i] * s_2;
        push(sign * u[i] * s, spatial(&of_w, &Vector3::zeros()), sign * turning);
    }
}

/// How one frame moves against another, in its own axes at its own origin.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RelativeMotion {
    /// From the frame to the other.
    pub place: RigidShift<f64>,
    /// V.
    pub velocity: Vector6<f64>,
    /// V', the rate of V in the frame's axes.
    pub acceleration: Vector6<f64>,
    /// Sizes of the terms that V' is the sum of, angular and linear.
    pub terms: [f64; 2],
}

impl RelativeMotion {
    /// Of frame C against frame D.
    pub fn of(c: &FrameMotion<f64>, d: &FrameMotion<f64>) -> Self {
        let place = d.placement.inverse().compose(&c.placement);
        let (seen, felt) = (place.motion_to_child(&d.velocity), place.motion_to_child(&d.acceleration));
        let velocity = c.velocity - seen;
        let turning = cross_motion(&velocity, &seen);
        let size = |half: fn(&Vector6<f64>) -> Vector3<f64>| {
            half(&c.acceleration).norm() + half(&felt).norm() + half(&turning).norm()
        };
        let terms = [size(angular::<f64>), size(linear::<f64>)];
        Self { place, velocity, acceleration: c.acceleration - felt + turning, terms }
    }
}
