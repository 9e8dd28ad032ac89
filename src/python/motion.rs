//! Methods of `Scene`: states through time.

use super::axis::Axis;
use super::choice::read_form;
use super::counts::{count, count_or};
use super::errors::{asked_by, batch_index, fault, of_batch};
use super::input::{self, Input, wrong_shape};
use super::interrupts::detached;
use super::output::{Output, from_numbers};
use super::scene::PyScene;
use crate::batch::{Broadcast, Fault, broadcast_axes};
use crate::error::{Error, check_finite};
use crate::memory;
use crate::motion::properties::FRICTION_SPEED;
use crate::motion::{Gains, Method, Properties, Records, Rollout, Settings, StepFault, Torque};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::time::{Duration, Instant};

/// Between reports of progress.
const BLOCK: Duration = Duration::from_millis(50);

#[pymethods]
impl PyScene {
    /// Viscous damping of each degree of freedom, (nv,), N m s/rad or N s/m; a copy. Simulation only.
    #[getter]
    fn damping<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        from_numbers(py, &Properties::of(&self.scene).damping, &[self.scene.nv()])
    }

    /// Coulomb friction of each degree of freedom, (nv,), N m or N; a copy. Simulation only.
    #[getter]
    fn friction<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        from_numbers(py, &Properties::of(&self.scene).friction, &[self.scene.nv()])
    }

    /// Stiffness of each degree of freedom's spring, (nv,), N m/rad or N/m; a copy. Simulation only.
    #[getter]
    fn stiffness<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        from_numbers(py, &Properties::of(&self.scene).stiffness, &[self.scene.nv()])
    }

    /// The configuration where the springs are at rest, (nq,); a copy.
    #[getter]
    fn rest<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        from_numbers(py, &Properties::of(&self.scene).rest, &[self.scene.nq()])
    }

    /// Advances states in time: fixed steps, whole batches, springs and damping implicitly where the method says so.
    ///
    /// With d damping, f friction, k stiffness, v0 friction_speed, differences on the manifold,
    ///
    ///     M(q) dv/dt + bias(q, v) = tau - d v - f v / sqrt(v^2 + v0^2) - k (q - rest) + kp (target - q) + kd (target_rate - v)
    ///
    /// and dq/dt = v on the manifold: quaternions stay unit, free joints move on SE(3).
    ///
    /// q: (..., nq); qd: (..., nv); leading axes broadcast. dt: s, finite and positive. steps: how many.
    /// tau: (..., nv), constant, or a function of (t, q, qd) that is called once a step with the whole batch and returns
    /// (..., nv); tau_steps: (..., steps, nv) instead. Either is held over each step, so that a function is followed to first
    /// order in dt by every method. pd: PD(kp, kd, target, target_rate), followed within the step.
    /// method: "semi-implicit-euler" (order 1), "rk4" (order 4), "implicit-euler" (order 1), "rosenbrock-2" (order 2) or "rosenbrock-3" (order 3).
    /// The last three take springs, damping, friction and pd implicitly, as measurement noise r + h d + h^2 k, at the cost of an explicit
    /// stage each; they are L-stable for them: what is faster than the step is damped, not followed. record_every: a row
    /// after so many steps. armature, damping, stiffness, friction: (nv,) or a number, rest: (nq,), instead of the
    /// scene's. friction_speed: rad/s or m/s, where friction becomes viscous. form: "auto" does a step whose digits are in
    /// doubt once more in square-root form; "covariance" watches the pivots only. progress: called with (steps done, steps)
    /// some twenty times a second at the most. conserve_momentum: each floating tree keeps its momentum, and its mass centre the
    /// parabola that weight gives it, to rounding: a step ends with a rigid motion of the tree, as large as the step's error in
    /// them, which leaves the order as it is and costs O(N). Every tree must hang on the base by a free joint that nothing acts
    /// along: no tau, pd, damping, stiffness, friction or armature there (ArgumentError).
    ///
    /// Returns a Trajectory: t (rows,), q (..., rows, nq), qd (..., rows, nv), rows = steps // record_every + 1, the first
    /// the start; momentum_correction, the largest that conserve_momentum made, else None. The same bits for any number of threads.
    ///
    /// Raises SimulationError where motion diverges, a pivot is lost, or tau raises, with the rows of the finished
    /// steps; SimulationInterrupted (a KeyboardInterrupt) on Ctrl-C, likewise; OutOfMemoryError where the rows have no room;
    /// ShapeError, NotFiniteError, ArgumentError, each naming the argument and the state.
    #[pyo3(signature = (q, qd, *, dt, steps, tau=None, tau_steps=None, method="semi-implicit-euler", record_every=None, pd=None,
                        armature=None, damping=None, stiffness=None, rest=None, friction=None, friction_speed=FRICTION_SPEED, form="auto",
                        progress=None, conserve_momentum=false),
           text_signature = "($self, q, qd, *, dt, steps, tau=None, tau_steps=None, method='semi-implicit-euler', record_every=1, \
                             pd=None, armature=None, damping=None, stiffness=None, rest=None, friction=None, friction_speed=0.01, \
                             form='auto', progress=None, conserve_momentum=False)")]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn simulate<'py>(
        slf: &Bound<'py, Self>,
        q: &Bound<'py, PyAny>,
        qd: &Bound<'py, PyAny>,
        dt: f64,
        steps: &Bound<'py, PyAny>,
        tau: Option<&Bound<'py, PyAny>>,
        tau_steps: Option<&Bound<'py, PyAny>>,
        method: &str,
        record_every: Option<&Bound<'py, PyAny>>,
        pd: Option<&Bound<'py, PyAny>>,
        armature: Option<&Bound<'py, PyAny>>,
        damping: Option<&Bound<'py, PyAny>>,
        stiffness: Option<&Bound<'py, PyAny>>,
        rest: Option<&Bound<'py, PyAny>>,
        friction: Option<&Bound<'py, PyAny>>,
        friction_speed: f64,
        form: &str,
        progress: Option<&Bound<'py, PyAny>>,
        conserve_momentum: bool,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (py, own) = (slf.py(), slf.get());
        let scene = &own.scene;
        let (nq, nv) = (scene.nq(), scene.nv());
        let steps = count("steps", steps, 0)?;
        let every = count_or("record_every", record_every, 1, 1)?;
        let mut settings = Settings::new(scene, dt);
        settings.method = Method::named(method)?;
        settings.conserve_momentum = conserve_momentum;
        settings.form = read_form(form)?;
        let properties = &mut settings.properties;
        for (name, given, place) in [
            ("armature", armature, &mut properties.armature),
            ("damping", damping, &mut properties.damping),
            ("stiffness", stiffness, &mut properties.stiffness),
            ("friction", friction, &mut properties.friction),
        ] {
            if let Some(given) = given {
                *place = input::spread(name, given, own.rates())?;
            }
        }
        if let Some(rest) = rest {
            properties.rest = input::state("rest", rest, own.coordinates())?;
        }
        properties.friction_speed = friction_speed;

        let [q, qd] = [own.configuration("q", q)?, own.rate("qd", qd)?];
        let given = Given::read(tau, tau_steps, steps, own.rates())?;
        let pd = pd.map(|pd| Pd::read(pd, own)).transpose()?;
        let mut axes = vec![("q", q.leading()), ("qd", qd.leading())];
        axes.extend(given.leading());
        if let Some(pd) = &pd {
            axes.extend([("pd.target", pd.target.leading()), ("pd.target_rate", pd.rate.leading())]);
        }
        let batch = broadcast_axes(axes)?;
        let room = Room { states: product(&batch), rows: steps / every + 1, numbers: nq + nv };
        let states = room.checked()?;
        own.check_scratch(states)?;
        if let Some(pd) = pd {
            settings.gains = Some(pd.over(&batch, states)?);
        }
        let outputs = [room.output(py, &batch, nq)?, room.output(py, &batch, nv)?];
        let [all_q, all_qd] = [everyone(&q, &batch, states)?, everyone(&qd, &batch, states)?];
        let fields = PyDict::new(py);
        fields.set_item("scene", slf)?;
        fields.set_item("dt", dt)?;
        fields.set_item("record_every", every)?;
        fields.set_item("method", settings.method.name())?;
        let Properties { armature, stiffness, rest, .. } = &settings.properties;
        for (name, numbers) in [("armature", armature), ("stiffness", stiffness), ("rest", rest)] {
            fields.set_item(name, from_numbers(py, numbers, &[numbers.len()])?)?;
        }
        let rollout = detached(py, || Rollout::new(scene, settings, &all_q[..], &all_qd[..]))?;
        let mut rollout = rollout.map_err(|error| of_batch(py, &error, &batch))?;
        drop((all_q, all_qd));
        if conserve_momentum {
            let torque = given.torque(&batch, (steps, nv))?;
            rollout.check_torque(&torque, steps).map_err(|error| fault(py, error, &batch))?;
        }
        let [mut out_q, mut out_qd] = outputs;
        let mut records = Records { q: out_q.numbers()?, qd: out_qd.numbers()?, every };
        let plan = Plan { given: &given, batch: &batch, steps, dt, progress, nq, nv, rates: own.rates() };
        let stopped = run(py, &mut rollout, &mut records, &plan).err();
        fields.set_item("steps", rollout.steps())?;
        if conserve_momentum {
            let each = || (0..states).filter_map(|state| rollout.correction(state));
            let velocity: Vec<f64> = each().map(|largest| largest.velocity).collect();
            let position: Vec<f64> = each().map(|largest| largest.position).collect();
            let largest = (from_numbers(py, &velocity, &batch)?, from_numbers(py, &position, &batch)?);
            let largest = py.import("phipsi._motion")?.getattr("MomentumCorrection")?.call1(largest)?;
            fields.set_item("momentum_correction", largest)?;
        }
        let whole = (out_q.finish(), out_qd.finish());
        let trajectory = py.import("phipsi._motion")?.getattr("trajectory_of")?.call(whole, Some(&fields))?;
        match stopped {
            None => Ok(trajectory),
            Some(stopped) => Err(stopped.raise(py, &trajectory, &batch)?),
        }
    }
}

