//! A rollout: time integration of a batch of states, vectorized and on several threads, a number of steps per call.

use super::choice::{check_connections_of_contacts, check_method, step_settings};
use super::contact::{self, ContactReport, RECORD};
use super::events::StopImpact;
use super::friction_curve::check_curves;
use super::job::{Impacts, Job, Records, Rows, States};
use super::method::Method;
use super::population::Population;
use super::properties::Gains;
use super::runner::Runner;
use super::settings::{Limits, Settings};
use super::step_settings::StepSettings;
use super::torque::{StepFault, Torque};
use super::totals::{TOTALS, Totals};
use super::touches::{ShapeContact, Touches};
use super::wrenches::LinkWrenches;
use crate::algorithm::Algorithm;
use crate::batch::{Batch, Fault, Pool, SLICE};
use crate::dynamics::contacts::ContactScratch;
use crate::error::{Error, in_language};
use crate::filter::Form;
use crate::filter::tolerance::Tolerance;
use crate::joints::JointKind;
use crate::scene::Scene;
use crate::{interrupt, memory};
use std::borrow::Borrow;
use std::iter;
use std::sync::{Arc, Mutex, PoisonError};

/// States under time integration. `S` holds the scene: `&Scene`, `Arc<Scene>` or `Scene`. A clone continues
/// independently.
///
/// ```
/// use phipsi::motion::{Method, Rollout, Settings, Torque};
/// # fn main() -> Result<(), phipsi::Error> {
/// let scene = phipsi::scenes::chain(7)?;
/// let mut settings = Settings::new(&scene, 1e-3);
/// settings.method = Method::RungeKutta4;
/// let mut rollout = Rollout::new(&scene, settings, &[0.3; 7], &[0.0; 7])?;
/// rollout.advance(100, &Torque::Zero, None)?;
/// assert_eq!(rollout.steps(), 100);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Rollout<S> {
    pub(super) scene: S,
    pub(super) settings: StepSettings,
    /// The models of the states, if the states differ in them.
    pub(super) population: Option<Arc<Population>>,
    /// The scratch of each state whose steps are those of its own scene.
    runners: Arc<Vec<Mutex<Option<Runner>>>>,
    states: usize,
    /// Per state: q, qd, the totals, and the stored values of contacts.
    current: Vec<f64>,
    /// The step at which each state began.
    begun: Vec<usize>,
    done: usize,
    pool: Pool<Runner>,
    impacts: Impacts,
    touches: Touches,
}

/// Checks restitution and error control, and limits of effort where contacts act.
fn check_options(holds: &Scene, settings: &Settings) -> Result<(), Error> {
    let (restitution, accuracy) = (settings.restitution, settings.accuracy);
    if !(0.0..=1.0).contains(&restitution) {
        return Err(Error::argument("restitution", format!("{restitution}"), "a number from 0 to 1"));
    }
    if let Some(accuracy) = accuracy
        && !(accuracy.is_finite() && accuracy >= 1e-12)
    {
        return Err(Error::argument("accuracy", format!("{accuracy}"), "an error bound of at least 1e-12"));
    }
    if holds.shapes().is_some() {
        let given = [("accuracy", accuracy.is_some()), ("smoothing", settings.smoothing > 0.0)];
        if let Some((name, _)) = given.into_iter().find(|(_, given)| *given) {
            let expected = format!("no {name} for shapes that touch, or contacts of named points");
            return Err(Error::argument(name, "a value for a scene with colliders", expected));
        }
    }
    if accuracy.is_some() && settings.method != Method::Auto {
        let found = "error control with a fixed method";
        return Err(Error::argument("accuracy", found, "None for this scene and these settings"));
    }
    if let Some(gains) = settings.gains.as_ref().filter(|_| holds.touches())
        && let Some(free) = holds.joints().iter().find(|joint| {
            joint.kind == JointKind::Floating && joint.v.clone().any(|row| gains.is_limited(holds.nv(), row))
        })
    {
        let [.., name] = Gains::names();
        let found = format!("limits for the free joint {:?} of a scene with contacts", free.name);
        return Err(Error::argument(name, found, "infinite limits for its degrees of freedom, which have no motor"));
    }
    Ok(())
}

