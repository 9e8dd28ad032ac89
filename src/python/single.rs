//! One state in plain float64 arrays: the shortest way to the kernel.
//!
//! For a small robot the kernel takes less than what a batch needs: axes that broadcast, the account of who borrows which
//! array, lanes. Whatever is not this case, refusals included, is left to [`Call`](super::evaluate::Call).

use super::arrays::{Output, from_numbers, plain};
use super::cost::Cost;
use super::errors::fault;
use super::evaluate::WORTH_RELEASING;
use super::scene::PyScene;
use crate::algorithm::{Algorithm, Arguments};
use crate::batch::evaluator::Evaluator;
use pyo3::prelude::*;
use std::sync::Mutex;

/// What single states are evaluated with, kept between calls.
///
/// The lock is never waited for: a call that finds it held, by a thread that is about to raise or below a signal handler, goes the
/// long way.
#[derive(Default)]
pub(super) struct Kept(Mutex<Option<Room>>);

struct Room {
    evaluator: Evaluator,
    results: Vec<f64>,
}

impl Room {
    fn new(evaluator: Evaluator) -> Self {
        Self { evaluator, results: Vec::new() }
    }
}

/// What a call may have been given beside the state.
#[derive(Clone, Copy, Default)]
pub(super) struct Keywords<'a, 'py> {
    pub wrenches: Option<&'a Bound<'py, PyAny>>,
    pub out: Option<&'a Bound<'py, PyAny>>,
    pub dtype: Option<&'a Bound<'py, PyAny>>,
    /// Whether bad states become NaN.
    pub nan: bool,
}

impl PyScene {
    /// Runs `algorithm` on q, qd and u, as many of them as it takes, into an array of this shape.
    ///
    /// None where that is not one plain state without wrenches and dtype, or takes so long (by its `cost`) that the GIL is to
    /// be given up.
    pub(super) fn single<'py, const N: usize>(
        &self,
        py: Python<'py>,
        algorithm: Algorithm,
        given: [&Bound<'py, PyAny>; N],
        shape: &[usize],
        cost: Cost,
        keywords: Keywords<'_, 'py>,
    ) -> PyResult<Option<Bound<'py, PyAny>>> {
        let Keywords { wrenches: None, dtype: None, nan: false, out } = keywords else { return Ok(None) };
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
        let Ok(mut kept) = self.single.0.try_lock() else { return Ok(None) };
        let Room { evaluator, results } = kept.get_or_insert_with(|| Room::new(scene.evaluator()));
        let [(q, _), (qd, _), (u, _)] = &arguments;
        let mut run = |results: &mut [f64]| {
            let state = Arguments { q, qd, u, wrenches: &[] };
            scene.evaluate(evaluator, algorithm, &[state], results).map_err(|error| fault(py, error, &[]))
        };
        if let Some(out) = out {
            let addresses = arguments.iter().map(|(_, addresses)| addresses.clone());
            let mut output = Output::given(out, shape, addresses)?;
            run(output.numbers()?)?;
            return Ok(Some(output.finish().into_any()));
        }
        results.resize(scene.width(algorithm), 0.0);
        run(results)?;
        from_numbers(py, results, shape).map(Some)
    }
}
