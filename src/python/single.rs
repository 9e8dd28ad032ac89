//! One state in plain float64 arrays: the shortest way to the kernel.
//!
//! For a small robot the kernel takes less than what a batch needs: axes that broadcast, the account of who borrows which
//! array, lanes. M of one link takes 0.2 us by this way and 0.45 us as the batch of one, forward dynamics of a chain of seven 0.8 and 1.1 us.
//! Whatever is not this case, refusals included, is left to [`evaluate`](super::evaluate).

use super::cost::{Cost, WORTH_RELEASING};
use super::errors::fault;
use super::input::plain;
use super::object::Object;
use super::output::{Output, from_numbers};
use super::scene::PyScene;
use super::scratch::Scratch;
use crate::algorithm::{Algorithm, Arguments};
use pyo3::prelude::*;

/// As many numbers are written elsewhere first and copied, which takes less time than keeping account of who borrows an array.
const COPIED: usize = 1024;

impl PyScene {
    /// Runs `algorithm` on q, qd and u, as many of them as it takes, into an array of this shape.
    ///
    /// None where that is not one plain state, or takes so long (by its `cost`) that the GIL is to be given up.
    pub(super) fn single<'py, const N: usize>(
        &self,
        py: Python<'py>,
        algorithm: Algorithm,
        given: [&Object<'py>; N],
        shape: &[usize],
        cost: Cost,
        out: Option<&Object<'py>>,
    ) -> PyResult<Option<Object<'py>>> {
        if cost.of_one() >= WORTH_RELEASING {
            return Ok(None);
        }
        let scene = &self.scene;
        let widths = [scene.nq(), scene.nv(), scene.nv()];
        // What is not given is empty, and has no addresses.
        let mut arguments = [const { (Vec::new(), 0..0) }; 3];
        for ((argument, value), width) in arguments.iter_mut().zip(given).zip(widths) {
            let Some(found) = plain(value, width) else { return Ok(None) };
            *argument = found;
        }
        let [(q, _), (qd, _), (u, _)] = &arguments;
        let state = [Arguments { q, qd, u, wrenches: &[], ..Arguments::default() }];
        let output = match out {
            Some(out) => Some(Output::given(out, shape, arguments.iter().map(|(_, addresses)| addresses.clone()))?),
            None => None,
        };
        self.pool.with(
            || Scratch::new(scene),
            |Scratch { evaluator, results, .. }| {
                let evaluator = evaluator.get_or_insert_with(|| scene.evaluator());
                let mut run = |results: &mut [f64]| {
                    scene.evaluate(evaluator, algorithm, &state, results).map_err(|error| fault(py, error, &[]))
                };
                if let Some(mut output) = output {
                    run(output.numbers()?)?;
                    return Ok(Some(output.finish().into_any()));
                }
                let width = scene.width(algorithm);
                if width > COPIED {
                    let mut output = Output::unwritten(py, shape)?;
                    run(output.numbers()?)?;
                    return Ok(Some(output.finish().into_any()));
                }
                results.resize(width, 0.0);
                run(results)?;
                from_numbers(py, results, shape).map(Some)
            },
        )
    }
}