#[pymethods]
impl PyScene {
    /// The equations of motion for SciPy's solve_ivp: right side and Jacobian in tangent coordinates, and a solver with error control
    /// on the manifold.
    ///
    /// tau: (nv,), constant, or a function of (t, q, qd), which is asked at every stage. pd, damping, stiffness, rest, friction,
    /// friction_speed: as in simulate. Returns an Ode; Ode.solve(q, qd, t_span, method=..., rtol=..., atol=...) gives a Trajectory.
    ///
    /// Raises ImportError without SciPy; ShapeError, NotFiniteError, ArgumentError.
    #[pyo3(signature = (**given),
           text_signature = "($self, *, tau=None, pd=None, damping=None, stiffness=None, rest=None, friction=None, friction_speed=0.01)")]
    fn ode<'py>(slf: &Bound<'py, Self>, given: Option<&Bound<'py, PyDict>>) -> PyResult<Bound<'py, PyAny>> {
        slf.py().import("phipsi._ode")?.getattr("Ode")?.call((slf,), given)
    }
}

fn product(axes: &[usize]) -> Option<usize> {
    axes.iter().try_fold(1, |product: usize, &length| product.checked_mul(length))
}

/// What is to be recorded.
struct Room {
    states: Option<usize>,
    rows: usize,
    numbers: usize,
}

