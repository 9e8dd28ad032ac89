//! Kinematic quantities, and methods that evaluate states one at a time, from the arguments of a call to its result.

use super::bad_states::is_nan;
use super::call::BatchCall;
use super::cost::{Cost, WORTH_RELEASING};
use super::keywords::Keywords;
use super::object::Object;
use super::output::Output;
use super::scene::PyScene;
use super::scratch::Scratch;
use crate::algorithm::{Arguments, KinematicQuantity};
use crate::error::Error;
use crate::scene::Scene;
use pyo3::prelude::*;

impl PyScene {
    /// Evaluates a kinematic quantity of every state: of q, qd and qdd, as many as its row of the table has, into a
    /// new array of the shape that it has there, or a NumPy scalar for the empty shape. A single plain state takes
    /// the short path; others are vectorized.
    pub(super) fn kinematic_quantity<'py, const N: usize>(
        &self,
        py: Python<'py>,
        what: &KinematicQuantity<'_>,
        values: [&Object<'py>; N],
        keywords: &Keywords<'_, 'py>,
    ) -> PyResult<Object<'py>> {
        let (entry, mut room) = (what.entry(), [0; 4]);
        if entry.needs_mass && !keywords.has_models() {
            self.scene.check_has_mass()?;
        }
        let shape = entry.shape(&self.scene.sizes(), &mut room);
        if !is_nan(keywords.errors)? && !keywords.has_models() {
            let kernel = |scene: &Scene, scratch: &mut Scratch, state: [&[f64]; N], out: &mut [f64]| {
                let evaluator = scratch.evaluator.get_or_insert_with(|| scene.evaluator());
                let of = |k: usize| state.get(k).copied().unwrap_or_default();
                let state = [Arguments { q: of(0), qd: of(1), u: of(2), ..Arguments::default() }];
                scene.evaluate_kinematic_quantity(evaluator, what, &state, out).map_err(|fault| fault.error)
            };
            // The depth of the frame is counted only if the cost of all bodies is not small.
            let most = self.cost_per_body(what) * self.size();
            let cost = Cost::of(if most < WORTH_RELEASING { most } else { self.cost_of(what) });
            if let Some(result) = self.single_by(py, values, shape, cost, None, kernel)? {
                return Ok(result);
            }
        }
        let call = self.call_of_quantity(what, values, keywords)?;
        let mut output = call.output(py, shape, None, Output::unwritten)?;
        call.quantity_in_chunks(py, what, output.numbers()?)?;
        output.finish_or_scalar()
    }

    /// A call of a kinematic quantity, with the models of the states.
    pub(super) fn call_of_quantity<'py, const N: usize>(
        &self,
        what: &KinematicQuantity<'_>,
        values: [&Object<'py>; N],
        keywords: &Keywords<'_, 'py>,
    ) -> PyResult<BatchCall<'_, 'py>> {
        let names = what.entry().arguments.iter().map(|&(name, _)| name);
        self.call_by(self.inputs(names.zip(values))?, self.cost_of(what), keywords)
    }

    /// Approximate time of a kinematic quantity of one state, ns.
    pub(super) fn cost_of(&self, what: &KinematicQuantity<'_>) -> usize {
        self.cost_per_body(what) * what.frame().map_or(self.size(), |frame| self.depth(frame))
    }

    fn cost_per_body(&self, what: &KinematicQuantity<'_>) -> usize {
        let [body, body_and_column] = what.entry().cost;
        body + body_and_column * self.scene.nv()
    }

    /// Evaluates every state, of `cost` ns each, into a new array of shape batch + `shape`, or a NumPy scalar for the
    /// empty shape.
    ///
    /// The kernel receives q, then one or two arrays of shape (nv,), according to `given`.
    #[inline(always)] // as `single_by`
    pub(super) fn each<'py, K, const N: usize>(
        &self,
        py: Python<'py>,
        given: [(&'static str, &Object<'py>); N],
        shape: &[usize],
        cost: usize,
        errors: &str,
        kernel: K,
    ) -> PyResult<Object<'py>>
    where
        K: Fn(&Scene, &mut Scratch, [&[f64]; N], &mut [f64]) -> Result<(), Error> + Sync,
    {
        if !is_nan(errors)? {
            let values = given.map(|(_, value)| value);
            if let Some(result) = self.single_by(py, values, shape, Cost::of(cost), None, &kernel)? {
                return Ok(result);
            }
        }
        let call = self.call(self.inputs(given)?, cost, errors)?;
        let mut output = call.output(py, shape, None, Output::new)?;
        call.numbers(py, output.numbers()?, kernel)?;
        output.finish_or_scalar()
    }
}
