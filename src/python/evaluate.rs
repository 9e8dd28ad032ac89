//! One call: its arguments over the states of the batch, its result, and the GIL.

use super::accuracy::Told;
use super::arrays::{Input, Output};
use super::bad_states::Errors;
use super::cost::Cost;
use super::errors::{asked_by, fault};
use super::estimation::Estimation;
use super::interrupts::detached;
use super::scene::PyScene;
use super::wrenches::{self, Wrench};
use crate::algorithm::{Algorithm, Arguments};
use crate::batch::evaluator::{Evaluated, Evaluator};
use crate::batch::{Batch, Broadcast, Fault, broadcast_axes};
use crate::dynamics::operational::OperationalScratch;
use crate::error::Error;
use crate::filter::Form;
use crate::memory;
use crate::scalar::MOST_LANES;
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::Workspace;
use numpy::{Element, PyArrayDyn};
use pyo3::prelude::*;

/// The GIL is kept for calls shorter than this (ns of one thread), as `NumPy` does: giving it up takes a tenth of a
/// microsecond where nobody wants it, and up to five milliseconds to get back where somebody does.
pub(super) const WORTH_RELEASING: usize = 5_000;

/// What a thread needs to evaluate states, kept between calls.
pub(super) struct Scratch {
    /// Per-body arrays of the recursions; the kernels are the evaluators'.
    pub workspace: Workspace<f64>,
    /// For estimation only.
    pub estimation: Option<Estimation>,
    /// For operational space only.
    pub operational: Option<OperationalScratch<f64>>,
    /// What runs the kernels in lanes, of float64 and of float32.
    evaluator: Option<Evaluator>,
    evaluator_f32: Option<Evaluator<f32>>,
    /// Forces on bodies of the state at hand; empty without wrenches.
    pub forces: Vec<SpatialVector<f64>>,
    /// The same of as many states as there are lanes.
    lane_forces: Vec<Vec<SpatialVector<f64>>>,
}

impl Scratch {
    pub(super) fn new(scene: &Scene) -> Self {
        Self {
            workspace: Workspace::new(scene.model()),
            estimation: None,
            operational: None,
            evaluator: None,
            evaluator_f32: None,
            forces: Vec::new(),
            lane_forces: vec![Vec::new(); MOST_LANES],
        }
    }
}

/// A dtype that the algorithms in lanes compute in.
pub(super) trait Dtype: Evaluated + Element {
    /// What runs them, and the forces on bodies of the states at hand.
    fn parts(scratch: &mut Scratch) -> (&mut Option<Evaluator<Self>>, &mut [Vec<SpatialVector<f64>>]);
}

impl Dtype for f64 {
    fn parts(scratch: &mut Scratch) -> (&mut Option<Evaluator<Self>>, &mut [Vec<SpatialVector<f64>>]) {
        (&mut scratch.evaluator, &mut scratch.lane_forces)
    }
}

impl Dtype for f32 {
    fn parts(scratch: &mut Scratch) -> (&mut Option<Evaluator<Self>>, &mut [Vec<SpatialVector<f64>>]) {
        (&mut scratch.evaluator_f32, &mut scratch.lane_forces)
    }
}

/// The arguments of a call, the leading axes they broadcast to, and about how long one state takes.
pub(super) struct Call<'a, 'py, const N: usize, P: Element = f64> {
    scene: &'a PyScene,
    inputs: [Input<'py, P>; N],
    wrenches: Vec<Wrench<'py>>,
    /// The leading axes of the result.
    pub batch: Vec<usize>,
    states: usize,
    cost: Cost,
    errors: Errors,
    told: Option<Told>,
}

/// The arguments of neighbouring states of a batch, q, then qd, then u; forces stay as they are.
fn take<'a, P>(states: &mut [Arguments<'a, P>], arguments: &[Broadcast<'a, P>], first: usize) {
    let of = |k: usize, state: usize| arguments.get(k).map_or(&[][..], |argument| argument.state(state));
    for (i, state) in states.iter_mut().enumerate() {
        (state.q, state.qd, state.u) = (of(0, first + i), of(1, first + i), of(2, first + i));
    }
}

