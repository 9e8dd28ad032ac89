//! A batch of states through time: on threads, in lanes, some steps at a call.

use super::choice::{CONTROLLED, choose, set_valued};
use super::conserve::{self, Correction, KEPT, Keeper};
use super::contact::{self, ContactReport, RECORD};
use super::job::{Impacts, Job, Rows};
use super::method::Method;
use super::properties::FRICTION_SPEED;
use super::settings::{Limits, Settings, Stabilisation};
use super::step_settings::StepSettings;
use super::stepper::Stepper;
use super::substeps::StopImpact;
use super::tally::{TALLY, Tally};
use super::torque::{StepFault, Torque};
use crate::algorithm::Algorithm;
use crate::batch::instruction_set::InstructionSet;
use crate::batch::{Batch, Fault, Pool, SLICE};
use crate::dynamics::contacts::ContactScratch;
use crate::error::Error;
use crate::filter::{FORMS, Form};
use crate::scene::Scene;
use crate::{memory, watch};
use std::borrow::Borrow;
use std::sync::{Mutex, PoisonError};

/// Where a rollout records: (states, rows, nq) and (states, rows, nv), row 0 the state at the start, row i after i * every steps.
#[derive(Debug)]
pub struct Records<'a> {
    /// Configurations.
    pub q: &'a mut [f64],
    /// Rates.
    pub qd: &'a mut [f64],
    /// Of a scene with contacts, (states, rows, contacts, 11): gap (m), slip velocity (m/s), force of the step that led to the row (N), the sum
    /// of the impulses of impacts since the row before (N s), vectors in the base frame, and what the contact did in the step that led to the row, the
    /// number of a [`ContactState`](super::ContactState), open in the first. Empty: not recorded.
    pub contacts: &'a mut [f64],
    /// A row after so many steps.
    pub every: usize,
}

/// States on their way; `S`: what the scene is held by, as `&Scene`, `Arc<Scene>` or `Scene`.
///
/// ```
/// use phipsi::motion::{Method, Rollout, Settings, Torque};
/// # fn main() -> Result<(), phipsi::Error> {
/// let scene = phipsi::scenes::chain(7)?;
/// let mut settings = Settings::new(&scene, 1e-3);
/// settings.method = Method::RungeKutta4;
/// let mut rollout = Rollout::new(&scene, settings, &[0.3; 7], &[0.0; 7])?;
/// rollout.advance(100, &Torque::Zero, None).map_err(|fault| fault.error)?;
/// assert_eq!(rollout.steps(), 100);
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Rollout<S> {
    scene: S,
    pub(super) law: StepSettings,
    /// As they were given.
    method: Method,
    limits: Limits,
    keeper: Keeper<f64>,
    pub(super) form: Form,
    pub(super) arm: InstructionSet,
    states: usize,
    /// (q, qd) of every state, and where momentum is kept what is kept and the largest corrections.
    current: Vec<f64>,
    /// The step that each state began at.
    begun: Vec<usize>,
    done: usize,
    pool: Pool<Stepper>,
    impacts: Impacts,
}

impl std::fmt::Debug for Stepper {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Stepper").field("lanes", &self.lanes()).finish_non_exhaustive()
    }
}

/// States are given to threads in multiples of this: more than any arm has lanes.
pub(super) const GRAIN: usize = 16;

