//! Steps of scenes with contacts under error control: substeps of one state.
//!
//! A substep in which no contact can act is that of the scene without contacts, with its own error control. In another
//! one, contact steps of h, h/2 and h/3 end at x1, x2 and x3, with errors of order 1 that are smooth in h as long as
//! contacts and stops keep their states. Their extrapolation is of order 3, and the estimate compares it with order 2:
//!
//! ```text
//! x = (9 x3 - 8 x2 + x1)/2,     error = |3 x3 - 4 x2 + x1|/2
//! ```
//!
//! A substep in which a contact or stop changes its state is an *event*: two contact steps, the first of which has the
//! change, so that the second one ends an inelastic impact. The substep is bisected until the effect of the unknown
//! time of the event is within the bound: the length times the largest jump of a velocity for positions, and for
//! velocities the length times the accelerations, or the difference of x1 and x2 if that is smaller. The error that the
//! shortest substeps leave is counted.

use super::super::events::{StopImpact, largest};
use super::super::job::{Impacts, Job, States};
use super::super::limit_rows::limit_rows;
use super::super::manifold::{advance, displacement};
use super::super::step_settings::StepSettings;
use super::super::stepper::Stepper;
use super::super::torque::{StepFault, Torque};
use super::super::totals::{ERROR, EVENTS, LENGTH, MOST, SUBSTEPS, TOTALS, WORKS};
use super::report;
use super::step::RESTS;
use super::switching::Switching;
use crate::batch::instruction_set::InstructionSet;
use crate::dynamics::contacts::LimitRow;
use crate::error::Error;
use crate::interrupt;
use crate::scene::Scene;

/// The first substep, the shortest one without a change of states, and the shortest one, as fractions of the step.
const FIRST: f64 = 1e-2;
const SHORTEST: f64 = 1e-5;
const SHORTEST_EVENT: f64 = 1e-10;
/// Length of substeps in which a joint returns from outside of its limits, s.
const RETURNING: f64 = 5e-4;
/// A joint within this distance of its limit is at it, rad or m.
const AT_LIMIT: f64 = 1e-11;
/// Largest number of substeps of a step, with those that are rejected.
const MOST_TRIED: usize = 20_000;
/// The estimate of a smooth motion decreases at least by this factor in a substep of at most half the length.
const SMOOTH: f64 = 0.9;
/// The smallest and the largest ratio of the lengths of two substeps.
const SHORTER: f64 = 0.3;
const LONGER: f64 = 5.0;

/// The step of one state that is divided.
struct Divided<'a> {
    scene: &'a Scene,
    torque: &'a Torque<'a>,
    n: usize,
    state: [usize; 1],
    limits: Vec<LimitRow>,
    accuracy: f64,
    /// The length of the step, s, and the settings of a substep.
    step: f64,
    settings: StepSettings,
    /// Forces of persistent contact in the last substep, N, and impulses since the start of the step, N s.
    forces: Vec<f64>,
    impulses: Vec<f64>,
    impacts: Vec<StopImpact>,
    /// The estimate of the last rejected substep without a change of states; infinite after an accepted one.
    rejected: f64,
    /// Part of the step that is left, and the values at its start.
    left: f64,
    values: Vec<f64>,
}

/// Some contact steps of equal lengths.
struct Run {
    values: Vec<f64>,
    impulses: Vec<f64>,
    impacts: Vec<StopImpact>,
    /// True if states change in the first step, or in any.
    changes_first: bool,
    changes: bool,
    /// True if friction changes its direction.
    reverses: bool,
    /// The largest acceleration of a joint without contacts.
    acceleration: f64,
}

impl Run {
    fn new(values: Vec<f64>, impulses: Vec<f64>, impacts: Vec<StopImpact>) -> Self {
        Self { values, impulses, impacts, changes_first: false, changes: false, reverses: false, acceleration: 0.0 }
    }
}

