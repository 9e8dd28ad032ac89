//! Time integration of a few states, one per lane, by many steps, compiled for one instruction set.

use super::checked::CheckedState;
use super::connected::Connected;
use super::contact::{ContactStepper, Shapes, Touching, finish_contacts};
use super::faults::strays;
use super::job::{Divisions, Impacts, Job, Models, States};
use super::limit_rows::limit_rows;
use super::method::Method;
use super::scratch::Scratch;
pub(super) use super::scratch::{fill, scatter, take_lane};
use super::solver::Kernels;
use super::step::step;
use super::step_settings::StepSettings;
use super::torque::{StepFault, Torque};
use super::totals::TOTALS;
use super::touches::Touches;
use super::works::add_work;
use crate::batch::instruction_set::{
    InstructionSet, Target, Vectorized, lanes_of, on_instruction_set, take_states, within_target,
};
use crate::batch::own_model::OwnInertias;
use crate::filter::Form;
use crate::scalar::lanes_but;
use crate::scene::Scene;

/// Advances states, for any scalar type.
trait Stepping: Send + Sync {
    fn run(&mut self, form: Form, checked: &mut CheckedStates, job: Job<'_, '_>) -> Result<(), StepFault>;
}

/// Scratch memory for one rollout on one thread, allocated at first use.
pub(super) struct Stepper {
    arm: InstructionSet,
    one: Option<Box<dyn Stepping>>,
    many: Option<Box<dyn Stepping>>,
    checked: CheckedStates,
    form: Form,
}

impl Stepper {
    pub fn new(form: Form, arm: InstructionSet) -> Self {
        let arm = if arm.available() { arm } else { InstructionSet::Baseline };
        Self { arm, one: None, many: None, checked: CheckedStates::default(), form }
    }

    /// Largest number of states of a job.
    pub fn lanes(&self) -> usize {
        if self.arm == InstructionSet::Neon { 1 } else { self.arm.lanes() }
    }

    /// The contact steps of one state, whose shapes may know its contacts.
    pub fn shaped_steps(&mut self, job: Job<'_, '_>, shapes: &mut Box<Shapes>) -> Result<(), StepFault> {
        let (scene, settings) = (job.scene, job.settings);
        self.touching(scene, settings).exchange(shapes);
        let made = self.steps(job);
        self.touching(scene, settings).exchange(shapes);
        made
    }

    /// The contact steps of one state, which are not vectorized.
    pub fn touching(&mut self, scene: &Scene, settings: &StepSettings) -> &mut ContactStepper {
        self.checked.touching(scene, settings, self.form)
    }

    /// The steps of a job, all by the method of its settings. Returns the fault of the earliest step, and of the lowest
    /// state in it.
    pub fn steps(&mut self, job: Job<'_, '_>) -> Result<(), StepFault> {
        let (arm, alone) = (self.arm, job.states.len() == 1);
        let place = if alone { &mut self.one } else { &mut self.many };
        let scratch =
            place.get_or_insert_with(|| on_instruction_set!((arm, alone), Compiled::boxed(job.scene, job.settings)));
        scratch.run(self.form, &mut self.checked, job)
    }
}

/// Scratch memory in a scalar type, for code compiled for one instruction set.
struct Compiled<T: Vectorized, I> {
    scratch: Scratch<T>,
    target: I,
    /// For a scene with connections, and for one with contacts.
    connected: Option<Box<Connected<T>>>,
    touching: Option<Box<Touching<T>>>,
    /// For states that differ in their inertias.
    own_inertias: Option<Box<OwnInertias<T>>>,
}

impl<T: Vectorized, I: Target> Compiled<T, I> {
    fn boxed(scene: &Scene, settings: &StepSettings, target: I) -> Box<dyn Stepping> {
        let scratch = Scratch::new(scene.model(), settings);
        let is_lanes = settings.method != Method::Contact && settings.connected && settings.is_vectorized();
        let limits = || if settings.stops() { limit_rows(scene) } else { Vec::new() };
        let connected = is_lanes.then(|| Box::new(Connected::new(scene, settings, &scratch, limits())));
        let touching = settings.touches_in_lanes(scene).then(|| Box::new(Touching::new(scene, settings, &scratch)));
        Box::new(Self { scratch, target, connected, touching, own_inertias: None })
    }
}

/// The scratch of the states of a job: one for all, or one for each lane whose state has its own model.
#[derive(Default)]
struct CheckedStates {
    of_all: Option<Box<CheckedState>>,
    of_lanes: Vec<Option<(usize, Box<CheckedState>)>>,
    /// For scenes with contacts.
    touching: Option<Box<ContactStepper>>,
}

