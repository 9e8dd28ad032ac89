//! Methods of `Scene`: states through time.

use super::contacts::{OF_CONTACT, contact_motion, reports};
use super::control::{Given, Pd, everyone};
use super::counts::{count, count_or};
use super::errors::{asked_by, fault, of_batch};
use super::fresh::entries;
use super::input::Input;
use super::interrupts::detached;
use super::object::{Object, imported};
use super::output::{Output, from_numbers};
use super::scene::PyScene;
use super::stepping::{BLOCK, Blocks, Keywords, Stopped, about, largest_corrections, set_outcome, warn_of_limits};
use crate::batch::broadcast_axes;
use crate::error::{Error, check_finite};
use crate::memory;
use crate::motion::{Properties, Records, Rollout, Torque};
use crate::scene::{Coupling, Scene};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::time::Instant;

#[pymethods]
impl PyScene {
    /// Viscous damping of each degree of freedom, (nv,), N m s/rad or N s/m; a copy. Simulation only.
    #[getter]
    fn damping<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        from_numbers(py, &self.properties_of_scene(&Properties::of(&self.scene)).damping, &[self.scene.nv()])
    }

    /// Coulomb friction of each degree of freedom, (nv,), N m or N; a copy. Simulation only.
    #[getter]
    fn friction<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        from_numbers(py, &self.properties_of_scene(&Properties::of(&self.scene)).friction, &[self.scene.nv()])
    }

    /// Stiffness of each degree of freedom's spring, (nv,), N m/rad or N/m; a copy. Simulation only.
    #[getter]
    fn stiffness<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        from_numbers(py, &self.properties_of_scene(&Properties::of(&self.scene)).stiffness, &[self.scene.nv()])
    }

    /// The configuration where the springs are at rest, (nq,); a copy.
    #[getter]
    fn rest<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        from_numbers(py, &self.properties_of_scene(&Properties::of(&self.scene)).rest, &[self.scene.nq()])
    }

    /// Simulates states in time: one state or a batch, with a step that is stable for stiff springs, damping, gains, dry friction and joint stops.
    ///
    /// With d damping, f friction, k stiffness and differences on the manifold,
    ///
    ///     M(q) dv/dt + bias(q, v) = tau - d v - f sign(v) - k (q - rest) + kp (target - q) + kd (target_rate - v) + stops
    ///
    /// and dq/dt = v on the manifold: quaternions stay unit, free joints move on SE(3).
    ///
    /// Parameters
    /// ----------
    /// q : (..., nq)
    ///     Configurations at the start. Leading axes of all arguments broadcast.
    /// qd : (..., nv)
    ///     Joint velocities at the start, rad/s or m/s.
    /// dt : float
    ///     Step, s. With accuracy and duration it is the time between rows, a thousandth of duration by default.
    /// steps : int
    ///     Number of steps; or give duration.
    /// tau : (..., nv), or callable
    ///     Torque, constant, or a function of (t, q, qd) that is called once per step with the whole batch and returns (..., nv). Held over each step: a
    ///     function is followed to first order in dt by every method.
    /// tau_steps : (..., steps, nv)
    ///     Torque of each step, instead of tau.
    /// method : str
    ///     "auto" (the default) is "rosenbrock-2" (order 2), or "rk4" (explicit, order 4) where springs, damping and gains are slow at this step, by bounds at the
    ///     first state: Trajectory.integrator reports which. "auto" divides steps in which joints rotate too far for the method, into at most 1024 substeps. The other
    ///     methods never divide for accuracy: "semi-implicit-euler" (order 1), "rk4", "dormand-prince-5" (order 5), "implicit-euler" (order 1), "rosenbrock-2",
    ///     "rosenbrock-3" (order 3). The implicit ones take
    ///     springs, damping and pd as measurement noise r + h d + h^2 k at the cost of an explicit stage, and are L-stable for them. Scenes with contacts have one
    ///     method, "contact" (order 1), which "auto" stands for.
    /// record_every : int
    ///     Steps between two rows.
    /// pd : PD(kp, kd, target, target_rate)
    ///     Control law that is evaluated within the step.
    /// armature, damping, stiffness, friction : (nv,) or float, optional
    ///     Instead of the scene's.
    /// rest : (nq,), optional
    ///     Configuration where springs are at rest, instead of the scene's.
    /// friction_speed : float, optional
    ///     Zero or None: exact Coulomb friction. A joint at rest stays exactly at rest while friction can hold it. Positive: regularized friction
    ///     -f v / sqrt(v^2 + friction_speed^2), with which joints creep, rad/s or m/s. None stands for 0.01 in scenes with contacts or
    ///     connections, where friction is always regularized: Trajectory.friction_speed reports it.
    /// form : str
    ///     "auto" recomputes a step whose estimated error exceeds the tolerance in square-root form; "covariance" checks the pivots only.
    /// tolerance : float, optional
    ///     Of form "auto", as in forward_dynamics.
    /// progress : callable, optional
    ///     Called with (steps done, steps) at most twenty times per second.
    /// conserve_momentum : bool
    ///     Each floating tree conserves its momentum, and its center of mass follows its parabola, to rounding: each step ends with a rigid motion of the tree,
    ///     as large as the step's error in them, O(N). Every tree must be connected to the base by a free joint without tau, pd, damping, stiffness, friction
    ///     or armature.
    /// compliance : float or array_like (m,), optional
    ///     Compliance of each row of the connections, (m/s^2)/N or (rad/s^2)/(N m), zero or above, in the order of connection_rows: accelerations, and the projection that ends each
    ///     step, let rows give way by it, and states need not meet the connections at the start. The default is none.
    /// baumgarte : float, optional
    ///     For scenes with connections. None: positions and velocities are projected onto them after each step (see project). A rate a in 1/s:
    ///     J qdd + J' qd = -2 a J qd - a^2 error.
    /// limits : str, optional
    ///     "stop", the default: joint limits are stops that a joint with one degree of freedom does not pass. "report": limits do nothing, and
    ///     Trajectory.violations lists them. A joint that starts outside of its limits is moved back without a jump of its velocity, with a LimitWarning.
    /// restitution : float
    ///     Coefficient of restitution of the stops, 0 to 1. A rebound that would end within the step is none.
    /// accuracy : float, optional
    ///     Error control: the estimated error of each substep, in rad or m and relative to the fastest joint velocity where that exceeds 1, is at most this. Changes between
    ///     sticking and sliding and impacts on stops are located within 1e-7 dt. Trajectory.estimated_error is the sum of the estimates.
    /// duration : float, optional
    ///     Simulated time, s, instead of steps.
    /// covariance : phipsi.estimation.MotionUncertainty, optional
    ///     What is uncertain: the trajectory gets .bands, standard deviations and covariances of every row to first order; or a covariance of the inertial parameters alone, as in
    ///     forward_dynamics_variance. Needs method="semi-implicit-euler" and record_every=1, and is refused where motion has no derivative (stops, exact friction, contacts).
    ///
    /// Returns
    /// -------
    /// Trajectory
    ///     Rows t (rows,), q (..., rows, nq), qd (..., rows, nv), the first at the start; integrator, substeps, events and stops; energy_audit() and error_estimate();
    ///     momentum_correction, drift and contacts where they apply. Bit for bit the same for any number of threads.
    ///
    /// Raises
    /// ------
    /// SimulationError
    ///     Motion diverges, a pivot is lost, connections cannot hold, no impulses meet the law of contacts to 1e-5, or tau raises. .trajectory has the rows of the finished steps.
    /// SimulationInterrupted
    ///     Ctrl-C (a KeyboardInterrupt), likewise.
    /// ConstraintError
    ///     A start that does not meet the connections.
    /// OutOfMemoryError, ShapeError, NotFiniteError, ArgumentError
    ///     Each names the argument and the state.
    ///
    /// Notes
    /// -----
    /// O(N) per stage. A step in which a joint sticks, slips or meets a stop is one implicit Euler step whose set-valued law is solved by block principal pivoting, with one
    /// factorization per pivot; a short substep where joints are fast. In scenes with contacts (see SceneBuilder.contact) each step ends with impulses that meet their law, and
    /// approaches faster than what gravity gives in a step rebound by Poisson's law; O(N + m^2 depth + m^3) for m rows of contacts that touch.
    ///
    /// Examples
    /// --------
    /// >>> import phipsi
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> path = scene.simulate([0.3, 0.2, 0.1], [0.0] * 3, dt=1e-3, steps=1000, record_every=100)
    /// >>> path.q.shape, path.integrator
    /// ((11, 3), 'rk4')
    #[pyo3(signature = (q, qd, *, dt=None, steps=None, tau=None, tau_steps=None, method=None, record_every=None, pd=None,
                        armature=None, damping=None, stiffness=None, rest=None, friction=None, friction_speed=None, form="auto", tolerance=None,
                        progress=None, conserve_momentum=false, baumgarte=None, compliance=None, limits=None, restitution=0.0, accuracy=None, duration=None, covariance=None),
           text_signature = "($self, q, qd, *, dt=None, steps=None, tau=None, tau_steps=None, method='auto', record_every=1, \
                             pd=None, armature=None, damping=None, stiffness=None, rest=None, friction=None, friction_speed=None, \
                             form='auto', tolerance=None, progress=None, conserve_momentum=False, baumgarte=None, compliance=None, limits=None, \
                             restitution=0.0, accuracy=None, duration=None, covariance=None)")]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn simulate<'py>(
        slf: &Bound<'py, Self>,
        q: &Object<'py>,
        qd: &Object<'py>,
        dt: Option<f64>,
        steps: Option<&Object<'py>>,
        tau: Option<&Object<'py>>,
        tau_steps: Option<&Object<'py>>,
        method: Option<&str>,
        record_every: Option<&Object<'py>>,
        pd: Option<&Object<'py>>,
        armature: Option<&Object<'py>>,
        damping: Option<&Object<'py>>,
        stiffness: Option<&Object<'py>>,
        rest: Option<&Object<'py>>,
        friction: Option<&Object<'py>>,
        friction_speed: Option<f64>,
        form: &str,
        tolerance: Option<f64>,
        progress: Option<&Object<'py>>,
        conserve_momentum: bool,
        baumgarte: Option<f64>,
        compliance: Option<&Object<'py>>,
        limits: Option<&str>,
        restitution: f64,
        accuracy: Option<f64>,
        duration: Option<f64>,
        covariance: Option<&Object<'py>>,
    ) -> PyResult<Object<'py>> {
        let (py, own) = (slf.py(), slf.get());
        let scene = &own.scene;
        let (nq, nv) = (scene.tree().nq(), scene.tree().nv());
        let (dt, steps) = length_of_run(dt, steps, duration, accuracy.is_some())?;
        let every = count_or("record_every", record_every, 1, 1)?;
        let keywords = Keywords {
            dt,
            method,
            pd,
            armature,
            damping,
            stiffness,
            rest,
            friction,
            friction_speed,
            form,
            tolerance,
            conserve_momentum,
            baumgarte,
            compliance,
            limits,
            restitution,
            accuracy,
        };
        let (mut settings, pd) = keywords.read(own)?;
        let q = own.on_tree(py, own.configuration("q", q)?, Coupling::configuration)?;
        let qd = own.on_tree(py, own.rate("qd", qd)?, Coupling::rates)?;
        let given = Given::read(tau, tau_steps, steps, own)?;
        let mut axes = vec![("q", q.leading()), ("qd", qd.leading())];
        axes.extend(given.leading());
        axes.extend(pd.iter().flat_map(Pd::leading));
        let batch = broadcast_axes(axes)?;
        let room = Room {
            states: entries(&batch),
            rows: steps / every + 1,
            numbers: nq + nv + OF_CONTACT * scene.contacts().len(),
        };
        let states = room.checked()?;
        own.check_scratch(states)?;
        if let Some(pd) = pd {
            settings.gains = Some(pd.over(&batch, states)?);
        }
        let of_contacts = OF_CONTACT * scene.contacts().len();
        let outputs = [nq, nv, of_contacts].map(|width| room.output(py, &batch, width));
        let [all_q, all_qd] = [everyone(&q, &batch, states)?, everyone(&qd, &batch, states)?];
        let fields = about(slf, &settings)?;
        fields.set_item("record_every", every)?;
        fields.set_item("given", keywords.given(py, (tau, tau_steps))?)?;
        let rollout = detached(py, || Rollout::new(scene, settings, &all_q[..], &all_qd[..]))?;
        let mut rollout = rollout.map_err(|error| of_batch(py, &error, &batch))?;
        warn_of_limits(py, rollout.limit_warning(0..rollout.states()))?;
        drop((all_q, all_qd));
        if conserve_momentum {
            let torque = given.torque(&batch, (steps, nv))?;
            rollout.check_torque(&torque, steps).map_err(|error| fault(py, error, &batch))?;
        }
        let [out_q, out_qd, out_contacts] = outputs;
        let (mut out_q, mut out_qd, mut out_contacts) = (out_q?, out_qd?, out_contacts?);
        let mut records =
            Records { q: out_q.numbers()?, qd: out_qd.numbers()?, contacts: out_contacts.numbers()?, every };
        let plan = Plan { given: &given, batch: &batch, steps, dt, progress, nv, own };
        let stopped = run(py, &mut rollout, &mut records, &plan).err();
        own.warn_of_linkage(py)?;
        fields.set_item("steps", rollout.steps())?;
        let (impacts, made) =
            (rollout.take_impacts(), (rollout.chosen_method(), &rollout.settings(), rollout.has_stops()));
        set_outcome(&fields, &batch, own, made, |state| rollout.tally(state), &impacts)?;
        if conserve_momentum {
            let largest = largest_corrections(py, &batch, |state| rollout.correction(state))?;
            fields.set_item("momentum_correction", largest)?;
        }
        if of_contacts > 0 {
            let told = reports(py, &batch, |state| rollout.contact_report(state))?;
            fields.set_item("contacts", contact_motion(slf, out_contacts.finish().into_any(), told)?)?;
        }
        let last = |of: &dyn Fn(usize) -> Vec<f64>, width: usize, rates: bool| -> PyResult<Object<'py>> {
            let values: Vec<f64> = (0..states).flat_map(of).collect();
            own.of_scene(from_numbers(py, &values, &[&batch[..], &[width]].concat())?, rates)
        };
        let ends =
            (last(&|i| rollout.state(i).0.to_vec(), nq, false)?, last(&|i| rollout.state(i).1.to_vec(), nv, true)?);
        fields.set_item("end", ends)?;
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
}

