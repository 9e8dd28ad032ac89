//! The class `Simulator`: states that are advanced call by call, with their own workspaces.

use super::contacts::{OF_CONTACT, contact_motion, reports};
use super::control::{Pd, everyone};
use super::cost::WORTH_RELEASING;
use super::counts::count;
use super::errors::{fault, of_batch, refuse};
use super::fresh::states_of;
use super::input::{Input, plain};
use super::interrupts::detached;
use super::motion::{Room, without_control};
use super::object::{Object, imported};
use super::output::{Names, Output, from_numbers};
use super::own_models;
use super::scene::PyScene;
use super::stepping::{
    Allowed, Blocks, Keywords, Stopped, about, set_outcome, stop_impacts, warn_of_limits, warn_of_start,
};
use super::threads::free;
use super::wrenches::LinkWrenches;
use crate::batch::{Broadcast, broadcast_axes};
use crate::error::{Error, check_finite};
use crate::memory;
use crate::motion::{Method, Rollout, ShapeContact, Simulator, Torque};
use crate::scene::{Coupling, Scene};
use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyTuple};
use std::borrow::Borrow;
use std::sync::{Mutex, MutexGuard};
use std::time::Instant;

/// Number of steps, as given.
#[derive(Clone, Copy)]
struct Steps(usize);

const ONE: Steps = Steps(1);

impl<'py> FromPyObject<'_, 'py> for Steps {
    type Error = PyErr;

    fn extract(given: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        count("steps", &given, 0).map(Self)
    }
}

/// The scene of a simulator or observer, as a reference to its Python object.
pub(super) struct Held(pub(super) Py<PyScene>);

impl Borrow<Scene> for Held {
    fn borrow(&self) -> &Scene {
        &self.0.get().scene
    }
}

/// States that are advanced by calls of step, for controllers, learning and real-time loops.
///
/// Create it with Scene.simulator. The batch has the axes to which q, qd and the targets of pd broadcast; large
/// batches are vectorized and run on threads. Results are bit-identical to those of Scene.simulate, for any
/// division of the steps into calls and any batch. Intermediate results are preallocated.
///
/// During a call, other calls on the same simulator raise ArgumentError. Copies and pickles are independent
/// simulators at the same state.
#[doc = section!(Examples)]
/// >>> simulator = phipsi.scenes.chain(3).simulator([0.3, 0.2, 0.1], [1.0, 0.0, 0.0], dt=1e-3)
/// >>> for step in range(10):
/// ...     simulator.step(tau=-0.1 * simulator.qd)
/// >>> np.allclose(simulator.t, 0.01)
/// True
#[pyclass(frozen, name = "Simulator", module = "phipsi")]
pub(crate) struct PySimulator {
    pub(super) scene: Py<PyScene>,
    pub(super) batch: Vec<usize>,
    dt: f64,
    method: Method,
    /// The actuators with their controls and activations (phipsi._actuators.Drive), if the simulator has controls.
    pub(super) drive: Option<Py<PyAny>>,
    /// The lock never blocks: a call that finds it taken raises.
    moving: Mutex<Simulator<Held>>,
}

