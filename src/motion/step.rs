//! One elementary step of one state, or of one state per lane, with any method.
//!
//! Joints with exact Coulomb friction or with stops have a *mode* during the step, which the initial state of the step
//! determines: stuck (held by friction or by a stop), or moving in one direction with constant friction. In these modes
//! the motion is smooth, and the step has the order of its method. The step also evaluates whether the modes hold until
//! its end ([`Scratch::consistent`]) and whether it is short enough ([`Scratch::short_enough`]). If one test fails,
//! [`division`](super::division) repeats the step with shorter ones and with the set-valued law.

use super::drives::{change_drives, set_drives};
use super::manifold::{advance, carry_back};
use super::method::Method;
use super::modes::{observe_end, rounded_speed, set_modes, test_stuck_rows};
use super::scratch::{Scratch, add_scaled, clear};
use super::solver::Solver;
use super::step_settings::StepArguments;
use crate::batch::accelerations::KernelArguments;
use crate::batch::instruction_set::{Target, Work};
use crate::scalar::{Real, lanes_but};

/// Largest number of times that a step is made again with other pieces of the control laws.
const CHANGES: usize = 3;

/// The parts of a step between the accelerations of its stages.
#[derive(Debug, Clone, Copy)]
pub(super) enum Part {
    /// The pieces of the control laws, for a step without an event; friction and modes.
    Begin { drives: bool },
    /// The same for a step without an event, then stage 0.
    Start,
    /// The state and the torque of a stage.
    Stage(usize),
    /// Its stuck rows.
    Hold(usize),
    /// The same, and the velocity of its increment.
    FinishStage(usize),
    /// The same, then the stage after it.
    Next(usize),
    /// The same, then the end of the step.
    End(usize),
    /// The end of the step.
    Finish,
    /// Other pieces of the control laws; nothing is done if none changes.
    Change,
}

struct InPart<'a, T: Real>(Part, StepArguments<'a>, &'a mut Scratch<T>);

impl<T: Real> Work for InPart<'_, T> {
    /// True if pieces of the control laws changed.
    type Output = bool;

    /// Each operation is compiled into it once.
    #[inline(always)]
    fn call(self) -> bool {
        let Self(part, by, s) = self;
        if let Part::Hold(i) | Part::FinishStage(i) | Part::Next(i) | Part::End(i) = part {
            test_stuck_rows(s, i);
            if !matches!(part, Part::Hold(_)) {
                finish_stage(by, s, i);
            }
        }
        if matches!(part, Part::End(_) | Part::Finish) {
            finish_step(by, s);
        }
        if matches!(part, Part::Begin { .. } | Part::Start) {
            if !matches!(part, Part::Begin { drives: false }) {
                set_drives(by, s);
            }
            if by.0.regularized {
                set_friction(by, s);
            }
            set_modes(by, s);
        }
        let next = match part {
            Part::Start => Some(0),
            Part::Stage(i) => Some(i),
            Part::Next(i) => Some(i + 1),
            _ => None,
        };
        if let Some(i) = next {
            if matches!(part, Part::Start) {
                clear(&mut s.control);
            }
            stage(by, s, i);
        }
        matches!(part, Part::Change) && change_drives(by, s)
    }
}

/// A part of a step, with the instructions of `target`. Compiled once for all solvers, forward and backward: inlined
/// into each of them, the parts took a tenth of the time of a build.
#[inline(never)]
pub(super) fn do_part<T: Real, I: Target>(target: I, part: Part, by: StepArguments<'_>, s: &mut Scratch<T>) -> bool {
    target.within(InPart(part, by, s))
}

/// One step of a scheme from `q`, `v` to `q_next`, `v_next`; returns as bits the lanes whose error estimate exceeds the
/// tolerance. A step that contradicts the pieces of the control laws is made again with others: in all lanes, of which
/// those without a change have the same result.
#[inline(always)]
pub(super) fn step<T: Real, I: Target, S: Solver<T>>(
    target: I,
    by @ (settings, _): StepArguments<'_>,
    s: &mut Scratch<T>,
    solver: &mut S,
) -> u64 {
    let mut fallback = on_pieces(target, by, s, solver);
    // Contacts change the end of their steps; error control locates the changes.
    if settings.limited.is_empty() || settings.method == Method::Contact || settings.given.accuracy.is_some() {
        return fallback;
    }
    for _ in 0..CHANGES {
        let is_consistent = lanes_but::<T>(|lane| s.consistent.lane(lane) > 0.0) == 0;
        if is_consistent || !do_part(target, Part::Change, by, s) {
            break;
        }
        s.are_sides_given = true;
        fallback = on_pieces(target, by, s, solver);
        s.are_sides_given = false;
    }
    fallback
}

