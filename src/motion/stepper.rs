//! A few states at once, one in each lane, through many steps compiled for one arm.

use super::conserve::KEPT;
use super::constrained::{Closed, Constrained};
use super::contact::Toucher;
use super::faults::{FARTHEST, fault_of};
use super::job::{Impacts, Job};
use super::limit_rows::limit_rows;
use super::method::Method;
use super::properties::of_state;
use super::scratch::Scratch;
use super::settings::Stabilisation;
use super::solver::{Checked, Kernels};
use super::step::step;
use super::step_settings::StepSettings;
use super::substeps::Substeps;
use super::tally::TALLY;
use super::torque::{StepFault, Torque};
use super::works::add_work;
use crate::batch::instruction_set::{Baseline, InstructionSet, Target, Vectorised, Work, take_states};
use crate::dynamics::contacts::LimitRow;
use crate::error::Error;
use crate::filter::Form;
use crate::model::Model;
use crate::scalar::{Fused, lanes_but};
#[cfg(target_arch = "x86_64")]
use crate::scalar::{Lanes, Real};
use crate::scene::Scene;
#[cfg(target_arch = "x86_64")]
use pulp::x86::V3;
#[cfg(all(target_arch = "x86_64", feature = "avx512"))]
use pulp::x86::V4;
use std::ops::Range;

/// What advances states, whatever its scalar.
trait Stepping: Send + Sync {
    fn run(&mut self, form: Form, checked: &mut Option<Box<Alone>>, job: Job<'_, '_>) -> Result<(), StepFault>;
}

/// Scratch for one rollout on one thread, made when it is first used.
pub(super) struct Stepper {
    arm: InstructionSet,
    one: Option<Box<dyn Stepping>>,
    many: Option<Box<dyn Stepping>>,
    checked: Option<Box<Alone>>,
    touching: Option<Box<Toucher>>,
    form: Form,
}

impl Stepper {
    pub fn new(form: Form, arm: InstructionSet) -> Self {
        let arm = if arm.available() { arm } else { InstructionSet::Baseline };
        Self { arm, one: None, many: None, checked: None, touching: None, form }
    }

    /// How many states a job may have.
    pub fn lanes(&self) -> usize {
        match self.arm {
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx2 => Lanes::<V3>::LANES,
            #[cfg(all(target_arch = "x86_64", feature = "avx512"))]
            InstructionSet::Avx512 => Lanes::<V4>::LANES,
            _ => 1,
        }
    }

    /// Runs a job; the fault is that of its earliest step, then of its lowest state.
    pub fn run(&mut self, job: Job<'_, '_>) -> Result<(), StepFault> {
        if job.law.method == Method::Contact {
            let touching = self.touching.get_or_insert_with(|| Box::new(Toucher::new(job.scene, job.law, self.form)));
            return touching.run(job);
        }
        let (arm, alone) = (self.arm, job.states.len() == 1);
        let place = if alone { &mut self.one } else { &mut self.many };
        let scratch = place.get_or_insert_with(|| scratch(job.scene.model(), job.law, arm, alone));
        scratch.run(self.form, &mut self.checked, job)
    }
}

/// Scratch in the scalar of an arm, for one state or for several.
fn scratch(model: &Model<f64>, law: &StepSettings, arm: InstructionSet, alone: bool) -> Box<dyn Stepping> {
    let on_arm: Option<Box<dyn Stepping>> = match (arm, alone) {
        (InstructionSet::Baseline, _) => None,
        #[cfg(target_arch = "x86_64")]
        (InstructionSet::Avx2, false) => Compiled::<Lanes<V3>, V3>::boxed(model, law),
        #[cfg(all(target_arch = "x86_64", feature = "avx512"))]
        (InstructionSet::Avx512, false) => Compiled::<Lanes<V4>, V4>::boxed(model, law),
        #[cfg(all(target_arch = "x86_64", feature = "avx512"))]
        (InstructionSet::Avx512, true) => Compiled::<Fused, V4>::boxed(model, law),
        _ => Compiled::<Fused, <Fused as Vectorised>::Least>::boxed(model, law),
    };
    on_arm.unwrap_or_else(|| Box::new(Compiled { scratch: Scratch::<f64>::new(model, law), target: Baseline }))
}

