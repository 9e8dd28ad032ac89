//! Methods of `Scene`: simulation.

use super::choice::of_unknown;
use super::contacts::{OF_CONTACT, contact_motion, reports};
use super::control::{Given, Pd, everyone};
use super::counts::{count, count_or};
use super::errors::{asked_by, of_batch, refuse};
use super::fresh::states_of;
use super::input::Input;
use super::interrupts::detached;
use super::object::{Object, imported};
use super::output::{Output, property};
use super::own_models;
use super::scene::PyScene;
use super::stepping::{Allowed, BLOCK, Blocks, Keywords, Stopped, about, set_outcome, warn_of_limits, warn_of_start};
use super::wrenches::LinkWrenches;
use crate::batch::broadcast_axes;
use crate::error::{Error, check_finite};
use crate::memory;
use crate::motion::{Records, Rollout, Torque};
use crate::scene::{Coupling, FrictionCurve, Scene};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::time::Instant;

getters! {
    in PyScene;

    /// Viscous damping of each degree of freedom, (nv,), N m s/rad or N s/m, read-only; used in simulations.
    damping: PyResult<Object<'py>> = |of, py| property(py, &of.properties().damping, &[of.scene.nv()]);

    /// Coulomb friction of each degree of freedom, (nv,), N m or N, read-only; used in simulations.
    friction: PyResult<Object<'py>> = |of, py| property(py, &of.properties().friction, &[of.scene.nv()]);

    /// Spring stiffness of each degree of freedom, (nv,), N m/rad or N/m, read-only; used in simulations.
    stiffness: PyResult<Object<'py>> = |of, py| property(py, &of.properties().stiffness, &[of.scene.nv()]);

    /// Configuration in which the springs are at rest, (nq,), read-only.
    rest: PyResult<Object<'py>> = |of, py| property(py, &of.properties().rest, &[of.scene.nq()]);
}

