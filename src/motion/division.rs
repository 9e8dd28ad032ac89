//! One step of one state in substeps, which are short enough for fast motion and end where joints stick, slip, or reach
//! a stop; the same for all kinds of scenes.
//!
//! A substep whose modes change before its end is an *event*, an elementary step with the set-valued law of
//! [`stops`](super::stops). Without error control the substeps have the largest lengths that the error estimate of the
//! method accepts; with error control, the estimated error of each substep is within a bound.

use super::events::{Ending, Event, Events, StopImpact, conserves, largest};
use super::method::{Method, Scheme};
use super::modes::speeds_and_errors;
use super::scratch::Scratch;
use super::solver::Checked;
use super::step::step;
use super::step_settings::{RateKind, StepArguments, StepSettings};
use super::stops::SetValued;
use super::totals::{ERROR, EVENTS, LENGTH, MOST, SUBSTEPS};
use super::works::add_work;
use crate::batch::instruction_set::Baseline;
use crate::interrupt;
use crate::workspace::Workspace;

/// Largest number of substeps of a step.
const MOST_SUBSTEPS: u32 = 1 << 10;

/// With error control, the first and the shortest substep, as fractions of the step.
const FIRST: f64 = 1e-2;
const SHORTEST: f64 = 1e-7;
/// The same for an event whose estimated error exceeds the bound.
const SHORTEST_EXACT: f64 = 1e-10;
/// The largest ratio of the lengths of two substeps.
const LONGER: f64 = 5.0;
/// The part of the estimated time until a change of modes that is tried.
const BEFORE: f64 = 0.98;
/// Length of substeps in which a joint returns from outside of its stops, s; each of them is an event.
const RETURNING: f64 = 5e-4;
/// With error control, the largest number of substeps of a step.
const MOST_CONTROLLED: usize = 1_000_000;

/// Largest rotation of a joint in an event, rad, unless the substep has at most this length, in units of the shortest.
const EVENT_ANGLE: f64 = 5e-3;
const SHORTEST_EVENT: u32 = 1;

/// Number of substeps of one length before a longer one is tried.
const ROUNDS_BEFORE_LONGER: u32 = 4;

/// The elementary steps of one state of a kind of scene; the provided methods are those of trees.
pub(super) trait Steps {
    /// One step from `q`, `v` to `q_next`, `v_next`, with the modes of its start.
    fn step(&mut self, by: StepArguments<'_>, s: &mut Scratch<f64>);

    /// Ends a step whose length is accepted.
    fn finish(&mut self, _settings: &StepSettings, _s: &mut Scratch<f64>) {}

    /// Repeats a step whose end [`Steps::event`] starts from.
    fn repeat(&mut self, _by: StepArguments<'_>, _s: &mut Scratch<f64>) {}

    /// Repeats the last finished step with the set-valued law. Returns an estimate of the error, as of error control.
    fn event(&mut self, settings: &StepSettings, s: &mut Scratch<f64>, ending: Ending<'_>) -> f64;

    /// The solution of the last event, for its adjoint.
    fn solution(&self) -> Event<'_>;

    fn workspace(&mut self) -> &mut Workspace<f64>;

    /// True if a singular pivot or an error ends the step.
    fn has_failed(&self) -> bool;

    /// Clears a failure that a shorter step can avoid. Returns false if there is none.
    fn recovers(&mut self) -> bool {
        false
    }

    /// The rows with friction or stops.
    fn rows<'a>(&'a self, settings: &'a StepSettings) -> &'a [SetValued] {
        &settings.set_valued
    }

    /// True if every step from this state is an event, because friction or a stop acts from its start on.
    fn holds(&self, _s: &Scratch<f64>) -> bool {
        false
    }
}

/// The elementary steps of a tree, with or without coupled joints.
pub(super) struct TreeSteps<'a> {
    pub solver: &'a mut Checked,
    pub events: &'a mut Events,
}

impl Steps for TreeSteps<'_> {
    fn step(&mut self, by: StepArguments<'_>, s: &mut Scratch<f64>) {
        step(Baseline, by, s, self.solver);
    }

    fn event(&mut self, settings: &StepSettings, s: &mut Scratch<f64>, ending: Ending<'_>) -> f64 {
        self.events.event(settings, s, self.solver, ending)
    }

    fn solution(&self) -> Event<'_> {
        self.events.solution()
    }

    fn workspace(&mut self) -> &mut Workspace<f64> {
        &mut self.solver.workspace
    }

    fn has_failed(&self) -> bool {
        self.solver.lost.is_some()
    }
}

/// Receives each accepted substep: its scheme, its initial state, and the solution of an event.
pub(super) type Visitor<'a> = dyn FnMut(&Scheme, &Scratch<f64>, Option<&Event<'_>>) + 'a;