#[pymethods]
impl PyScene {
    /// The equations of motion for SciPy's solve_ivp: right side and Jacobian in tangent coordinates, and a solver with error control
    /// on the manifold.
    ///
    /// tau: (nv,), constant, or a function of (t, q, qd), which is asked at every stage. pd, damping, stiffness, rest, friction:
    /// as in simulate; friction_speed: positive, rad/s or m/s, for the solvers need smooth friction. Returns an Ode; Ode.solve(q, qd, t_span, method=..., rtol=..., atol=...) gives a Trajectory.
    ///
    /// Raises ImportError without SciPy; ShapeError, NotFiniteError, ArgumentError.
    #[pyo3(signature = (**given),
           text_signature = "($self, *, tau=None, pd=None, damping=None, stiffness=None, rest=None, friction=None, friction_speed=0.01)")]
    fn ode<'py>(slf: &Bound<'py, Self>, given: Option<&Bound<'py, PyDict>>) -> PyResult<Object<'py>> {
        slf.get().scene.check_no_contacts("ode")?;
        imported!(slf.py(), "phipsi._ode", "Ode")?.call((slf,), given)
    }
}

/// The step and the number of steps: `steps`, or `duration` over the step; with error control, rows every thousandth of the duration.
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
        return Err(Error::argument("duration", format!("{duration}"), "a time in s, finite and positive").into());
    }
    let dt = match (dt, duration) {
        (Some(dt), _) => dt,
        (None, Some(duration)) if controlled => duration / ROWS,
        _ => {
            return Err(
                Error::argument("dt", "None", "a step in s; it may be left out with accuracy and duration").into()
            );
        }
    };
    match (steps, duration) {
        (Some(steps), None) => Ok((dt, count("steps", steps, 0)?)),
        (None, Some(duration)) => {
            let found = (duration / dt).round();
            if !((1.0..1e15).contains(&found)) || !((found * dt - duration).abs() <= 1e-6 * duration) {
                let expected = "a multiple of dt; or steps";
                return Err(Error::argument("duration", format!("{duration} with dt {dt}"), expected).into());
            }
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // in these bounds
            Ok((dt, found as usize))
        }
        (None, None) => Err(Error::argument("steps", "None", "a number of steps, or duration").into()),
        (Some(_), Some(_)) => Err(Error::argument("duration", "steps as well", "one of the two").into()),
    }
}