/// One step with given pieces of the control laws, or with those of its start.
#[inline(always)]
fn on_pieces<T: Real, I: Target, S: Solver<T>>(
    target: I,
    by @ (_, scheme): StepArguments<'_>,
    s: &mut Scratch<T>,
    solver: &mut S,
) -> u64 {
    let mut fallback = 0;
    let last = scheme.tableau.stages - 1;
    do_part(target, Part::Start, by, s);
    for i in 0..=last {
        fallback |= solver.solve(i == 0, at_stage(s, i));
        do_part(target, if i < last { Part::Next(i) } else { Part::End(i) }, by, s);
    }
    fallback
}

/// The arguments of the solver of stage `i`.
#[inline(always)]
pub(super) fn at_stage<T: Real>(s: &mut Scratch<T>, i: usize) -> KernelArguments<'_, T> {
    KernelArguments {
        scene: (&s.model, &s.constants),
        scratch: &mut s.sweeps,
        state: (&s.q_stage, &s.v_stage, &s.u),
        wrenches: &[],
        qdd: &mut s.m[i],
    }
}

/// Computes the end of a step from its stages, and whether the step is consistent and short enough.
#[inline(always)]
fn finish_step<T: Real>(by @ (settings, scheme): StepArguments<'_>, s: &mut Scratch<T>) {
    let t = &scheme.tableau;
    clear(&mut s.x);
    s.v_next.copy_from_slice(&s.v);
    for i in 0..t.stages {
        add_scaled(&mut s.x, t.weights[i], &s.l[i]);
        add_scaled(&mut s.v_next, t.weights[i], &s.m[i]);
    }
    if settings.wrenches.is_some() {
        s.wrenches.end_work_of_stages(&s.x);
    }
    advance(&s.model, &s.q, &s.x, &mut s.q_next);
    observe_end(by, s);
}

/// Increment, configuration, velocity, transported velocity and torque of stage `i`, from the preceding stages.
#[inline(always)]
fn stage<T: Real>(by @ (_, scheme): StepArguments<'_>, s: &mut Scratch<T>, i: usize) {
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

/// The velocity of the increment in stage `i`, from its accelerations.
#[inline(always)]
fn finish_stage<T: Real>(by @ (settings, scheme): StepArguments<'_>, s: &mut Scratch<T>, i: usize) {
    if !s.curved.is_empty() {
        s.rub_by_noise(by, i);
    }
    s.l[i].copy_from_slice(&s.c);
    add_scaled(&mut s.l[i], scheme.tableau.gamma[i][i], &s.m[i]);
    if settings.wrenches.is_some() {
        s.wrenches.add_work_of_stage(scheme, i, (&s.v_stage, &s.m));
    }
}

/// Secant coefficient of friction, f / sqrt(v^2 + v0^2) at the start of the step. It is nonzero if f is, so that a row
/// has noise in all lanes or in none. Treated implicitly, it cannot reverse a velocity.
#[inline(always)]
pub(super) fn set_friction<T: Real>((settings, scheme): StepArguments<'_>, s: &mut Scratch<T>) {
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

/// The right-hand side of stage `i`.
#[inline(always)]
fn forces<T: Real>((settings, scheme): StepArguments<'_>, s: &mut Scratch<T>, i: usize) {
    let t = &scheme.tableau;
    for (k, body) in s.model.bodies.iter().enumerate() {
        let stage = &s.model.system.stages[k];
        let (row, at) = (stage.first_row, body.q);
        if settings.sprung_bodies[k] {
            body.motion.displacement(&s.rest[at..], &s.q_stage[at..], &mut s.displaced[row..]);
        }
        if settings.controlled_bodies[k] {
            body.motion.displacement(&s.target[at..], &s.q_stage[at..], &mut s.displaced_target[row..]);
        }
    }
    for (row, of) in s.rows.iter().enumerate() {
        let v = s.v_stage[row];
        let mut u = s.torque[row];
        u = u.minus_product(of.damping, v);
        u = u.minus_product(of.stiffness, s.displaced[row]);
        let mut control = of.held;
        if settings.gains.is_some() {
            control = control.minus_product(of.derivative, v - s.target_rate[row]);
            control = control.minus_product(of.proportional, s.displaced_target[row]);
        }
        let mut damping = of.damping;
        if settings.regularized {
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
    if !s.curved.is_empty() {
        s.rub((settings, scheme), i);
    }
    for mode in &s.modes {
        s.u[mode.row] += s.dry[mode.row];
    }
    if let Some(wrenches) = &settings.wrenches {
        if i == 0 {
            s.wrenches.begin();
        }
        s.wrenches.add_torques(&s.model, wrenches, &s.q_stage, (&mut s.u, t.weights[i] / scheme.step));
    }
}