/// Scratch for substeps.
#[derive(Debug)]
pub(super) struct Substeps {
    q: Vec<f64>,
    v: Vec<f64>,
    /// Impacts on stops, with the time since the start of the step.
    pub impacts: Vec<StopImpact>,
}

impl Substeps {
    pub fn new(s: &Scratch<f64>) -> Self {
        Self { q: s.q.clone(), v: s.v.clone(), impacts: Vec::new() }
    }

    /// One step of the run from `q`, `v` to `q_next`, `v_next`. Calls `visit` before each substep is accepted, while
    /// `q` and `v` are still its initial state.
    pub fn advance(
        &mut self,
        settings: &StepSettings,
        s: &mut Scratch<f64>,
        steps: &mut impl Steps,
        visit: &mut Visitor<'_>,
    ) {
        self.q.copy_from_slice(&s.q);
        self.v.copy_from_slice(&s.v);
        self.impacts.clear();
        match settings.given.accuracy {
            Some(accuracy) => self.controlled((settings, accuracy), s, steps, visit),
            None => self.through(settings, s, steps, visit),
        }
        s.q_next.copy_from_slice(&s.q);
        s.v_next.copy_from_slice(&s.v);
        s.q.copy_from_slice(&self.q);
        s.v.copy_from_slice(&self.v);
    }

    /// All substeps, in place. Ends at a failure or a result that is not finite.
    fn through(
        &mut self,
        settings: &StepSettings,
        s: &mut Scratch<f64>,
        steps: &mut impl Steps,
        visit: &mut Visitor<'_>,
    ) {
        // Lengths are in units of the shortest substep.
        let shortest = settings.step / f64::from(MOST_SUBSTEPS);
        let mut size = MOST_SUBSTEPS;
        let (mut left, mut calm, mut made, mut tried) = (MOST_SUBSTEPS, 0, 0_u32, 0_u32);
        while left > 0 {
            tried += 1;
            if tried % 64 == 0 && interrupt::check().is_err() {
                s.v.fill(f64::NAN);
                break;
            }
            size = size.min(left);
            let scheme = Scheme::new(settings.method, shortest * f64::from(size));
            s.adopt(settings, &scheme);
            steps.step((settings, &scheme), s);
            // The event replaces a step without the friction that holds joints; the length is that of the event.
            let is_held = !(s.consistent > 0.0) && steps.holds(s);
            if !steps.has_failed() && !(s.short_enough > 0.0) && size > 1 && !is_held {
                (size, calm) = (shorter((settings, &scheme), s, size), 0);
                continue;
            }
            steps.finish(settings, s);
            if settings.divides && size > 1 && steps.has_failed() && steps.recovers() {
                (size, calm) = (size / 2, 0);
                continue;
            }
            if steps.has_failed() {
                s.v.fill(f64::NAN);
                break;
            }
            if s.consistent > 0.0 {
                visit(&scheme, s, None);
                add_work(settings, s);
            } else if settings.divides
                && size > SHORTEST_EVENT
                && (turns_far((settings, &scheme), &s.v) || !is_held && turns_far((settings, &scheme), &s.v_next))
            {
                (size, calm) = (size / 2, 0);
                continue;
            } else if s.v_next.iter().all(|v| v.is_finite()) {
                let time = shortest * f64::from(MOST_SUBSTEPS - left + size);
                let (totals, impacts) = (s.totals, self.impacts.len());
                steps.event(settings, s, (scheme.step, time, &mut self.impacts));
                if steps.has_failed() {
                    s.v.fill(f64::NAN);
                    break;
                }
                // The time of a rebound, and the work of the other forces until then, need the shortest substep.
                // Compliant connections store energy.
                let returns = steps.rows(settings).iter().any(|of| of.is_outside(&s.q));
                let is_exact = (settings.given.restitution == 0.0 || steps.solution().rebound.is_none())
                    && (!settings.is_rigid() || conserves(settings, s, (&totals, returns), steps.workspace()));
                if settings.divides && size > 1 && (!is_exact || is_held && turns_far((settings, &scheme), &s.v_next)) {
                    s.totals = totals;
                    self.impacts.truncate(impacts);
                    (size, calm) = (size / 2, 0);
                    continue;
                }
                let scheme = Scheme::new(Method::ImplicitEuler, scheme.step);
                visit(&scheme, s, Some(&steps.solution()));
                s.totals[EVENTS] += 1.0;
            }
            std::mem::swap(&mut s.q, &mut s.q_next);
            std::mem::swap(&mut s.v, &mut s.v_next);
            if !s.v.iter().chain(&s.q).all(|x| x.is_finite()) {
                break;
            }
            left -= size;
            made += 1;
            calm += 1;
            if calm >= ROUNDS_BEFORE_LONGER && left % (2 * size) == 0 {
                (size, calm) = (2 * size, 0);
            }
        }
        s.totals[SUBSTEPS] += f64::from(made);
        s.totals[MOST] = s.totals[MOST].max(f64::from(made));
    }