/// What is to be recorded.
pub(super) struct Room {
    pub states: Option<usize>,
    pub rows: usize,
    pub numbers: usize,
}

impl Room {
    /// The number of states, if there is room for what they record, for where they are, and for where they began.
    pub fn checked(&self) -> Result<usize, Error> {
        let Some(states) = self.states else {
            return Err(Error::argument("batch", "more states than memory has addresses", "fewer"));
        };
        let numbers = self.numbers.max(1);
        let rows = memory::bytes_of::<f64>(&[states, self.rows, numbers]);
        let at_once = memory::bytes_of::<f64>(&[states, numbers, 3]);
        let asking = if self.rows > 3 { "steps" } else { "q, qd" };
        memory::room(asking, rows.saturating_add(at_once)).map_err(|mut error| {
            if let Error::Memory { shortage, .. } = &mut error {
                shortage.what = format!("{} rows of {} numbers for {states} states", self.rows, self.numbers);
            }
            error
        })?;
        Ok(states)
    }

    fn output<'py>(&self, py: Python<'py>, batch: &[usize], width: usize) -> PyResult<Output<'py>> {
        asked_by(py, "steps", Output::new(py, &[batch, &[self.rows, width]].concat()))
    }
}

/// What a run follows.
struct Plan<'a, 'py> {
    given: &'a Given<'py>,
    batch: &'a [usize],
    steps: usize,
    dt: f64,
    progress: Option<&'a Object<'py>>,
    nv: usize,
    own: &'a PyScene,
}