impl Room {
    /// The number of states, if there is room for what they record, for where they are, and for where they began.
    fn checked(&self) -> Result<usize, Error> {
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

/// The numbers of every state of the batch, one after another.
fn everyone(input: &Input<'_>, batch: &[usize], states: usize) -> PyResult<Vec<f64>> {
    let own = input.over(batch)?;
    let width = if states == 0 { 0 } else { own.state(0).len() };
    let mut all = memory::with_capacity(&input.name, states.saturating_mul(width))?;
    for state in 0..states {
        all.extend_from_slice(own.state(state));
    }
    Ok(all)
}

/// The torques of a call, as given.
enum Given<'py> {
    Nothing,
    Constant(Input<'py>),
    Steps(Input<'py>),
    Function(Bound<'py, PyAny>),
}

impl<'py> Given<'py> {
    fn read(
        tau: Option<&Bound<'py, PyAny>>,
        tau_steps: Option<&Bound<'py, PyAny>>,
        steps: usize,
        rates: Axis<'_>,
    ) -> PyResult<Self> {
        match (tau, tau_steps) {
            (None, None) => Ok(Self::Nothing),
            (Some(_), Some(_)) => Err(Error::argument("tau_steps", "tau as well", "one of the two").into()),
            (Some(tau), None) if tau.is_callable() => Ok(Self::Function(tau.clone())),
            (Some(tau), None) => {
                let tau = Input::new("tau", tau, rates)?;
                check_finite("tau", tau.data()?)?;
                Ok(Self::Constant(tau))
            }
            (None, Some(tau)) => {
                let tau = Input::new("tau_steps", tau, rates)?;
                if tau.leading().last() != Some(&steps) {
                    let found = [tau.leading(), &[rates.width()]].concat();
                    return Err(wrong_shape("tau_steps", &found, format!("(..., {steps}, {})", rates.width())));
                }
                check_finite("tau_steps", tau.data()?)?;
                Ok(Self::Steps(tau))
            }
        }
    }

    /// The leading axes that the batch must have.
    fn leading(&self) -> Option<(&'static str, &[usize])> {
        match self {
            Self::Nothing | Self::Function(_) => None,
            Self::Constant(tau) => Some(("tau", tau.leading())),
            Self::Steps(tau) => {
                let axes = tau.leading();
                Some(("tau_steps", &axes[..axes.len() - 1]))
            }
        }
    }

    /// The torques of all steps; none where a function gives them.
    fn torque<'a>(&'a self, batch: &[usize], (steps, nv): (usize, usize)) -> PyResult<Torque<'a>> {
        Ok(match self {
            Self::Constant(tau) => Torque::Constant(tau.over(batch)?),
            Self::Steps(tau) => {
                let axes = tau.leading();
                let torque = Broadcast::new("tau_steps", tau.data()?, steps * nv, &axes[..axes.len() - 1], batch);
                Torque::Steps { torque: torque.map_err(PyErr::from)?, first: 0 }
            }
            Self::Nothing | Self::Function(_) => Torque::Zero,
        })
    }
}

/// The control law of a call, as given.
struct Pd<'py> {
    gains: [Vec<f64>; 2],
    target: Input<'py>,
    rate: Input<'py>,
}

impl<'py> Pd<'py> {
    fn read(pd: &Bound<'py, PyAny>, scene: &PyScene) -> PyResult<Self> {
        let expected = "PD(kp, kd, target) or PD(kp, kd, target, target_rate)";
        let refuse = |found: String| PyErr::from(Error::argument("pd", found, expected));
        let Ok(parts) = pd.cast::<PyTuple>() else {
            return Err(refuse(format!("an object of type {}", pd.get_type().name()?)));
        };
        if !(3..=4).contains(&parts.len()) {
            return Err(refuse(format!("{} parts", parts.len())));
        }
        let rate = match parts.get_item(3) {
            Ok(rate) if !rate.is_none() => scene.rate("pd.target_rate", &rate)?,
            _ => Input::filled(pd.py(), "pd.target_rate", 0.0, scene.scene.nv())?,
        };
        Ok(Self {
            gains: [
                input::spread("pd.kp", &parts.get_item(0)?, scene.rates())?,
                input::spread("pd.kd", &parts.get_item(1)?, scene.rates())?,
            ],
            target: scene.configuration("pd.target", &parts.get_item(2)?)?,
            rate,
        })
    }