#[pymethods]
impl PyScene {
    /// Terms of friction: friction_offset, stribeck, stribeck_speed and load_friction, (4, nv), read-only.
    #[getter]
    fn friction_terms<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        let (curves, nv) = (self.properties().curves, self.scene.nv());
        let each = |row: usize| curves.get(row).copied().unwrap_or_default();
        let terms = |term: fn(&FrictionCurve) -> f64| (0..nv).map(move |row| term(&each(row)));
        let all = terms(|of| of.offset).chain(terms(|of| of.stribeck));
        let all: Vec<f64> = all.chain(terms(|of| of.stribeck_speed)).chain(terms(|of| of.load)).collect();
        property(py, &all, &[4, nv])
    }

    #[doc = signature!("simulate", "q, qd, *, dt=None, steps=None, tau=None, tau_steps=None", method;
                       ", record_every=1", joints form; ", progress=None", compliance stops accuracy smoothing;
                       ", duration=None, covariance=None", targets effort; ", control=None, activation=None",
                       wrenches contacts)]
    /// Simulate one state or a batch in time: M(q) dv/dt + bias(q, v) = tau + forces of joints and stops, dq/dt = v.
    #[doc = section!(Parameters)]
    /// q : (..., nq) array_like
    ///     Joint positions at the start, rad or m.
    /// qd : (..., nv) array_like
    ///     Joint velocities at the start, rad/s or m/s.
    /// dt : float
    ///     Step, s. With accuracy and duration: time between rows, duration / 1000 by default.
    /// steps : int
    ///     Number of steps. Alternatively, give duration.
    /// tau : (..., nv) array_like or callable, optional
    ///     Joint torques: constant, or a function of (t, q, qd) that returns (..., nv), called once per step with the
    ///     batch. An error for one state and shape (steps, nv): use tau_steps.
    /// tau_steps : (..., steps, nv) array_like, optional
    ///     Joint torques of each step, instead of tau.
    /// method : str, default "auto"
    ///     "semi-implicit-euler", "rk4", "dormand-prince-5", "implicit-euler", "rosenbrock-2" or "rosenbrock-3";
    ///     "contact", for scenes with contacts. "auto" selects "rk4" or "rosenbrock-2" and divides steps with fast
    ///     rotations. Steps in which contacts act are those of "contact" with every method; with "contact" or
    ///     smoothing, all are.
    /// record_every : int, default 1
    ///     Steps between two rows.
    /// pd : PD, optional
    ///     Control law PD(kp, kd, target, target_rate, effort), evaluated within the step.
    /// inertias : (..., bodies, 10) array_like, optional
    ///     Inertial parameters of each state instead of those of the scene, in the order of inertial_parameters: a
    ///     model per state.
    /// armature : float or (..., nv) array_like, optional
    ///     Armature instead of that of the scene, kg m^2 or kg. As damping, stiffness and friction, for all states or
    ///     (..., nv) for each.
    #[doc = entries!(losses)]
    /// friction_speed : float, optional
    ///     0 or None: exact Coulomb friction. Positive: friction is viscous below this speed, rad/s or m/s. 0 and
    ///     None are 0.01 in steps in which contacts act.
    /// form : {"auto", "covariance"}, default "auto"
    ///     "auto" recomputes steps whose error estimate exceeds the tolerance; "covariance" checks the pivots only.
    /// tolerance : float, optional
    ///     As in forward_dynamics; with accuracy, the default is at least 1e-4 times accuracy.
    /// progress : callable, optional
    ///     Function of (steps done, steps), called at most 20 times per second.
    #[doc = entries!(compliance)]
    /// limits : {"stop", "report"}, optional
    ///     "stop" (default): position limits are stops. "report": Trajectory.violations() lists them.
    /// restitution : float, default 0
    ///     Coefficient of restitution of the stops, 0 to 1.
    /// accuracy : float, optional
    ///     Error control: bound of the estimated error of each substep, rad or m, relative above 1 rad/s or m/s.
    /// smoothing : float, default 0
    ///     Length by which contacts are smoothed, m; 0: the exact law. A contact at rest that carries its equal share
    ///     of the weight has this gap; gradients exist before contact and at changes of its state. The bias is reported
    ///     in Trajectory.contacts. An error for contacts with restitution and with limits="stop" at joints with limits.
    /// duration : float, optional
    ///     Simulated time, s, instead of steps.
    /// covariance : MotionUncertainty or (bodies, 10, 10) array_like, optional
    ///     Uncertainty of the start, the parameters and the torques, or the covariance of the inertial parameters
    ///     alone. The trajectory then has .bands: standard deviations and covariances of each row, to first order, of
    ///     each state by its own model. An error for impacts on stops, accuracy and functions tau.
    /// targets : (..., steps, nq) array_like, optional
    ///     Target of pd in each step, instead of pd.target.
    /// target_rates : (..., steps, nv) array_like, optional
    ///     Target velocity of pd in each step, instead of pd.target_rate.
    /// effort : {"report", "clip"}, default "report"
    ///     "clip": the sum of tau and pd is limited to scene.limits.effort. "report": Trajectory.violations() lists
    ///     rows with more.
    /// control : (n,) or (..., steps, n) array_like, or dict of str to float or array_like, optional
    ///     Controls of scene.actuators: constant, or for each step (an axis of one step: for all steps); by name, a
    ///     float or (..., steps), and 0 for the others. They are clipped to ctrlrange, which Trajectory.violations()
    ///     lists. Servos act within the step, like pd, which cannot be given too; torques of tau are added.
    /// activation : (..., n) array_like or dict, optional
    ///     Activations of the actuators at the start, as Trajectory.activation; None: zero.
    /// wrenches : dict of str to (6,) or (..., steps, 6) array_like, optional
    ///     External forces by link name (links on fixed joints too): (moment, force) at the origin of the link, N m and
    ///     N, constant or for each step (an axis of one step: for all steps). They act in all stages of a step.
    /// frame : {"link", "world"}, default "link"
    ///     Axes of the wrenches: those of the link, with which they rotate, or those of the base.
    /// contact_friction, contact_restitution : float or (..., n) array_like, optional
    ///     Coefficients of the contacts of contacts.names and then the colliders of collider_names, instead of those of
    ///     the scene, for all states or for each.
    #[doc = section!(Returns)]
    /// trajectory : Trajectory
    ///     Rows t (rows,), q (..., rows, nq) and qd (..., rows, nv), the first at the start, with the integrator,
    ///     events and stops; bit-identical for any number of threads.
    #[doc = section!(Raises)]
    /// SimulationError
    ///     The motion diverges, a pivot is lost, connections or contacts have no solution, or tau raises. .trajectory
    ///     has the finished rows.
    /// SimulationInterrupted
    ///     Ctrl-C (a KeyboardInterrupt), with .trajectory. Other exceptions of signal handlers are raised unchanged.
    /// ConstraintError
    ///     The start violates the connections; see loops.project.
    #[doc = entries!(memory arguments)]
    #[doc = section!(Warns)]
    /// UnitsWarning
    ///     A step of 1 s or more without error control.
    /// FrictionWarning
    ///     friction_speed=0 in a scene with contacts, in whose steps joint friction is regularized.
    /// ContactWarning
    ///     Contacts that start below their surface, which the first step moves out, or slowly with smoothing.
    /// LimitWarning
    ///     Joints that start outside of limits that are stops, or stops that connections or contacts prevent from
    ///     acting.
    /// UncertaintyWarning
    ///     With covariance, joints that friction holds, and contacts that errors can bring into another mode.
    #[doc = section!(Notes)]
    /// O(N) per stage. docs/motion.md has the equations, the methods and their orders, friction, stops, contacts,
    /// connections, error control and the energy audit.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)  # falls from its neutral configuration
    /// >>> path = scene.simulate(scene.neutral(), np.zeros(6), dt=1e-3, steps=1000, record_every=100)
    /// >>> path.q.shape, path.integrator, path.q[-1, 1:3].round(2)
    /// ((11, 6), 'rk4', array([0.79, 0.35]))
    #[pyo3(signature = (q, qd, *, dt=None, steps=None, tau=None, tau_steps=None, record_every=None, progress=None,
                        duration=None, covariance=None, control=None, activation=None, **given),
           text_signature = None)]
    #[allow(clippy::too_many_lines)] // keywords, in Python
    fn simulate<'py>(
        slf: &Bound<'py, Self>,
        q: &Object<'py>,
        qd: &Object<'py>,
        dt: Option<f64>,
        steps: Option<&Object<'py>>,
        tau: Option<&Object<'py>>,
        tau_steps: Option<&Object<'py>>,
        record_every: Option<&Object<'py>>,
        progress: Option<&Object<'py>>,
        duration: Option<f64>,
        covariance: Option<&Object<'py>>,
        control: Option<&Object<'py>>,
        activation: Option<&Object<'py>>,
        given: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Object<'py>> {
        let (py, own) = (slf.py(), slf.get());
        let all = given.map(PyDictMethods::copy).transpose()?;
        let keywords = Keywords::take(py, "Scene.simulate", given, Allowed { accuracy: true, steps: true })?;
        let scene = &own.scene;
        let (nq, nv) = (scene.tree().nq(), scene.tree().nv());
        let (dt, steps) = length_of_run(dt, steps, duration, keywords.accuracy.is_some())?;
        if let Some(control) = control {
            let all = all.unwrap_or_else(|| PyDict::new(py));
            all.set_item("dt", dt)?;
            all.set_item("steps", steps)?;
            let others = [("tau", tau), ("tau_steps", tau_steps), ("record_every", record_every)];
            for (name, value) in others.into_iter().chain([("progress", progress), ("covariance", covariance)]) {
                all.set_item(name, value)?;
            }
            let driven = imported!(py, "phipsi._actuators", "simulate")?;
            return driven.call((slf, q, qd, control, activation), Some(&all));
        }
        if activation.is_some() {
            return Err(without_control().into());
        }
        let every = count_or("record_every", record_every, 1, 1)?;
        let (mut settings, pd, of_states) = keywords.read(py, own, (dt, steps))?;
        keywords.warn_of_units(py, dt)?;
        keywords.warn_of_friction(py, own, &settings)?;
        let q = own.on_tree(py, own.configuration("q", q)?, Coupling::configuration)?;
        let qd = own.on_tree(py, own.rate("qd", qd)?, Coupling::rates)?;
        // The torques of a function are recorded, for Trajectory.torques.
        let recorder = match tau.filter(|tau| tau.is_callable()) {
            Some(tau) => Some(imported!(py, "phipsi._recorded", "Recorded")?.call1((slf, tau, every))?),
            None => None,
        };
        let tau = recorder.as_ref().or(tau);
        let given = Given::read(tau, tau_steps, steps, own)?;
        let wrenches = keywords.wrenches(own, steps)?;
        let mut axes = vec![("q", q.leading()), ("qd", qd.leading())];
        axes.extend(pd.iter().flat_map(Pd::leading));
        axes.extend(wrenches.iter().flat_map(LinkWrenches::leading));
        given.check_not_steps(steps, axes.iter().all(|(_, leading)| leading.is_empty()))?;
        axes.extend(given.leading());
        axes.extend(own_models::leading(&of_states));
        let batch = broadcast_axes(axes)?;
        let room = Room {
            states: states_of(&batch)?,
            rows: steps / every + 1,
            numbers: nq + nv + OF_CONTACT * scene.contacts().len(),
        };
        room.checked()?;
        let states = room.states;
        own.check_scratch(states)?;
        settings.gains = pd.map(|pd| pd.over(&batch, states)).transpose()?;
        own_models::fill(&of_states, &mut settings.properties, &batch, states)?;
        settings.wrenches = wrenches.map(|wrenches| wrenches.over(&batch, states)).transpose()?;
        let of_contacts = OF_CONTACT * scene.contacts().len();
        let outputs = [nq, nv, of_contacts].map(|width| room.output(py, &batch, width));
        let [all_q, all_qd] = [everyone(&q, &batch, states)?, everyone(&qd, &batch, states)?];
        let fields = about(slf, &settings, &batch)?;
        fields.set_item("record_every", every)?;
        fields.set_item("given", keywords.given(py, (tau, tau_steps))?)?;
        let rollout = detached(py, || Rollout::of_states(scene, settings, states, (&all_q, &all_qd)))?;
        let mut rollout = rollout.map_err(|error| of_batch(py, &error, &batch))?;
        let all = 0..rollout.states();
        warn_of_start(py, [rollout.limit_warning(all.clone()), rollout.contact_warning(all)])?;
        drop((all_q, all_qd));
        let [out_q, out_qd, out_contacts] = outputs;
        let (mut out_q, mut out_qd, mut out_contacts) = (out_q?, out_qd?, out_contacts?);
        let mut records =
            Records { q: out_q.numbers()?, qd: out_qd.numbers()?, contacts: out_contacts.numbers()?, every };
        let plan = Plan { given: &given, batch: &batch, steps, dt, progress, nv, own };
        let stopped = run(py, &mut rollout, &mut records, &plan).err();
        own.warn_of_linkage(py)?;
        warn_of_limits(py, (rollout.dropped() > 0.0).then(|| rollout.dropped_warning()))?;
        fields.set_item("steps", rollout.steps())?;
        let (impacts, made) = (
            rollout.take_impacts(),
            (rollout.chosen_method(), rollout.friction_speed(), [rollout.has_stops(), keywords.accuracy.is_some()]),
        );
        set_outcome(&fields, &batch, own, made, |state| rollout.totals(state), &impacts)?;
        if scene.touches() {
            if stopped.is_none() {
                scene.check_result("contacts", out_contacts.numbers()?)?;
            }
            let told = reports(py, &batch, |state| rollout.contact_report(state))?;
            let rows = (out_contacts.finish().into_any(), told);
            let shapes = rollout.shape_contacts();
            fields.set_item("contacts", contact_motion(slf, rows, (&shapes, every))?)?;
        }
        let end = |is_rate| own.of_states(py, &batch, (0..states).map(|state| rollout.state(state)), is_rate);
        fields.set_item("end", (end(false)?, end(true)?))?;
        let whole = (own.of_scene(out_q.finish().into_any(), false)?, own.of_scene(out_qd.finish().into_any(), true)?);
        let trajectory = imported!(py, "phipsi._motion", "trajectory_of")?.call(whole, Some(&fields))?;
        match (stopped, covariance) {
            (None, None) => Ok(trajectory),
            (None, Some(covariance)) => {
                imported!(py, "phipsi.estimation.trajectories", "with_bands")?.call1((trajectory, covariance))
            }
            (Some(stopped), _) => Err(stopped.raise(py, &trajectory, &batch)?),
        }
    }

    /// Equations of motion for SciPy's solve_ivp: right-hand side and Jacobian in tangent coordinates, and a solver.
    #[doc = section!(Parameters)]
    /// tau : (nv,) array_like or callable, optional
    ///     Joint torques: constant, or a function of (t, q, qd), called at every stage.
    /// pd : PD, optional
    ///     Control law, as in simulate.
    #[doc = entries!(losses)]
    /// friction_speed : float, default 0.01
    ///     Speed below which friction is viscous, rad/s or m/s; positive, because the solvers need smooth friction.
    #[doc = section!(Returns)]
    /// ode : Ode
    ///     ode.solve(q, qd, t_span, method=..., rtol=..., atol=...) returns a Trajectory, with error control on the
    ///     manifold.
    #[doc = section!(Raises)]
    /// ImportError
    ///     SciPy is not installed.
    #[doc = entries!(arguments)]
    #[doc = section!(Examples)]
    /// >>> ode = phipsi.scenes.chain(3).ode()
    /// >>> path = ode.solve([0.3, 0.2, 0.1], [1.0, 0.0, 0.0], (0.0, 0.5))
    /// >>> path.q[-1].round(3)
    /// array([0.8, 0.2, 0.1])
    #[pyo3(signature = (**given),
           text_signature = "($self, *, tau=None, pd=None, damping=None, stiffness=None, rest=None, friction=None, \
                             friction_speed=0.01)")]
    fn ode<'py>(slf: &Bound<'py, Self>, given: Option<&Bound<'py, PyDict>>) -> PyResult<Object<'py>> {
        let py = slf.py();
        slf.get().scene.check_no_contacts("ode")?;
        let made = imported!(py, "phipsi._ode", "Ode")?.call((slf,), given);
        made.map_err(|error| of_unknown(py, "Scene.ode", given, error))
    }
}

