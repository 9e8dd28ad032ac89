//! One state in plain float64 arrays: the shortest path to the kernel.
//!
//! For a small robot, the kernel takes less time than the preparation of a batch: broadcasting, borrow tracking of
//! arrays, lanes. M of one link takes 0.2 us on this path and 0.45 us as a batch of one, forward dynamics of a chain of
//! seven 0.8 and 1.1 us. All other cases, including invalid arguments, are handled by [`evaluate`](super::evaluate),
//! and by [`each`](super::each) for methods without a vectorized kernel.

use super::cost::{Cost, WORTH_RELEASING};
use super::fresh::entries;
use super::input::plain;
use super::object::Object;
use super::output::{Output, from_numbers};
use super::scene::PyScene;
use super::scratch::Scratch;
use crate::algorithm::{Algorithm, Arguments};
use crate::error::Error;
use crate::scene::Scene;
use pyo3::prelude::*;

/// Results of up to this many numbers are written to a buffer and copied, which is faster than tracking the borrow of
/// an array.
const COPIED: usize = 1024;

impl PyScene {
    /// Evaluates `algorithm` at q, qd and u, as many of them as it has, into an array of this shape.
    ///
    /// None if the arguments are not one plain state, or if the call should release the GIL because of its `cost`.
    pub(super) fn single<'py, const N: usize>(
        &self,
        py: Python<'py>,
        algorithm: Algorithm,
        given: [&Object<'py>; N],
        shape: &[usize],
        cost: Cost,
        out: Option<&Object<'py>>,
    ) -> PyResult<Option<Object<'py>>> {
        self.single_by(py, given, shape, cost, out, |scene, scratch, state, results| {
            let evaluator = scratch.evaluator.get_or_insert_with(|| scene.evaluator());
            let of = |k: usize| state.get(k).copied().unwrap_or_default();
            let state = [Arguments { q: of(0), qd: of(1), u: of(2), ..Arguments::default() }];
            scene.evaluate(evaluator, algorithm, &state, results).map_err(|fault| fault.error)
        })
    }

    /// The same with any kernel of one state, which receives q, then one or two arrays of shape (nv,).
    #[inline(always)] // what the kernel is given would be stored and loaded again
    pub(super) fn single_by<'py, const N: usize>(
        &self,
        py: Python<'py>,
        given: [&Object<'py>; N],
        shape: &[usize],
        cost: Cost,
        out: Option<&Object<'py>>,
        kernel: impl FnOnce(&Scene, &mut Scratch, [&[f64]; N], &mut [f64]) -> Result<(), Error>,
    ) -> PyResult<Option<Object<'py>>> {
        if cost.of_one() >= WORTH_RELEASING {
            return Ok(None);
        }
        let scene = &self.scene;
        let widths = [scene.nq(), scene.nv(), scene.nv()];
        // Arguments that are not given are empty and have no addresses.
        let mut arguments = [const { (Vec::new(), 0..0) }; 3];
        for ((argument, value), width) in arguments.iter_mut().zip(given).zip(widths) {
            let Some(found) = plain(value, width) else { return Ok(None) };
            *argument = found;
        }
        let output = match out {
            Some(out) => Some(Output::given(out, shape, arguments.iter().map(|(_, addresses)| addresses.clone()))?),
            None => None,
        };
        let state = std::array::from_fn(|k| &arguments[k].0[..]);
        self.pool.with(
            || Scratch::new(scene),
            |scratch| {
                if let Some(mut output) = output {
                    kernel(scene, scratch, state, output.numbers()?)?;
                    return Ok(Some(output.finish().into_any()));
                }
                let width = entries(shape).unwrap_or_default();
                if width > COPIED {
                    let mut output = Output::unwritten(py, shape)?;
                    kernel(scene, scratch, state, output.numbers()?)?;
                    return Ok(Some(output.finish().into_any()));
                }
                let mut results = std::mem::take(&mut scratch.results);
                results.resize(width, 0.0);
                let outcome = kernel(scene, scratch, state, &mut results);
                let array = outcome.map_err(PyErr::from).and_then(|()| from_numbers(py, &results, shape));
                scratch.results = results;
                array.map(Some)
            },
        )
    }
}