#[pymethods]
impl PyScene {
    #[doc = signature!("simulator", "q, qd=None, *, dt", method joints form compliance stops accuracy smoothing effort
                       contacts; ", control=None, activation=None")]
    /// Create a Simulator: one state or a batch that is advanced call by call.
    #[doc = section!(Parameters)]
    /// q : (..., nq) array_like
    ///     Joint positions at the start, rad or m.
    /// qd : (..., nv) array_like, optional
    ///     Joint velocities at the start, rad/s or m/s; zero by default.
    /// dt : float
    ///     Step, s.
    #[doc = names_of_keywords!(method joints form)]
    ///     As in simulate, for all steps.
    #[doc = names_of_keywords!(compliance stops accuracy smoothing effort contacts)]
    ///     As in simulate, for all steps. The targets of pd can be changed by step.
    /// control : (..., n) array_like or dict of str to float, optional
    ///     Controls of scene.actuators, which then act in all steps; step(control=...) changes them.
    /// activation : (..., n) array_like or dict, optional
    ///     Activations of the actuators at the start; None: zero.
    #[doc = section!(Returns)]
    /// simulator : Simulator
    ///     step(tau) costs one forward dynamics per stage and some tenths of a microsecond.
    #[doc = raises!(memory arguments)]
    #[doc = section!(Examples)]
    /// >>> simulator = phipsi.scenes.chain(3).simulator([0.3, 0.2, 0.1], [1.0, 0.0, 0.0], dt=1e-3)
    /// >>> simulator.step(steps=100)
    /// >>> simulator.q.round(3)
    /// array([0.4, 0.2, 0.1])
    #[pyo3(signature = (q, qd=None, *, dt, control=None, activation=None, **given),
           text_signature = None)]
    fn simulator<'py>(
        slf: &Bound<'py, Self>,
        q: &Object<'py>,
        qd: Option<&Object<'py>>,
        dt: Option<f64>,
        control: Option<&Object<'py>>,
        activation: Option<&Object<'py>>,
        given: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<PySimulator> {
        let (py, own) = (slf.py(), slf.get());
        let none = PyDict::new(py);
        let given = given.unwrap_or(&none);
        let drive = match control {
            Some(control) => {
                let drive =
                    imported!(py, "phipsi._actuators", "Drive")?.call1((slf, control, activation, dt, given))?;
                given.update(drive.call_method0("keywords")?.cast::<PyMapping>()?)?;
                Some(drive)
            }
            None if activation.is_some() => return Err(without_control().into()),
            None => None,
        };
        let keywords = Keywords::take(py, "Scene.simulator", Some(given), Allowed { accuracy: true, steps: false })?;
        let dt = dt.ok_or_else(|| Error::argument("dt", "None", "a step in s, finite and positive"))?;
        let (mut settings, pd, of_states) = keywords.read(py, own, (dt, 0))?;
        keywords.warn_of_units(py, dt)?;
        keywords.warn_of_friction(py, own, &settings)?;
        let [q, qd] = own.state_of_tree(py, q, qd)?;
        let mut axes = vec![("q", q.leading()), ("qd", qd.leading())];
        axes.extend(pd.iter().flat_map(Pd::leading));
        axes.extend(own_models::leading(&of_states));
        let batch = broadcast_axes(axes)?;
        let numbers = own.scene.tree().nq() + own.scene.tree().nv();
        let states = states_of(&batch)?;
        Room { states, rows: 1, numbers }.checked()?;
        own.check_scratch(states)?;
        settings.gains = pd.map(|pd| pd.over(&batch, states)).transpose()?;
        own_models::fill(&of_states, &mut settings.properties, &batch, states)?;
        let [all_q, all_qd] = [everyone(&q, &batch, states)?, everyone(&qd, &batch, states)?];
        let (scene, method) = (slf.clone().unbind(), settings.method);
        let held = Held(scene.clone_ref(py));
        let moving = detached(py, || Simulator::of(Rollout::of_states(held, settings, states, (&all_q, &all_qd))?))?;
        let moving = moving.map_err(|error| of_batch(py, &error, &batch))?;
        let all = 0..moving.states();
        warn_of_start(py, [moving.limit_warning(all.clone()), moving.contact_warning(all)])?;
        own.warn_of_linkage(py)?;
        if let Some(drive) = &drive {
            drive.call_method1("spread", (PyTuple::new(py, &batch)?,))?;
        }
        let (drive, moving) = (drive.map(Bound::unbind), Mutex::new(moving));
        Ok(PySimulator { scene, batch, dt, method, drive, moving })
    }
}

impl PyScene {
    /// Reads a state, with joint velocities or zero, and converts it to the tree.
    fn state_of_tree<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: Option<&Object<'py>>,
    ) -> PyResult<[Input<'py>; 2]> {
        let q = self.on_tree(py, self.configuration("q", q)?, Coupling::configuration)?;
        let qd = qd.map_or_else(|| Input::filled(py, "qd", 0.0, self.scene.nv()), |qd| self.rate("qd", qd))?;
        Ok([q, self.on_tree(py, qd, Coupling::rates)?])
    }
}

