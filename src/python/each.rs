//! Methods that evaluate states one by one, from the arguments of a call to its result.

use super::bad_states::is_nan;
use super::cost::Cost;
use super::object::Object;
use super::output::Output;
use super::scene::PyScene;
use super::scratch::Scratch;
use crate::error::Error;
use crate::scene::Scene;
use pyo3::prelude::*;

impl PyScene {
    /// Evaluates every state, of so many ns each, into a new array of shape batch + `shape`; a NumPy scalar for the empty shape.
    ///
    /// The kernel gets q, then one or two arrays of rates, as many as are `given`.
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
        let mut inputs = Vec::with_capacity(N);
        for (at, (name, value)) in given.into_iter().enumerate() {
            inputs.push(if at == 0 { self.configuration(name, value)? } else { self.rate(name, value)? });
        }
        let call = self.call(inputs, cost, errors)?;
        let mut output = call.output(py, shape, None, Output::new)?;
        call.numbers(py, output.numbers()?, kernel)?;
        output.finish_or_scalar()
    }
}