impl CheckedStates {
    fn touching(&mut self, scene: &Scene, settings: &StepSettings, form: Form) -> &mut ContactStepper {
        self.touching.get_or_insert_with(|| Box::new(ContactStepper::new(scene, settings, form)))
    }

    /// The scratch of a lane and its state, or that of all.
    fn of(&mut self, own: Option<(usize, usize)>, make: impl FnOnce() -> CheckedState) -> &mut CheckedState {
        let Some((lane, state)) = own else { return self.of_all.get_or_insert_with(|| Box::new(make())) };
        self.of_lanes.resize_with(self.of_lanes.len().max(lane + 1), || None);
        let kept = self.of_lanes[lane].take().filter(|(of, _)| *of == state);
        &mut self.of_lanes[lane].insert(kept.unwrap_or_else(|| (state, Box::new(make())))).1
    }
}

impl<T: Vectorized, I: Target> Stepping for Compiled<T, I> {
    fn run(&mut self, form: Form, checked: &mut CheckedStates, job: Job<'_, '_>) -> Result<(), StepFault> {
        run(self.target, self, form, checked, job)
    }
}

within_target! {
    /// The steps of a job.
    fn run<'a, 'r, T, I>(
        target;
        compiled: &'a mut Compiled<T, I>,
        form: Form,
        checked: &'a mut CheckedStates,
        job: Job<'a, 'r>,
    ) -> Result<(), StepFault> {
        let Compiled { scratch: s, connected, touching, own_inertias, .. } = compiled;
        let (connected, mut touching) = (connected.as_deref_mut(), touching.as_deref_mut());
        let Job { scene, settings, models, steps, states, begun, current, torque, .. } = job;
        let Job { mut rows, impacts, touches, mut divisions, .. } = job;
        let (count, nq, nv) = (states.len(), scene.nq(), scene.nv());
        let width = settings.width(scene);
        let kept = nq + nv + TOTALS;
        begin(s, settings, (&states, &*current, width), torque, (nq, nv));
        if let Some((population, _)) = models {
            s.take_models((population, own_inertias), settings, count, |lane| states.at(lane));
        }
        let mut kernels = Kernels::new(target, form, connected);
        kernels.factors = touching.is_some();
        if let Some(connected) = &mut kernels.connected {
            connected.begin(count, s);
        }
        let is_vectorized = if settings.method == Method::Contact { kernels.factors } else { settings.is_vectorized() };
        let mut outcome = Ok(());
        for n in steps {
            if let Torque::Steps { torque, first } = torque {
                let at = (n - first) * nv;
                take_states(&mut s.torque, count, |lane| &torque.state(states.at(lane))[at..at + nv]);
            }
            s.take_targets(settings, (n, count), |lane| states.at(lane));
            let by = (settings, &settings.scheme);
            // Steps that are not vectorized run one state after another.
            let mut fallback = if is_vectorized { step(target, by, s, &mut kernels) } else { u64::MAX };
            let totals = s.totals;
            if let Some(connected) = &mut kernels.connected {
                fallback |= connected.finish(target, form, s);
            }
            if let Some(touching) = &mut touching {
                let (contacts, alone) = ((&mut *current, width, kept), &mut checked.touching);
                let contacts = (contacts, fallback);
                fallback = finish_contacts(target, touching, (form, alone), (scene, settings), s, contacts);
            } else if is_vectorized {
                fallback |= needs_fallback(settings, s);
                add_work(settings, s);
            }
            fallback &= u64::MAX >> (64 - count);
            if fallback != 0 {
                if let Some(connected) = &mut kernels.connected {
                    connected.replaced();
                }
                // The totals of these lanes come from their recomputed step instead.
                let accumulated = std::mem::replace(&mut s.totals, totals);
                let mut counted = accumulated;
                let (of, steps) = ((scene, settings, form), (n, &states, begun));
                let lanes = (fallback, &mut counted[..], (&mut *current, width, kept));
                let results = (impacts, touches, divisions.as_deref_mut());
                outcome = recompute(s, (of, models), checked, steps, lanes, results);
                s.totals = counted;
                if outcome.is_err() {
                    break;
                }
            }
            std::mem::swap(&mut s.q, &mut s.q_next);
            std::mem::swap(&mut s.v, &mut s.v_next);
            if let Some(rows) = &mut rows
                && (n + 1 - rows.from) % rows.every == 0
            {
                let row = (n + 1 - rows.from) / rows.every;
                for lane in 0..count {
                    let at = (states.at(lane) - rows.first) * rows.of_state + row;
                    scatter(&s.q, lane, &mut rows.q[at * nq..(at + 1) * nq]);
                    scatter(&s.v, lane, &mut rows.qd[at * nv..(at + 1) * nv]);
                }
            }
        }
        if let Some(connected) = &mut kernels.connected {
            connected.end(s);
        }
        for lane in 0..count {
            let current = &mut current[lane * width..(lane + 1) * width];
            scatter(&s.q, lane, &mut current[..nq]);
            scatter(&s.v, lane, &mut current[nq..nq + nv]);
            scatter(&s.totals, lane, &mut current[nq + nv..nq + nv + TOTALS]);
        }
        outcome
    }
}