impl PySimulator {
    /// Locks the states for one call.
    pub(super) fn moving(&self) -> Result<MutexGuard<'_, Simulator<Held>>, Error> {
        let expected = "one call at a time; copy.copy(simulator) creates an independent one";
        free(&self.moving, "simulator", expected)
    }

    /// Configurations or joint velocities of all states, with the given axes after the batch.
    fn of_all<'py>(
        &self,
        py: Python<'py>,
        moving: &Simulator<Held>,
        between: &[usize],
        is_rate: bool,
    ) -> PyResult<Object<'py>> {
        let states = (0..moving.states()).map(|state| moving.state(state));
        self.scene.get().of_states(py, &[&self.batch[..], between].concat(), states, is_rate)
    }

    /// Advances all states; long runs release the GIL and check for signals between blocks.
    fn advance(&self, py: Python<'_>, torque: &Torque<'_>, steps: usize) -> PyResult<()> {
        let mut guard = self.moving()?;
        let moving = &mut *guard;
        let dropped = moving.dropped();
        moving.check_torque(torque, steps).map_err(|error| fault(py, error, &self.batch))?;
        let cost = moving.cost().saturating_mul(moving.states()).saturating_mul(steps);
        let outcome = if cost < WORTH_RELEASING {
            moving.step(torque, steps).map_err(Stopped::Fault)
        } else {
            in_blocks(py, moving, torque, steps)
        };
        let Err(stopped) = outcome else {
            let warning = (moving.dropped() > dropped).then(|| moving.dropped_warning());
            // The lock is released first, because a handler of warnings can call the simulator.
            drop(guard);
            warn_of_limits(py, warning)?;
            return self.scene.get().warn_of_linkage(py);
        };
        let now = self.now(py, moving)?;
        Err(stopped.raise(py, &now, &self.batch)?)
    }

    /// Changes the targets of the control law.
    fn aim<'py>(&self, py: Python<'py>, target: Option<&Object<'py>>, rate: Option<&Object<'py>>) -> PyResult<()> {
        let own = self.scene.get();
        let read = |name: &'static str, given: &Object<'py>, is_rate: bool| -> PyResult<Vec<f64>> {
            let input = if is_rate {
                own.on_tree(py, own.rate(name, given)?, Coupling::rates)?
            } else {
                own.on_tree(py, own.configuration(name, given)?, Coupling::configuration)?
            };
            if input.leading().is_empty() {
                return Ok(input.data()?.to_vec());
            }
            everyone(&input, &self.batch, self.batch.iter().product())
        };
        let target = target.map(|given| read("target", given, false)).transpose()?;
        let rate = rate.map(|given| read("target_rate", given, true)).transpose()?;
        self.moving()?.aim(target.as_deref(), rate.as_deref()).map_err(|error| of_batch(py, &error, &self.batch))
    }

    /// Sets the wrenches on links for the steps of this call; None removes those of the last one.
    fn push(&self, py: Python<'_>, wrenches: Option<&Object<'_>>, frame: Option<&str>) -> PyResult<()> {
        let given = LinkWrenches::read(&self.scene.get().scene, wrenches, frame, None)?;
        let mut moving = self.moving()?;
        if given.is_none() && !moving.is_pushed() {
            return Ok(());
        }
        let given = given.map(|given| given.over(&self.batch, moving.states())).transpose()?;
        moving.push(given).map_err(|error| of_batch(py, &error, &self.batch))
    }

    /// Current contacts of all states, with the given axes after the batch; None without contacts.
    fn contacts_now<'py>(
        &self,
        py: Python<'py>,
        moving: &Simulator<Held>,
        between: &[usize],
    ) -> PyResult<Option<Object<'py>>> {
        if !moving.scene().touches() {
            return Ok(None);
        }
        let width = OF_CONTACT * moving.scene().contacts().len();
        let all: Vec<f64> = (0..moving.states()).flat_map(|state| moving.contacts_now(state)).collect();
        moving.scene().check_result("contacts", &all)?;
        let rows = from_numbers(py, &all, &[&self.batch[..], between, &[width]].concat())?;
        let told = reports(py, &self.batch, |state| moving.contact_report(state))?;
        let shapes: Vec<ShapeContact> =
            moving.shape_contacts().into_iter().map(|of| ShapeContact { step: 0, ..of }).collect();
        contact_motion(self.scene.bind(py), (rows, told), (&shapes, 1)).map(Some)
    }

    /// Current states as a trajectory of one row.
    fn now<'py>(&self, py: Python<'py>, moving: &Simulator<Held>) -> PyResult<Object<'py>> {
        let fields = about(self.scene.bind(py), &moving.settings(), &self.batch)?;
        fields.set_item("steps", moving.steps())?;
        let made = (
            moving.chosen_method(),
            moving.friction_speed(),
            [moving.has_stops(), moving.settings().accuracy.is_some()],
        );
        set_outcome(&fields, &self.batch, self.scene.get(), made, |state| moving.totals(state), &[])?;
        if let Some(contacts) = self.contacts_now(py, moving, &[1])? {
            fields.set_item("contacts", contacts)?;
        }
        let rows = (self.of_all(py, moving, &[1], false)?, self.of_all(py, moving, &[1], true)?);
        imported!(py, "phipsi._motion", "only_now")?.call(rows, Some(&fields))
    }
}