/// Step and number of steps: `steps`, or `duration` divided by the step; with error control, 1000 rows by default.
fn length_of_run(
    dt: Option<f64>,
    steps: Option<&Object<'_>>,
    duration: Option<f64>,
    controlled: bool,
) -> PyResult<(f64, usize)> {
    const ROWS: f64 = 1000.0;
    if let Some(duration) = duration
        && !(duration.is_finite() && duration > 0.0)
    {
        return refuse("duration", format!("{duration}"), "a time in s, finite and positive");
    }
    let dt = match (dt, duration) {
        (Some(dt), _) => dt,
        (None, Some(duration)) if controlled => duration / ROWS,
        _ => {
            return refuse("dt", "None", "a step in s, which is optional with accuracy and duration");
        }
    };
    match (steps, duration) {
        (Some(steps), None) => Ok((dt, count("steps", steps, 0)?)),
        (None, Some(duration)) => {
            let found = (duration / dt).round();
            if !((1.0..1e15).contains(&found)) || !((found * dt - duration).abs() <= 1e-6 * duration) {
                let expected = "a multiple of dt, or steps instead of duration";
                return refuse("duration", format!("{duration} with dt {dt}"), expected);
            }
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // in these bounds
            Ok((dt, found as usize))
        }
        (None, None) => refuse("steps", "None", "a number of steps, or duration"),
        (Some(_), Some(_)) => refuse("duration", "steps and duration", "either steps or duration"),
    }
}

