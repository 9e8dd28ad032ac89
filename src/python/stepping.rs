//! Common parts of `simulate` and `simulator`: keywords, number of steps between two checks for signals, early end.

use super::choice::{read_form, refuse_unknown};
use super::control::Pd;
use super::description::body_names;
use super::errors::{batch_index, fault, refuse, warn_as};
use super::input;
use super::input::Input;
use super::object::{Object, imported};
use super::output::from_numbers;
use super::own_models::{OfStates, Place};
use super::scene::PyScene;
use super::wrenches::LinkWrenches;
use crate::batch::Fault;
use crate::motion::properties::joint_of_row;
use crate::motion::{FRICTION_SPEED, Limits, Method, Properties, Settings, StepFault, StopImpact, Totals};
use crate::scene::Coupling;
use pyo3::IntoPyObjectExt;
use pyo3::conversion::FromPyObjectOwned;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyTuple};
use std::time::{Duration, Instant};

/// Time between two reports of progress, and between two checks for signals.
pub(super) const BLOCK: Duration = Duration::from_millis(50);

/// Shortest step with a warning, s.
const LONG_STEP: f64 = 1.0;

/// Names with commas.
macro_rules! joined {
    ($first:ident $($other:ident)*) => { concat!(stringify!($first) $(, ", ", stringify!($other))*) };
}

/// The keywords of a simulation with their defaults, in sections that follow each other in signatures; with `if`, those
/// of some methods only. `=>`: the default as signatures show it. `in`: the field of [`Settings`] that has this value.
macro_rules! keywords {
    ($(
        $section:ident $(if $has:ident)? {
            $($visible:vis $name:ident: $kind:ty = $usual:expr $(=> $shown:literal)? $(, in $field:ident)?;)*
        }
    )*) => {
        /// Keywords of a simulation, as given.
        pub(super) struct Keywords<'py> {
            $($($visible $name: $kind,)*)*
        }

        impl<'py> Keywords<'py> {
            /// The keywords of a call of this method, which are removed from those given; others are refused.
            pub fn take(
                py: Python<'py>,
                method: &str,
                given: Option<&Bound<'py, PyDict>>,
                allowed: Allowed,
            ) -> PyResult<Self> {
                let none = PyDict::new(py);
                let given = given.unwrap_or(&none);
                $(
                    let is_taken = true $(&& allowed.$has)?;
                    $(let $name = if is_taken { taken(given, stringify!($name), $usual)? } else { $usual };)*
                )*
                refuse_unknown(py, method, Some(given))?;
                Ok(Self { $($($name,)*)* })
            }

            /// Keywords and torques of a run that are not fields of the trajectory.
            pub fn given(
                &self,
                py: Python<'py>,
                (tau, tau_steps): (Option<&Object<'py>>, Option<&Object<'py>>),
            ) -> PyResult<Bound<'py, PyDict>> {
                let given = PyDict::new(py);
                let torques = [("tau", tau), ("tau_steps", tau_steps)];
                let torques = torques.into_iter().filter_map(|(name, tau)| Some((name, tau?.clone())));
                let all = [$($((stringify!($name), (&self.$name).into_bound_py_any(py)?)),*),*];
                let is_given = |(name, value): &(&str, Object<'_>)| !OF_TRAJECTORY.contains(name) && !value.is_none();
                for (name, value) in torques.chain(all).filter(is_given) {
                    given.set_item(name, value)?;
                }
                Ok(given)
            }

            /// Sets the fields of the settings that are keywords.
            fn set(&self, settings: &mut Settings) {
                $($($(settings.$field = self.$name;)?)*)*
            }

            /// Adds the keywords that are fields of the settings.
            pub fn add_fields(keywords: &Bound<'py, PyDict>, settings: &Settings) -> PyResult<()> {
                $($($(keywords.set_item(stringify!($name), settings.$field)?;)?)*)*
                Ok(())
            }
        }

        /// The keywords of a section with their defaults, for a signature in Python.
        macro_rules! section_of_signature {
            $(($section) => { concat!($(", ", stringify!($name), "=", shown!($usual $(, $shown)?)),*) };)*
        }

        /// The names of a section, for a docstring.
        macro_rules! section_of_names {
            $(($section) => { joined!($($name)*) };)*
        }
    };
}

/// The first line of a docstring, from which Python takes the signature: arguments, and sections of the keywords of a
/// simulation.
macro_rules! signature {
    ($method:literal, $($arguments:literal $(, $($section:ident)+)?);+) => {
        concat!($method, "($self, ", $($arguments $(, $(section_of_signature!($section)),+)?),+, ")\n--\n")
    };
}

/// The names of these sections of keywords.
macro_rules! names_of_keywords {
    ($first:ident $($section:ident)*) => {
        concat!(section_of_names!($first) $(, ", ", section_of_names!($section))*)
    };
}

