//! Methods of `Scene`: gradients of a function of a trajectory.

use super::control::{Given, Pd, everyone};
use super::counts::{count, count_or};
use super::coupling::Expand;
use super::errors::{asked_by, batch_index, fault, of_batch, refuse};
use super::fresh::states_of;
use super::input::Input;
use super::interrupts::detached;
use super::object::{Object, imported};
use super::output::from_numbers;
use super::own_models;
use super::products::{Place, parameters_of, places_of_links};
use super::scene::PyScene;
use super::stepping::{Allowed, Keywords};
use super::wrenches::LinkWrenches;
use crate::batch::{Fault, broadcast_axes};
use crate::error::check_finite;
use crate::memory;
use crate::motion::{ContactId, Gains, ModeChange, RecordedRows, Rollout, RolloutGradients, ShapeGradients};
use crate::scene::{Coupling, Scene};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyTuple};
use std::collections::BTreeSet;

#[pymethods]
impl PyScene {
    #[doc = signature!("simulate_vjp", "q, qd, cotangent_q, cotangent_qd, *, dt, steps, tau=None, tau_steps=None",
                       method; ", record_every=1", joints form; ", parameters=False", stops compliance smoothing
                       targets effort wrenches contacts)]
    /// Gradients of a function of a trajectory by the adjoint of every step, from recorded rows; as Trajectory.vjp.
    #[doc = section!(Parameters)]
    /// q : (..., rows, nq) array_like
    ///     Recorded joint positions, the first at the start.
    /// qd : (..., rows, nv) array_like
    ///     Recorded joint velocities.
    /// cotangent_q : (..., rows, nv) array_like
    ///     Gradient of the function with respect to q, in the tangent space of each row.
    /// cotangent_qd : (..., rows, nv) array_like
    ///     Gradient of the function with respect to qd.
    /// dt : float
    ///     Step, s.
    /// steps : int
    ///     Number of steps.
    #[doc = concat!("tau, tau_steps, method, record_every, ", names_of_keywords!(joints))]
    ///     As given to simulate; tau is an array.
    #[doc = names_of_keywords!(form)]
    ///     As given to simulate.
    /// parameters : bool, default False
    ///     If true, compute the gradients with respect to inertial parameters too.
    #[doc = names_of_keywords!(stops compliance smoothing targets effort wrenches)]
    ///     As given to simulate.
    #[doc = names_of_keywords!(contacts)]
    ///     As given to simulate.
    #[doc = section!(Returns)]
    /// gradients : RolloutGradients
    ///     Named tuple (q, qd, tau, armature, damping, stiffness, friction, parameters, contacts, mode_changes, target,
    ///     target_rate, control, wrenches): (..., nv) each; tau is (..., steps, nv) with tau_steps, target with targets
    ///     and target_rate with target_rates; parameters is (..., bodies, 10) or None; contacts has the gradients by
    ///     each contact, wrenches those by the wrench on each link, in the shape in which it was given, or None; control
    ///     is None.
    #[doc = raises!(singular memory arguments)]
    #[doc = section!(Notes)]
    /// O(N) per stage. Steps between rows, and steps with contacts, are recomputed. The memory of a thread grows with
    /// the square root of the number of steps between two rows; with contacts, the run is
    /// repeated and every step is stored. Steps after the last row have no effect. Contacts are
    /// differentiated in the modes of the trajectory (open, sticking, sliding): see docs/motion.md. In closed loops,
    /// steps are recomputed too, joints at stops or held by friction are differentiated in these modes, and the
    /// gradients by q and qd are those of changes that satisfy the connections. With mimic joints, q, qd and tau are
    /// those of the independent joints; parameters has all links of body_names, which include those of the joints that
    /// follow.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> path = scene.simulate([0.3, 0.2, 0.1], np.zeros(3), dt=1e-3, steps=100, method="rk4")
    /// >>> last = np.zeros_like(path.qd)
    /// >>> last[-1, 0] = 1.0     # the function is q[-1, 0]
    /// >>> keywords = dict(dt=1e-3, steps=100, method="rk4")
    /// >>> gradients = scene.simulate_vjp(path.q, path.qd, last, np.zeros_like(last), **keywords)
    /// >>> np.allclose(gradients.q[0], 1.0)     # the first joint is vertical
    /// True
    #[pyo3(signature = (q, qd, cotangent_q, cotangent_qd, *, dt, steps, tau=None, tau_steps=None, record_every=None,
                        parameters=false, **given),
           text_signature = None)]
    fn simulate_vjp<'py>(
        slf: &Bound<'py, Self>,
        q: &Object<'py>,
        qd: &Object<'py>,
        cotangent_q: &Object<'py>,
        cotangent_qd: &Object<'py>,
        dt: f64,
        steps: &Object<'py>,
        tau: Option<&Object<'py>>,
        tau_steps: Option<&Object<'py>>,
        record_every: Option<&Object<'py>>,
        parameters: bool,
        given: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Object<'py>> {
        let (py, own) = (slf.py(), slf.get());
        let keywords = Keywords::take(py, "Scene.simulate_vjp", given, Allowed { accuracy: false, steps: true })?;
        let scene = &own.scene;
        let (nq, nv) = (scene.tree().nq(), scene.tree().nv());
        let steps = count("steps", steps, 0)?;
        let every = count_or("record_every", record_every, 1, 1)?;
        let rows = steps / every + 1;
        let (mut settings, pd, of_states) = keywords.read(py, own, (dt, steps))?;
        let given = Given::read(tau, tau_steps, steps, own)?;
        let wrenches = keywords.wrenches(own, steps)?;
        if matches!(given, Given::Function(_)) {
            let expected = "an array; the torques of a function can be given as tau_steps";
            return refuse("tau", "a function, which has no known gradients", expected);
        }
        let inputs = [
            Input::table("q", q, rows, own.coordinates())?,
            Input::table("qd", qd, rows, own.rates())?,
            Input::table("cotangent_q", cotangent_q, rows, own.rates())?,
            Input::table("cotangent_qd", cotangent_qd, rows, own.rates())?,
        ];
        for input in &inputs {
            check_finite(&input.name, input.data()?)?;
        }
        let mut axes: Vec<(&str, &[usize])> = inputs.iter().map(|input| (&*input.name, input.leading())).collect();
        axes.extend(given.leading());
        for of_pd in pd.iter().flat_map(Pd::leading) {
            axes.push(of_pd);
        }
        axes.extend(wrenches.iter().flat_map(LinkWrenches::leading));
        axes.extend(own_models::leading(&of_states));
        let batch = broadcast_axes(axes)?;
        let states = states_of(&batch)?;
        memory::room("q", memory::bytes_of::<f64>(&[states, rows, nq + 3 * nv]))?;
        settings.gains = pd.map(|pd| pd.over(&batch, states)).transpose()?;
        own_models::fill(&of_states, &mut settings.properties, &batch, states)?;
        settings.wrenches = wrenches.as_ref().map(|wrenches| wrenches.over(&batch, states)).transpose()?;
        let changes = |of: fn(&Gains) -> &[f64]| settings.gains.as_ref().is_some_and(|gains| !of(gains).is_empty());
        let (targets, rates) = (changes(|gains| &gains.targets), changes(|gains| &gains.target_rates));
        let every_row = |i: usize, expand: Expand| -> PyResult<Vec<f64>> {
            let all = everyone(&inputs[i], &batch, states)?;
            let width = if i == 0 { scene.nq() } else { scene.nv() };
            Ok(match scene.coupling() {
                Some(coupling) => all.chunks_exact(width.max(1)).flat_map(|row| expand(coupling, row)).collect(),
                None => all,
            })
        };
        let [q, qd] = [every_row(0, Coupling::configuration)?, every_row(1, Coupling::rates)?];
        let [by_q, by_qd] = [every_row(2, Coupling::torques)?, every_row(3, Coupling::torques)?];
        let first = |numbers: &[f64], width: usize| -> Vec<f64> {
            numbers.chunks_exact((rows * width).max(1)).flat_map(|state| &state[..width]).copied().collect()
        };
        let starts = (first(&q, nq), first(&qd, nv));
        let rollout = detached(py, || Rollout::of_states(scene, settings, states, (&starts.0, &starts.1)))?;
        let rollout = rollout.map_err(|error| of_batch(py, &error, &batch))?;
        let torque = given.torque(&batch, (steps, nv))?;
        let recorded = RecordedRows { q: &q, qd: &qd, every, by_q: &by_q, by_qd: &by_qd };
        let found = detached(py, || rollout.gradients(&torque, steps, &recorded, parameters))?;
        let found = found.map_err(|stopped| fault(py, Fault { state: stopped.state, error: stopped.error }, &batch))?;
        let links = if parameters { places_of_links(scene) } else { Vec::new() };
        let of_steps = matches!(given, Given::Steps(_)).then_some(steps);
        let inputs = [of_steps, targets.then_some(steps), rates.then_some(steps)];
        let wrenches = wrenches.map_or_else(Vec::new, |wrenches| wrenches.shapes());
        let outputs = Output { py, batch: &batch, nv: scene.nv(), scene };
        outputs.tuple(&found, inputs, &wrenches, parameters.then_some(&links[..]))
    }
}

