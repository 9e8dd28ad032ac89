//! One elementary step of one state, or of one state per lane, by any method.
//!
//! Joints with exact Coulomb friction or with stops have a *mode* during the step, which their state at its start decides: locked (at rest, held by friction or by a stop),
//! or moving in one direction, with constant friction against it. In these modes the motion is smooth, and the step has the order of its method. The step also evaluates whether
//! the modes hold until its end ([`Scratch::consistent`]) and whether it is short enough ([`Scratch::short_enough`]); where one fails,
//! [`substeps`](super::substeps) does the step with shorter ones and with the set-valued law.

use super::manifold::{advance, carry_back};
use super::modes::{observe_end, observe_locks, set_modes};
use super::scratch::{Scratch, add_scaled, clear};
use super::solver::Solver;
use super::step_settings::{By, StepSettings};
use crate::scalar::Real;

/// The accelerations of the state that [`Scratch::set_stage`] has set, in `m[0]`, with nothing implicit.
#[cfg(feature = "adaptive")]
pub(super) fn accelerations<T: Real, S: Solver<T>>(settings: &StepSettings, s: &mut Scratch<T>, solver: &mut S) {
    forces((settings, &settings.scheme), s, 0);
    solver.solve(true, (&s.model, &s.constants), &mut s.sweeps, (&s.q_stage, &s.v_stage, &s.u), &mut s.m[0]);
}

/// From `q`, `v` to `q_next`, `v_next` by one step of a scheme; gives the lanes whose error estimate exceeds its bound as bits.
#[inline(always)]
pub(super) fn step<T: Real, S: Solver<T>>(by @ (settings, scheme): By<'_>, s: &mut Scratch<T>, solver: &mut S) -> u64 {
    let t = &scheme.tableau;
    let mut doubt = 0;
    if settings.rubs {
        set_friction(by, s);
    }
    set_modes(by, s);
    clear(&mut s.control);
    for i in 0..t.stages {
        stage(by, s, i);
        let state = (&s.q_stage[..], &s.v_stage[..], &s.u[..]);
        doubt |= solver.solve(i == 0, (&s.model, &s.constants), &mut s.sweeps, state, &mut s.m[i]);
        observe_locks(s, i);
        finish_stage(by, s, i);
    }
    finish_step(by, s);
    doubt
}

/// The end of a step whose stages are there, and whether it is consistent and short enough.
#[inline(always)]
pub(super) fn finish_step<T: Real>(by @ (_, scheme): By<'_>, s: &mut Scratch<T>) {
    let t = &scheme.tableau;
    clear(&mut s.x);
    s.v_next.copy_from_slice(&s.v);
    for i in 0..t.stages {
        add_scaled(&mut s.x, t.weights[i], &s.l[i]);
        add_scaled(&mut s.v_next, t.weights[i], &s.m[i]);
    }
    advance(&s.model, &s.q, &s.x, &mut s.q_next);
    observe_end(by, s);
}

/// Increment, configuration, velocity, carried velocity and torque of stage `i`, from the stages before it.
#[inline(always)]
pub(super) fn stage<T: Real>(by @ (_, scheme): By<'_>, s: &mut Scratch<T>, i: usize) {
    let t = &scheme.tableau;
    s.v_stage.copy_from_slice(&s.v);
    if i == 0 {
        s.q_stage.copy_from_slice(&s.q);
        s.c.copy_from_slice(&s.v);
    } else {
        clear(&mut s.x);
        for j in 0..i {
            add_scaled(&mut s.x, t.alpha[i][j], &s.l[j]);
            add_scaled(&mut s.v_stage, t.alpha[i][j], &s.m[j]);
        }
        advance(&s.model, &s.q, &s.x, &mut s.q_stage);
        s.c.copy_from_slice(&s.v_stage);
        carry_back(&s.model, &s.x, &mut s.c);
        for j in 0..i {
            add_scaled(&mut s.c, t.gamma[i][j], &s.m[j]);
        }
    }
    forces(by, s, i);
}