/// The keywords that some methods have.
#[derive(Clone, Copy)]
pub(super) struct Allowed {
    /// Error control.
    pub accuracy: bool,
    /// Values of each step, whose number is known.
    pub steps: bool,
}

keywords! {
    method { method: Option<String> = None => "'auto'"; }
    joints {
        pd: Option<Object<'py>> = None;
        inertias: Option<Object<'py>> = None;
        armature: Option<Object<'py>> = None;
        damping: Option<Object<'py>> = None;
        stiffness: Option<Object<'py>> = None;
        rest: Option<Object<'py>> = None;
        friction: Option<Object<'py>> = None;
        friction_speed: Option<f64> = None;
    }
    form {
        form: String = "auto".to_owned() => "'auto'";
        tolerance: Option<f64> = None, in tolerance;
    }
    compliance { compliance: Option<Object<'py>> = None; }
    stops {
        limits: Option<String> = None;
        restitution: f64 = 0.0, in restitution;
    }
    accuracy if accuracy { pub accuracy: Option<f64> = None, in accuracy; }
    smoothing { smoothing: f64 = 0.0, in smoothing; }
    targets if steps {
        targets: Option<Object<'py>> = None;
        target_rates: Option<Object<'py>> = None;
    }
    effort { effort: Option<String> = None; }
    wrenches if steps {
        wrenches: Option<Object<'py>> = None;
        frame: Option<String> = None => "'link'";
    }
    contacts {
        contact_friction: Option<Object<'py>> = None;
        contact_restitution: Option<Object<'py>> = None;
    }
}

/// The keywords that are fields of a trajectory.
const OF_TRAJECTORY: [&str; 5] = ["method", "armature", "stiffness", "rest", "inertias"];

/// The properties of each degree of freedom that are keywords.
pub(super) const OF_RATES: [(&str, Place); 4] = [
    ("armature", |of| &mut of.armature),
    ("damping", |of| &mut of.damping),
    ("stiffness", |of| &mut of.stiffness),
    ("friction", |of| &mut of.friction),
];

/// The coefficients of contacts that are keywords.
pub(super) const OF_CONTACTS: [(&str, Place); 2] =
    [("contact_friction", |of| &mut of.contact_friction), ("contact_restitution", |of| &mut of.contact_restitution)];

/// Removes a keyword from those given; without it, `usual`.
fn taken<'py, T: FromPyObjectOwned<'py>>(given: &Bound<'py, PyDict>, name: &str, usual: T) -> PyResult<T> {
    let Some(value) = given.get_item(name)? else { return Ok(usual) };
    given.del_item(name)?;
    value.extract::<T>().map_err(|error| {
        let error: PyErr = error.into();
        // As PyO3 does for arguments; notes exist from Python 3.11.
        let _ = error.value(given.py()).call_method1("add_note", (format!("while processing '{name}'"),));
        error
    })
}

impl<'py> Keywords<'py> {
    /// Reads the settings, and the control law, whose targets can be a batch.
    pub fn read(
        &self,
        py: Python<'py>,
        own: &PyScene,
        (dt, steps): (f64, usize),
    ) -> PyResult<(Settings, Option<Pd<'py>>, OfStates<'py>)> {
        let mut settings = Settings::new(&own.scene, dt);
        match self.method.as_deref().map(Method::named).transpose()? {
            // Scenes with contacts have one method, which is their default.
            None | Some(Method::Auto) => {}
            Some(method) => settings.method = method,
        }
        settings.limits = match self.limits.as_deref() {
            None | Some("stop") => Limits::Stop,
            Some("report") => Limits::Report,
            Some(other) => return refuse("limits", format!("{other:?}"), "\"stop\" or \"report\""),
        };
        self.set(&mut settings);
        if let Some(compliance) = &self.compliance {
            settings.compliance = input::spread("compliance", compliance, own.compliant_rows()?.into())?;
        }
        settings.form = read_form(&self.form)?;
        let (properties, mut of_states) = (&mut settings.properties, OfStates::new());
        let of_rates = [&self.armature, &self.damping, &self.stiffness, &self.friction];
        for ((name, place), given) in OF_RATES.into_iter().zip(of_rates) {
            let Some(given) = given else { continue };
            let input = own.on_tree(py, Input::spread(name, given, own.rates())?, Coupling::torques)?;
            if input.leading().is_empty() {
                *place(properties) = input.data()?.to_vec();
            } else {
                of_states.push((place, input));
            }
        }
        if let Some(given) = &self.inertias {
            let input = Input::table("inertias", given, body_names(&own.scene).len(), 10)?;
            of_states.push((|of| &mut of.inertias, input));
        }
        for ((name, place), given) in OF_CONTACTS.into_iter().zip([&self.contact_friction, &self.contact_restitution]) {
            let Some(given) = given else { continue };
            let contacts = own.scene.contact_coefficients();
            if contacts == 0 {
                return refuse(name, "coefficients for a scene without contacts", "a scene with contacts or colliders");
            }
            of_states.push((place, Input::spread(name, given, contacts.into())?));
        }
        if let Some(rest) = &self.rest {
            properties.rest = own.expanded(input::state("rest", rest, own.coordinates())?, Coupling::configuration);
        }
        properties.friction_speed = self.friction_speed.unwrap_or(0.0);
        let mut pd = self.pd.as_ref().map(|pd| Pd::read(pd, own)).transpose()?;
        let targets = [self.targets.as_ref(), self.target_rates.as_ref()];
        if targets.iter().any(Option::is_some) {
            let Some(law) = pd else {
                let expected = "targets with pd=PD(kp, kd), whose targets they are";
                return refuse("targets", "targets without a control law", expected);
            };
            pd = Some(law.with_targets(targets, steps, own)?);
        }
        match self.effort.as_deref() {
            None | Some("report") => {}
            Some("clip") => pd = Some(Pd::clipped(py, pd, own)?),
            Some(other) => return refuse("effort", format!("{other:?}"), "\"report\" or \"clip\""),
        }
        Ok((settings, pd, of_states))
    }

    /// Reads the wrenches on links, whose values can be those of a batch.
    pub fn wrenches(&self, own: &PyScene, steps: usize) -> PyResult<Option<LinkWrenches<'py>>> {
        LinkWrenches::read(&own.scene, self.wrenches.as_ref(), self.frame.as_deref(), Some(steps))
    }

    /// Warns about a step that does not resolve the motion of any robot, for instance one in milliseconds.
    pub fn warn_of_units(&self, py: Python<'py>, dt: f64) -> PyResult<()> {
        if self.accuracy.is_some() || dt.is_nan() || dt < LONG_STEP {
            return Ok(());
        }
        let text = format!(
            "dt: found steps of {dt} s, which do not resolve the motion of a robot; expected a step in s, for instance \
             1e-3, or error control with accuracy"
        );
        warn_as(py, "UnitsWarning", &text)
    }

    /// Warns about exact friction that is requested where contacts act, whose steps regularize it.
    pub fn warn_of_friction(&self, py: Python<'py>, own: &PyScene, settings: &Settings) -> PyResult<()> {
        let friction = &settings.properties.friction;
        let Some(row) = friction.iter().position(|&friction| friction > 0.0) else { return Ok(()) };
        if self.friction_speed != Some(0.0) || own.scene.contacts().is_empty() {
            return Ok(());
        }
        let text = format!(
            "friction_speed: found 0, exact friction, of joint {:?} in a scene with contacts; expected a positive \
             speed: in steps in which contacts act, friction is viscous below {FRICTION_SPEED} rad/s or m/s",
            joint_of_row(own.scene.tree(), row)
        );
        warn_as(py, "FrictionWarning", &text)
    }
}