/// Runs all steps in blocks of about the time between two checks for signals.
fn in_blocks(py: Python<'_>, moving: &mut Simulator<Held>, torque: &Torque<'_>, steps: usize) -> Result<(), Stopped> {
    let mut blocks = Blocks::new();
    let end = moving.steps() + steps;
    while moving.steps() < end {
        let count = blocks.next(end - moving.steps());
        let began = Instant::now();
        detached(py, || moving.step(torque, count)).map_err(Stopped::Signal)?.map_err(Stopped::Fault)?;
        py.check_signals().map_err(Stopped::Signal)?;
        blocks.done(began);
    }
    Ok(())
}

typed_methods! {
    in PySimulator;

    /// Advance all states by steps of dt, with constant joint torques.
    #[doc = section!(Parameters)]
    /// tau : (..., nv) array_like, optional
    ///     Joint torques, N m or N, which broadcast to the batch. None: zero.
    /// steps : int, default 1
    ///     Number of steps.
    /// target : (..., nq) array_like, optional
    ///     New target of pd, from this step on. None: the last one.
    /// target_rate : (..., nv) array_like, optional
    ///     New target velocity of pd, likewise.
    /// control : (..., n) array_like or dict of str to float, optional
    ///     New controls of scene.actuators, from this step on, of a simulator that was created with controls. None: the
    ///     last ones.
    /// wrenches : dict of str to (..., 6) array_like, optional
    ///     External forces in the steps of this call by link name: (moment, force) at the origin of the link, N m and
    ///     N, which broadcast to the batch. None: none.
    /// frame : {"link", "world"}, default "link"
    ///     Axes of the wrenches: those of the link, with which they rotate, or those of the base.
    #[doc = section!(Raises)]
    /// SimulationError
    ///     The motion diverges or a pivot is lost. .step, .joint, .state and .trajectory (one row) describe it. All
    ///     states are at the last step that all of them finished; reset(q, qd, states=error.state) lets the others
    ///     continue.
    /// SimulationInterrupted
    ///     Ctrl-C (a KeyboardInterrupt), likewise. Other exceptions of signal handlers are raised unchanged.
    /// ShapeError, NotFiniteError, ArgumentError
    ///     An invalid argument; no state has moved.
    #[doc = section!(Examples)]
    /// >>> simulator = phipsi.scenes.chain(3).simulator([0.3, 0.2, 0.1], dt=1e-3)
    /// >>> simulator.step([0.5, 0.0, 0.0], steps=100)
    /// >>> bool(simulator.qd[0] > 0.0)
    /// True
    fn step[slf: &Bound<'py, Self>](
        tau: Option<&Object<'py>> = None, steps: Steps = ONE => "1"; target: Option<&Object<'py>> = None,
        target_rate: Option<&Object<'py>> = None, control: Option<&Object<'py>> = None,
        wrenches: Option<&Object<'py>> = None, frame: Option<&str> = None => "'link'"
    ) -> PyResult<()> {
        let (py, own) = (slf.py(), slf.get());
        if let Some(drive) = &own.drive {
            if target.is_some() || target_rate.is_some() {
                let expected = "one of them: the targets of servos are their controls";
                return refuse("target", "a target and control", expected);
            }
            own.push(py, wrenches, frame)?;
            drive.call_method1(py, "step", (slf, tau, steps.0, control))?;
            return Ok(());
        }
        if control.is_some() {
            let expected = "Scene.simulator(..., control=...) with the first controls";
            return refuse("control", "controls for a simulator without", expected);
        }
        own.push(py, wrenches, frame)?;
        own.advance_by(py, tau, steps, target, target_rate)
    }

    /// Set states and their times to a new start; the other states remain.
    #[doc = section!(Parameters)]
    /// q : (..., nq) array_like
    ///     Joint positions, rad or m.
    /// qd : (..., nv) array_like, optional
    ///     Joint velocities, rad/s or m/s; zero by default.
    /// states : optional
    ///     Selection of states as in array[states] = q: a mask, an index, a list of indices or a slice. None: all.
    /// activation : (..., n) array_like or dict, optional
    ///     Activations of the actuators of these states; None: zero. The controls remain.
    #[doc = raises!(arguments)]
    #[doc = section!(Warns)]
    /// ContactWarning, LimitWarning
    ///     Contacts that start below their surface, and joints that start outside of limits that are stops.
    #[doc = section!(Notes)]
    /// If the call raises, all states are unchanged.
    #[doc = section!(Examples)]
    /// >>> simulator = phipsi.scenes.chain(3).simulator(np.zeros((4, 3)), dt=1e-3)
    /// >>> simulator.step(steps=10)
    /// >>> simulator.reset([0.3, 0.2, 0.1], states=2)
    /// >>> simulator.t
    /// array([0.01, 0.01, 0.  , 0.01])
    fn reset[&self, py: Python<'py>](
        q: &Object<'py>, qd: Option<&Object<'py>> = None; states: Option<&Object<'py>> = None,
        activation: Option<&Object<'py>> = None
    ) -> PyResult<()> {
        let own = self.scene.get();
        let activation = match &self.drive {
            Some(drive) => Some(drive.call_method1(py, "read", (activation,))?),
            None if activation.is_some() => return Err(without_control().into()),
            None => None,
        };
        let [q, qd] = own.state_of_tree(py, q, qd)?;
        let (axes, chosen) = match states {
            None => (self.batch.clone(), self.every()?),
            Some(states) => self.chosen(states)?,
        };
        let (q, qd) = (q.over(&axes)?, qd.over(&axes)?);
        let mut guard = self.moving()?;
        let moving = &mut *guard;
        let outcome = if chosen.len() * (own.scene.nq() + own.scene.nv()) < RESET_AT_ONCE {
            moving.reset(&chosen, &q, &qd)
        } else {
            detached(py, || moving.reset(&chosen, &q, &qd))?
        };
        outcome.map_err(|error| fault(py, error, &self.batch))?;
        if let (Some(drive), Some(activation)) = (&self.drive, activation) {
            drive.call_method1(py, "reset", (states, activation))?;
        }
        let warnings = [guard.limit_warning(chosen.iter().copied()), guard.contact_warning(chosen)];
        // The lock is released first, because a handler of warnings can call the simulator.
        drop(guard);
        warn_of_start(py, warnings)
    }
}