    fn over(self, batch: &[usize], states: usize) -> PyResult<Gains> {
        let each = |input: &Input<'_>| {
            if input.leading().is_empty() {
                Ok(memory::copied(&input.name, input.data()?)?)
            } else {
                everyone(input, batch, states)
            }
        };
        let (target, target_rate) = (each(&self.target)?, each(&self.rate)?);
        let [proportional, derivative] = self.gains;
        Ok(Gains { proportional, derivative, target, target_rate })
    }
}

/// Why a run ended early.
enum Stopped {
    Fault(StepFault),
    Raised(PyErr),
}

impl From<PyErr> for Stopped {
    fn from(error: PyErr) -> Self {
        Self::Raised(error)
    }
}

impl Stopped {
    /// The exception, with what was computed.
    fn raise(self, py: Python<'_>, trajectory: &Bound<'_, PyAny>, batch: &[usize]) -> PyResult<PyErr> {
        let (cause, joint, state) = match self {
            Self::Raised(error) => (error, None, None),
            Self::Fault(StepFault { state, joint, error, .. }) => {
                let index = (!batch.is_empty()).then(|| batch_index(py, state, batch)).transpose()?;
                (fault(py, Fault { state, error }, batch), Some(joint), index)
            }
        };
        let made = py.import("phipsi._motion")?.getattr("stopped")?.call1((trajectory, cause.value(py), joint, state))?;
        Ok(PyErr::from_value(made))
    }
}