/// A substep with its error estimate; `None` if it is rejected.
struct Substep {
    accepted: Option<(Run, f64)>,
    is_event: bool,
    /// The next length to try, as a multiple of this one.
    next: f64,
}

impl Divided<'_> {
    /// The index of the first total, and that of the first value of contacts.
    fn at(&self) -> (usize, usize) {
        let totals = self.scene.nq() + self.scene.nv();
        (totals, totals + TOTALS)
    }

    fn total(&mut self, which: usize) -> &mut f64 {
        let at = self.at().0 + which;
        &mut self.values[at]
    }

    fn moving<'v>(&self, values: &'v [f64]) -> (&'v [f64], &'v [f64]) {
        values[..self.at().0].split_at(self.scene.nq())
    }

    /// A job of one step, which adds its impacts, with the time since its start.
    fn job<'j>(&'j self, values: &'j mut [f64], impacts: &'j Impacts) -> Job<'j, 'static> {
        let of_state = (self.n..self.n + 1, States::Listed(&self.state));
        let plain = Job::of((self.scene, &self.settings), of_state, (values, self.torque));
        Job { begun: std::slice::from_ref(&self.n), impacts: Some(impacts), ..plain }
    }

    /// The states of the contacts, and whether joints are at their limits. The relaxed law has no states.
    fn states(&self, values: &[f64]) -> Vec<f64> {
        if self.settings.smoothing.is_some() {
            return Vec::new();
        }
        let (q, _) = self.moving(values);
        let (kept, contacts) = (&values[self.at().1..], self.scene.contact_points().len());
        let at_limit = |limit: &LimitRow| f64::from(u8::from(limit.gap(q) <= AT_LIMIT));
        kept[6 * contacts..7 * contacts].iter().copied().chain(self.limits.iter().map(at_limit)).collect()
    }

    /// `count` contact steps of `h`/count from the current values, or the first one alone if states have to change in
    /// it and do not.
    fn run(&mut self, one: &mut Stepper, h: f64, (count, must): (u8, bool)) -> Result<Run, StepFault> {
        let h = h / f64::from(count);
        self.settings.adopt(h);
        let (at, contacts) = (self.at().1, self.scene.contact_points().len());
        let mut values = self.values.clone();
        for (held, force) in values[at..].iter_mut().zip(&self.forces) {
            *held = h * force;
        }
        let struck = at + 3 * contacts..at + 6 * contacts;
        let mut run = Run::new(Vec::new(), vec![0.0; 3 * contacts], Vec::new());
        for k in 0..count {
            let impacts = Impacts::default();
            one.steps(self.job(&mut values, &impacts))?;
            let touching = &one.touching(self.scene, &self.settings).touching;
            let later = |impact: StopImpact| StopImpact { time: impact.time + h * f64::from(k), ..impact };
            run.impacts.extend(impacts.take().into_iter().map(later));
            run.impulses.iter_mut().zip(&values[at..]).for_each(|(sum, held)| *sum += held);
            run.acceleration = run.acceleration.max(touching.acceleration);
            run.reverses |= touching.reverses;
            run.changes |= touching.reverses
                || !run.impacts.is_empty()
                || self.states(&values) != self.states(&self.values)
                || values[struck.clone()] != self.values[struck.clone()];
            run.changes_first |= k == 0 && run.changes;
            if must && !run.changes {
                break;
            }
        }
        run.values = values;
        Ok(run)
    }

    /// The displacement and the change of velocities from one end to another.
    fn difference(&self, from: &Run, to: &Run) -> (Vec<f64>, Vec<f64>) {
        let ((q, v), (to_q, to_v)) = (self.moving(&from.values), self.moving(&to.values));
        (displacement(self.scene.model(), q, to_q), to_v.iter().zip(v).map(|(to, from)| to - from).collect())
    }

    /// A substep of the part `part` of the step in contact steps; `rests`: a contact touches at its start, where gaps
    /// have these rates.
    fn touching(&mut self, one: &mut Stepper, (part, rests): (f64, bool), rates: &[f64]) -> Result<Substep, StepFault> {
        let (h, is_shortest) = (part * self.step, part <= SHORTEST_EVENT);
        let rejected = Substep { accepted: None, is_event: false, next: 0.5 };
        let mut halves = self.run(one, h, (2, !rests && !is_shortest))?;
        // A change in the second half, or none after a flight that can touch, is in a shorter substep.
        if !halves.changes_first && (halves.changes || !rests) && !is_shortest {
            return Ok(rejected);
        }
        let whole = self.run(one, h, (1, false))?;
        if !(halves.changes || whole.changes) {
            let thirds = self.run(one, h, (3, false))?;
            if !thirds.changes {
                return self.extrapolated(one, [whole, halves, thirds], part);
            } else if !is_shortest {
                return Ok(rejected);
            }
        }
        let ((x, dv), (_, before), (_, after)) =
            (self.difference(&whole, &halves), self.moving(&self.values), self.moving(&halves.values));
        let jump = after.iter().zip(before).fold(0.0_f64, |most, (after, before)| most.max((after - before).abs()));
        // The force of a contact that begins or ceases to stick, or opens, is continuous, and so is the velocity of one
        // that is reached; friction that changes its direction is not.
        let of_v = if halves.reverses || whole.reverses {
            2.0 * jump.max(h * halves.acceleration)
        } else {
            largest(&dv, 0.0).min(h * halves.acceleration)
        };
        let error = (h * jump).max(largest(&x, 0.0)).max(of_v / largest(before, 1.0));
        let omitted = self.omitted(rates, &halves);
        if !(error <= self.accuracy && omitted <= RESTS * self.accuracy || is_shortest) {
            return Ok(rejected);
        }
        self.project(one, &mut halves, false)?;
        let error = error + omitted;
        let next = 0.9 * (self.accuracy / error.max(f64::MIN_POSITIVE)).sqrt();
        Ok(Substep { accepted: Some((halves, error)), is_event: true, next: next.min(LONGER) })
    }

    /// The extrapolation of steps of h, h/2 and h/3 in the same states.
    fn extrapolated(
        &mut self,
        one: &mut Stepper,
        [whole, halves, mut thirds]: [Run; 3],
        part: f64,
    ) -> Result<Substep, StepFault> {
        let ((x1, v1), (x2, v2)) = (self.difference(&thirds, &whole), self.difference(&thirds, &halves));
        let (q, v) = self.moving(&self.values);
        let estimate = |first: &[f64], second: &[f64]| {
            first.iter().zip(second).fold(0.0_f64, |most, (first, second)| most.max((0.5 * first - 2.0 * second).abs()))
        };
        let error = estimate(&x1, &x2).max(estimate(&v1, &v2) / largest(v, 1.0));
        let next = 0.9 * (self.accuracy / error.max(f64::MIN_POSITIVE)).cbrt();
        // A joint outside of its limits returns at a given velocity.
        let returns = part * self.step <= RETURNING && self.limits.iter().any(|limit| limit.gap(q) < -AT_LIMIT);
        // Rounding errors do not decrease with the length.
        let is_rounding = error >= SMOOTH * self.rejected;
        if !(error <= self.accuracy || part <= SHORTEST || returns || is_rounding) {
            self.rejected = error;
            let next = if next.is_finite() { next.clamp(0.1, 0.5) } else { 0.1 };
            return Ok(Substep { accepted: None, is_event: false, next });
        }
        let of = |first: f64, second: f64, third: f64| third + 0.5 * (first - third) - 4.0 * (second - third);
        let (scene, nq, (totals, _)) = (self.scene, self.scene.nq(), self.at());
        let x: Vec<f64> = x1.iter().zip(&x2).map(|(first, second)| 0.5 * first - 4.0 * second).collect();
        let mut values = thirds.values.clone();
        advance(scene.model(), &thirds.values[..nq], &x, &mut values[..nq]);
        for i in (nq..totals).chain(WORKS.map(|work| totals + work)).chain(report::dissipated(values.len())) {
            values[i] = of(whole.values[i], halves.values[i], thirds.values[i]);
        }
        for (i, impulse) in thirds.impulses.iter_mut().enumerate() {
            *impulse = of(whole.impulses[i], halves.impulses[i], *impulse);
        }
        thirds.values = values;
        self.project(one, &mut thirds, true)?;
        Ok(Substep { accepted: Some((thirds, error)), is_event: false, next: next.clamp(SHORTER, LONGER) })
    }

    /// Ends a substep: velocities, and positions, of the contacts that act at its end.
    fn project(&self, one: &mut Stepper, run: &mut Run, positions: bool) -> Result<(), StepFault> {
        let (scene, contacts, (totals, kept)) = (self.scene, self.scene.contact_points().len(), self.at());
        let touching: Vec<usize> = (0..contacts).filter(|&i| report::acts(&run.values[kept..], contacts, i)).collect();
        let struck = kept + 3 * contacts..kept + 6 * contacts;
        let rebounds = run.values[struck.clone()] != self.values[struck];
        let moving = run.values[..totals].split_at_mut(scene.nq());
        let projected = one.touching(scene, &self.settings).project(
            (scene, &self.settings),
            (&touching, rebounds, positions),
            moving,
        );
        projected.map_err(|(joint, error)| StepFault { step: self.n, state: self.state[0], joint, error })
    }

    /// The error of rebounds that are too slow to be made, for the rates of the gaps at the start of an event.
    fn omitted(&self, rates: &[f64], end: &Run) -> f64 {
        let (kept, points) = (self.at().1, self.scene.contact_points());
        let each = points.iter().zip(rates).enumerate();
        let slow = each.filter(|(i, (_, rate))| **rate < 0.0 && report::acts(&end.values[kept..], points.len(), *i));
        let fastest = largest(self.moving(&self.values).1, 1.0);
        slow.fold(0.0_f64, |most, (_, (point, rate))| most.max(-rate * point.restitution / fastest))
    }

    /// Ends a substep: its values, impulses, impacts and error.
    fn accept(&mut self, part: f64, run: Run, error: f64) {
        let start = self.step * (1.0 - self.left);
        self.impacts.extend(run.impacts.into_iter().map(|of| StopImpact { time: of.time + start, ..of }));
        for ((sum, force), impulse) in self.impulses.iter_mut().zip(&mut self.forces).zip(run.impulses) {
            *sum += impulse;
            *force = impulse / (part * self.step);
        }
        (self.values, self.rejected) = (run.values, f64::INFINITY);
        *self.total(ERROR) += error;
        self.left = if part < self.left { self.left - part } else { 0.0 };
    }
}