#[pymethods]
impl PySimulator {
    /// Advances all states, also if the simulator has controls, whose torques are in the arguments.
    #[pyo3(name = "_advance", signature = (tau, steps, target, target_rate, /))]
    fn advance_by<'py>(
        &self,
        py: Python<'py>,
        tau: Option<&Object<'py>>,
        steps: Steps,
        target: Option<&Object<'py>>,
        target_rate: Option<&Object<'py>>,
    ) -> PyResult<()> {
        let Steps(steps) = steps;
        if target.is_some() || target_rate.is_some() {
            self.aim(py, target, target_rate)?;
        }
        let Some(tau) = tau else { return self.advance(py, &Torque::Zero, steps) };
        let own = self.scene.get();
        let nv = own.scene.nv();
        // The shortest path, for one torque in a plain array.
        if let Some((numbers, _)) = plain(tau, nv).filter(|_| own.scene.coupling().is_none()) {
            check_finite("tau", &numbers)?;
            return self.advance(py, &Torque::Constant(Broadcast::new("tau", &numbers, nv, &[], &self.batch)?), steps);
        }
        let tau: Input<'_> = own.rate("tau", tau)?;
        check_finite("tau", tau.data()?)?;
        let tau = own.on_tree(py, tau, Coupling::torques)?;
        self.advance(py, &Torque::Constant(tau.over(&self.batch)?), steps)
    }

    /// Time since the start or last reset of each state, (...), s: a float for one state, otherwise an array.
    #[getter]
    fn t<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        let moving = self.moving()?;
        let mut times = Output::new(py, &self.batch)?;
        for (state, time) in times.numbers()?.iter_mut().enumerate() {
            *time = moving.time(state);
        }
        times.finish_or_scalar()
    }

    /// Return the impacts of joints on their stops since the last call, and clear the list.
    #[doc = section!(Returns)]
    /// stops : list of StopImpact
    ///     Sorted by state and time; times are those of each state.
    #[doc = section!(Examples)]
    /// >>> builder = phipsi.SceneBuilder().link("rail").link("cart", mass=1.0)
    /// >>> scene = builder.joint("x", "prismatic", "rail", "cart", axis=(1, 0, 0), upper=0.5).build()
    /// >>> simulator = scene.simulator([0.0], [1.0], dt=0.01)
    /// >>> simulator.step(steps=100)
    /// >>> [(stop.joint, stop.limit, round(stop.speed, 3)) for stop in simulator.take_stops()]
    /// [('x', 'upper', 1.0)]
    fn take_stops<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        let impacts = self.moving()?.take_impacts();
        stop_impacts(py, &self.batch, self.scene.get(), &impacts)
    }

    fn __repr__(&self) -> PyResult<String> {
        let moving = self.moving()?;
        let (dt, method) = (self.dt, self.method.name());
        let states = if self.batch.is_empty() { "one state".to_owned() } else { format!("{} states", moving.states()) };
        Ok(format!("<phipsi.Simulator: {states}, {} steps of {dt} s by {method}>", moving.steps()))
    }
}