/// The accepted error of accelerations, relative to the largest, as a share of that of a substep.
const SOLVED: f64 = 1e-4;

/// Threads receive multiples of this number of states, which is at least the number of lanes of every instruction set.
pub(super) const GRAIN: usize = 16;

impl<S: Borrow<Scene>> Rollout<S> {
    /// Creates a rollout from initial states, one after another: `q` (states, nq), `qd` (states, nv).
    ///
    /// For a scene with coupled joints all arrays are those of its [`tree`](Scene::tree);
    /// [`Coupling`](crate::scene::Coupling) converts them.
    ///
    /// # Errors
    ///
    /// A step that is not finite and positive; a form other than auto and covariance; wrong lengths; values that are
    /// not finite; negative properties; quaternions that are not of unit norm; a state that violates the connections
    /// ([`Scene::project`] corrects it).
    pub fn new(scene: S, settings: Settings, q: &[f64], qd: &[f64]) -> Result<Self, Error> {
        let states = q.len().checked_div(scene.borrow().tree().nq()).unwrap_or(1);
        Self::of_states(scene, settings, states, (q, qd))
    }

    /// As [`Rollout::new`], for scenes without joints too, whose number of states is not that of the numbers.
    #[allow(clippy::needless_pass_by_value)] // the settings are those of this rollout
    pub(crate) fn of_states(
        scene: S,
        settings: Settings,
        states: usize,
        (q, qd): (&[f64], &[f64]),
    ) -> Result<Self, Error> {
        let coupling = scene.borrow().shared_coupling();
        let holds: &Scene = scene.borrow().tree();
        let Settings { dt, method, form, .. } = settings;
        if !(dt.is_finite() && dt > 0.0) {
            return Err(Error::argument("dt", format!("{dt}"), "a step in s, finite and positive"));
        }
        if !matches!(form, Form::Auto | Form::Covariance) {
            return Err(Error::argument("form", format!("\"{form}\""), "\"auto\" or \"covariance\" for a rollout"));
        }
        scene.borrow().check_tolerance(Algorithm::ForwardDynamics(form), settings.tolerance)?;
        settings.properties.check(holds, states)?;
        check_curves(holds, coupling.as_deref(), &settings.properties)?;
        check_method(holds, &settings)?;
        holds.check_compliance(&settings.compliance)?;
        check_connections_of_contacts(holds, &settings.compliance)?;
        let (nq, nv) = (holds.nq(), holds.nv());
        if q.len() != states * nq || qd.len() != states * nv {
            return Err(Error::Shape {
                argument: "q, qd".to_owned(),
                found: format!("({},), ({},)", q.len(), qd.len()),
                expected: format!("{nq} and {nv} values per state"),
            });
        }
        if let Some(gains) = &settings.gains {
            gains.check(holds, states)?;
        }
        check_options(holds, &settings)?;
        let wrenches = settings.wrenches.clone().map(|given| LinkWrenches::new(given, holds, states).map(Arc::new));
        let wrenches = wrenches.transpose()?;
        let stops = settings.limits == Limits::Stop;
        let smoothing = contact::Smoothing::new(holds, settings.smoothing, stops)?;
        let has_models = !settings.properties.are_of_all(nv);
        let properties = if has_models { settings.properties.largest(nv) } else { settings.properties.clone() };
        let gains = settings.gains.clone();
        let usual = || Tolerance { given: None, rows: holds.model().longest_path() }.of_covariance(f64::EPSILON);
        let of_control = settings.accuracy.map(|accuracy| SOLVED * accuracy).filter(|bound| *bound > usual());
        let tolerance = settings.tolerance.or(of_control);
        let given = Arc::new(Settings { gains: None, wrenches: None, tolerance, ..settings });
        let of_steps = |touches: bool| {
            step_settings(holds, &given, (properties.clone(), gains.clone(), coupling.clone()), (q, touches))
        };
        let mut step_settings = of_steps(holds.touches());
        if holds.touches() && method != Method::Contact && smoothing.is_none() {
            step_settings.free = Some(Box::new(of_steps(false)));
        }
        step_settings.smoothing = smoothing;
        step_settings.change(&|of| of.wrenches.clone_from(&wrenches));
        let population = if has_models {
            let mut population = Population::new(scene.borrow(), &step_settings, &given.properties, states);
            population.check(scene.borrow())?;
            Some(Arc::new(population))
        } else {
            None
        };
        let current = memory::filled("q, qd", states.saturating_mul(step_settings.width(holds)), 0.0)?;
        let begun = memory::filled("q, qd", states, 0)?;
        let pool = Pool::default();
        let mut rollout = Self {
            scene,
            settings: step_settings,
            runners: Arc::new((0..if population.is_some() { states } else { 0 }).map(|_| Mutex::new(None)).collect()),
            population,
            states,
            current,
            begun,
            done: 0,
            pool,
            impacts: Impacts::default(),
            touches: Touches::default(),
        };
        for state in 0..states {
            interrupt::check_at(state, 1_024)?;
            let (q, qd) = (&q[state * nq..(state + 1) * nq], &qd[state * nv..(state + 1) * nv]);
            let named = |error: Error| if states > 1 { error.in_state(state) } else { error };
            rollout.check_state(q, qd).map_err(named)?;
            rollout.begin(state, q, qd);
        }
        Ok(rollout)
    }

