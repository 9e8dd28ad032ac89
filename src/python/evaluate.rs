//! Algorithms with vectorized (SIMD) kernels, from the arguments of a call to its result.

use super::accuracy::BatchAccuracy;
use super::bad_states::{Errors, is_nan};
use super::call::BatchCall;
use super::choice::read_judged;
use super::cost::Cost;
use super::dtype::{Dtype, check_range, is_float32};
use super::fresh::entries;
use super::keywords::Keywords;
use super::object::Object;
use super::output::Output;
use super::scene::PyScene;
use super::scratch::Scratch;
use super::wrenches::{self, Wrench};
use crate::algorithm::{Algorithm, Arguments, KinematicQuantity};
use crate::batch::evaluator::Evaluator;
use crate::batch::instruction_set::InstructionSet;
use crate::batch::{Broadcast, Fault};
use crate::error::Error;
use crate::filter::Form;
use crate::scalar::MOST_LANES;
use pyo3::prelude::*;

impl PyScene {
    /// Evaluates `algorithm` for every state of the arguments: q, qd and u, as many as its row of the table has.
    pub(super) fn evaluate<'py, const N: usize>(
        &self,
        py: Python<'py>,
        algorithm: fn(Form) -> Algorithm,
        values: [&Object<'py>; N],
        keywords: &Keywords<'_, 'py>,
    ) -> PyResult<Object<'py>> {
        let &Keywords { wrenches, out, dtype, errors, form, tolerance, return_info, .. } = keywords;
        let algorithm = algorithm(read_judged(&self.scene, (form, tolerance), algorithm)?);
        let (entry, mut room) = (algorithm.entry(), [0; 4]);
        if let Some(instead) = entry.instead {
            self.check_dense(entry.name, instead)?;
        }
        let shape = entry.shape(&self.scene.sizes(), &mut room);
        let is_connected = !self.scene.connections().is_empty();
        let body = match algorithm {
            Algorithm::ConstrainedDynamics(_) => self.cost_through_connections(),
            Algorithm::ForwardDynamics(_) if is_connected => self.cost_through_connections(),
            _ => entry.cost[0] + entry.cost[1] * self.scene.nv(),
        };
        let cost = Cost { arithmetic: body * self.size(), results: entries(shape).unwrap_or(usize::MAX) };
        let is_plain = !is_nan(errors)?
            && !return_info
            && wrenches.is_none()
            && dtype.is_none()
            && tolerance.is_none()
            && !keywords.has_models();
        if is_plain && let Some(result) = self.single(py, algorithm, values, shape, cost, out)? {
            self.warn_of_linkage(py)?;
            return Ok(result);
        }
        let result = if is_float32(dtype)? {
            self.in_lanes::<f32, N>(py, (algorithm, cost), values, shape, keywords)
        } else {
            self.in_lanes::<f64, N>(py, (algorithm, cost), values, shape, keywords)
        };
        self.warn_of_linkage(py)?;
        result
    }

    fn in_lanes<'py, P: Dtype, const N: usize>(
        &self,
        py: Python<'py>,
        (algorithm, cost): (Algorithm, Cost),
        values: [&Object<'py>; N],
        shape: &[usize],
        keywords: &Keywords<'_, 'py>,
    ) -> PyResult<Object<'py>> {
        let names = algorithm.entry().arguments.iter().map(|&(name, _)| name);
        let inputs = self.inputs(names.zip(values))?;
        let wrenches = Wrench::read(&self.scene, keywords.wrenches)?;
        let form = algorithm.form();
        let call = BatchCall::of_models(self, inputs, wrenches, keywords.models(&self.scene)?, cost)?;
        let call = call.with(self.errors(keywords.errors, form)?);
        let call = call.accepting(keywords.tolerance);
        let accuracy = match form {
            Some(form) if keywords.return_info => Some(BatchAccuracy::new(form, call.states)?),
            _ => None,
        };
        let mut output = call.output::<P>(py, shape, keywords.out, Output::unwritten)?;
        call.in_chunks(py, algorithm, output.numbers()?, accuracy.as_ref())?;
        let result = output.finish().into_any();
        match accuracy {
            Some(accuracy) => Ok((result, accuracy.finish(py, &call.batch)?).into_pyobject(py)?.into_any()),
            None => Ok(result),
        }
    }

    /// Reads the argument `errors`; faults of the scene in this form, which concern all states, are raised first.
    pub(super) fn errors(&self, errors: &str, form: Option<Form>) -> Result<Errors, Error> {
        let errors = Errors::read(errors)?;
        if let (true, Some(form)) = (errors.are_gathered(), form) {
            self.scene.check_roots(form)?;
        }
        Ok(errors)
    }
}