impl Switching {
    /// Step `n` of one lane, with error control.
    pub(super) fn controlled(&mut self, job: &mut Job<'_, '_>, n: usize, lane: usize) -> Result<(), StepFault> {
        let (scene, settings) = (job.scene, job.settings);
        let (width, contacts) = (settings.width(scene), scene.contact_points().len());
        let Some(accuracy) = settings.given.accuracy else { return Ok(()) };
        let values = job.current[lane * width..][..width].to_vec();
        let mut step = Divided {
            scene,
            torque: job.torque,
            n,
            state: [job.states.at(lane)],
            limits: if settings.stops() { limit_rows(scene) } else { Vec::new() },
            accuracy,
            step: settings.step,
            settings: settings.clone(),
            forces: Vec::new(),
            impulses: vec![0.0; 3 * contacts],
            impacts: Vec::new(),
            rejected: f64::INFINITY,
            left: 1.0,
            values,
        };
        let (at, before) = (step.at().1, *step.total(SUBSTEPS));
        step.forces = step.values[at..at + 3 * contacts].iter().map(|impulse| impulse / step.step).collect();
        let mut one = self.one.take().unwrap_or_else(|| Box::new(Stepper::new(self.form, InstructionSet::Baseline)));
        let outcome = self.substeps(&mut step, &mut one);
        self.one = Some(one);
        if let Some(to) = job.impacts
            && !step.impacts.is_empty()
        {
            to.add(&step.impacts, step.state[0], settings.time(n - job.begun[lane]));
        }
        outcome?;
        let made = *step.total(SUBSTEPS) - before;
        *step.total(MOST) = step.total(MOST).max(made);
        step.values[at..at + 3 * contacts].copy_from_slice(&step.impulses);
        job.current[lane * width..][..width].copy_from_slice(&step.values);
        Ok(())
    }