    /// Checks that an initial state is valid.
    pub(super) fn check_state(&self, q: &[f64], qd: &[f64]) -> Result<(), Error> {
        self.scene().check_configuration("q", q)?;
        self.scene().check_rates("qd", qd)?;
        self.check_connections(q, qd)?;
        self.settings.coupling.as_ref().map_or(Ok(()), |coupling| coupling.check_followed(q, qd))
    }

    /// Restarts one state at the current step, from values that [`Rollout::check_state`] accepted.
    pub(super) fn begin(&mut self, state: usize, q: &[f64], qd: &[f64]) {
        let Self { scene, settings, current, .. } = self;
        let scene: &Scene = (*scene).borrow().tree();
        let width = settings.width(scene);
        let (moving, rest) = current[state * width..(state + 1) * width].split_at_mut(q.len() + qd.len());
        let (totals, kept) = rest.split_at_mut(TOTALS);
        totals.fill(0.0);
        let (own_q, own_qd) = moving.split_at_mut(q.len());
        own_q.copy_from_slice(q);
        own_qd.copy_from_slice(qd);
        if settings.method == Method::Contact {
            contact::begin(kept);
        }
        self.begun[state] = self.done;
    }

    /// The scene of the states; for coupled joints its [`tree`](Scene::tree).
    #[must_use]
    pub fn scene(&self) -> &Scene {
        self.scene.borrow().tree()
    }

    /// A copy of the settings.
    #[must_use]
    pub fn settings(&self) -> Settings {
        let StepSettings { gains, wrenches, .. } = &self.settings;
        let (gains, wrenches) = (gains.as_deref().cloned(), wrenches.as_ref().map(|wrenches| wrenches.given.clone()));
        Settings { gains, wrenches, ..Settings::clone(&self.settings.given) }
    }

    /// The integration method; for [`Method::Auto`], the method that it selected. In a scene with contacts, that of the
    /// steps in which no contact can act; all other steps are those of [`Method::Contact`].
    #[must_use]
    pub fn chosen_method(&self) -> Method {
        self.without_contacts().method
    }

    /// The settings of steps in which no contact can act.
    fn without_contacts(&self) -> &StepSettings {
        self.settings.free.as_deref().unwrap_or(&self.settings)
    }

    /// The velocity below which joint friction is regularized, rad/s or m/s; zero for exact friction. In a scene with
    /// contacts, that of the steps in which contacts act.
    #[must_use]
    pub fn friction_speed(&self) -> f64 {
        self.settings.properties.friction_speed
    }