/// Evaluates neighbouring states of a batch, the first of which is its `first`; with bad ones among them the others all the same, if faults
/// are gathered.
fn evaluate<P: Dtype>(
    scene: &Scene,
    (evaluator, algorithm): (&mut Evaluator<P>, Algorithm),
    states: &[Arguments<'_, P>],
    first: usize,
    out: &mut [P],
    (errors, told): (&Errors, Option<&Told>),
) -> Result<(), Fault> {
    let width = scene.width(algorithm);
    let mut done = 0;
    let mut from = |done: usize, out: &mut [P]| match told {
        Some(told) => told.evaluate(scene, evaluator, &states[done..], first + done, out),
        None => scene.evaluate(evaluator, algorithm, &states[done..], out),
    };
    // Those before a bad one are done, in the lanes that they would have without it.
    while let Err(fault) = from(done, &mut out[done * width..]) {
        let bad = done + fault.state;
        errors.note(Fault { state: first + bad, ..fault })?;
        out[bad * width..(bad + 1) * width].fill(P::nearest(f64::NAN));
        done = bad + 1;
        if done == states.len() {
            break;
        }
    }
    Ok(())
}

impl<'a, 'py, const N: usize, P: Dtype> Call<'a, 'py, N, P> {
    /// A call with these arguments.
    pub fn new(
        scene: &'a PyScene,
        inputs: [Input<'py, P>; N],
        wrenches: Vec<Wrench<'py>>,
        cost: impl Into<Cost>,
    ) -> PyResult<Self> {
        let given = inputs.iter().map(|input| (&*input.name, input.leading()));
        let all = given.chain(wrenches.iter().map(|Wrench { input, .. }| (&*input.name, input.leading())));
        let batch = if all.clone().all(|(_, leading)| leading.is_empty()) { Vec::new() } else { broadcast_axes(all)? };
        let states = batch.iter().try_fold(1, |product: usize, &length| product.checked_mul(length));
        let Some(states) = states else {
            return Err(Error::argument("batch", "more states than memory has addresses", "fewer").into());
        };
        Ok(Self { scene, inputs, wrenches, batch, states, cost: cost.into(), errors: Errors::Raise, told: None })
    }

    /// The same call with another choice of what becomes of bad states.
    pub fn with(self, errors: Errors) -> Self {
        Self { errors, ..self }
    }

    /// The same call of forward dynamics, which tells its accuracy.
    pub fn telling(self, form: Form) -> Result<Self, Error> {
        let told = Some(Told::new(form, self.states)?);
        Ok(Self { told, ..self })
    }

    /// What a call that is [`telling`](Self::telling) found of its accuracy.
    pub fn accuracy(self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.told.map(|told| told.finish(py, &self.batch)).transpose()
    }

    /// Runs `algorithm` on every state, in lanes, into an array of shape batch + `shape`; the inputs are q, then qd, then u.
    pub fn algorithm(
        &self,
        py: Python<'py>,
        algorithm: Algorithm,
        shape: &[usize],
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
        let mut output = self.output(py, shape, out, |full| Output::unwritten(py, full))?;
        let results = output.numbers()?;
        let scene = &self.scene.scene;
        let (arguments, wrenches) = self.over()?;
        let (width, errors, told) = (scene.width(algorithm), &self.errors, self.told.as_ref());
        let bodies = scene.model().bodies.len();
        self.run(py, self.cost.of_many::<P>(self.states, algorithm), |batch| {
            batch.run_pieces(MOST_LANES, results, |scratch, states, results| {
                let (evaluator, forces) = P::parts(scratch);
                let evaluator = evaluator.get_or_insert_with(|| Evaluator::new(scene));
                let (mut first, last) = (states.start, states.end);
                // Written anew for every chunk only where it holds forces: that is a kilobyte.
                let mut chunk = [Arguments::default(); MOST_LANES];
                while first < last {
                    let count = evaluator.lanes().min(last - first);
                    let from = (first - states.start) * width;
                    let out = &mut results[from..from + count * width];
                    if wrenches.is_empty() {
                        take(&mut chunk[..count], &arguments, first);
                        evaluate(scene, (&mut *evaluator, algorithm), &chunk[..count], first, out, (errors, told))?;
                    } else {
                        let mut chunk = chunk;
                        take(&mut chunk[..count], &arguments, first);
                        let mut is_bad = [false; MOST_LANES];
                        for (lane, (state, forces)) in chunk.iter_mut().zip(forces.iter_mut()).enumerate().take(count) {
                            if let Err(error) = wrenches::on_bodies(&wrenches, bodies, first + lane, forces) {
                                errors.note(Fault { state: first + lane, error })?;
                                is_bad[lane] = true;
                            }
                            state.wrenches = forces;
                        }
                        evaluate(scene, (&mut *evaluator, algorithm), &chunk[..count], first, out, (errors, told))?;
                        for lane in (0..count).filter(|&lane| is_bad[lane]) {
                            out[lane * width..(lane + 1) * width].fill(P::nearest(f64::NAN));
                        }
                    }
                    first += count;
                }
                Ok(())
            })
        })?;
        Ok(output.finish())
    }

    /// The array of shape batch + `shape` that receives the results: a new one from `make`, or the caller's `out`.
    fn output(
        &self,
        py: Python<'py>,
        shape: &[usize],
        out: Option<&Bound<'py, PyAny>>,
        make: impl FnOnce(&[usize]) -> PyResult<Output<'py, P>>,
    ) -> PyResult<Output<'py, P>> {
        let mut full = Vec::with_capacity(self.batch.len() + shape.len());
        full.extend_from_slice(&self.batch);
        full.extend_from_slice(shape);
        match out {
            None => match make(&full) {
                Ok(made) => Ok(made),
                Err(failed) => asked_by(py, &self.asking(), Err(failed)),
            },
            Some(out) => {
                let wrenches = self.wrenches.iter().map(|wrench| wrench.input.addresses());
                Output::given(out, &full, self.inputs.iter().map(Input::addresses).chain(wrenches))
            }
        }
    }

    /// The names of the arguments that make the batch as large as it is.
    pub fn asking(&self) -> String {
        let given = self.inputs.iter().map(|input| (&*input.name, input.leading()));
        let all = given.chain(self.wrenches.iter().map(|Wrench { input, .. }| (&*input.name, input.leading())));
        let names: Vec<&str> = all.filter(|(_, leading)| !leading.is_empty()).map(|(name, _)| name).collect();
        if names.is_empty() { "scene".to_owned() } else { names.join(", ") }
    }

    /// The arguments for the threads, which see no Python.
    fn over(&self) -> PyResult<(Vec<Broadcast<'_, P>>, Vec<wrenches::States<'_>>)> {
        let arguments = self.inputs.iter().map(|input| input.over(&self.batch)).collect::<PyResult<Vec<_>>>()?;
        let wrenches = self.wrenches.iter().map(|wrench| wrench.over(&self.batch)).collect::<PyResult<Vec<_>>>()?;
        Ok((arguments, wrenches))
    }

    /// Runs a batch, of so many ns a state, without the GIL, but for short calls.
    fn run(
        &self,
        py: Python<'py>,
        cost: usize,
        work: impl FnOnce(Batch<'_, Scratch, &(dyn Fn() -> Scratch + Sync)>) -> Result<(), Fault> + Send,
    ) -> PyResult<()> {
        let scene = &self.scene.scene;
        let make = || Scratch::new(scene);
        let batch =
            Batch { states: self.states, cost, pool: &self.scene.pool, make: &make as &(dyn Fn() -> Scratch + Sync) };
        let short = self.states.saturating_mul(cost) < WORTH_RELEASING;
        let outcome = if short {
            work(batch)
        } else {
            self.scene.check_scratch(self.states)?;
            detached(py, || work(batch))?
        };
        outcome.map_err(|error| fault(py, error, &self.batch))?;
        self.errors.warn(py, &self.batch)
    }
}

impl<'py, const N: usize> Call<'_, 'py, N> {
    /// Room for `width` numbers a state, where the result is not one array; for the arrays that they are copied to there is room too.
    pub fn scratch_results(&self, py: Python<'py>, width: usize) -> PyResult<Output<'py>> {
        memory::room(&self.asking(), memory::bytes_of::<f64>(&[self.states, width, 2]))?;
        let Some(entries) = self.states.checked_mul(width) else {
            return Err(Error::argument(self.asking(), "more numbers than memory has addresses", "fewer states").into());
        };
        asked_by(py, &self.asking(), Output::new(py, &[entries]))
    }

    /// Evaluates every state into an array of shape batch + `shape`: a new one, or the caller's `out`.
    pub fn array<K>(
        &self,
        py: Python<'py>,
        shape: &[usize],
        out: Option<&Bound<'py, PyAny>>,
        kernel: K,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>>
    where
        K: Fn(&Scene, &mut Scratch, [&[f64]; N], &mut [f64]) -> Result<(), Error> + Sync,
    {
        let mut output = self.output(py, shape, out, |full| Output::new(py, full))?;
        self.numbers(py, output.numbers()?, kernel)?;
        Ok(output.finish())
    }

    /// Evaluates every state into `results`, row-major over the batch.
    pub fn numbers<K>(&self, py: Python<'py>, results: &mut [f64], kernel: K) -> PyResult<()>
    where
        K: Fn(&Scene, &mut Scratch, [&[f64]; N], &mut [f64]) -> Result<(), Error> + Sync,
    {
        let scene = &self.scene.scene;
        let (arguments, wrenches) = self.over()?;
        let (bodies, errors) = (scene.model().bodies.len(), &self.errors);
        self.run(py, self.cost.of_one(), |batch| {
            batch.run(results, |scratch, i, out| {
                let outcome = wrenches::on_bodies(&wrenches, bodies, i, &mut scratch.forces)
                    .and_then(|()| kernel(scene, scratch, std::array::from_fn(|k| arguments[k].state(i)), out));
                if let Err(error) = outcome {
                    errors.note(Fault { state: i, error }).map_err(|fault| fault.error)?;
                    out.fill(f64::NAN);
                }
                Ok(())
            })
        })
    }
}
