//! One call: its arguments broadcast over the batch, its result, and the release of the GIL.

use super::bad_states::Errors;
use super::cost::{Cost, WORTH_RELEASING};
use super::dtype::Dtype;
use super::errors::{asked_by, fault, refuse};
use super::fresh::states_of;
use super::input::Input;
use super::interrupts::detached;
use super::keywords::Keywords;
use super::object::Object;
use super::output::{Array, Output};
use super::own_models::Models;
use super::scene::PyScene;
use super::scratch::Scratch;
use super::wrenches::{self, Wrench};
use crate::batch::{Batch, Broadcast, Fault, broadcast_axes};
use crate::error::Error;
use crate::memory;
use crate::model::StateModel;
use crate::scene::Scene;
use pyo3::prelude::*;

/// Arguments of a call, the leading axes to which they broadcast, and the approximate time per state.
pub(super) struct BatchCall<'a, 'py> {
    pub scene: &'a PyScene,
    inputs: Vec<Input<'py>>,
    wrenches: Vec<Wrench<'py>>,
    pub models: Models<'py>,
    /// Leading axes of the result.
    pub batch: Vec<usize>,
    pub states: usize,
    pub cost: Cost,
    pub errors: Errors,
    /// Largest accepted error estimate; None: the default.
    pub tolerance: Option<f64>,
}

impl PyScene {
    /// Reads a configuration, (..., nq).
    pub(super) fn configuration<'py>(&self, name: &'static str, value: &Object<'py>) -> PyResult<Input<'py>> {
        Input::new(name, value, self.coordinates())
    }

    /// Reads joint velocities, accelerations or torques, (..., nv).
    pub(super) fn rate<'py>(&self, name: &'static str, value: &Object<'py>) -> PyResult<Input<'py>> {
        Input::new(name, value, self.rates())
    }

    /// Reads q, then arrays of shape (..., nv).
    pub(super) fn inputs<'a, 'py: 'a>(
        &self,
        given: impl IntoIterator<Item = (&'static str, &'a Object<'py>)>,
    ) -> PyResult<Vec<Input<'py>>> {
        let read = |(at, (name, value))| if at == 0 { self.configuration(name, value) } else { self.rate(name, value) };
        given.into_iter().enumerate().map(read).collect()
    }

    /// Creates a call with these arguments, of `cost` ns per state.
    pub(super) fn call<'a, 'py>(
        &'a self,
        inputs: impl Into<Vec<Input<'py>>>,
        cost: usize,
        errors: &str,
    ) -> PyResult<BatchCall<'a, 'py>> {
        Ok(BatchCall::new(self, inputs.into(), Vec::new(), Cost::of(cost))?.with(Errors::read(errors)?))
    }

    /// The same with the wrenches, the models of the states and the tolerance of the keywords.
    pub(super) fn call_by<'a, 'py>(
        &'a self,
        inputs: impl Into<Vec<Input<'py>>>,
        cost: usize,
        keywords: &Keywords<'_, 'py>,
    ) -> PyResult<BatchCall<'a, 'py>> {
        let (wrenches, models) = (Wrench::read(&self.scene, keywords.wrenches)?, keywords.models(&self.scene)?);
        let call = BatchCall::of_models(self, inputs.into(), wrenches, models, Cost::of(cost))?;
        Ok(call.with(Errors::read(keywords.errors)?).accepting(keywords.tolerance))
    }
}

impl<'a, 'py> BatchCall<'a, 'py> {
    pub fn new(scene: &'a PyScene, inputs: Vec<Input<'py>>, wrenches: Vec<Wrench<'py>>, cost: Cost) -> PyResult<Self> {
        Self::of_models(scene, inputs, wrenches, Models::default(), cost)
    }

    /// The same for states that have their own models.
    pub fn of_models(
        scene: &'a PyScene,
        inputs: Vec<Input<'py>>,
        wrenches: Vec<Wrench<'py>>,
        models: Models<'py>,
        cost: Cost,
    ) -> PyResult<Self> {
        let all = || names_and_axes(&inputs, &wrenches, &models);
        let batch = if all().all(|(_, axes)| axes.is_empty()) { Vec::new() } else { broadcast_axes(all())? };
        let states = states_of(&batch)?;
        Ok(Self { scene, inputs, wrenches, models, batch, states, cost, errors: Errors::Raise, tolerance: None })
    }

    /// Sets the treatment of invalid states.
    pub fn with(self, errors: Errors) -> Self {
        Self { errors, ..self }
    }

    /// Sets the tolerance.
    pub fn accepting(self, tolerance: Option<f64>) -> Self {
        Self { tolerance, ..self }
    }