    /// All substeps with error control, in place. The error estimate of each substep, from the embedded method or from
    /// the difference between one step and two of half its length, is within the bound. A change of modes ends a
    /// substep, by bisection until the estimated error of the event is within the bound too.
    #[allow(clippy::too_many_lines)] // one loop
    fn controlled(
        &mut self,
        (settings, accuracy): (&StepSettings, f64),
        s: &mut Scratch<f64>,
        steps: &mut impl Steps,
        visit: &mut Visitor<'_>,
    ) {
        // Order of the error estimate.
        let order = f64::from(settings.method.order()) - f64::from(u8::from(settings.scheme.embedded));
        let (mut left, mut made, mut tried) = (1.0, 0.0, 0_usize);
        let mut length = if s.totals[LENGTH] > 0.0 { s.totals[LENGTH] } else { FIRST };
        let (mut q, mut v) = (s.q.clone(), s.v.clone());
        let (mut whole_q, mut whole_v) = (q.clone(), v.clone());
        while left > 0.0 {
            let is_last = length >= left;
            let part = if is_last { left } else { length };
            q.copy_from_slice(&s.q);
            v.copy_from_slice(&s.v);
            let totals = s.totals;
            let scheme = Scheme::new(settings.method, settings.step * part);
            let (mut consistent, error) = attempt(settings, &scheme, s, steps, (&mut whole_q, &mut whole_v));
            tried += 1;
            let recovers = steps.has_failed() && part > SHORTEST && steps.recovers();
            consistent &= !recovers;
            let interrupted = tried % 256 == 0 && interrupt::check().is_err();
            if steps.has_failed() || tried > MOST_CONTROLLED || interrupted {
                s.v.fill(f64::NAN);
                break;
            }
            if consistent && error <= accuracy {
                at_start(s, (&mut q, &mut v), |s| visit(&scheme, s, None));
                s.totals[ERROR] += error;
                made += if scheme.embedded { 1.0 } else { 2.0 };
                left = if is_last { 0.0 } else { left - part };
                let longer = 0.9 * (accuracy / error.max(1e-300)).powf(1.0 / (order + 1.0));
                // A substep that is cut short by the end of the step does not shorten the next one.
                length = if is_last { length.max(part * longer.min(LONGER)) } else { part * longer.clamp(0.3, LONGER) };
                continue;
            }
            s.totals = totals;
            s.q.copy_from_slice(&q);
            s.v.copy_from_slice(&v);
            let (changes, rows) = (!consistent && !recovers, steps.rows(settings));
            let returns = changes && scheme.step <= RETURNING && rows.iter().any(|of| of.is_outside(&s.q));
            let grazes = changes && rows.iter().any(|of| of.grazes(&s.q));
            let lasts = changes && steps.holds(s);
            if part <= SHORTEST || returns || lasts || grazes {
                let error = if consistent {
                    // Shorter substeps do not help: the substep is accepted, and its error is reported.
                    std::mem::swap(&mut s.q, &mut whole_q);
                    std::mem::swap(&mut s.v, &mut whole_v);
                    error
                } else {
                    let (impacts, time) = (self.impacts.len(), settings.step * (1.0 - left + part));
                    s.adopt(settings, &scheme);
                    steps.repeat((settings, &scheme), s);
                    let error = steps.event(settings, s, (scheme.step, time, &mut self.impacts));
                    if steps.has_failed() {
                        s.v.fill(f64::NAN);
                        break;
                    }
                    if !(error <= accuracy) && part > SHORTEST_EXACT && !returns {
                        s.totals = totals;
                        self.impacts.truncate(impacts);
                        length = (0.25 * part).max(SHORTEST_EXACT);
                        continue;
                    }
                    s.totals[EVENTS] += 1.0;
                    std::mem::swap(&mut s.q, &mut s.q_next);
                    std::mem::swap(&mut s.v, &mut s.v_next);
                    error
                };
                s.totals[ERROR] += error;
                if !s.v.iter().chain(&s.q).all(|x| x.is_finite()) {
                    break;
                }
                at_start(s, (&mut q, &mut v), |s| visit(&scheme, s, None));
                made += 1.0;
                left = if is_last { 0.0 } else { left - part };
                // The error of an event is of second order.
                let longer = part * (0.9 * (accuracy / error.max(1e-300)).sqrt()).min(LONGER);
                let next = if is_last { length.max(longer) } else { longer };
                length = match (lasts, returns) {
                    (_, true) => next.max(FIRST).min(RETURNING / settings.step),
                    (true, false) => next,
                    (false, false) => FIRST,
                };
                continue;
            }
            let shorter = 0.9 * (accuracy / error).powf(1.0 / (order + 1.0));
            let keeps = |of: &SetValued| of.keeps((&q, &v), (&whole_q, &whole_v), scheme.step);
            let kept = if changes { rows.iter().map(keeps).fold(1.0, f64::min) } else { 1.0 };
            let share = match () {
                () if consistent && shorter.is_finite() => shorter.clamp(0.1, 0.5),
                () if kept < 1.0 => (BEFORE * kept).clamp(0.02, 0.5),
                () => 0.25,
            };
            length = (part * share).max(SHORTEST);
        }
        s.totals[LENGTH] = length;
        s.totals[SUBSTEPS] += made;
        s.totals[MOST] = s.totals[MOST].max(made);
    }
}

