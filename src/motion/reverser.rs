//! Backpropagation through all steps of a rollout for a few states, one per lane, compiled for one instruction set.

mod job;
mod step;

use super::backward::{ACTING, CheckedBackward, INPUTS, StepGradients, VectorizedBackward, backward};
use super::checked::CheckedState;
use super::closed_reverse::ClosedReverse;
use super::connected::ConnectedReverse;
use super::contact::{ContactReverse, ModeChange};
use super::drives::give;
use super::events::{EventSolution, Rebound, Reversal};
use super::faults::pivot_fault;
use super::gradient_layout::{CONTACTS, INPUT, PARAMETERS, ROWS};
use super::job::{self as forward, Rows};
use super::limit_rows::limit_rows;
use super::method::{Method, Scheme};
use super::reversed_substeps::{Parts, RecordedEvent, Substep, through_substeps};
use super::runner::Runner;
use super::scratch::{Scratch, add_scaled, clear};
use super::step_settings::{StepArguments, StepSettings};
use super::stepper::{fill, scatter, take_lane};
use super::torque::{StepFault, Torque};
use crate::batch::instruction_set::{Baseline, InstructionSet, Target, Vectorized, lanes_of, on_instruction_set};
use crate::error::Error;
use crate::filter::Form;
use crate::{interrupt, memory};
pub(super) use job::Job;
use std::ops::Range;
use std::sync::PoisonError;
use step::{Lanes, step};

/// Largest number of consecutive steps that are recomputed and all stored.
const KEPT_WHOLE: usize = 256;