    /// Array of shape batch + `shape` for the results: a new one from `make`, or the caller's `out`.
    pub fn output<P: Dtype>(
        &self,
        py: Python<'py>,
        shape: &[usize],
        out: Option<&Object<'py>>,
        make: fn(Python<'py>, &[usize]) -> PyResult<Output<'py, P>>,
    ) -> PyResult<Output<'py, P>> {
        let full = [&self.batch, shape].concat();
        let Some(out) = out else {
            return make(py, &full).or_else(|failed| asked_by(py, &self.asking(), Err(failed)));
        };
        let wrenches = self.wrenches.iter().map(|wrench| wrench.input.addresses());
        Output::given(out, &full, self.inputs.iter().chain(self.models.inputs()).map(Input::addresses).chain(wrenches))
    }

    /// Names of the arguments that determine the size of the batch.
    pub fn asking(&self) -> String {
        let all = names_and_axes(&self.inputs, &self.wrenches, &self.models);
        let names: Vec<&str> = all.filter(|(_, axes)| !axes.is_empty()).map(|(name, _)| name).collect();
        if names.is_empty() { "scene".to_owned() } else { names.join(", ") }
    }

    /// Views of the arguments for threads without access to Python.
    pub fn over(&self) -> PyResult<(Vec<Broadcast<'_>>, Vec<wrenches::States<'_>>)> {
        let arguments = self.inputs.iter().map(|input| input.over(&self.batch)).collect::<PyResult<Vec<_>>>()?;
        let wrenches = self.wrenches.iter().map(|wrench| wrench.over(&self.batch)).collect::<PyResult<Vec<_>>>()?;
        Ok((arguments, wrenches))
    }

    /// True if there is nothing to evaluate: states without numbers, of which an array without memory can have any
    /// count.
    pub fn is_void<P>(&self, results: &[P]) -> bool {
        results.is_empty() && self.scene.scene.nv() == 0 && self.wrenches.is_empty()
    }