/// Scratch in a scalar, for code compiled for some instructions.
struct Compiled<T: Vectorised, I> {
    scratch: Scratch<T>,
    target: I,
}

impl<T: Vectorised<Number = f64>, I: Target> Compiled<T, I> {
    /// None where this processor does not have them.
    fn boxed(model: &Model<f64>, law: &StepSettings) -> Option<Box<dyn Stepping>> {
        let target = I::here()?;
        Some(Box::new(Self { scratch: Scratch::new(model, law), target }))
    }
}

/// One state, for the steps that a lane was in doubt at.
struct Alone {
    scratch: Scratch<f64>,
    solver: Checked,
    substeps: Substeps,
    /// Of a scene with connections, whose steps are all of this kind.
    closed: Option<(Closed, Vec<LimitRow>)>,
}

impl Alone {
    #[cold]
    fn new(scene: &Scene, law: &StepSettings, form: Form) -> Self {
        let model = scene.model();
        let limits = if law.stops { limit_rows(scene) } else { Vec::new() };
        let closed = law.connected.map(|_| (Closed::new(scene, law, form), limits));
        let scratch = Scratch::new(model, law);
        let substeps = Substeps::new(law, &scratch);
        let solver = Checked::new(model, law.coupling.clone(), form).accepting(law.tolerance).with_kernels();
        Self { scratch, solver, substeps, closed }
    }

    /// The step of one state; the joint and the error, where there is none.
    #[inline(never)]
    fn step(&mut self, scene: &Scene, law: &StepSettings) -> Result<(), (String, Error)> {
        let mut lost = None;
        self.substeps.impacts.clear();
        if let Some((closed, limits)) = &mut self.closed {
            let alpha = if let Some(Stabilisation::Baumgarte(rate)) = law.connected { Some(rate) } else { None };
            let mut solver = Constrained { scene, scratch: closed, alpha, compliance: &law.compliance };
            step((law, &law.scheme), &mut self.scratch, &mut solver);
            let finished = solver.finish(&mut self.scratch);
            match finished.and_then(|()| solver.stop(law, limits, &mut self.scratch)) {
                Ok(impacts) => self.substeps.impacts.extend(impacts),
                Err((_, Some(error))) => return Err((String::new(), error)),
                Err((found, None)) => lost = found,
            }
            add_work(law, &mut self.scratch);
        } else {
            let Self { scratch, solver, substeps, .. } = self;
            substeps.advance(law, scratch, solver, &mut |_, _, _| {});
            lost = solver.lost.take();
            scratch.keeper.correct_if_kept(&scratch.model, &mut scratch.q_next, &mut scratch.v_next);
        }
        if let Some(coupling) = &law.coupling {
            // Joints follow each other exactly, not but for the rounding of many steps.
            let s = &mut self.scratch;
            s.q_next = coupling.configuration(&coupling.independent_coordinates(&s.q_next));
            s.v_next = coupling.rates(&coupling.independent_rates(&s.v_next));
        }
        fault_of(scene, law, &self.scratch, lost).map_or(Ok(()), Err)
    }
}

impl<T: Vectorised<Number = f64>, I: Target> Stepping for Compiled<T, I> {
    fn run(&mut self, form: Form, checked: &mut Option<Box<Alone>>, job: Job<'_, '_>) -> Result<(), StepFault> {
        let target = self.target;
        target.within(Run { scratch: &mut self.scratch, target, form, checked, job })
    }
}