impl<S: Borrow<Scene>> Rollout<S> {
    /// States to start from, one after another: `q` (states, nq), `qd` (states, nv); `scene`: a reference, or what holds one.
    ///
    /// Of a scene whose joints follow each other all numbers are those of its [`tree`](Scene::tree); [`Coupling`](crate::scene::Coupling) gives them.
    ///
    /// # Errors
    ///
    /// A step that is not finite and positive, a form other than auto and covariance; wrong lengths, numbers that are not finite,
    /// negative properties, quaternions that are not unit; momentum that cannot be kept; a state that does not meet the connections ([`Scene::project`] gives one that does).
    pub fn new(scene: S, settings: Settings, q: &[f64], qd: &[f64]) -> Result<Self, Error> {
        let coupling = scene.borrow().shared_coupling();
        let holds: &Scene = scene.borrow().tree();
        let Settings { dt, method, form, mut properties, gains, arm, conserve_momentum, stabilisation, .. } = settings;
        if !(dt.is_finite() && dt > 0.0) {
            return Err(Error::argument("dt", format!("{dt}"), "a step in s, finite and positive"));
        }
        if !matches!(form, Form::Auto | Form::Covariance) {
            let found = FORMS.iter().find(|(_, known)| *known == form).map_or("", |(name, _)| name);
            return Err(Error::argument("form", format!("{found:?}"), "\"auto\" or \"covariance\" for a rollout"));
        }
        scene.borrow().check_tolerance(Algorithm::ForwardDynamics(form), settings.tolerance)?;
        properties.check(holds)?;
        check_method(holds, method, conserve_momentum)?;
        if let Stabilisation::Baumgarte(rate) = stabilisation
            && !(rate.is_finite() && rate > 0.0)
        {
            return Err(Error::argument("baumgarte", format!("{rate}"), "a rate in 1/s, finite and positive"));
        }
        holds.check_compliance(&settings.compliance)?;
        if conserve_momentum {
            holds.check_no_connections("conserve_momentum")?;
        }
        let restitution = settings.restitution;
        if !(0.0..=1.0).contains(&restitution) {
            return Err(Error::argument("restitution", format!("{restitution}"), "a number from 0 to 1"));
        }
        let is_tree = holds.constraints().is_empty() && holds.contacts().is_empty();
        let accuracy = settings.accuracy;
        if let Some(accuracy) = accuracy
            && !(accuracy.is_finite() && accuracy >= 1e-12)
        {
            return Err(Error::argument("accuracy", format!("{accuracy}"), "a bound on the error, 1e-12 or more"));
        }
        if accuracy.is_some() && (!is_tree || coupling.is_some() || conserve_momentum || method != Method::Auto) {
            let found = "error control with contacts, connections, coupled joints, conserve_momentum or a method";
            return Err(Error::argument("accuracy", found, "None for this scene and these settings"));
        }
        let stops = settings.limits == Limits::Stop;
        if !is_tree && properties.friction_speed == 0.0 {
            properties.friction_speed = FRICTION_SPEED;
        }
        let (nq, nv) = (holds.nq(), holds.nv());
        let states = q.len().checked_div(nq).unwrap_or(1);
        if q.len() != states * nq || qd.len() != states * nv {
            return Err(Error::Shape {
                argument: "q, qd".to_owned(),
                found: format!("({},), ({},)", q.len(), qd.len()),
                expected: format!("{nq} and {nv} numbers for each state"),
            });
        }
        if let Some(gains) = &gains {
            gains.check(holds, states)?;
        }
        let chosen = match method {
            // With error control the step follows from the accuracy, and explicit methods are stable up to longer ones.
            Method::Auto if accuracy.is_some() => match choose(holds, CONTROLLED, &properties, gains.as_ref(), q) {
                Method::RungeKutta4 => Method::DormandPrince5,
                _ => Method::Rosenbrock3,
            },
            Method::Auto => choose(holds, dt, &properties, gains.as_ref(), q),
            method => method,
        };
        let roots = if conserve_momentum { conserve::roots(holds, &properties, gains.as_ref())? } else { Vec::new() };
        let mut law = StepSettings::new(holds.model(), dt, chosen, (properties, gains), roots).with_coupling(coupling);
        law.divides = method == Method::Auto && is_tree;
        law.restitution = restitution;
        law.stops = stops;
        law.accuracy = accuracy;
        law.set_valued = set_valued(holds, law.coupling.as_deref(), &law.properties, stops && is_tree);
        law.tolerance = settings.tolerance;
        law.connected = (!holds.constraints().is_empty()).then_some(stabilisation);
        law.compliance = settings.compliance;
        let keeper = Keeper::new(holds.model(), &law.roots);
        let current = memory::filled("q, qd", states.saturating_mul(law.width(holds)), 0.0)?;
        let begun = memory::filled("q, qd", states, 0)?;
        let pool = Pool::default();
        let mut rollout = Self {
            scene,
            law,
            method,
            limits: settings.limits,
            keeper,
            form,
            arm,
            states,
            current,
            begun,
            done: 0,
            pool,
            impacts: Impacts::default(),
        };
        for state in 0..states {
            watch::check_at(state, 1_024)?;
            let (q, qd) = (&q[state * nq..(state + 1) * nq], &qd[state * nv..(state + 1) * nv]);
            let named = |error: Error| if states > 1 { error.in_state(state) } else { error };
            rollout.check_state(q, qd).map_err(named)?;
            rollout.begin(state, q, qd);
        }
        Ok(rollout)
    }