/// Fields of a trajectory that describe the run.
pub(super) fn about<'py>(
    scene: &Bound<'py, PyScene>,
    settings: &Settings,
    batch: &[usize],
) -> PyResult<Bound<'py, PyDict>> {
    let py = scene.py();
    let fields = PyDict::new(py);
    fields.set_item("scene", scene)?;
    fields.set_item("dt", settings.dt)?;
    fields.set_item("method", settings.method.name())?;
    let own = scene.get();
    let Properties { armature, stiffness, rest, inertias, .. } = &own.properties_of_scene(&settings.properties);
    for (name, numbers, width) in [
        ("armature", armature, own.scene.nv()),
        ("stiffness", stiffness, own.scene.nv()),
        ("rest", rest, own.scene.nq()),
    ] {
        let of_states = if numbers.len() == width { &[][..] } else { batch };
        fields.set_item(name, from_numbers(py, numbers, &[of_states, &[width]].concat())?)?;
    }
    let bodies = body_names(&own.scene).len();
    if !inertias.is_empty() {
        let of_states = if inertias.len() == 10 * bodies { &[][..] } else { batch };
        fields.set_item("inertias", from_numbers(py, inertias, &[of_states, &[bodies, 10]].concat())?)?;
    }
    Ok(fields)
}

/// Issues a warning about joint limits, if there is one.
pub(super) fn warn_of_limits(py: Python<'_>, warning: Option<String>) -> PyResult<()> {
    warning.map_or(Ok(()), |text| warn_as(py, "LimitWarning", &text))
}

/// Issues the warnings of [`Rollout::limit_warning`](crate::motion::Rollout::limit_warning) and
/// [`Rollout::contact_warning`](crate::motion::Rollout::contact_warning) about a start, if there are any.
pub(super) fn warn_of_start(py: Python<'_>, [limits, contacts]: [Option<String>; 2]) -> PyResult<()> {
    warn_of_limits(py, limits)?;
    contacts.map_or(Ok(()), |text| warn_as(py, "ContactWarning", &text))
}

