//! Modes of joints with exact friction or stops during one step: stuck, or moving in one direction.
//!
//! The state at the start of a step determines the modes. During the step a stuck joint has measurement noise without
//! bound, so that its acceleration is zero, and a sliding joint has constant friction. Two values per lane report
//! if the modes hold until the end of the step, and if the step is short enough for the method.

use super::drives::agreement;
use super::method::Method;
use super::scratch::Scratch;
use super::step_settings::{RateKind, StepArguments, StepSettings};
use crate::scalar::{Real, larger};

/// Measurement noise of a stuck joint, kg m^2 or kg: so large that the acceleration rounds to zero relative to any
/// other, and so small that products with inertias do not overflow. Noise times acceleration is the torque that holds
/// the joint.
pub(super) const STUCK_NOISE: f64 = 1e200;
/// Added to a value that can be zero, so that a test for positive values accepts it.
const BARELY: f64 = 1e-300;

/// sqrt(v^2 + v0^2), never zero.
#[inline(always)]
pub(super) fn rounded_speed<T: Real>(settings: &StepSettings, v: T) -> T {
    let v0 = settings.properties.friction_speed;
    if v0 == 0.0 {
        // Exact friction: v divided by this value is the sign of v. The reciprocal of a smaller number overflows.
        return larger(v.abs() + v.one_if_zero(), v.constant(f64::MIN_POSITIVE));
    }
    v.mul_add(v, v.constant(v0 * v0)).sqrt()
}

/// Sets the mode of each row with exact friction or stops from the state at the start of the step.
#[inline(always)]
pub(super) fn set_modes<T: Real>((settings, scheme): StepArguments<'_>, s: &mut Scratch<T>) {
    let hg = if scheme.implicit && settings.regularized { scheme.tableau.gamma[0][0] } else { 0.0 };
    s.consistent = s.v.first().map_or_else(T::one, |v| v.constant(1.0));
    for (mode, of) in s.modes.iter_mut().zip(&settings.set_valued) {
        let (v, q) = (s.v[mode.row], s.q[mode.coordinate]);
        mode.target = v.constant(0.0);
        let (o, at_rest) = (v.constant(0.0), v.one_if_zero());
        if of.stops {
            mode.at_lower = larger(q - mode.lower, o).one_if_zero();
            mode.at_upper = larger(mode.upper - q, o).one_if_zero();
        }
        if of.rubs() {
            mode.stuck = at_rest;
            if settings.connected {
                // A joint of a loop at rest is solved together with the others.
                s.consistent = s.consistent.worst(v.constant(0.5) - at_rest);
                mode.stuck = o;
            }
            s.dry[mode.row] = -(mode.friction * v * rounded_speed(settings, v).recip());
        } else {
            mode.stuck = at_rest * larger(mode.at_lower, mode.at_upper);
        }
        if settings.connected {
            continue;
        }
        let moving = s.chord[mode.row].mul_add(v.constant(hg), s.rows[mode.row].noise);
        s.model.system.noise[mode.row] = mode.stuck.mul_add(v.constant(STUCK_NOISE), moving);
    }
}

/// Tests the torques that hold stuck rows in stage `i` against their bounds, and sets the accelerations of these rows
/// to exactly their targets.
#[inline(always)]
pub(super) fn test_stuck_rows<T: Real>(s: &mut Scratch<T>, i: usize) {
    for at in 0..s.modes.len() {
        let mode = s.modes[at];
        let [back, ahead] = s.friction_of_mode(&mode);
        let m = &mut s.m[i][mode.row];
        let held = -(*m * mode.stuck * m.constant(STUCK_NOISE));
        let (endless, barely) = (m.constant(STUCK_NOISE), m.constant(BARELY));
        let below = mode.at_lower.mul_add(endless, back - held);
        let above = mode.at_upper.mul_add(endless, ahead + held);
        s.consistent = s.consistent.worst(below + barely).worst(above + barely);
        *m = mode.target.mul_add(mode.stuck, *m * (m.constant(1.0) - mode.stuck));
    }
}

/// Tests that sliding joints still slide at the end of the step, that all joints are within their stops, and that the
/// step was short enough.
#[inline(always)]
pub(super) fn observe_end<T: Real>(by @ (settings, scheme): StepArguments<'_>, s: &mut Scratch<T>) {
    for (mode, of) in s.modes.iter().zip(&settings.set_valued) {
        let (v, next, q) = (s.v[mode.row], s.v_next[mode.row], s.q_next[mode.coordinate]);
        if of.rubs() {
            s.consistent = s.consistent.worst(v.mul_add(next, mode.stuck));
        }
        if of.stops {
            let barely = q.constant(BARELY);
            s.consistent = s.consistent.worst(q - mode.lower + barely).worst(mode.upper - q + barely);
            // A step can be so short that no position changes.
            let inward = next * (mode.at_lower - mode.at_upper);
            s.consistent = s.consistent.worst(inward + barely);
        }
    }
    if settings.divides {
        let [(fastest, error), (linear, linear_error)] = speeds_and_errors(by, s);
        let share = fastest.constant(scheme.share);
        let slow = fastest.constant(scheme.angle) - fastest * fastest.constant(scheme.step);
        let exact = fastest.mul_add(share, -error).worst(linear.mul_add(share, -linear_error));
        s.short_enough = larger(slow, exact) + slow.constant(BARELY);
    }
    // Contacts change the end of their steps.
    if settings.method != Method::Contact {
        s.without_drives = s.consistent.worst(s.short_enough);
        s.consistent = s.consistent.worst(agreement(by, s));
    }
}

/// The largest angular velocity of a joint in a step, rad/s, with an estimate of its error; and the same for linear
/// velocities in rotating axes, m/s.
#[inline(always)]
pub(super) fn speeds_and_errors<T: Real>((settings, scheme): StepArguments<'_>, s: &Scratch<T>) -> [(T, T); 2] {
    let zero = s.v.first().map_or_else(T::zero, |v| v.constant(0.0));
    let mut found = [(zero, zero); 2];
    for (row, kind) in settings.kinds.iter().enumerate() {
        let (speed, worst) = match kind {
            RateKind::Rotation => &mut found[0],
            RateKind::InRotatingAxes => &mut found[1],
            RateKind::Translation => continue,
        };
        let mut error = zero;
        for i in 0..scheme.tableau.stages {
            error = s.m[i][row].mul_add(error.constant(scheme.error[i]), error);
        }
        *speed = larger(*speed, larger(s.v[row].abs(), s.v_next[row].abs()));
        *worst = larger(*worst, error.abs());
    }
    found
}