impl<'py> BatchCall<'_, 'py> {
    /// Evaluates `algorithm` for every state, in chunks of the number of lanes, and rounds the results to `P`.
    pub(super) fn in_chunks<P: Dtype>(
        &self,
        py: Python<'py>,
        algorithm: Algorithm,
        results: &mut [P],
        accuracy: Option<&BatchAccuracy>,
    ) -> PyResult<()> {
        if accuracy.is_none() && self.is_void(results) {
            return Ok(());
        }
        let (scene, cost) = (&self.scene.scene, self.cost.of_many(self.states, algorithm));
        let width = scene.width(algorithm);
        self.chunks(py, (width, cost), None, results, &|evaluator, states, first, out| {
            let outcome = match accuracy {
                Some(accuracy) => accuracy.evaluate(scene, evaluator, states, first, out),
                None => scene.evaluate(evaluator, algorithm, states, out),
            };
            check_range::<P>(outcome, algorithm, out, width)
        })
    }

    /// The same for a third seed vector that `third` computes from several arguments.
    pub(super) fn seeded_in_chunks(
        &self,
        py: Python<'py>,
        algorithm: Algorithm,
        third: &Third<'_>,
        results: &mut [f64],
    ) -> PyResult<()> {
        let (scene, cost) = (&self.scene.scene, self.cost.of_many(self.states, algorithm));
        let width = scene.width(algorithm);
        self.chunks(py, (width, cost), Some(third), results, &|evaluator, states, _, out| {
            scene.evaluate(evaluator, algorithm, states, out)
        })
    }

    /// Evaluates every state in chunks of the number of lanes, with `width` results of `cost` ns per state, and rounds
    /// the results to `P`: `run` receives the states, the index of the first, and the memory of the results.
    pub(super) fn chunks<P: Dtype>(
        &self,
        py: Python<'py>,
        (width, cost): (usize, usize),
        third: Option<&Third<'_>>,
        results: &mut [P],
        run: &Run<'_>,
    ) -> PyResult<()> {
        let scene = &self.scene.scene;
        let ((arguments, wrenches), models) = (self.over()?, self.models.over(&self.batch)?);
        let (bodies, errors, tolerance) = (scene.model().bodies.len(), &self.errors, self.tolerance);
        self.run(py, cost, |batch| {
            batch.run_pieces(MOST_LANES, results, |scratch, states, results| {
                let Scratch { evaluator, forces, .. } = scratch;
                let evaluator = evaluator.get_or_insert_with(|| Evaluator::new(scene));
                let (lanes, mut room) = (evaluator.lanes(), Vec::new());
                let mut thirds = vec![Vec::new(); if third.is_some() { lanes } else { 0 }];
                // Reset for every chunk only if it contains forces: that is a kilobyte, a tenth of the time of inverse
                // dynamics.
                let mut chunk = [Arguments { tolerance, ..Arguments::default() }; MOST_LANES];
                for first in states.clone().step_by(lanes) {
                    let count = lanes.min(states.end - first);
                    let from = (first - states.start) * width;
                    let rounded = &mut results[from..from + count * width];
                    let out = P::in_f64(rounded, &mut room);
                    take(&mut chunk[..count], &arguments, first);
                    if !models.is_empty() {
                        for (lane, state) in chunk[..count].iter_mut().enumerate() {
                            state.model = models.of(first + lane);
                        }
                    }
                    if wrenches.is_empty() && third.is_none() {
                        evaluate((evaluator, run, errors), &chunk[..count], first, out)?;
                    } else {
                        let mut chunk = chunk;
                        let mut is_bad = [false; MOST_LANES];
                        let mut thirds = thirds.iter_mut();
                        for (lane, (state, forces)) in chunk.iter_mut().zip(&mut *forces).take(count).enumerate() {
                            let at = first + lane;
                            let mut outcome = wrenches::on_bodies(&wrenches, bodies, at, forces);
                            state.wrenches = forces;
                            if let (Some(third), Some(numbers)) = (third, thirds.next()) {
                                outcome = outcome.and_then(|()| third(&arguments, at, numbers));
                                state.seed[2] = numbers;
                            }
                            if let Err(error) = outcome {
                                errors.note(Fault { state: at, error })?;
                                is_bad[lane] = true;
                            }
                        }
                        evaluate((evaluator, run, errors), &chunk[..count], first, out)?;
                        for lane in (0..count).filter(|&lane| is_bad[lane]) {
                            out[lane * width..(lane + 1) * width].fill(f64::NAN);
                        }
                    }
                    // Empty for f64, whose results are in place.
                    for (rounded, &result) in rounded.iter_mut().zip(&room) {
                        *rounded = P::nearest(result);
                    }
                }
                Ok(())
            })
        })
    }

    /// Evaluates a kinematic quantity for every state, in chunks of the number of lanes.
    pub(super) fn quantity_in_chunks(
        &self,
        py: Python<'py>,
        what: &KinematicQuantity<'_>,
        results: &mut [f64],
    ) -> PyResult<()> {
        if self.is_void(results) {
            return Ok(());
        }
        let scene = &self.scene.scene;
        let lanes = InstructionSet::of_process().lanes().min(self.states.max(1));
        let cost = self.cost.of_one() / lanes;
        self.chunks(py, (what.width(scene.nv()), cost), None, results, &|evaluator, states, _, out| {
            scene.evaluate_kinematic_quantity(evaluator, what, states, out)
        })
    }
}