/// The error for activations without controls.
pub(super) fn without_control() -> Error {
    Error::argument("activation", "activations without control", "control too")
}

/// Amount of data to record.
pub(super) struct Room {
    pub states: usize,
    pub rows: usize,
    pub numbers: usize,
}

impl Room {
    /// Number of states, if their records, current states and initial states fit in memory.
    pub fn checked(&self) -> Result<(), Error> {
        let numbers = self.numbers.max(1);
        let rows = memory::bytes_of::<f64>(&[self.states, self.rows, numbers]);
        let at_once = memory::bytes_of::<f64>(&[self.states, numbers, 3]);
        let asking = if self.rows > 3 { "steps" } else { "q, qd" };
        memory::room(asking, rows.saturating_add(at_once)).map_err(|mut error| {
            if let Error::Memory { request, .. } = &mut error {
                request.what = format!("{} rows of {} numbers for {} states", self.rows, self.numbers, self.states);
            }
            error
        })
    }

    fn output<'py>(&self, py: Python<'py>, batch: &[usize], width: usize) -> PyResult<Output<'py>> {
        asked_by(py, "steps", Output::new(py, &[batch, &[self.rows, width]].concat()))
    }
}

/// Plan of a run.
struct Plan<'a, 'py> {
    given: &'a Given<'py>,
    batch: &'a [usize],
    steps: usize,
    dt: f64,
    progress: Option<&'a Object<'py>>,
    nv: usize,
    own: &'a PyScene,
}