    /// Whether a state can begin there.
    pub(super) fn check_state(&self, q: &[f64], qd: &[f64]) -> Result<(), Error> {
        self.scene().check_configuration("q", q)?;
        self.scene().check_rates("qd", qd)?;
        self.check_connections(q, qd)?;
        self.law.coupling.as_ref().map_or(Ok(()), |coupling| coupling.check_followed(q, qd))
    }

    /// Begins one of the states at the step at hand, from what [`Rollout::check_state`] has seen.
    pub(super) fn begin(&mut self, state: usize, q: &[f64], qd: &[f64]) {
        let Self { scene, law, keeper, current, .. } = self;
        let scene: &Scene = (*scene).borrow().tree();
        let width = law.width(scene);
        let (moving, rest) = current[state * width..(state + 1) * width].split_at_mut(q.len() + qd.len());
        let (tally, kept) = rest.split_at_mut(TALLY);
        tally.fill(0.0);
        let (own_q, own_qd) = moving.split_at_mut(q.len());
        own_q.copy_from_slice(q);
        own_qd.copy_from_slice(qd);
        if keeper.keeps() {
            keeper.begin(scene.model(), q, qd);
            let (start, largest) = kept.split_at_mut(KEPT * law.roots.len());
            start.copy_from_slice(&keeper.start);
            largest.fill(0.0);
        }
        if law.method == Method::Contact {
            contact::begin(kept);
        }
        self.begun[state] = self.done;
    }