/// Function that evaluates neighboring states of a batch from an index on.
pub(super) type Run<'a> = dyn Fn(&mut Evaluator, &[Arguments<'_>], usize, &mut [f64]) -> Result<(), Fault> + Sync + 'a;

/// Function that writes the third seed vector of one state of these arguments.
pub(super) type Third<'a> = dyn Fn(&[Broadcast<'_>], usize, &mut Vec<f64>) -> Result<(), Error> + Sync + 'a;

/// Sets the arguments of neighboring states of a batch: q, qd, u and the seed, but not the forces.
fn take<'a>(states: &mut [Arguments<'a>], arguments: &[Broadcast<'a>], first: usize) {
    let of = |k: usize, state: usize| arguments.get(k).map_or(&[][..], |argument| argument.state(state));
    for (i, state) in states.iter_mut().enumerate() {
        (state.q, state.qd, state.u) = (of(0, first + i), of(1, first + i), of(2, first + i));
        if arguments.len() > 3 {
            state.seed = [of(3, first + i), of(4, first + i), of(5, first + i)];
        }
    }
}

/// Evaluates neighboring states of a batch from index `first` on. If faults are collected, invalid states do not affect
/// the others.
fn evaluate(
    (evaluator, run, errors): (&mut Evaluator, &Run<'_>, &Errors),
    states: &[Arguments<'_>],
    first: usize,
    out: &mut [f64],
) -> Result<(), Fault> {
    let (width, mut done) = (out.len() / states.len(), 0);
    // The states before an invalid one are finished, in the same lanes as without it.
    while let Err(fault) = run(evaluator, &states[done..], first + done, &mut out[done * width..]) {
        let bad = done + fault.state;
        errors.note(Fault { state: first + bad, ..fault })?;
        out[bad * width..(bad + 1) * width].fill(f64::NAN);
        done = bad + 1;
        if done == states.len() {
            break;
        }
    }
    Ok(())
}
