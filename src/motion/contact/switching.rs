//! Steps of scenes with contacts: a state whose contacts cannot act takes the step of the scene without contacts, by
//! the same code and with the same bits; another takes the contact step.
//!
//! The step without contacts is made first, and accepted if [`Reach`] finds that no contact acts in it. States that
//! touch at the start are not tried. The decision depends on the state and on the torques of the step alone, so that
//! results do not depend on other states, on threads or on the division into calls.

use super::super::job::{Divisions, Impacts, Job, States};
use super::super::stepper::Stepper;
use super::super::torque::StepFault;
use super::super::totals::TOTALS;
use super::reach::Reach;
use super::record::Outcome;
use super::report;
use super::step::keep;
use super::stepper::record;
use crate::batch::instruction_set::InstructionSet;
use crate::dynamics::contacts::ContactScratch;
use crate::filter::Form;
use crate::motion::step_settings::StepSettings;
use crate::scene::Scene;

/// Scratch memory for the states of a job.
pub(in crate::motion) struct Switching {
    /// The steps without contacts, and those with contacts.
    free: Box<Stepper>,
    touching: Box<Stepper>,
    /// One state, with error control.
    pub(super) one: Option<Box<Stepper>>,
    pub(super) form: Form,
    /// One per lane.
    pub(super) reaches: Vec<Reach>,
    rows: ContactScratch,
    part: Part,
    divisions: Divisions,
    impacts: Impacts,
}

/// Some of the states of a job.
#[derive(Default)]
struct Part {
    lanes: Vec<usize>,
    states: Vec<usize>,
    begun: Vec<usize>,
    current: Vec<f64>,
}

impl Part {
    /// Copies the lanes given as bits, the first `width` values of each.
    fn take(&mut self, job: &Job<'_, '_>, bits: u64, (of_state, width): (usize, usize)) {
        self.lanes.clear();
        self.lanes.extend((0..job.states.len()).filter(|lane| bits >> lane & 1 == 1));
        self.states.clear();
        self.states.extend(self.lanes.iter().map(|&lane| job.states.at(lane)));
        self.begun.clear();
        self.begun.extend(self.lanes.iter().filter_map(|&lane| job.begun.get(lane)));
        self.current.clear();
        self.lanes.iter().for_each(|lane| self.current.extend_from_slice(&job.current[lane * of_state..][..width]));
    }

    /// One step of these states.
    fn job<'a>(&'a mut self, job: &Job<'a, '_>, settings: &'a StepSettings, n: usize) -> Job<'a, 'static> {
        let Job { scene, torque, impacts, touches, .. } = *job;
        let of_states = (n..n + 1, States::Listed(&self.states));
        let plain = Job::of((scene, settings), of_states, (&mut self.current, torque));
        Job { begun: &self.begun, impacts, touches, ..plain }
    }
}

impl Switching {
    #[cold]
    pub fn new(scene: &Scene, (form, arm): (Form, InstructionSet), lanes: usize) -> Self {
        Self {
            free: Box::new(Stepper::new(form, arm)),
            touching: Box::new(Stepper::new(form, arm)),
            one: None,
            form,
            reaches: (0..lanes).map(|_| Reach::new(scene)).collect(),
            rows: ContactScratch::new(scene.model(), scene.contact_points(), Vec::new()),
            part: Part::default(),
            divisions: Divisions::default(),
            impacts: Impacts::default(),
        }
    }

    /// Runs a job; returns the fault of the earliest step, and of the lowest state in it.
    pub fn run(&mut self, mut job: Job<'_, '_>) -> Result<(), StepFault> {
        if job.rows.as_ref().is_some_and(|rows| job.steps.start == rows.from) {
            self.record(&mut job, 0);
        }
        for n in job.steps.clone() {
            self.step(&mut job, n)?;
            if let Some(rows) = &job.rows
                && (n + 1 - rows.from) % rows.every == 0
            {
                let row = (n + 1 - rows.from) / rows.every;
                self.record(&mut job, row);
            }
        }
        Ok(())
    }

    fn step(&mut self, job: &mut Job<'_, '_>, n: usize) -> Result<(), StepFault> {
        let (settings, width) = (job.settings, job.settings.width(job.scene));
        let all = u64::MAX >> (64 - job.states.len());
        let (acting, fault) = self.free_steps(job, n, all);
        let mut outcome = fault.map_or(Ok(()), Err);
        if settings.given.accuracy.is_some() {
            for lane in (0..job.states.len()).filter(|lane| acting >> lane & 1 == 1) {
                let fault = self.controlled(job, n, lane);
                let is_earlier = |fault: &StepFault| {
                    outcome.as_ref().err().is_none_or(|known: &StepFault| fault.state < known.state)
                };
                if fault.as_ref().is_err_and(is_earlier) {
                    outcome = fault;
                }
            }
        }
        let mut left = if settings.given.accuracy.is_some() { 0 } else { acting };
        while left != 0 {
            let Self { part, touching, reaches, .. } = self;
            let shapes = reaches[left.trailing_zeros() as usize].shapes.as_mut();
            // One state at a time with shapes, whose contacts are known.
            let bits = if shapes.is_some() { left & left.wrapping_neg() } else { left };
            left &= !bits;
            part.take(job, bits, (width, width));
            let touched = match shapes {
                Some(shapes) => touching.shaped_steps(part.job(job, settings, n), shapes),
                None => touching.steps(part.job(job, settings, n)),
            };
            for (lane, values) in part.lanes.iter().zip(part.current.chunks_exact(width)) {
                job.current[lane * width..][..width].copy_from_slice(values);
            }
            if let Err(fault) = touched
                && outcome.as_ref().err().is_none_or(|known| fault.state < known.state)
            {
                outcome = Err(fault);
            }
        }
        outcome
    }