    /// True if joint limits act as stops.
    #[must_use]
    pub fn has_stops(&self) -> bool {
        self.settings.stops()
    }

    /// Works and numbers of substeps of one state since it began.
    ///
    /// # Panics
    ///
    /// If `index` is not below [`Rollout::states`].
    #[must_use]
    pub fn totals(&self, index: usize) -> Totals {
        Totals::of(&self.of_state(index)[self.scene().nq() + self.scene().nv()..])
    }

    /// Removes and returns the impacts of joints on their stops, sorted by state and time, including those before a
    /// step that failed.
    pub fn take_impacts(&mut self) -> Vec<StopImpact> {
        self.impacts.take()
    }

    /// Where shapes touched in the recorded steps, or in the last step of a call without records, sorted by state and
    /// step.
    #[must_use]
    pub fn shape_contacts(&self) -> Vec<ShapeContact> {
        self.touches.sorted()
    }

    /// Number of steps made.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.done
    }

    /// Number of states.
    #[must_use]
    pub fn states(&self) -> usize {
        self.states
    }

    /// Simulated time of one state, s: dt times the number of steps since it began.
    ///
    /// # Panics
    ///
    /// If `index` is not below [`Rollout::states`].
    #[must_use]
    pub fn time(&self, index: usize) -> f64 {
        self.settings.time(self.done - self.begun[index])
    }

    /// Changes the settings of the steps of all models, with contacts and without.
    pub(super) fn change(&mut self, change: impl Fn(&mut StepSettings)) {
        let of_models = self.population.as_mut().map(|population| Arc::make_mut(population).settings());
        iter::once(&mut self.settings).chain(of_models.into_iter().flatten()).for_each(|of| of.change(&change));
    }

    /// All values that steps change except their number, and the step at which each state began.
    pub(super) fn numbers(&self) -> (&[f64], &[usize]) {
        (&self.current, &self.begun)
    }

    /// Restores the values that [`Rollout::numbers`] returned after `done` steps.
    pub(super) fn restore(&mut self, numbers: &[f64], done: usize) {
        self.current.copy_from_slice(numbers);
        self.done = done;
    }

    /// Resumes from the values of another rollout, with the method that it chose from its initial states. Returns false
    /// if they do not match this rollout.
    #[cfg(feature = "python")]
    pub(super) fn resume(&mut self, chosen: Method, (numbers, begun): (&[f64], &[usize]), done: usize) -> bool {
        let fits = numbers.len() == self.current.len() && begun.len() == self.begun.len();
        let fits = fits && begun.iter().all(|&begun| begun <= done);
        if fits {
            self.change(|of| {
                if of.free.is_none() {
                    of.method = chosen;
                    of.adopt(of.step);
                }
            });
            self.restore(numbers, done);
            self.begun.copy_from_slice(begun);
        }
        fits
    }

    /// Current configuration and joint velocities of one state.
    ///
    /// # Panics
    ///
    /// If `index` is not below [`Rollout::states`].
    #[must_use]
    pub fn state(&self, index: usize) -> (&[f64], &[f64]) {
        let scene = self.scene();
        let (q, rest) = self.of_state(index).split_at(scene.nq());
        (q, &rest[..scene.nv()])
    }

    /// Diagnostics of the contacts of one state since it began; `None` for a scene without contacts.
    ///
    /// # Panics
    ///
    /// If `index` is not below [`Rollout::states`].
    #[must_use]
    pub fn contact_report(&self, index: usize) -> Option<ContactReport> {
        let kept = &self.of_state(index)[self.scene().nq() + self.scene().nv() + TOTALS..];
        if self.settings.method == Method::Contact { ContactReport::of(kept) } else { None }
    }

    /// The current contacts of one state in the layout of [`Records::contacts`], (contacts, 11). The impulses are sums
    /// over the impacts since the last recorded row, or since the state began.
    ///
    /// # Panics
    ///
    /// If `index` is not below [`Rollout::states`].
    #[must_use]
    pub fn contacts_now(&self, index: usize) -> Vec<f64> {
        let (scene, (q, v)) = (self.scene(), self.state(index));
        let points = scene.contact_points();
        let mut out = vec![0.0; RECORD * points.len()];
        if self.settings.method == Method::Contact {
            let kept = &self.of_state(index)[q.len() + v.len() + TOTALS..];
            let mut rows = ContactScratch::new(scene.model(), points, Vec::new());
            contact::record(scene.model(), points, &mut rows, (q, v), (kept, self.settings.step), &mut out);
        }
        out
    }

    fn of_state(&self, index: usize) -> &[f64] {
        assert!(index < self.states, "state {index} of a simulation with {} states", self.states);
        let width = self.settings.width(self.scene());
        &self.current[index * width..(index + 1) * width]
    }

    /// Approximate time per step and state on one thread, ns. It determines the number of threads, not the results.
    #[must_use]
    #[doc(hidden)]
    pub fn cost(&self) -> usize {
        const ONE_BODY: usize = 100;
        /// Cost factor of steps with connections or contacts that run one state at a time, and in the kernels.
        const CONNECTED: usize = 20;
        const IN_LANES: usize = 4;
        /// Number of contacts that cost as much as those of a shape.
        const OF_SHAPE: usize = 4;
        let one_by_one = ONE_BODY * self.settings.scheme.tableau.stages * self.scene().model().bodies.len().max(1);
        let connected = self.settings.connected;
        let touches = self.settings.method == Method::Contact;
        if (connected && !self.settings.is_vectorized()) || (touches && !self.settings.touches_in_lanes(self.scene())) {
            let contacts =
                self.scene().contacts().len() + OF_SHAPE * self.scene().shapes().map_or(0, |of| of.all.len());
            return CONNECTED * (one_by_one + ONE_BODY * contacts);
        }
        let factor = if connected || touches { IN_LANES } else { 1 };
        factor * one_by_one / self.settings.given.arm.lanes().min(self.states.max(1))
    }

    /// Advances all states by `steps` steps, and records rows, the first before the first step.
    ///
    /// The results are bit-identical for any number of threads and any division into calls.
    ///
    /// # Errors
    ///
    /// [`StepFault`] if a motion diverges or a pivot is singular. All rows of earlier steps are recorded; afterwards
    /// the states are at different steps, and the rollout cannot continue. Records and torques of wrong sizes, and an
    /// [`interrupt`], are faults of the current step.
    pub fn advance(
        &mut self,
        steps: usize,
        torque: &Torque<'_>,
        records: Option<&mut Records<'_>>,
    ) -> Result<(), StepFault> {
        let (nq, nv, width) = (self.scene().nq(), self.scene().nv(), self.settings.width(self.scene()));
        let first = self.done;
        let refuse = |error| StepFault { step: first, state: 0, joint: String::new(), error };
        let Some(last) = first.checked_add(steps) else {
            return Err(refuse(Error::argument(
                "steps",
                steps.to_string(),
                "a number of steps that does not overflow",
            )));
        };
        self.check_torque(torque, steps).map_err(|fault| StepFault { state: fault.state, ..refuse(fault.error) })?;
        let every = records.as_ref().map_or(0, |records| records.every);
        let pieces = self.pieces(records, first, last).map_err(refuse)?;
        let fault: Mutex<Option<StepFault>> = Mutex::new(None);
        let cost = self.cost().saturating_mul(steps);
        let slice = (SLICE / self.cost().max(1)).max(1);
        self.touches.begin(every, last);
        let Self { scene, settings, current, begun, pool, impacts, touches, population, runners, .. } = self;
        let (impacts, touches, population) = (&*impacts, &*touches, population.as_deref());
        let whole: &Scene = (*scene).borrow();
        let scene = whole.tree();
        let has_shapes = scene.shapes().is_some();
        let make = || Runner::new(settings.given.form, settings.given.arm);
        let batch = Batch { states: self.states, cost, pool, make };
        let outcome = batch.run_pieces(GRAIN, current, |runner, states, current| {
            let alone = population.filter(|population| !population.in_lanes);
            let lanes = if alone.is_some() { 1 } else { runner.lanes() };
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
                // Check for interruption between slices of steps.
                let mut begins = first;
                loop {
                    interrupt::check().map_err(|error| Fault { state: from, error })?;
                    let ends = last.min(begins.saturating_add(slice));
                    let member = alone.map(|population| population.of(from));
                    let own = member.map(|member| member.scene(whole)).transpose();
                    let own = own.map_err(|error| Fault { state: from, error })?;
                    let job = Job {
                        scene: own.as_deref().map_or(scene, Scene::tree),
                        settings: member.map_or(&*settings, |member| &member.settings),
                        models: population.filter(|_| member.is_none()).map(|population| (population, whole)),
                        steps: begins..ends,
                        states: States::Adjacent(from..to),
                        begun: &begun[from..to],
                        current: &mut *current,
                        torque,
                        rows: rows.as_deref_mut(),
                        impacts: Some(impacts),
                        touches: has_shapes.then_some(touches),
                        divisions: None,
                    };
                    let made = match member {
                        Some(_) => {
                            let mut own = runners[from].lock().unwrap_or_else(PoisonError::into_inner);
                            own.get_or_insert_with(make).run(job)
                        }
                        None => runner.run(job),
                    };
                    if let Err(found) = made {
                        // Interrupted substeps return a diverging motion.
                        interrupt::check().map_err(|error| Fault { state: from, error })?;
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
        // After an interruption the rollout keeps the steps made before; no other fault is reported here.
        outcome.map_err(|fault| refuse(fault.error))?;
        if let Some(fault) = fault.into_inner().unwrap_or_else(PoisonError::into_inner) {
            self.done = fault.step;
            return Err(fault);
        }
        self.done = last;
        Ok(())
    }

    /// Checks that `torque` is valid for the next `steps` steps, as [`Rollout::advance`] does.
    ///
    /// # Errors
    ///
    /// A number of torques that does not match the steps, or torques that begin later.
    pub(crate) fn check_torque(&self, torque: &Torque<'_>, steps: usize) -> Result<(), Fault> {
        self.check_torque_from(self.done, torque, steps)
    }

    /// As [`Rollout::check_torque`], beginning at step `start` of the run.
    pub(super) fn check_torque_from(&self, start: usize, torque: &Torque<'_>, steps: usize) -> Result<(), Fault> {
        let (nv, last) = (self.scene().nv(), start.saturating_add(steps));
        if let Some(gains) = self.settings.gains.as_ref().filter(|gains| gains.changes() && last > gains.steps) {
            let [.., name, _, _, _] = Gains::names();
            let found = format!("targets of {} steps", gains.steps);
            let error = Error::argument(name, found, format!("targets of all {last} steps"));
            return Err(Fault { state: 0, error });
        }
        if let Some(given) = self.settings.wrenches.as_ref().and_then(|wrenches| wrenches.given.steps)
            && last > given
        {
            let name = in_language("wrenches.steps", "wrenches");
            let error =
                Error::argument(name, format!("wrenches of {given} steps"), format!("wrenches of all {last} steps"));
            return Err(Fault { state: 0, error });
        }
        let (given, steps) = match torque {
            Torque::Constant(torque) if self.states > 0 => (torque, 1),
            Torque::Steps { torque, first } if self.states > 0 => {
                if *first > start {
                    let error =
                        Error::argument("torque.first", first.to_string(), format!("at most {start}, the next step"));
                    return Err(Fault { state: 0, error });
                }
                (torque, last - first)
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
        Ok(())
    }

    #[allow(clippy::needless_pass_by_value)] // a reference that is passed on
    /// Splits the rows into pieces of [`GRAIN`] states.
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
                found: format!("{} and {} values with a row every {every} steps", q.len(), qd.len()),
                expected: format!("{} states with rows over {last} steps, {nq} and {nv} values per row", self.states),
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