/// Reads the initial state of each lane, and what is constant during the run.
#[inline(always)]
fn begin<T: Vectorized>(
    s: &mut Scratch<T>,
    settings: &StepSettings,
    (states, current, width): (&States<'_>, &[f64], usize),
    torque: &Torque<'_>,
    (nq, nv): (usize, usize),
) {
    let count = states.len();
    take_states(&mut s.q, count, |lane| &current[lane * width..][..nq]);
    take_states(&mut s.v, count, |lane| &current[lane * width + nq..][..nv]);
    take_states(&mut s.totals, count, |lane| &current[lane * width + nq + nv..][..TOTALS]);
    s.take_gains(settings, count, |lane| states.at(lane));
    if let Torque::Constant(torque) = torque {
        take_states(&mut s.torque, count, |lane| torque.state(states.at(lane)));
    } else {
        for u in &mut s.torque {
            *u = u.constant(0.0);
        }
    }
}

/// The lanes whose next state is not finite or moved too far, whose modes changed, or whose step was too long.
#[inline(always)]
fn needs_fallback<T: Vectorized>(settings: &StepSettings, s: &Scratch<T>) -> u64 {
    strays(settings, s) | lanes_but::<T>(|lane| s.consistent.lane(lane) > 0.0 && s.short_enough.lane(lane) > 0.0)
}

/// Recomputes the step of some lanes one by one, with all checks, in substeps, and with the set-valued law. `totals`
/// are the totals of these lanes.
#[cold]
#[inline(never)]
fn recompute<T: Vectorized>(
    s: &mut Scratch<T>,
    ((scene, settings, form), models): ((&Scene, &StepSettings, Form), Option<Models<'_>>),
    checked: &mut CheckedStates,
    (n, states, begun): (usize, &States<'_>, &[usize]),
    (lanes, totals, (current, width, kept)): (u64, &mut [T], (&mut [f64], usize, usize)),
    (impacts, touches, mut divisions): (Option<&Impacts>, Option<&Touches>, Option<&mut Divisions>),
) -> Result<(), StepFault> {
    for lane in lanes_of(lanes) {
        let state = states.at(lane);
        let impacts = impacts.map(|impacts| (impacts, begun[lane]));
        let one = if settings.method == Method::Contact {
            let alone = checked.touching(scene, settings, form);
            take_lane(&mut alone.scratch, s, lane);
            let kept = &mut current[lane * width + kept..(lane + 1) * width];
            alone.step((scene, settings), (n, state), kept, (impacts, touches))?;
            &alone.scratch
        } else {
            let member = models.map(|(population, whole)| (population.of(state), whole));
            let own = member.map(|(member, whole)| member.scene(whole)).transpose();
            let own = own.map_err(|error| StepFault { step: n, state, joint: String::new(), error })?;
            let scene = own.as_deref().map_or(scene, Scene::tree);
            let settings = member.map_or(settings, |(member, _)| &member.settings);
            let alone = checked.of(member.map(|_| (lane, state)), || CheckedState::new(scene, settings, form));
            take_lane(&mut alone.scratch, s, lane);
            let made = alone.step(scene, settings, &mut |scheme, s, _| {
                if let Some(divisions) = &mut divisions {
                    divisions.add(lane, scheme.step, (&s.q, &s.v));
                }
            });
            made.map_err(|(joint, error)| StepFault { step: n, state, joint, error })?;
            if let Some((impacts, begun)) = impacts.filter(|_| !alone.substeps.impacts.is_empty()) {
                impacts.add(&alone.substeps.impacts, state, settings.time(n - begun));
            }
            &alone.scratch
        };
        fill(totals, lane, &one.totals);
        fill(&mut s.q_next, lane, &one.q_next);
        fill(&mut s.v_next, lane, &one.v_next);
    }
    Ok(())
}