getters! {
    in PySimulator;

    /// Current joint positions, (..., nq), rad or m, a copy.
    pub(super) q: PyResult<Object<'py>> = |of, py| of.of_all(py, &*of.moving()?, &[], false);

    /// Current joint velocities, (..., nv), rad/s or m/s, a copy.
    pub(super) qd: PyResult<Object<'py>> = |of, py| of.of_all(py, &*of.moving()?, &[], true);

    /// Contact forces of the last step and impulses since the start, a ContactMotion; None without contacts.
    contacts: PyResult<Option<Object<'py>>> = |of, py| of.contacts_now(py, &*of.moving()?, &[]);

    /// Controls of the actuators, (..., n), a copy; None without control.
    pub(super) control: PyResult<Option<Object<'py>>> = |of, py| of.of_drive(py, "control");

    /// Activations of the actuators, (..., n), a copy, zero for those without one; None without control.
    pub(super) activation: PyResult<Option<Object<'py>>> = |of, py| of.of_drive(py, "activation");

    /// Number of steps since the creation of the simulator; reset does not change it.
    steps: PyResult<usize> = |of, _| Ok(of.moving()?.steps());

    /// Step, s.
    dt: f64 = |of, _| of.dt;

    /// Integration method, one of the names of Scene.simulate.
    method: &'static str = |of, _| of.method.name();

    /// Scene that is simulated.
    scene: Py<PyScene> = |of, py| of.scene.clone_ref(py);

    /// Shape of the batch; () for one state.
    batch: Names<'py> = |of, py| PyTuple::new(py, &of.batch);
}

/// Resets of fewer values keep the GIL.
const RESET_AT_ONCE: usize = 1_000;

impl PySimulator {
    fn of_drive<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Option<Object<'py>>> {
        let part = |drive: &Py<PyAny>| drive.bind(py).getattr(name)?.call_method0("copy");
        self.drive.as_ref().map(part).transpose()
    }

    /// Indices of all states.
    fn every(&self) -> Result<Vec<usize>, Error> {
        let states = self.batch.iter().product();
        let mut every = memory::with_capacity("states", states)?;
        every.extend(0..states);
        Ok(every)
    }

    /// Axes and indices of the states that `states` selects.
    fn chosen(&self, states: &Object<'_>) -> PyResult<(Vec<usize>, Vec<usize>)> {
        let py = states.py();
        let found = imported!(py, "phipsi._arguments", "states_of")?.call1((states, PyTuple::new(py, &self.batch)?))?;
        let (axes, indices): (Vec<usize>, Object<'_>) = found.extract()?;
        Ok((axes, indices.cast_into::<PyArray1<usize>>()?.to_vec()?))
    }
}
