//! The modes of joints with exact friction or stops in one step: locked, or moving in one direction.
//!
//! The state at the start of a step decides the modes. During the step a locked joint has measurement noise without bound, so that its acceleration is zero, and one that slides has constant
//! friction. Two values per lane report whether the modes hold until the end of the step, and whether the step is short enough for the method.

use super::scratch::Scratch;
use super::step_settings::{By, RateKind};
use crate::scalar::{Real, larger};

/// Measurement noise of a locked joint, in kg m^2 or kg: as large as numbers allow whose products with inertias are numbers. Its acceleration is then exactly zero beside any
/// other, and noise times acceleration is the torque that holds it.
pub(super) const LOCKED: f64 = 1e200;
/// Added to a value that may be zero, so that a test for positive values accepts it.
const BARELY: f64 = 1e-300;

/// The mode of each row with exact friction or stops, from the state at the step's start.
#[inline(always)]
pub(super) fn set_modes<T: Real>((settings, scheme): By<'_>, s: &mut Scratch<T>) {
    let hg = if scheme.implicit && settings.rubs { scheme.tableau.gamma[0][0] } else { 0.0 };
    s.consistent = s.v.first().map_or_else(T::one, |v| v.constant(1.0));
    for (mode, of) in s.modes.iter_mut().zip(&settings.set_valued) {
        let (v, q) = (s.v[mode.row], s.q[mode.coordinate]);
        mode.target = v.constant(0.0);
        let (o, at_rest) = (v.constant(0.0), v.one_if_zero());
        if of.stops {
            mode.at_lower = larger(q - mode.lower, o).one_if_zero();
            mode.at_upper = larger(mode.upper - q, o).one_if_zero();
        }
        if of.friction > 0.0 {
            mode.locked = at_rest;
            s.dry[mode.row] = -(mode.friction * v * (v.abs() + at_rest).recip());
        } else {
            mode.locked = at_rest * larger(mode.at_lower, mode.at_upper);
        }
        let moving = s.chord[mode.row].mul_add(v.constant(hg), s.rows[mode.row].noise);
        s.model.system.noise[mode.row] = mode.locked.mul_add(v.constant(LOCKED), moving);
    }
}

/// Tests the torques that hold locked rows in stage `i` against their bounds, and sets the accelerations of these rows to exactly their targets.
#[inline(always)]
pub(super) fn observe_locks<T: Real>(s: &mut Scratch<T>, i: usize) {
    for mode in &s.modes {
        let m = &mut s.m[i][mode.row];
        let held = -(*m * mode.locked * m.constant(LOCKED));
        let (endless, barely) = (m.constant(LOCKED), m.constant(BARELY));
        let below = mode.at_lower.mul_add(endless, mode.friction - held);
        let above = mode.at_upper.mul_add(endless, mode.friction + held);
        s.consistent = s.consistent.worst(below + barely).worst(above + barely);
        *m = mode.target.mul_add(mode.locked, *m * (m.constant(1.0) - mode.locked));
    }
}

/// Tests that sliding joints still slide at the end of the step, that all joints are within their stops, and that the step was short enough.
#[inline(always)]
pub(super) fn observe_end<T: Real>(by @ (settings, scheme): By<'_>, s: &mut Scratch<T>) {
    for (mode, of) in s.modes.iter().zip(&settings.set_valued) {
        let (v, next, q) = (s.v[mode.row], s.v_next[mode.row], s.q_next[mode.coordinate]);
        if of.friction > 0.0 {
            s.consistent = s.consistent.worst(v.mul_add(next, mode.locked));
        }
        if of.stops {
            let barely = q.constant(BARELY);
            s.consistent = s.consistent.worst(q - mode.lower + barely).worst(mode.upper - q + barely);
            // Steps may be so short that no position changes.
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
}

/// The fastest rotation of a joint in a step, rad/s, and an estimate of the error in these velocities; and the same of linear velocities in rotating axes, m/s.
#[inline(always)]
pub(super) fn speeds_and_errors<T: Real>((settings, scheme): By<'_>, s: &Scratch<T>) -> [(T, T); 2] {
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