/// What a run follows.
struct Plan<'a, 'py> {
    given: &'a Given<'py>,
    batch: &'a [usize],
    steps: usize,
    dt: f64,
    progress: Option<&'a Bound<'py, PyAny>>,
    nq: usize,
    nv: usize,
    rates: Axis<'a>,
}

/// All steps, in blocks of about the time between two reports; signals are looked at after each, and within those that take longer.
fn run<'py>(
    py: Python<'py>,
    rollout: &mut Rollout<'_>,
    records: &mut Records<'_>,
    plan: &Plan<'_, 'py>,
) -> Result<(), Stopped> {
    let constant = plan.given.torque(plan.batch, (plan.steps, plan.nv))?;
    if plan.steps == 0 {
        return advanced(py, rollout, 0, &constant, records);
    }
    // Doubled or halved until a block takes as long as it should: where steps are cut changes nothing in them.
    let mut block = 1_usize;
    let mut reported = Instant::now();
    while rollout.steps() < plan.steps {
        let count = block.min(plan.steps - rollout.steps());
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
            let elapsed = began.elapsed();
            if elapsed < BLOCK / 2 {
                block = block.saturating_mul(2);
            } else if elapsed > BLOCK {
                block = (block / 2).max(1);
            }
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
    rollout: &mut Rollout<'_>,
    steps: usize,
    torque: &Torque<'_>,
    records: &mut Records<'_>,
) -> Result<(), Stopped> {
    detached(py, || rollout.advance(steps, torque, Some(records)))?.map_err(Stopped::Fault)
}

/// The torques that the caller's function gives for the states as they are.
fn asked<'py>(tau: &Bound<'py, PyAny>, rollout: &Rollout<'_>, plan: &Plan<'_, 'py>) -> PyResult<Input<'py>> {
    let py = tau.py();
    let states = rollout.states();
    let mut q = memory::with_capacity("q", states * plan.nq)?;
    let mut qd = memory::with_capacity("qd", states * plan.nv)?;
    for state in 0..rollout.states() {
        let (own_q, own_qd) = rollout.state(state);
        q.extend_from_slice(own_q);
        qd.extend_from_slice(own_qd);
    }
    let shape = |width: usize| [plan.batch, &[width]].concat();
    #[allow(clippy::cast_precision_loss)] // a time
    let t = rollout.steps() as f64 * plan.dt;
    let value = tau.call1((t, from_numbers(py, &q, &shape(plan.nq))?, from_numbers(py, &qd, &shape(plan.nv))?))?;
    let tau = Input::new("tau(t, q, qd)", &value, plan.rates)?;
    check_finite("tau(t, q, qd)", tau.data()?)?;
    Ok(tau)
}