/// State, torque and targets of one lane, before a step.
pub(super) fn take_lane<T: Vectorised<Number = f64>>(one: &mut Scratch<f64>, s: &Scratch<T>, lane: usize) {
    for (to, from) in [
        (&mut one.q, &s.q),
        (&mut one.v, &s.v),
        (&mut one.torque, &s.torque),
        (&mut one.target, &s.target),
        (&mut one.target_rate, &s.target_rate),
    ] {
        scatter(from, lane, to);
    }
    scatter(&s.tally, lane, &mut one.tally);
}

/// Numbers into one lane of an array.
pub(super) fn fill<T: Vectorised<Number = f64>>(numbers: &mut [T], lane: usize, values: &[f64]) {
    for (number, &value) in numbers.iter_mut().zip(values) {
        number.lanes_mut()[lane] = value;
    }
}

struct Run<'a, 'r, T: Vectorised, I> {
    scratch: &'a mut Scratch<T>,
    target: I,
    form: Form,
    checked: &'a mut Option<Box<Alone>>,
    job: Job<'a, 'r>,
}

/// One lane of an array.
#[inline(always)]
pub(super) fn scatter<T: Vectorised<Number = f64>>(numbers: &[T], lane: usize, out: &mut [f64]) {
    for (value, number) in out.iter_mut().zip(numbers) {
        *value = number.lanes()[lane];
    }
}

impl<T: Vectorised<Number = f64>, I: Target> Work for Run<'_, '_, T, I> {
    type Output = Result<(), StepFault>;

    #[inline(always)]
    fn call(self) -> Result<(), StepFault> {
        let Self { scratch: s, target, form, checked, job } = self;
        let Job { scene, law, steps, states, begun, current, torque, mut rows, impacts } = job;
        let (count, nq, nv) = (states.len(), scene.nq(), scene.nv());
        let width = law.width(scene);
        take_states(&mut s.q, count, |lane| &current[lane * width..][..nq]);
        take_states(&mut s.v, count, |lane| &current[lane * width + nq..][..nv]);
        take_states(&mut s.tally, count, |lane| &current[lane * width + nq + nv..][..TALLY]);
        let (kept, end) = (nq + nv + TALLY, nq + nv + TALLY + KEPT * law.roots.len());
        if s.keeper.keeps() {
            take_states(&mut s.keeper.start, count, |lane| &current[lane * width + kept..][..end - kept]);
            take_states(&mut s.keeper.largest, count, |lane| &current[lane * width + end..][..2]);
        }
        if let Some(gains) = &law.gains {
            take_states(&mut s.target, count, |lane| of_state(&gains.target, nq, states.start + lane));
            take_states(&mut s.target_rate, count, |lane| of_state(&gains.target_rate, nv, states.start + lane));
        }
        if let Torque::Constant(torque) = torque {
            take_states(&mut s.torque, count, |lane| torque.state(states.start + lane));
        } else {
            for u in &mut s.torque {
                *u = u.constant(0.0);
            }
        }
        let mut kernels = Kernels::new(target, form);
        let mut outcome = Ok(());
        for n in steps {
            if let Torque::Steps { torque, first } = torque {
                let at = (n - first) * nv;
                take_states(&mut s.torque, count, |lane| &torque.state(states.start + lane)[at..at + nv]);
            }
            if s.keeper.keeps() {
                for (time, &begun) in s.keeper.time.lanes_mut().iter_mut().zip(begun) {
                    *time = law.time(n + 1 - begun);
                }
            }
            let by = (law, &law.scheme);
            // Else one state after another.
            let mut doubt = if law.is_vectorized() { step(by, s, &mut kernels) } else { u64::MAX };
            let tally = s.tally;
            if law.is_vectorized() {
                s.keeper.correct_if_kept(&s.model, &mut s.q_next, &mut s.v_next);
                doubt |= unsound(law, s);
                add_work(law, s);
            }
            doubt &= u64::MAX >> (64 - count);
            if doubt != 0 {
                // These lanes add the values of their recomputed step instead.
                let accumulated = std::mem::replace(&mut s.tally, tally);
                let mut counted = accumulated;
                outcome = again(s, (scene, law, form), checked, (n, &states, begun, impacts), (doubt, &mut counted));
                s.tally = counted;
                if outcome.is_err() {
                    break;
                }
            }
            std::mem::swap(&mut s.q, &mut s.q_next);
            std::mem::swap(&mut s.v, &mut s.v_next);
            if s.keeper.keeps() {
                s.keeper.remember();
            }
            if let Some(rows) = &mut rows
                && (n + 1 - rows.from) % rows.every == 0
            {
                let row = (n + 1 - rows.from) / rows.every;
                for lane in 0..count {
                    let at = (states.start - rows.first + lane) * rows.of_state + row;
                    scatter(&s.q, lane, &mut rows.q[at * nq..(at + 1) * nq]);
                    scatter(&s.v, lane, &mut rows.qd[at * nv..(at + 1) * nv]);
                }
            }
        }
        for lane in 0..count {
            let current = &mut current[lane * width..(lane + 1) * width];
            scatter(&s.q, lane, &mut current[..nq]);
            scatter(&s.v, lane, &mut current[nq..nq + nv]);
            scatter(&s.tally, lane, &mut current[nq + nv..nq + nv + TALLY]);
            if s.keeper.keeps() {
                scatter(&s.keeper.largest, lane, &mut current[end..]);
            }
        }
        outcome
    }
}