/// Backpropagation through steps, for any scalar type.
trait Reversing: Send + Sync {
    /// Sets all gradients to zero.
    fn begin(&mut self, job: &Job<'_>);

    /// Adds the gradients by a recorded row, at which the next step ends.
    fn add_row(&mut self, job: &Job<'_>, row: usize);

    /// Propagates the gradients through step `n` to its start, (q, qd) of each state; gradients by torques of steps are
    /// written to `out`.
    fn step(&mut self, job: &Job<'_>, n: usize, start: &[f64], out: &mut [f64]) -> Result<(), StepFault>;

    /// Writes the accumulated gradients.
    fn finish(&mut self, job: &Job<'_>, out: &mut [f64]);
}

/// Scratch memory for backpropagation on one thread, allocated at first use.
pub(super) struct Reverser {
    runner: Runner,
    arm: InstructionSet,
    form: Form,
    one: Option<Box<dyn Reversing>>,
    many: Option<Box<dyn Reversing>>,
}

impl Reverser {
    pub fn new(form: Form, arm: InstructionSet) -> Self {
        let arm = if arm.available() { arm } else { InstructionSet::Baseline };
        Self { runner: Runner::new(form, arm), arm, form, one: None, many: None }
    }

    /// Largest number of states of a job.
    pub fn lanes(&self) -> usize {
        self.runner.lanes()
    }

    /// Propagates the gradients from the last row to the first.
    pub fn run(&mut self, job: &Job<'_>, out: &mut [f64]) -> Result<(), StepFault> {
        let (arm, form, alone) = (self.arm, self.form, job.states.len() == 1);
        let place = if alone { &mut self.one } else { &mut self.many };
        let reversing = place.get_or_insert_with(|| on_instruction_set!((arm, alone), Compiled::boxed(job, form)));
        reversing.begin(job);
        let (every, mut start) = (job.rows.every, Vec::new());
        for row in (0..job.count).rev() {
            if row + 1 < job.count {
                interrupt::check().map_err(|error| job.refuse(error))?;
                job.row(row, &mut start);
                through(&mut self.runner, &mut **reversing, (job, &start), row * every..(row + 1) * every, out)?;
            }
            reversing.add_row(job, row);
        }
        reversing.finish(job, out);
        Ok(())
    }
}

/// Propagates the gradients through consecutive steps of which only the initial state is known. The steps are
/// recomputed and stored, or some of them, from which the others are recomputed.
fn through(
    runner: &mut Runner,
    reversing: &mut dyn Reversing,
    (job, start): (&Job<'_>, &[f64]),
    steps: Range<usize>,
    out: &mut [f64],
) -> Result<(), StepFault> {
    let count = steps.len();
    if count == 1 {
        return reversing.step(job, steps.start, start, out);
    }
    interrupt::check().map_err(|error| job.refuse(error))?;
    let stride = if count <= KEPT_WHOLE { 1 } else { count.isqrt() + 1 };
    let rows = count.div_ceil(stride);
    let (nq, nv, states) = (job.scene.nq(), job.scene.nv(), job.states.len());
    let room =
        |width: usize| memory::filled("steps", states * rows * width, f64::NAN).map_err(|error| job.refuse(error));
    let width = job.settings.width(job.scene);
    let (mut q, mut qd, mut current) = (room(nq)?, room(nv)?, vec![0.0; states * width]);
    for (at, start) in current.chunks_exact_mut(width).zip(start.chunks_exact((nq + nv).max(1))) {
        at[..nq + nv].copy_from_slice(start);
    }
    for (state, at) in current.chunks_exact(width).enumerate() {
        q[state * rows * nq..][..nq].copy_from_slice(&at[..nq]);
        qd[state * rows * nv..][..nv].copy_from_slice(&at[nq..nq + nv]);
    }
    let mut kept = Rows {
        q: &mut q,
        qd: &mut qd,
        contacts: &mut [],
        first: job.states.start,
        of_state: rows,
        from: steps.start,
        every: stride,
    };
    let stored = (steps.start..steps.start + (rows - 1) * stride, forward::States::Adjacent(job.states.clone()));
    let plain = forward::Job::of((job.scene, job.settings), stored, (&mut current, job.torque));
    runner.run(forward::Job { rows: Some(&mut kept), ..plain })?;
    let mut current = start.to_vec();
    for row in (0..rows).rev() {
        for (state, at) in current.chunks_exact_mut((nq + nv).max(1)).enumerate() {
            at[..nq].copy_from_slice(&q[(state * rows + row) * nq..][..nq]);
            at[nq..].copy_from_slice(&qd[(state * rows + row) * nv..][..nv]);
        }
        let from = steps.start + row * stride;
        through(runner, reversing, (job, &current), from..(from + stride).min(steps.end), out)?;
    }
    Ok(())
}

/// Scratch memory in a scalar type, for code compiled for one instruction set.
struct Compiled<T: Vectorized, I> {
    lanes: Lanes<T, I>,
    /// Sums over all steps of [`StepGradients::acting`], and of the gradients by wrenches and parameters.
    sums: Vec<Vec<T>>,
    target: I,
    checked: Option<Box<Checked>>,
    closed: Option<Box<ClosedReverse>>,
    touching: Option<Box<ContactReverse>>,
}

/// One state, for steps that are not vectorized.
trait OneState: Parts {
    /// Propagates the gradients through the step of one state. Returns the joint and the error if that fails.
    fn step(&mut self, job: &Job<'_>) -> Result<(), (String, Error)>;
}

impl Parts for ClosedReverse {
    fn parts(&mut self) -> (&mut Scratch<f64>, &mut StepGradients<f64>) {
        (&mut self.one.scratch, &mut self.gradients)
    }
}

impl OneState for ClosedReverse {
    fn step(&mut self, job: &Job<'_>) -> Result<(), (String, Error)> {
        let (scene, settings) = (job.scene, job.settings);
        if self.step((scene, settings), &settings.scheme, true)? {
            return Ok(());
        }
        let mut made = Vec::new();
        self.one.step(scene, settings, &mut |scheme, s, event| {
            made.push(Substep::new(settings, scheme, s, event));
        })?;
        through_substeps(self, settings, made, |closed, Substep { scheme, event, .. }| {
            let scheme = Scheme::new(settings.method, scheme.step);
            let Some(rebound) = event.and_then(|event| event.rebound) else {
                return closed.step((scene, settings), &scheme, false).map(drop);
            };
            let [of_q, of_v] = closed.gradients.end.clone();
            clear(&mut closed.gradients.end[0]);
            closed.step((scene, settings), &scheme, false)?;
            let after = closed.accelerations_after(scene, settings, &scheme)?;
            let ClosedReverse { one, gradients, .. } = closed;
            through_impact((&one.scratch.v, scheme.step), (&rebound, &after), [&of_q, &of_v], &mut gradients.start);
            Ok(())
        })
    }
}

/// One state with all checks, in substeps, and with the set-valued law.
struct Checked {
    one: CheckedState,
    gradients: StepGradients<f64>,
    solver: CheckedBackward,
}

impl Checked {
    #[cold]
    fn new(job: &Job<'_>, form: Form) -> Self {
        let one = CheckedState::new(job.scene, job.settings, form);
        let (model, tolerance) = (&one.scratch.model, job.settings.given.tolerance);
        let gradients = StepGradients::new(model, job.settings, job.layout.count(PARAMETERS) > 0);
        let solver = CheckedBackward::new(model, job.settings.coupling.clone(), form, tolerance);
        Self { one, gradients, solver }
    }
}

impl Parts for Checked {
    fn parts(&mut self) -> (&mut Scratch<f64>, &mut StepGradients<f64>) {
        (&mut self.one.scratch, &mut self.gradients)
    }
}

impl OneState for Checked {
    #[inline(never)]
    fn step(&mut self, job: &Job<'_>) -> Result<(), (String, Error)> {
        let (settings, mut made) = (job.settings, Vec::new());
        self.one.step(job.scene, settings, &mut |scheme, s, event| {
            made.push(Substep::new(settings, scheme, s, event));
        })?;
        through_substeps(self, settings, made, |state, Substep { scheme, pieces, event, .. }| {
            let Self { one: CheckedState { scratch, solver: forward, events, .. }, gradients, solver } = state;
            let by = (settings, &scheme);
            match event {
                None => {
                    if !pieces.is_empty() {
                        give(settings, scratch, &pieces);
                    }
                    backward(Baseline, by, scratch, gradients, solver, None);
                    scratch.are_sides_given = false;
                }
                Some(event) => {
                    let after = event
                        .rebound
                        .as_ref()
                        .map(|rebound| events.accelerations_after(settings, (scheme.step, rebound), scratch, forward));
                    scratch.adopt(settings, &scheme);
                    through_event(by, scratch, gradients, solver, (&event, after.as_deref()));
                }
            }
            Ok(())
        })?;
        let Self { one, gradients, solver } = self;
        if let Some(lost) = one.solver.lost.take().or(solver.solver.lost.take()) {
            return Err(pivot_fault(job.scene, lost));
        }
        gradients.check(job.scene)
    }
}

/// Propagates the gradients through an event.
fn through_event(
    by: StepArguments<'_>,
    s: &mut Scratch<f64>,
    gradients: &mut StepGradients<f64>,
    solver: &mut CheckedBackward,
    (RecordedEvent { solutions, reached, rebound, reversals }, after): (&RecordedEvent, Option<&[f64]>),
) {
    // A joint that ends the step at a stop also ends there for all perturbed initial states, but not with a rebound.
    let rebounds = |row: &usize| rebound.as_ref().is_some_and(|of| of.rows.contains(row) && of.velocities[*row] != 0.0);
    for &row in reached.iter().filter(|row| !rebounds(row)) {
        gradients.end[0][row] = 0.0;
    }
    let mut through = |gradients: &mut StepGradients<f64>, solutions: &EventSolution| {
        backward(Baseline, by, s, gradients, &mut solver.known(&solutions.accelerations), Some(&solutions.rows));
    };
    let [for_positions, for_velocities] = &solutions[..] else {
        for solutions in solutions {
            through(gradients, solutions);
        }
        Reversal::add(reversals, &gradients.end[1], &mut gradients.start[1]);
        return;
    };
    let [of_q, of_v] = gradients.end.clone();
    gradients.end[0].fill(0.0);
    if let (Some(rebound), Some(after)) = (rebound, after) {
        through(gradients, for_velocities);
        through_impact((&s.v, by.1.step), (rebound, after), [&of_q, &of_v], &mut gradients.start);
        return;
    }
    through(gradients, for_velocities);
    let first: Vec<Vec<f64>> = gradients.results().map(|numbers| numbers.to_vec()).collect();
    gradients.end[0].copy_from_slice(&of_q);
    gradients.end[1].fill(0.0);
    through(gradients, for_positions);
    for (sum, more) in gradients.results().zip(first) {
        add_scaled(sum, 1.0, &more);
    }
}

/// Completes `start`, the gradients by the velocities after an impact, propagated to its start: adds those by the
/// positions, which the impact leaves as they are, and by the time of the impact.
///
/// An impact D from (q, v) with accelerations a to (q, v+) with a+, later by `dt = -dq_i/v_i`, changes the motion after
/// it by (D (v, a) - (v+, a+)) dt (M. A. Aizerman and F. R. Gantmacher, Quarterly Journal of Mechanics and Applied
/// Mathematics 11, 1958).
fn through_impact(
    (v, h): (&[f64], f64),
    (Rebound { rows, velocities, accelerations_before: before }, after): (&Rebound, &[f64]),
    end: [&[f64]; 2],
    [of_q, of_v]: &mut [Vec<f64>; 2],
) {
    add_scaled(of_q, 1.0, end[0]);
    add_scaled(of_v, h, end[0]);
    let times: Vec<(usize, f64)> = rows
        .iter()
        .map(|&row| {
            let of_time =
                |i: usize| of_q[i] * v[i] + of_v[i] * before[i] - end[0][i] * velocities[i] - end[1][i] * after[i];
            // Of several joints that hit their stops at once, each changes its own motion.
            let of_time = if rows.len() == 1 { (0..v.len()).map(of_time).sum() } else { of_time(row) };
            (row, -of_time / v[row])
        })
        .collect();
    for (row, by_position) in times {
        of_q[row] += by_position;
    }
}

impl<T: Vectorized, I: Target> Compiled<T, I> {
    fn boxed(job: &Job<'_>, form: Form, target: I) -> Box<dyn Reversing> {
        let scratch = Scratch::new(job.scene.model(), job.settings);
        let parameters = job.layout.count(PARAMETERS) > 0;
        let mut gradients = StepGradients::new(&scratch.model, job.settings, parameters);
        let limits = || if job.settings.stops() { limit_rows(job.scene) } else { Vec::new() };
        let is_connected = job.settings.connected && job.settings.has_vectorized_adjoint();
        let connected = is_connected
            .then(|| Box::new(ConnectedReverse::new(job.scene, job.settings, &scratch, (limits(), parameters))));
        Box::new(Self {
            sums: gradients.results().skip(2).map(|numbers| numbers.to_vec()).collect(),
            lanes: Lanes {
                connected,
                gradients,
                solver: VectorizedBackward::new(target, form, (&scratch.model, &scratch.constants)),
                scratch,
                form,
            },
            target,
            checked: None,
            closed: None,
            touching: None,
        })
    }
}

impl<T: Vectorized, I: Target> Reversing for Compiled<T, I> {
    fn begin(&mut self, job: &Job<'_>) {
        let Self { lanes: Lanes { scratch: s, gradients, .. }, sums, .. } = self;
        for numbers in sums.iter_mut().chain(&mut gradients.end).chain([&mut s.torque]) {
            clear(numbers);
        }
        if let Some(touching) = &mut self.touching {
            touching.begin();
        }
        let states = &job.states;
        s.take_gains(job.settings, states.len(), |lane| states.start + lane);
        for lane in 0..T::LANES {
            let state = states.start + lane.min(states.len() - 1);
            if let Torque::Constant(torque) = job.torque {
                fill(&mut s.torque, lane, torque.state(state));
            }
        }
    }

    fn add_row(&mut self, job: &Job<'_>, row: usize) {
        let nv = job.scene.nv();
        for (end, given) in self.lanes.gradients.end.iter_mut().zip([job.rows.by_q, job.rows.by_qd]) {
            for (lane, state) in job.states.clone().enumerate() {
                let given = &given[(state * job.count + row) * nv..][..nv];
                for (sum, &more) in end.iter_mut().zip(given) {
                    sum.lanes_mut()[lane] += more;
                }
            }
        }
    }

    fn step(&mut self, job: &Job<'_>, n: usize, start: &[f64], out: &mut [f64]) -> Result<(), StepFault> {
        let mut fallback = step(self.target, &mut self.lanes, job, n, start);
        fallback &= u64::MAX >> (64 - job.states.len());
        if fallback != 0 {
            if job.settings.method == Method::Contact {
                self.through_contacts(job, n)?;
            } else {
                self.recompute(job, n, fallback)?;
            }
        }
        let Self { lanes: Lanes { gradients, .. }, sums, .. } = self;
        for (sums, more) in sums.iter_mut().zip(gradients.results().skip(2)) {
            sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += *more);
        }
        let StepGradients { start, end, acting, wrenches, .. } = gradients;
        std::mem::swap(start, end);
        let inputs = acting[..INPUTS].iter().chain([&*wrenches]).zip(INPUT..);
        for (numbers, part) in inputs.filter(|(_, part)| job.layout.count(*part) > 1) {
            for (lane, out) in out.chunks_exact_mut(job.layout.width()).enumerate() {
                scatter(numbers, lane, &mut out[job.layout.one(part, n)]);
            }
        }
        Ok(())
    }

    fn finish(&mut self, job: &Job<'_>, out: &mut [f64]) {
        let Self { lanes: Lanes { gradients, .. }, sums, .. } = self;
        let layout = job.layout;
        let [.., wrenches, parameters] = &sums[..] else { return };
        for (lane, out) in out.chunks_exact_mut(layout.width().max(1)).enumerate() {
            let of_rows = gradients.end.iter().chain(&sums[INPUTS..ACTING]);
            for (i, numbers) in of_rows.enumerate() {
                scatter(numbers, lane, &mut out[layout.one(ROWS, i)]);
            }
            let inputs = sums[..INPUTS].iter().chain([wrenches]).zip(INPUT..);
            for (numbers, part) in inputs.filter(|(_, part)| layout.count(*part) == 1) {
                scatter(numbers, lane, &mut out[layout.all(part)]);
            }
            scatter(parameters, lane, &mut out[layout.all(PARAMETERS)]);
            if let Some(touching) = &self.touching {
                touching.write(job.scene, &mut out[layout.all(CONTACTS)]);
                let mut shapes = job.shapes.lock().unwrap_or_else(PoisonError::into_inner);
                shapes.extend(touching.of_shapes(job.states.start));
            }
        }
    }
}

impl<T: Vectorized, I: Target> Compiled<T, I> {
    /// The step of one state of a scene with contacts.
    fn through_contacts(&mut self, job: &Job<'_>, n: usize) -> Result<(), StepFault> {
        let Self { lanes: Lanes { scratch: s, gradients, form, .. }, checked, closed, touching, .. } = self;
        let parameters = job.layout.count(PARAMETERS) > 0;
        let touching =
            touching.get_or_insert_with(|| Box::new(ContactReverse::new(job.scene, job.settings, *form, parameters)));
        take_lane(&mut touching.scratch, s, 0);
        for (to, from) in touching.gradients.end.iter_mut().zip(&gradients.end) {
            scatter(from, 0, to);
        }
        // With contacts every step has a row.
        let (state, mut row) = (job.states.start, Vec::new());
        job.row(n + 1, &mut row);
        let recorded = row.split_at(job.scene.nq());
        let row_before = |back: usize| {
            let mut row = Vec::new();
            job.row(n.checked_sub(back)?, &mut row);
            Some(row)
        };
        let changed = |contact, before, after| {
            let mut changes = job.changes.lock().unwrap_or_else(PoisonError::into_inner);
            changes.push(ModeChange { state, step: n + 1, contact, before, after });
        };
        let mut flight = |free: &StepSettings, s: &Scratch<f64>, gradients: &mut StepGradients<f64>| {
            let job = Job { settings: free, states: job.states.clone(), ..*job };
            through_lane(one_state((checked, closed), &job, *form), &job, (s, 0), gradients)
        };
        let through = touching.through((job.scene, job.settings), n, recorded, row_before, (&mut flight, changed));
        through.map_err(|(joint, error)| StepFault { step: n, state, joint, error })?;
        for (numbers, own) in gradients.results().zip(touching.gradients.results()) {
            fill(numbers, 0, own);
        }
        Ok(())
    }

    /// Recomputes the step with all checks, for the lanes in `fallback`.
    #[cold]
    #[inline(never)]
    fn recompute(&mut self, job: &Job<'_>, n: usize, fallback: u64) -> Result<(), StepFault> {
        let Self { lanes: Lanes { scratch: s, gradients, form, .. }, checked, closed, .. } = self;
        let one = one_state((checked, closed), job, *form);
        for lane in lanes_of(fallback) {
            let state = job.states.start + lane;
            through_lane(one, job, (s, lane), gradients).map_err(|(joint, error)| StepFault {
                step: n,
                state,
                joint,
                error,
            })?;
        }
        Ok(())
    }
}

/// The state for steps with all checks, allocated at first use.
fn one_state<'a>(
    (checked, closed): (&'a mut Option<Box<Checked>>, &'a mut Option<Box<ClosedReverse>>),
    job: &Job<'_>,
    form: Form,
) -> &'a mut dyn OneState {
    let parameters = job.layout.count(PARAMETERS) > 0;
    if job.settings.connected {
        &mut **closed.get_or_insert_with(|| Box::new(ClosedReverse::new(job.scene, job.settings, form, parameters)))
    } else {
        &mut **checked.get_or_insert_with(|| Box::new(Checked::new(job, form)))
    }
}

/// Propagates the gradients of one lane through the step of its state.
fn through_lane<T: Vectorized>(
    one: &mut dyn OneState,
    job: &Job<'_>,
    (s, lane): (&Scratch<T>, usize),
    gradients: &mut StepGradients<T>,
) -> Result<(), (String, Error)> {
    let (scratch, own) = one.parts();
    take_lane(scratch, s, lane);
    for (to, from) in own.end.iter_mut().zip(&gradients.end) {
        scatter(from, lane, to);
    }
    one.step(job)?;
    for (numbers, own) in gradients.results().zip(one.parts().1.results()) {
        fill(numbers, lane, own);
    }
    Ok(())
}