/// True if a joint rotates too far in an event of the length of a step at these velocities.
fn turns_far((settings, scheme): StepArguments<'_>, v: &[f64]) -> bool {
    let mut each = settings.kinds.iter().zip(v).filter(|(kind, _)| **kind == RateKind::Rotation);
    each.any(|(_, v)| !(scheme.step * v.abs() <= EVENT_ANGLE))
}

/// Calls `visit` with the state at the start of a substep.
fn at_start(s: &mut Scratch<f64>, (q, v): (&mut Vec<f64>, &mut Vec<f64>), visit: impl FnOnce(&Scratch<f64>)) {
    let mut swap = |s: &mut Scratch<f64>| {
        std::mem::swap(&mut s.q, q);
        std::mem::swap(&mut s.v, v);
    };
    swap(s);
    visit(s);
    swap(s);
}

/// The next length to try after a rejected substep: at most half, by the error estimate.
fn shorter(by: StepArguments<'_>, s: &Scratch<f64>, size: u32) -> u32 {
    let excess = speeds_and_errors(by, s)
        .iter()
        .fold(0.0_f64, |most, (speed, error)| most.max(if *error > 0.0 { error / (by.1.share * speed) } else { 0.0 }));
    let mut shorter = size / 2;
    // The estimate decreases at least with the square of the step.
    let mut reached = 4.0;
    while shorter > 1 && !(excess <= reached) && reached < 1e6 {
        shorter /= 2;
        reached *= 4.0;
    }
    shorter
}

/// Tries a substep, in place, and without an embedded method again as two of half the length. Copies the end of the
/// whole one. Returns whether its modes hold to the end, and the estimated error.
fn attempt(
    settings: &StepSettings,
    scheme: &Scheme,
    s: &mut Scratch<f64>,
    steps: &mut impl Steps,
    (whole_q, whole_v): (&mut [f64], &mut [f64]),
) -> (bool, f64) {
    let fastest = largest(&s.v, 1.0);
    s.adopt(settings, scheme);
    steps.step((settings, scheme), s);
    steps.finish(settings, s);
    whole_q.copy_from_slice(&s.q_next);
    whole_v.copy_from_slice(&s.v_next);
    let keeps = |steps: &_, s: &Scratch<f64>, h: f64| {
        let passes = |of: &SetValued| of.passes((&s.q, &s.v), (&s.q_next, &s.v_next), h);
        s.consistent > 0.0 && !Steps::rows(steps, settings).iter().any(passes)
    };
    let mut consistent = keeps(steps, s, scheme.step);
    let error = if scheme.embedded {
        let [of_q, of_v] = [&s.l, &s.m].map(|stages| {
            let row = |row: usize| scheme.error.iter().zip(stages).map(|(e, k)| e * k[row]).sum::<f64>().abs();
            (0..s.v.len()).map(row).fold(0.0, f64::max)
        });
        add_work(settings, s);
        std::mem::swap(&mut s.q, &mut s.q_next);
        std::mem::swap(&mut s.v, &mut s.v_next);
        of_q.max(of_v / fastest)
    } else {
        let half = Scheme::new(settings.method, 0.5 * scheme.step);
        s.adopt(settings, &half);
        for _ in 0..2 {
            if consistent {
                steps.step((settings, &half), s);
                steps.finish(settings, s);
                consistent = keeps(steps, s, half.step);
                add_work(settings, s);
                std::mem::swap(&mut s.q, &mut s.q_next);
                std::mem::swap(&mut s.v, &mut s.v_next);
            }
        }
        let size = |x: &[f64], y: &[f64]| x.iter().zip(y).fold(0.0_f64, |most, (x, y)| most.max((x - y).abs()));
        size(&s.q, whole_q).max(size(&s.v, whole_v) / fastest) / (f64::from(settings.method.order()).exp2() - 1.0)
    };
    (consistent, error)
}