/// Sets the fields of a trajectory that are known at its end: works, numbers of substeps, impacts on stops.
pub(super) fn set_outcome<'py>(
    fields: &Bound<'py, PyDict>,
    batch: &[usize],
    own: &PyScene,
    (chosen, friction_speed, [stops, is_controlled]): (Method, f64, [bool; 2]),
    totals: impl Fn(usize) -> Totals,
    impacts: &[StopImpact],
) -> PyResult<()> {
    let py = fields.py();
    fields.set_item("integrator", chosen.name())?;
    fields.set_item("friction_speed", friction_speed)?;
    fields.set_item("limits", if stops { "stop" } else { "report" })?;
    let states = batch.iter().product();
    let each = |of: &dyn Fn(&Totals) -> f64| -> PyResult<Object<'py>> {
        let values: Vec<f64> = (0..states).map(|state| of(&totals(state))).collect();
        from_numbers(py, &values, batch)
    };
    let works: [&dyn Fn(&Totals) -> f64; 5] =
        [&|t| t.torque, &|t| t.damping, &|t| t.friction, &|t| t.control, &|t| t.stops];
    let works = works.into_iter().map(each).collect::<PyResult<Vec<_>>>()?;
    fields.set_item("works", PyTuple::new(py, works)?)?;
    let error = |t: &Totals| if is_controlled { t.error } else { f64::NAN };
    let counts: [&dyn Fn(&Totals) -> f64; 4] = [&|t| t.most_substeps.max(1.0), &|t| t.events, &error, &|t| t.unsettled];
    let counts = counts.into_iter().map(each).collect::<PyResult<Vec<_>>>()?;
    fields.set_item("counts", PyTuple::new(py, counts)?)?;
    fields.set_item("stops", stop_impacts(py, batch, own, impacts)?)
}

/// Impacts as a list of StopImpact.
pub(super) fn stop_impacts<'py>(
    py: Python<'py>,
    batch: &[usize],
    own: &PyScene,
    impacts: &[StopImpact],
) -> PyResult<Object<'py>> {
    let class = imported!(py, "phipsi._motion", "StopImpact")?;
    let found = PyList::empty(py);
    for StopImpact { state, row, upper, time, speed, impulse } in impacts {
        let index = (!batch.is_empty()).then(|| batch_index(py, *state, batch)).transpose()?;
        let joint = joint_of_row(own.scene.tree(), *row);
        let limit = if *upper { "upper" } else { "lower" };
        found.append(class.call1((joint, limit, time, speed, impulse, index))?)?;
    }
    Ok(found.into_any())
}

/// Number of steps per block, doubled or halved until a block takes the intended time. The division does not change
/// results.
pub(super) struct Blocks {
    steps: usize,
}

impl Blocks {
    pub fn new() -> Self {
        Self { steps: 1 }
    }

    /// Size of the next block.
    pub fn next(&self, remaining: usize) -> usize {
        self.steps.min(remaining)
    }

    /// Records that a block that started at `began` is finished.
    pub fn done(&mut self, began: Instant) {
        let elapsed = began.elapsed();
        if elapsed < BLOCK / 2 {
            self.steps = self.steps.saturating_mul(2);
        } else if elapsed > BLOCK {
            self.steps = (self.steps / 2).max(1);
        }
    }
}

/// Reason for the early end of a run.
pub(super) enum Stopped {
    Fault(StepFault),
    /// A function of the caller raised.
    Raised(PyErr),
    /// A signal handler raised between two blocks.
    Signal(PyErr),
}

impl From<PyErr> for Stopped {
    fn from(error: PyErr) -> Self {
        Self::Raised(error)
    }
}

impl Stopped {
    /// Creates the exception, with the finished part of the trajectory.
    pub fn raise(self, py: Python<'_>, trajectory: &Object<'_>, batch: &[usize]) -> PyResult<PyErr> {
        let by_signal = matches!(self, Self::Signal(_));
        let (cause, joint, state) = match self {
            Self::Raised(error) | Self::Signal(error) => (error, None, None),
            Self::Fault(StepFault { state, joint, error, .. }) => {
                let index = (!batch.is_empty()).then(|| batch_index(py, state, batch)).transpose()?;
                (fault(py, Fault { state, error }, batch), Some(joint), index)
            }
        };
        // The frames of the exception are in its value only after this conversion.
        let arguments = (trajectory, cause.into_value(py), joint, state, by_signal);
        let made = imported!(py, "phipsi._motion", "stopped")?.call1(arguments)?;
        Ok(PyErr::from_value(made))
    }
}