    /// The scene whose states these are: the [`tree`](Scene::tree), where joints follow each other.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        self.scene.borrow().tree()
    }

    /// What it was made with; a copy.
    #[must_use]
    pub fn settings(&self) -> Settings {
        let StepSettings { step, properties, gains, roots, connected, restitution, .. } = &self.law;
        Settings {
            dt: *step,
            method: self.method,
            form: self.form,
            tolerance: self.law.tolerance,
            properties: properties.clone(),
            gains: gains.clone(),
            arm: self.arm,
            conserve_momentum: !roots.is_empty(),
            stabilisation: connected.unwrap_or_default(),
            compliance: self.law.compliance.clone(),
            limits: self.limits,
            restitution: *restitution,
            accuracy: self.law.accuracy,
        }
    }

    /// The method that advances states: of [`Method::Auto`], the one that was chosen.
    #[must_use]
    pub fn chosen_method(&self) -> Method {
        self.law.method
    }

    /// True if joint limits are stops.
    #[must_use]
    pub fn has_stops(&self) -> bool {
        self.law.stops
    }

    /// The works and the numbers of substeps of one state since it began.
    ///
    /// # Panics
    ///
    /// If there is no such state, as a slice does: see [`Rollout::states`].
    #[must_use]
    pub fn tally(&self, index: usize) -> Tally {
        Tally::of(&self.of_state(index)[self.scene().nq() + self.scene().nv()..])
    }

    /// The impacts of joints on their stops since the last call, by state and time; those before a step that failed are among them.
    pub fn take_impacts(&mut self) -> Vec<StopImpact> {
        self.impacts.take()
    }

    /// How many steps were made.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.done
    }

    /// How many states there are.
    #[must_use]
    pub fn states(&self) -> usize {
        self.states
    }

    /// How long one state has moved, s: dt for every step since it began.
    ///
    /// # Panics
    ///
    /// If there is no such state, as a slice does: see [`Rollout::states`].
    #[must_use]
    pub fn time(&self, index: usize) -> f64 {
        self.law.time(self.done - self.begun[index])
    }

    /// All that steps change but their number, and the step that each state began at.
    pub(super) fn numbers(&self) -> (&[f64], &[usize]) {
        (&self.current, &self.begun)
    }

    /// Goes to where [`Rollout::numbers`] was after so many steps.
    pub(super) fn put_back(&mut self, numbers: &[f64], done: usize) {
        self.current.copy_from_slice(numbers);
        self.done = done;
    }

    /// Takes the numbers of another rollout of as many states, which began where that one's did; false where they are of others.
    #[cfg(feature = "python")]
    pub(super) fn take_up(&mut self, numbers: &[f64], begun: &[usize], done: usize) -> bool {
        let fits = numbers.len() == self.current.len() && begun.len() == self.begun.len();
        let fits = fits && begun.iter().all(|&begun| begun <= done);
        if fits {
            self.put_back(numbers, done);
            self.begun.copy_from_slice(begun);
        }
        fits
    }

    /// Configuration and rates of one state now.
    ///
    /// # Panics
    ///
    /// If there is no such state, as a slice does: see [`Rollout::states`].
    #[must_use]
    pub fn state(&self, index: usize) -> (&[f64], &[f64]) {
        let scene = self.scene();
        let (q, rest) = self.of_state(index).split_at(scene.nq());
        (q, &rest[..scene.nv()])
    }

    /// The largest corrections that one state had so far to keep its momentum; none where that was not asked for.
    ///
    /// # Panics
    ///
    /// If there is no such state, as a slice does: see [`Rollout::states`].
    #[must_use]
    pub fn correction(&self, index: usize) -> Option<Correction> {
        let &[.., velocity, position] = self.of_state(index) else { return None };
        (!self.law.roots.is_empty()).then_some(Correction { velocity, position })
    }

    /// What the steps of one state told of its contacts since it began; none for a scene without.
    ///
    /// # Panics
    ///
    /// If there is no such state, as a slice does: see [`Rollout::states`].
    #[must_use]
    pub fn contact_report(&self, index: usize) -> Option<ContactReport> {
        let kept = &self.of_state(index)[self.scene().nq() + self.scene().nv() + TALLY..];
        if self.law.method == Method::Contact { ContactReport::of(kept) } else { None }
    }

    /// The contacts of one state now, as [`Records::contacts`] has them, (contacts, 11); impulses are those of all impacts since the last row that
    /// was recorded, or since it began.
    ///
    /// # Panics
    ///
    /// If there is no such state, as a slice does: see [`Rollout::states`].
    #[must_use]
    pub fn contacts_now(&self, index: usize) -> Vec<f64> {
        let (scene, (q, v)) = (self.scene(), self.state(index));
        let points = scene.contact_points();
        let mut out = vec![0.0; RECORD * points.len()];
        if self.law.method == Method::Contact {
            let kept = &self.of_state(index)[q.len() + v.len() + TALLY..];
            let mut rows = ContactScratch::new(scene.model(), points, Vec::new());
            contact::record(scene.model(), points, &mut rows, (q, v), (kept, self.law.step), &mut out);
        }
        out
    }

    fn of_state(&self, index: usize) -> &[f64] {
        assert!(index < self.states, "state {index} of a simulation with {} states", self.states);
        let width = self.law.width(self.scene());
        &self.current[index * width..(index + 1) * width]
    }

    /// Rough time of one step of one state on one thread, ns; decides about threads, not about results.
    #[must_use]
    #[doc(hidden)]
    pub fn cost(&self) -> usize {
        const ONE_BODY: usize = 100;
        /// About as many times as long through connections, one state at a time.
        const CONNECTED: usize = 20;
        let one_by_one = ONE_BODY * self.law.scheme.tableau.stages * self.scene().model().bodies.len().max(1);
        if self.law.connected.is_some() {
            return CONNECTED * one_by_one;
        }
        if self.law.method == Method::Contact {
            return CONNECTED * (one_by_one + ONE_BODY * self.scene().contacts().len());
        }
        one_by_one / self.arm.lanes(size_of::<f64>()).min(self.states.max(1))
    }

    /// Makes `steps` steps in every state; rows are recorded where they fall due, the first before the first step.
    ///
    /// The results have the same bits for any number of threads and for any division into calls.
    ///
    /// # Errors
    ///
    /// [`StepFault`] where a joint runs away or its pivot is lost. The rows of earlier steps are all there; states are then at
    /// different steps, and the rollout is at its end. Records and torques of the wrong size are a fault of the step at hand; so is that a
    /// [`watch`] ended the work.
    pub fn advance(
        &mut self,
        steps: usize,
        torque: &Torque<'_>,
        records: Option<&mut Records<'_>>,
    ) -> Result<(), StepFault> {
        let (nq, nv, width) = (self.scene().nq(), self.scene().nv(), self.law.width(self.scene()));
        let first = self.done;
        let refuse = |error| StepFault { step: first, state: 0, joint: String::new(), error };
        let Some(last) = first.checked_add(steps) else {
            return Err(refuse(Error::argument("steps", steps.to_string(), "a number of steps that can be counted")));
        };
        self.check_torque(torque, steps).map_err(|fault| StepFault { state: fault.state, ..refuse(fault.error) })?;
        let pieces = self.pieces(records, first, last).map_err(refuse)?;
        let fault: Mutex<Option<StepFault>> = Mutex::new(None);
        let cost = self.cost().saturating_mul(steps);
        let slice = (SLICE / self.cost().max(1)).max(1);
        let Self { scene, law, form, arm, current, begun, pool, impacts, .. } = self;
        let impacts = &*impacts;
        let scene: &Scene = (*scene).borrow().tree();
        // The lanes know no contacts.
        let arm = if law.method == Method::Contact { InstructionSet::Baseline } else { *arm };
        let make = || Stepper::new(*form, arm);
        let batch = Batch { states: self.states, cost, pool, make };
        let outcome = batch.run_pieces(GRAIN, current, |stepper, states, current| {
            let lanes = stepper.lanes();
            let mut from = states.start;
            while from < states.end {
                let to = (from + lanes).min(states.end);
                let mut rows = pieces.get(from / GRAIN).map(|rows| rows.lock().unwrap_or_else(PoisonError::into_inner));
                let current = &mut current[(from - states.start) * width..(to - states.start) * width];
                if first == 0
                    && let Some(rows) = rows.as_deref_mut()
                {
                    rows.record_start(from..to, current, (nq, nv, width));
                }
                // Interruption is checked between slices of steps.
                let mut begins = first;
                loop {
                    watch::check().map_err(|error| Fault { state: from, error })?;
                    let ends = last.min(begins.saturating_add(slice));
                    let job = Job {
                        scene,
                        law,
                        steps: begins..ends,
                        states: from..to,
                        begun: &begun[from..to],
                        current: &mut *current,
                        torque,
                        rows: rows.as_deref_mut(),
                        impacts: Some(impacts),
                    };
                    if let Err(found) = stepper.run(job) {
                        // Interrupted substeps end with a diverging motion.
                        watch::check().map_err(|error| Fault { state: from, error })?;
                        let mut fault = fault.lock().unwrap_or_else(PoisonError::into_inner);
                        let earlier = |known: &StepFault| (found.step, found.state) < (known.step, known.state);
                        if fault.as_ref().is_none_or(earlier) {
                            *fault = Some(found);
                        }
                        break;
                    }
                    begins = ends;
                    if begins == last {
                        break;
                    }
                }
                from = to;
            }
            Ok(())
        });
        // What was interrupted is at its end, with the steps made before; no other fault comes out here.
        outcome.map_err(|fault| refuse(fault.error))?;
        if let Some(fault) = fault.into_inner().unwrap_or_else(PoisonError::into_inner) {
            self.done = fault.step;
            return Err(fault);
        }
        self.done = last;
        Ok(())
    }

    /// Whether `torque` serves the next `steps` steps; [`Rollout::advance`] asks too.
    ///
    /// # Errors
    ///
    /// Another number of torques than the steps need, or torques that begin later; with `conserve_momentum`, a torque along a free joint that a tree hangs on.
    pub(crate) fn check_torque(&self, torque: &Torque<'_>, steps: usize) -> Result<(), Fault> {
        self.check_torque_from(self.done, torque, steps)
    }

    /// The same of the steps from some step of the run on.
    pub(super) fn check_torque_from(&self, start: usize, torque: &Torque<'_>, steps: usize) -> Result<(), Fault> {
        let (nv, last) = (self.scene().nv(), start.saturating_add(steps));
        let (given, before, steps) = match torque {
            Torque::Constant(torque) if self.states > 0 => (torque, 0, 1),
            Torque::Steps { torque, first } if self.states > 0 => {
                if *first > start {
                    let error =
                        Error::argument("torque.first", first.to_string(), format!("at most {start}, the next step"));
                    return Err(Fault { state: 0, error });
                }
                (torque, start - first, last - first)
            }
            _ => return Ok(()),
        };
        given.check_states("torque", self.states).map_err(|error| Fault { state: 0, error })?;
        let (found, expected) = (given.state(0).len(), steps.saturating_mul(nv));
        let fits = if matches!(torque, Torque::Constant(_)) { found == expected } else { found >= expected };
        if !fits {
            let expected = format!("{nv} torques for each of {steps} steps");
            let error = Error::Shape { argument: "torque".to_owned(), found: format!("({found},)"), expected };
            return Err(Fault { state: 0, error });
        }
        let roots = &self.law.roots;
        if roots.is_empty() {
            return Ok(());
        }
        for state in 0..self.states {
            if let Some(error) = conserve::outer_torque(self.scene(), roots, &given.state(state)[before * nv..expected])
            {
                return Err(Fault { state, error });
            }
        }
        Ok(())
    }

    #[allow(clippy::needless_pass_by_value)] // a reference that is passed on
    /// The rows of each [`GRAIN`] states, by themselves.
    fn pieces<'r>(
        &self,
        records: Option<&'r mut Records<'_>>,
        first: usize,
        last: usize,
    ) -> Result<Vec<Mutex<Rows<'r>>>, Error> {
        let Some(Records { q, qd, contacts, every }) = records else { return Ok(Vec::new()) };
        if self.states == 0 {
            return Ok(Vec::new());
        }
        let (nq, nv) = (self.scene().nq(), self.scene().nv());
        let width = nq.max(nv);
        let numbers = if nq >= nv { q.len() } else { qd.len() };
        let rows = numbers.checked_div(self.states * width).unwrap_or(0);
        let every = *every;
        let fits = every > 0 && (width == 0 || rows > last / every || (last == first && rows > 0));
        if !fits || q.len() != self.states * rows * nq || qd.len() != self.states * rows * nv {
            return Err(Error::Shape {
                argument: "records".to_owned(),
                found: format!("{} and {} numbers, a row every {every} steps", q.len(), qd.len()),
                expected: format!("{} states, a row for every so many of {last} steps, ({nq}) and ({nv})", self.states),
            });
        }
        let each = self.scene().contacts().len() * RECORD;
        if !contacts.is_empty() && contacts.len() != self.states * rows * each {
            return Err(Error::Shape {
                argument: "records.contacts".to_owned(),
                found: format!("({},)", contacts.len()),
                expected: format!("({},), or empty", self.states * rows * each),
            });
        }
        let each = if contacts.is_empty() { 0 } else { each };
        let mut contacts: &mut [f64] = contacts;
        let (mut q, mut qd): (&mut [f64], &mut [f64]) = (q, qd);
        let mut pieces = memory::with_capacity("q, qd", self.states.div_ceil(GRAIN))?;
        for first in (0..self.states).step_by(GRAIN) {
            let count = GRAIN.min(self.states - first) * rows;
            let (own_q, rest_q) = q.split_at_mut(count * nq);
            let (own_qd, rest_qd) = qd.split_at_mut(count * nv);
            let (own_contacts, rest) = contacts.split_at_mut(count * each);
            let piece = Rows { q: own_q, qd: own_qd, contacts: own_contacts, first, of_state: rows, from: 0, every };
            pieces.push(Mutex::new(piece));
            (q, qd, contacts) = (rest_q, rest_qd, rest);
        }
        Ok(pieces)
    }
}

/// Whether the scene can move by the method: one with contacts by its own and by no other.
fn check_method(scene: &Scene, method: Method, conserve_momentum: bool) -> Result<(), Error> {
    let (touches, is_own) = (!scene.contacts().is_empty(), method == Method::Contact);
    if touches != is_own {
        let found = format!("{:?}", method.name());
        let expected = if touches {
            "\"contact\" for a scene with contacts; scene.without_contacts() moves by the others"
        } else {
            "another method: the scene has no contacts"
        };
        return Err(Error::argument("method", found, expected));
    }
    if conserve_momentum { scene.check_no_contacts("conserve_momentum") } else { Ok(()) }
}