/// Memory of the gradients.
struct Output<'a, 'py> {
    py: Python<'py>,
    batch: &'a [usize],
    nv: usize,
    scene: &'a Scene,
}

impl<'py> Output<'_, 'py> {
    fn array(&self, numbers: &[f64], own: &[usize]) -> PyResult<Object<'py>> {
        asked_by(self.py, "q", from_numbers(self.py, numbers, &[self.batch, own].concat()))
    }

    /// Gradients of the scene by a quantity, from those of its tree: by states, in which an independent joint also moves
    /// its followers, or by torques and properties at the independent joints.
    fn of_scene(&self, numbers: &[f64], by_states: bool) -> Vec<f64> {
        let Some(coupling) = self.scene.coupling() else { return numbers.to_vec() };
        let rows = numbers.chunks_exact(self.scene.tree().nv().max(1));
        let reduced = |row: &[f64]| {
            if !by_states {
                return coupling.independent_rates(row);
            }
            let mut out = vec![0.0; self.nv];
            coupling.reduce(row, &mut out);
            out
        };
        rows.flat_map(reduced).collect()
    }

    /// Creates the named tuple, with the torques of steps and the parameters of links if requested.
    fn tuple(
        &self,
        found: &RolloutGradients,
        inputs: [Option<usize>; 3],
        wrenches: &[(String, Vec<usize>)],
        links: Option<&[Place]>,
    ) -> PyResult<Object<'py>> {
        let [torque, target, rate] =
            inputs.map(|steps| steps.map_or_else(|| vec![self.nv], |steps| vec![steps, self.nv]));
        let of_rows = [&found.armature, &found.damping, &found.stiffness, &found.friction];
        let mut parts = Vec::new();
        for of_state in [&found.q, &found.qd] {
            parts.push(self.array(&self.of_scene(of_state, true), &[self.nv])?);
        }
        parts.push(self.array(&self.of_scene(&found.torque, false), &torque)?);
        for numbers in of_rows {
            parts.push(self.array(&self.of_scene(numbers, false), &[self.nv])?);
        }
        parts.push(match links {
            Some(links) => {
                let bodies = found.parameters.len().checked_div(self.batch.iter().product()).unwrap_or(0);
                let each = found.parameters.chunks_exact(bodies.max(1)).flat_map(|state| parameters_of(links, state));
                self.array(each.collect::<Vec<_>>().as_flattened(), &[links.len(), 10])?
            }
            None => self.py.None().into_bound(self.py),
        });
        parts.push(self.contacts(found)?.into_any());
        parts.push(self.mode_changes(&found.mode_changes)?.into_any());
        for (numbers, shape) in [(&found.target, &target), (&found.target_rate, &rate)] {
            parts.push(if numbers.is_empty() && self.nv > 0 {
                self.py.None().into_bound(self.py)
            } else {
                self.array(&self.of_scene(numbers, true), shape)?
            });
        }
        parts.push(self.py.None().into_bound(self.py));
        parts.push(self.wrenches(&found.wrenches, wrenches)?);
        imported!(self.py, "phipsi._results", "RolloutGradients")?.call1(PyTuple::new(self.py, parts)?)
    }

    /// The gradients by the wrenches on links, by name, in the shapes in which they were given; None without wrenches.
    fn wrenches(&self, numbers: &[f64], given: &[(String, Vec<usize>)]) -> PyResult<Object<'py>> {
        if given.is_empty() {
            return Ok(self.py.None().into_bound(self.py));
        }
        let by_name = PyDict::new(self.py);
        let (states, width) = (self.batch.iter().product::<usize>(), 6 * given.len());
        let of_state = numbers.len().checked_div(states).unwrap_or(0);
        for (at, (link, shape)) in given.iter().enumerate() {
            let own = shape.iter().product::<usize>();
            let mut all = vec![0.0; states * own];
            // Of a wrench that is constant beside others that change, the gradient is the sum over the steps.
            for (of, to) in numbers.chunks_exact(of_state.max(1)).zip(all.chunks_exact_mut(own.max(1))) {
                for (step, row) in of.chunks_exact(width).enumerate() {
                    let first = (6 * step).min(own - 6);
                    to[first..first + 6].iter_mut().zip(&row[6 * at..]).for_each(|(sum, more)| *sum += more);
                }
            }
            by_name.set_item(link, self.array(&all, shape)?)?;
        }
        Ok(by_name.into_any())
    }

    /// The gradients by each contact, by name.
    fn contacts(&self, found: &RolloutGradients) -> PyResult<Object<'py>> {
        let class = imported!(self.py, "phipsi._motion_parts", "ContactGradients")?;
        let (of, contacts) = (&found.contacts, self.scene.contacts());
        let by_name = PyDict::new(self.py);
        for (i, contact) in contacts.iter().enumerate() {
            let each = |numbers: &[f64]| -> PyResult<Object<'py>> {
                let own: Vec<f64> = numbers.iter().skip(i).step_by(contacts.len()).copied().collect();
                self.array(&own, &[])
            };
            let normals: Vec<f64> = of.normal.iter().skip(i).step_by(contacts.len()).flatten().copied().collect();
            #[allow(clippy::cast_precision_loss)] // number of steps of a run
            let steps: Vec<f64> = of.margin_step.iter().map(|&step| step as f64).collect();
            let parts = [
                each(&of.friction)?,
                each(&of.restitution)?,
                each(&of.offset)?,
                self.array(&normals, &[3])?,
                each(&of.margin)?,
                each(&steps)?,
            ];
            by_name.set_item(&contact.name, class.call1(PyTuple::new(self.py, parts)?)?)?;
        }
        let pairs: BTreeSet<[usize; 2]> = found.shapes.iter().map(|of| of.colliders).collect();
        let states = self.batch.iter().product();
        for pair in pairs {
            // A state in which the shapes could not touch has no gradients and no other mode.
            let each = |of: fn(&ShapeGradients) -> f64, none: f64| {
                let mut all = vec![none; states];
                found.shapes.iter().filter(|one| one.colliders == pair).for_each(|one| all[one.state] = of(one));
                self.array(&all, &[])
            };
            let nan = vec![f64::NAN; 3 * states];
            #[allow(clippy::cast_precision_loss)] // number of steps of a run
            let parts = [
                each(|of| of.friction, 0.0)?,
                each(|of| of.restitution, 0.0)?,
                self.array(&nan[..states], &[])?,
                self.array(&nan, &[3])?,
                each(|of| of.margin, f64::INFINITY)?,
                each(|of| of.margin_step as f64, 0.0)?,
            ];
            by_name.set_item(self.names(pair), class.call1(PyTuple::new(self.py, parts)?)?)?;
        }
        Ok(by_name.into_any())
    }

    /// The names of a pair of colliders.
    fn names(&self, pair: [usize; 2]) -> (&str, &str) {
        let [first, second] = pair.map(|at| self.scene.colliders().get(at).map_or("", |of| &*of.name));
        (first, second)
    }

    /// The changes of contacts as a list of ModeChange.
    fn mode_changes(&self, changes: &[ModeChange]) -> PyResult<Object<'py>> {
        let class = imported!(self.py, "phipsi._motion_parts", "mode_change")?;
        let found = PyList::empty(self.py);
        for ModeChange { state, step, contact, before, after } in changes {
            let index = (!self.batch.is_empty()).then(|| batch_index(self.py, *state, self.batch)).transpose()?;
            let (step, before, after) = (*step, before.number(), after.number());
            let change = match *contact {
                ContactId::Named(at) => {
                    let name = self.scene.contacts().get(at).map_or("", |contact| &*contact.name);
                    class.call1((name, step, before, after, index))?
                }
                ContactId::Shapes(pair) => class.call1((self.names(pair), step, before, after, index))?,
            };
            found.append(change)?;
        }
        Ok(found.into_any())
    }
}