    /// Evaluates the states, of `cost` ns each, and warns about invalid ones.
    pub fn run<W>(&self, py: Python<'py>, cost: usize, work: W) -> PyResult<()>
    where
        W: FnOnce(Batch<'_, Scratch, &(dyn Fn() -> Scratch + Sync)>) -> Result<(), Fault> + Send,
    {
        let PyScene { scene, pool } = self.scene;
        let make = || Scratch::new(scene);
        let make: &(dyn Fn() -> Scratch + Sync) = &make;
        self.scene.check_scratch(self.states)?;
        run(py, &self.batch, Batch { states: self.states, cost, pool, make }, work)?;
        self.errors.warn(py, &self.batch)
    }
}

impl<'py> BatchCall<'_, 'py> {
    /// Allocates `width` values per state for results that are not one array. The memory for the copies is checked too.
    pub fn scratch_results(&self, py: Python<'py>, width: usize) -> PyResult<Output<'py>> {
        memory::room(&self.asking(), memory::bytes_of::<f64>(&[self.states, width, 2]))?;
        let Some(entries) = self.states.checked_mul(width) else {
            return refuse(self.asking(), "more numbers than memory can address", "fewer states");
        };
        asked_by(py, &self.asking(), Output::new(py, &[entries]))
    }

    /// Arrays of shape batch + one of `shapes` each, from the results of every state one after another.
    pub fn pieces(
        &self,
        py: Python<'py>,
        results: &[f64],
        shapes: &[impl AsRef<[usize]>],
    ) -> PyResult<Vec<Object<'py>>> {
        let size = |shape: &[usize]| shape.iter().product::<usize>();
        let width: usize = shapes.iter().map(|shape| size(shape.as_ref())).sum();
        let mut at = 0;
        let piece = |shape: &[usize]| {
            let (own, states) = (at..at + size(shape), results.chunks_exact(width.max(1)));
            at = own.end;
            let mut output = Output::unwritten(py, &[&self.batch, shape].concat())?;
            output.gather(py, own.len(), states.map(|state| &state[own.clone()]))?;
            output.finish_or_scalar()
        };
        let pieces = shapes.iter().map(AsRef::as_ref).map(piece).collect();
        asked_by(py, &self.asking(), pieces)
    }

    /// Evaluates every state into a new array of shape batch + `shape`.
    pub fn array<K, const N: usize>(&self, py: Python<'py>, shape: &[usize], kernel: K) -> Array<'py>
    where
        K: Fn(&Scene, &mut Scratch, [&[f64]; N], &mut [f64]) -> Result<(), Error> + Sync,
    {
        let mut output = self.output(py, shape, None, Output::new)?;
        self.numbers(py, output.numbers()?, kernel)?;
        Ok(output.finish())
    }

    /// Evaluates every state into `results`, row-major over the batch.
    pub fn numbers<K, const N: usize>(&self, py: Python<'py>, results: &mut [f64], kernel: K) -> PyResult<()>
    where
        K: Fn(&Scene, &mut Scratch, [&[f64]; N], &mut [f64]) -> Result<(), Error> + Sync,
    {
        self.each_state(py, results, |scene, scratch, of, out| kernel(scene, scratch, std::array::from_fn(of), out))
    }

    /// The same for any number of arguments: the kernel receives a function that returns the values of each.
    pub fn each_state<K>(&self, py: Python<'py>, results: &mut [f64], kernel: K) -> PyResult<()>
    where
        K: for<'a> Fn(&Scene, &mut Scratch, &dyn Fn(usize) -> &'a [f64], &mut [f64]) -> Result<(), Error> + Sync,
    {
        self.along_paths(py, results, 1, |scene, scratch, of, _, out| kernel(scene, scratch, of, out))
    }

    /// The same for paths of `length` states, one after another: the kernel also receives the results of the last valid
    /// state before on the same path.
    pub fn along_paths<K>(&self, py: Python<'py>, results: &mut [f64], length: usize, kernel: K) -> PyResult<()>
    where
        K: for<'a> Fn(
                &Scene,
                &mut Scratch,
                &dyn Fn(usize) -> &'a [f64],
                Option<&[f64]>,
                &mut [f64],
            ) -> Result<(), Error>
            + Sync,
    {
        if self.is_void(results) {
            return Ok(());
        }
        let scene = &self.scene.scene;
        let ((arguments, wrenches), models) = (self.over()?, self.models.over(&self.batch)?);
        let (bodies, errors, tolerance) = (scene.model().bodies.len(), &self.errors, self.tolerance);
        self.run(py, self.cost.of_one(), |batch| {
            batch.run_pieces(length.max(1), results, |scratch, states, results| {
                let (width, mut last) = (results.len() / states.len().max(1), None);
                let mut own: Option<(StateModel<'_>, Scene, Scratch)> = None;
                for (at, i) in states.enumerate() {
                    last = last.filter(|_| i % length != 0);
                    let (before, rest) = results.split_at_mut(at * width);
                    let (previous, out) = (last.map(|last| &before[last * width..][..width]), &mut rest[..width]);
                    let mut run = |scene: &Scene, scratch: &mut Scratch| {
                        scratch.workspace.tolerance = tolerance;
                        wrenches::on_bodies(&wrenches, bodies, i, &mut scratch.forces[0])?;
                        kernel(scene, scratch, &|k: usize| arguments[k].state(i), previous, &mut *out)
                    };
                    let model = models.of(i);
                    own = own.filter(|own| own.0 == model);
                    let outcome = match &mut own {
                        _ if model.is_of_scene() => run(scene, scratch),
                        Some((_, scene, scratch)) => run(scene, scratch),
                        None => scene.with_state_model(&model).and_then(|scene| {
                            let scratch = Scratch::new(&scene);
                            let (_, scene, scratch) = own.insert((model, scene, scratch));
                            run(scene, scratch)
                        }),
                    };
                    if let Err(error) = outcome {
                        errors.note(Fault { state: i, error })?;
                        out.fill(f64::NAN);
                    } else {
                        last = Some(at);
                    }
                }
                Ok(())
            })
        })
    }
}

/// Names of the arguments in messages, and their leading axes.
fn names_and_axes<'a>(
    inputs: &'a [Input<'_>],
    wrenches: &'a [Wrench<'_>],
    models: &'a Models<'_>,
) -> impl Iterator<Item = (&'a str, &'a [usize])> {
    let given = inputs.iter().map(|input| (&*input.name, input.leading()));
    let given = given.chain(wrenches.iter().map(|Wrench { input, .. }| (&*input.name, input.leading())));
    given.chain(models.inputs().map(|input| (&*input.name, input.leading())))
}

/// Evaluates a batch with these leading axes, without the GIL unless it is short; raises the fault of the lowest state.
pub(super) fn run<S: Send, M: Fn() -> S + Sync + Send>(
    py: Python<'_>,
    axes: &[usize],
    batch: Batch<'_, S, M>,
    work: impl FnOnce(Batch<'_, S, M>) -> Result<(), Fault> + Send,
) -> PyResult<()> {
    let short = batch.states.saturating_mul(batch.cost) < WORTH_RELEASING;
    let outcome = if short { work(batch) } else { detached(py, || work(batch))? };
    outcome.map_err(|error| fault(py, error, axes))
}