    /// Step `n` of the states, given as bits, whose contacts cannot act in it. Returns the others, and the fault of the
    /// lowest state.
    fn free_steps(&mut self, job: &mut Job<'_, '_>, n: usize, all: u64) -> (u64, Option<StepFault>) {
        let (scene, settings) = (job.scene, job.settings);
        let Some(free) = &settings.free else { return (all, None) };
        let (width, (nq, nv)) = (settings.width(scene), (scene.nq(), scene.nv()));
        let mut trying = 0_u64;
        for lane in 0..job.states.len() {
            let (moving, kept) = job.current[lane * width..(lane + 1) * width].split_at(nq + nv);
            let last = report::acting(&kept[TOTALS..], scene.contact_points().len());
            let touches =
                all >> lane & 1 == 1 && self.reaches[lane].touches(scene, settings.step, moving.split_at(nq), last);
            trying |= u64::from(all >> lane & 1 == 1 && !touches) << lane;
        }
        if trying == 0 {
            return (all, None);
        }
        let (passed, fault) = self.attempt(job, free, n, trying);
        (all & !passed, fault)
    }

    /// Tries step `n` without contacts of the states given as bits; returns those that made it, and the fault of the
    /// lowest state.
    pub(super) fn attempt(
        &mut self,
        job: &mut Job<'_, '_>,
        free: &StepSettings,
        n: usize,
        trying: u64,
    ) -> (u64, Option<StepFault>) {
        let (scene, settings) = (job.scene, job.settings);
        let (width, (nq, nv)) = (settings.width(scene), (scene.nq(), scene.nv()));
        let of_step = nq + nv + TOTALS;
        let Self { free: stepper, part, divisions, impacts, reaches, .. } = self;
        part.take(job, trying, (width, of_step));
        divisions.clear();
        impacts.take();
        let own = job.impacts.is_some().then_some(&*impacts);
        let outcome = stepper.steps(Job { impacts: own, divisions: Some(divisions), ..part.job(job, free, n) });
        if let Err(fault) = outcome {
            let lane = trying.trailing_zeros() as usize;
            if trying.is_power_of_two() {
                let start = job.current[lane * width..][..nq + nv].split_at(nq);
                let is_far = reaches[lane].is_far(scene, settings.step, start);
                return (0, is_far.then_some(fault));
            }
            // Some states of a failed step are unfinished.
            let (mut passed, mut bits) = (0, trying);
            while bits != 0 {
                let one = bits & bits.wrapping_neg();
                bits &= bits - 1;
                let (made, fault) = self.attempt(job, free, n, one);
                passed |= made;
                if fault.is_some() {
                    return (passed, fault);
                }
            }
            return (passed, None);
        }
        let mut passed = 0_u64;
        for (at, &lane) in part.lanes.iter().enumerate() {
            let values = &part.current[at * of_step..(at + 1) * of_step];
            let reach = &mut reaches[lane];
            let starts = divisions.of.iter().zip(divisions.starts.chunks_exact((nq + nv).max(1)));
            let mut starts = starts.filter(|((of, _), _)| *of == at).map(|((_, h), start)| (*h, start));
            let mut h = starts.next().map_or(settings.step, |(h, _)| h);
            // The end of a substep is the start of the next one.
            let inner = starts.all(|(next, start)| {
                let length = std::mem::replace(&mut h, next);
                reach.passes(scene, length, start.split_at(nq))
            });
            if !inner || !reach.passes(scene, h, values[..nq + nv].split_at(nq)) {
                continue;
            }
            passed |= 1 << lane;
            let current = &mut job.current[lane * width..(lane + 1) * width];
            current[..of_step].copy_from_slice(values);
            keep(&mut current[of_step..], &Outcome::default(), scene.contact_points().len());
        }
        if let Some(to) = job.impacts {
            for impact in impacts.take() {
                let lane = part.states.iter().position(|&state| state == impact.state).map(|at| part.lanes[at]);
                if lane.is_some_and(|lane| passed >> lane & 1 == 1) {
                    to.add(&[impact], impact.state, 0.0);
                }
            }
        }
        (passed, None)
    }

    /// Writes a row of each state.
    fn record(&mut self, job: &mut Job<'_, '_>, row: usize) {
        let Job { scene, settings, states, current, rows: Some(rows), .. } = job else { return };
        let (points, width, (nq, nv)) = (scene.contact_points(), settings.width(scene), (scene.nq(), scene.nv()));
        for (lane, current) in current.chunks_exact_mut(width).enumerate() {
            let (state, (moving, kept)) = (states.at(lane), current.split_at_mut(nq + nv));
            let (q, v) = moving.split_at(nq);
            let at = (state - rows.first) * rows.of_state + row;
            rows.q[at * nq..(at + 1) * nq].copy_from_slice(q);
            rows.qd[at * nv..(at + 1) * nv].copy_from_slice(v);
            let Some(to) = rows.of_contacts(state, row, points.len()) else { continue };
            record(scene.model(), points, &mut self.rows, (q, v), (&kept[TOTALS..], settings.step), to);
            if row > 0 {
                kept[TOTALS..][3 * points.len()..6 * points.len()].fill(0.0);
            }
        }
    }
}