#[allow(clippy::eq_op)] // x - x is zero where x is finite, else NaN
/// The lanes whose next state is not finite, or further away than a joint moves in one step; whose modes did not hold; and whose step was too long.
#[inline(always)]
fn unsound<T: Vectorised>(law: &StepSettings, s: &Scratch<T>) -> u64 {
    let mut worst = T::one();
    let limit = FARTHEST / law.step;
    for &v in &s.v_next {
        worst = worst.worst(v.constant(limit) - v.abs());
    }
    for &q in &s.q_next {
        worst += q - q;
    }
    if s.keeper.keeps() {
        for c in s.keeper.correction {
            worst += c - c;
        }
    }
    lanes_but::<T>(|lane| worst.lane(lane) >= 0.0 && s.consistent.lane(lane) > 0.0 && s.short_enough.lane(lane) > 0.0)
}

/// Recomputes the step of some lanes one by one: with every check, in substeps, and with the set-valued law. `tally` is what these lanes accumulate.
#[cold]
#[inline(never)]
fn again<T: Vectorised<Number = f64>>(
    s: &mut Scratch<T>,
    (scene, law, form): (&Scene, &StepSettings, Form),
    alone: &mut Option<Box<Alone>>,
    (n, states, begun, impacts): (usize, &Range<usize>, &[usize], Option<&Impacts>),
    (mut doubt, tally): (u64, &mut [T]),
) -> Result<(), StepFault> {
    let alone = alone.get_or_insert_with(|| Box::new(Alone::new(scene, law, form)));
    while doubt != 0 {
        let lane = doubt.trailing_zeros() as usize;
        doubt &= doubt - 1;
        let one = &mut alone.scratch;
        take_lane(one, s, lane);
        scatter(&s.keeper.start, lane, &mut one.keeper.start);
        one.keeper.time = s.keeper.time.lanes()[lane];
        let state = states.start + lane;
        alone.step(scene, law).map_err(|(joint, error)| StepFault { step: n, state, joint, error })?;
        if let Some(impacts) = impacts
            && !alone.substeps.impacts.is_empty()
        {
            impacts.add(&alone.substeps.impacts, state, law.time(n - begun[lane]));
        }
        let one = &alone.scratch;
        fill(tally, lane, &one.tally);
        fill(&mut s.q_next, lane, &one.q_next);
        fill(&mut s.v_next, lane, &one.v_next);
        fill(&mut s.keeper.correction, lane, &one.keeper.correction);
    }
    Ok(())
}