/// All steps, in blocks of about the time between two reports; signals are looked at after each, and within those that take longer.
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
        py.check_signals()?;
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

/// So many steps, without the GIL.
fn advanced(
    py: Python<'_>,
    rollout: &mut Rollout<&Scene>,
    steps: usize,
    torque: &Torque<'_>,
    records: &mut Records<'_>,
) -> Result<(), Stopped> {
    detached(py, || rollout.advance(steps, torque, Some(records)))?.map_err(Stopped::Fault)
}

/// The torques that the caller's function gives for the states as they are.
fn asked<'py>(tau: &Object<'py>, rollout: &Rollout<&Scene>, plan: &Plan<'_, 'py>) -> PyResult<Input<'py>> {
    let py = tau.py();
    let states = rollout.states();
    let (nq, nv) = (plan.own.scene.nq(), plan.own.scene.nv());
    let mut q = memory::with_capacity("q", states * nq)?;
    let mut qd = memory::with_capacity("qd", states * nv)?;
    for state in 0..rollout.states() {
        let (own_q, own_qd) = rollout.state(state);
        q.extend_from_slice(&plan.own.coordinates_of_scene(own_q));
        qd.extend_from_slice(&plan.own.rates_of_scene(own_qd));
    }
    let shape = |width: usize| [plan.batch, &[width]].concat();
    #[allow(clippy::cast_precision_loss)] // a time
    let t = rollout.steps() as f64 * plan.dt;
    let value = tau.call1((t, from_numbers(py, &q, &shape(nq))?, from_numbers(py, &qd, &shape(nv))?))?;
    let tau = Input::new("tau(t, q, qd)", &value, plan.own.rates())?;
    check_finite("tau(t, q, qd)", tau.data()?)?;
    plan.own.on_tree(py, tau, Coupling::torques)
}