/// Runs all steps in blocks of about the time between two reports. Signals are checked after each block, and within
/// long ones.
fn run<'py>(
    py: Python<'py>,
    rollout: &mut Rollout<&Scene>,
    records: &mut Records<'_>,
    plan: &Plan<'_, 'py>,
) -> Result<(), Stopped> {
    let constant = plan.given.torque(plan.batch, (plan.steps, plan.nv))?;
    if plan.steps == 0 {
        return advanced(py, rollout, 0, &constant, records);
    }
    let mut blocks = Blocks::new();
    let mut reported = Instant::now();
    while rollout.steps() < plan.steps {
        let count = blocks.next(plan.steps - rollout.steps());
        let began = Instant::now();
        if let Given::Function(tau) = plan.given {
            let tau = asked(tau, rollout, plan)?;
            let torque = Torque::Constant(tau.over(plan.batch)?);
            advanced(py, rollout, count, &torque, records)?;
        } else {
            advanced(py, rollout, count, &constant, records)?;
        }
        py.check_signals().map_err(Stopped::Signal)?;
        if !matches!(plan.given, Given::Function(_)) {
            blocks.done(began);
        }
        let done = rollout.steps();
        if let Some(progress) = plan.progress
            && (done == plan.steps || reported.elapsed() >= BLOCK)
        {
            reported = Instant::now();
            progress.call1((done, plan.steps))?;
        }
    }
    Ok(())
}

/// Runs `steps` steps without the GIL.
fn advanced(
    py: Python<'_>,
    rollout: &mut Rollout<&Scene>,
    steps: usize,
    torque: &Torque<'_>,
    records: &mut Records<'_>,
) -> Result<(), Stopped> {
    detached(py, || rollout.advance(steps, torque, Some(records))).map_err(Stopped::Signal)?.map_err(Stopped::Fault)
}

/// Calls the function of the caller for the torques at the current states.
fn asked<'py>(tau: &Object<'py>, rollout: &Rollout<&Scene>, plan: &Plan<'_, 'py>) -> PyResult<Input<'py>> {
    let (py, states) = (tau.py(), || (0..rollout.states()).map(|state| rollout.state(state)));
    let now = |is_rate| plan.own.of_states(py, plan.batch, states(), is_rate);
    #[allow(clippy::cast_precision_loss)] // a time
    let t = rollout.steps() as f64 * plan.dt;
    let value = tau.call1((t, now(false)?, now(true)?))?;
    let tau = Input::new("tau(t, q, qd)", &value, plan.own.rates())?;
    check_finite("tau(t, q, qd)", tau.data()?)?;
    plan.own.on_tree(py, tau, Coupling::torques)
}