    /// All substeps of a step.
    fn substeps(&mut self, step: &mut Divided<'_>, one: &mut Stepper) -> Result<(), StepFault> {
        let fault =
            |step: &Divided<'_>, error| StepFault { step: step.n, state: step.state[0], joint: String::new(), error };
        let (mut trial, mut tried, mut failed) = (1.0_f64, 0_usize, false);
        while step.left > 0.0 {
            tried += 1;
            if tried % 64 == 0 {
                interrupt::check().map_err(|error| fault(step, error))?;
            }
            if tried > MOST_TRIED {
                let found = format!("{}, which takes more than {MOST_TRIED} substeps in one step", step.accuracy);
                return Err(fault(step, Error::argument("accuracy", found, "a larger bound, or a smaller dt")));
            }
            let (q, v) = step.moving(&step.values);
            let rests = self.reaches[0].rests(step.scene, RESTS * step.accuracy, (q, v));
            let rates = self.reaches[0].rates().to_vec();
            let length = if *step.total(LENGTH) > 0.0 { *step.total(LENGTH) } else { FIRST };
            let flies = !rests && step.settings.free.is_some();
            let part = if flies { trial } else { trial.min(length) }.min(step.left);
            if flies && self.free_substep(step, part)? {
                // After a failure, this length is about the rest of the bracket of an impact.
                trial = if failed { part } else { 2.0 * part };
                failed = false;
                continue;
            }
            let Substep { accepted, is_event, next } = match step.touching(one, (part, !flies), &rates) {
                Err(found) if part <= SHORTEST_EVENT => return Err(found),
                Err(_) => Substep { accepted: None, is_event: true, next: 0.5 },
                Ok(substep) => substep,
            };
            let is_last = part >= step.left;
            let Some((run, error)) = accepted else {
                (trial, failed) = (next * part, true);
                continue;
            };
            step.accept(part, run, error);
            *step.total(SUBSTEPS) += if is_event { 2.0 } else { 3.0 };
            *step.total(EVENTS) += f64::from(u8::from(is_event));
            // Neither an event nor the end of the step shortens the next substep.
            let next = next * part;
            *step.total(LENGTH) = if is_event || is_last { length.max(next) } else { next };
            (trial, failed) = (1.0, false);
        }
        Ok(())
    }

    /// A substep without contacts; returns false if a contact can act in it.
    fn free_substep(&mut self, step: &mut Divided<'_>, part: f64) -> Result<bool, StepFault> {
        step.settings.adopt(part * step.step);
        let (at, contacts) = (step.at().0, step.scene.contact_points().len());
        let (mut values, impacts) = (step.values.clone(), Impacts::default());
        values[at + LENGTH] /= part;
        let Some(free) = &step.settings.free else { return Ok(false) };
        let (passed, fault) = self.attempt(&mut step.job(&mut values, &impacts), free, step.n, 1);
        if let Some(fault) = fault {
            return Err(fault);
        }
        if passed == 0 {
            return Ok(false);
        }
        values[at + LENGTH] *= part;
        let (impulses, impacts) = (vec![0.0; 3 * contacts], impacts.take());
        step.accept(part, Run::new(values, impulses, impacts), 0.0);
        Ok(true)
    }
}
