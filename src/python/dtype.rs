//! The argument `dtype`: results in float64, or rounded to float32.

use super::errors::refuse;
use super::object::Object;
use crate::algorithm::Algorithm;
use crate::batch::Fault;
use crate::error::Error;
use numpy::{Element, PyArrayDescr, PyArrayDescrMethods};
use pyo3::prelude::*;

/// Type of results. The arithmetic is always in f64.
pub(super) trait Dtype: Element + Copy + Default + 'static {
    const NAME: &'static str;

    /// The value nearest to `x`; infinite beyond the largest.
    fn nearest(x: f64) -> Self;

    /// Memory in which results are computed: that of the results for f64, else `room`, in the same length.
    fn in_f64<'a>(results: &'a mut [Self], room: &'a mut Vec<f64>) -> &'a mut [f64];

    /// True if rounding to this type keeps a finite value finite.
    fn can_hold(x: f64) -> bool;
}

impl Dtype for f64 {
    const NAME: &'static str = "float64";

    fn nearest(x: f64) -> Self {
        x
    }

    fn in_f64<'a>(results: &'a mut [Self], _room: &'a mut Vec<f64>) -> &'a mut [f64] {
        results
    }

    fn can_hold(_x: f64) -> bool {
        true
    }
}

impl Dtype for f32 {
    const NAME: &'static str = "float32";

    #[allow(clippy::cast_possible_truncation)] // rounding is the purpose
    fn nearest(x: f64) -> Self {
        x as Self
    }

    fn in_f64<'a>(results: &'a mut [Self], room: &'a mut Vec<f64>) -> &'a mut [f64] {
        room.clear();
        room.resize(results.len(), f64::NAN);
        room
    }

    fn can_hold(x: f64) -> bool {
        Self::nearest(x).is_finite()
    }
}

/// The outcome of an evaluation of states with `width` results each, and the first result that `P` cannot hold.
pub(super) fn check_range<P: Dtype>(
    outcome: Result<(), Fault>,
    algorithm: Algorithm,
    results: &[f64],
    width: usize,
) -> Result<(), Fault> {
    let valid = outcome.as_ref().map_or_else(|fault| fault.state * width, |()| results.len());
    let Some(at) = results[..valid].iter().position(|&x| !P::can_hold(x)) else { return outcome };
    let entry = algorithm.entry();
    let name = if let [(name, _)] = entry.results { name } else { entry.name };
    let found = format!("{:e} at index {}, which {} cannot hold", results[at], at % width, P::NAME);
    let expected = "results below 3.4e38; float64 holds this one";
    Err(Fault { state: at / width, error: Error::argument(format!("{name} (result)"), found, expected) })
}

/// True if the argument `dtype` is float32: any value that `NumPy` accepts for float64 or float32; None: float64.
pub(super) fn is_float32(dtype: Option<&Object<'_>>) -> PyResult<bool> {
    let Some(given) = dtype else { return Ok(false) };
    let py = given.py();
    match PyArrayDescr::new(py, given) {
        Ok(found) if found.is_equiv_to(&numpy::dtype::<f64>(py)) => Ok(false),
        Ok(found) if found.is_equiv_to(&numpy::dtype::<f32>(py)) => Ok(true),
        _ => refuse("dtype", given.repr()?.to_string(), "numpy.float64 or numpy.float32"),
    }
}