/// The rate of the increment in stage `i`, whose accelerations are there.
#[inline(always)]
pub(super) fn finish_stage<T: Real>((_, scheme): By<'_>, s: &mut Scratch<T>, i: usize) {
    s.l[i].copy_from_slice(&s.c);
    add_scaled(&mut s.l[i], scheme.tableau.gamma[i][i], &s.m[i]);
}

/// Friction as damping, f / sqrt(v^2 + v0^2) at the step's start: never zero where f is not, so a row has noise in all lanes or
/// in none. Taken implicitly, it cannot turn a velocity round.
#[inline(always)]
pub(super) fn set_friction<T: Real>((settings, scheme): By<'_>, s: &mut Scratch<T>) {
    let hg = scheme.tableau.gamma[0][0];
    for (row, of) in s.rows.iter().enumerate() {
        if settings.properties.friction[row] == 0.0 {
            continue;
        }
        let chord = of.friction * rounded_speed(settings, s.v[row]).recip();
        s.chord[row] = chord;
        if scheme.implicit {
            s.model.system.noise[row] = chord.mul_add(chord.constant(hg), of.noise);
        }
    }
}

/// sqrt(v^2 + v0^2), never zero.
#[inline(always)]
pub(super) fn rounded_speed<T: Real>(settings: &StepSettings, v: T) -> T {
    let v0 = settings.properties.friction_speed;
    if v0 == 0.0 {
        // Exact: the quotient with it is the sign.
        return v.abs() + v.one_if_zero();
    }
    v.mul_add(v, v.constant(v0 * v0)).sqrt()
}

/// The right side of stage `i`.
#[inline(always)]
pub(super) fn forces<T: Real>((settings, scheme): By<'_>, s: &mut Scratch<T>, i: usize) {
    let t = &scheme.tableau;
    for (k, body) in s.model.bodies.iter().enumerate() {
        let stage = &s.model.system.stages[k];
        let (row, at) = (stage.first_row, body.q);
        if settings.sprung[k] {
            body.motion.displacement(&s.rest[at..], &s.q_stage[at..], &mut s.displaced[row..]);
        }
        if settings.pulled[k] {
            body.motion.displacement(&s.target[at..], &s.q_stage[at..], &mut s.displaced_target[row..]);
        }
    }
    for (row, of) in s.rows.iter().enumerate() {
        let v = s.v_stage[row];
        let mut u = s.torque[row];
        u = u.minus_product(of.damping, v);
        u = u.minus_product(of.stiffness, s.displaced[row]);
        let mut control = v.constant(0.0);
        if settings.gains.is_some() {
            control = control.minus_product(of.derivative, v - s.target_rate[row]);
            control = control.minus_product(of.proportional, s.displaced_target[row]);
        }
        let mut damping = of.damping;
        if settings.rubs {
            u = u.minus_product(of.friction * v, rounded_speed(settings, v).recip());
            damping += s.chord[row];
        }
        if scheme.implicit {
            let c = s.c[row];
            let (mut moved, mut sped) = (c * c.constant(t.gamma[i][i]), c.constant(0.0));
            for j in 0..i {
                let gamma = c.constant(t.gamma[i][j]);
                moved = s.l[j][row].mul_add(gamma, moved);
                sped = s.m[j][row].mul_add(gamma, sped);
            }
            u = u.minus_product(of.stiffness, moved);
            u = u.minus_product(damping, sped);
            if settings.gains.is_some() {
                control = control.minus_product(of.proportional, moved);
                control = control.minus_product(of.derivative, sped);
            }
        }
        s.u[row] = u + control;
        if settings.gains.is_some() {
            s.control[row] = control.mul_add(control.constant(t.weights[i]), s.control[row]);
        }
    }
    for mode in &s.modes {
        s.u[mode.row] += s.dry[mode.row];
    }
}
