//! Arguments that are one of some names or types.

use crate::error::Error;
use numpy::{PyArrayDescr, PyArrayDescrMethods};
use pyo3::prelude::*;

/// The thing of that name; the error lists the names that there are.
pub(super) fn choose<T: Copy>(argument: &str, name: &str, known: &[(&'static str, T)]) -> Result<T, Error> {
    known.iter().find(|(known, _)| *known == name).map(|&(_, thing)| thing).ok_or_else(|| {
        let names: Vec<String> = known.iter().map(|(name, _)| format!("{name:?}")).collect();
        Error::argument(argument, format!("{name:?}"), format!("one of {}", names.join(", ")))
    })
}

/// The dtypes that algorithms in lanes compute in.
#[derive(Debug, Clone, Copy)]
pub(super) enum Precise {
    Float64,
    Float32,
}

/// The argument `dtype`: whatever `NumPy` takes for float64 or float32; None for float64.
pub(super) fn read_dtype(dtype: Option<&Bound<'_, PyAny>>) -> PyResult<Precise> {
    let Some(given) = dtype else { return Ok(Precise::Float64) };
    let py = given.py();
    let found = PyArrayDescr::new(py, given);
    match &found {
        Ok(found) if found.is_equiv_to(&numpy::dtype::<f64>(py)) => Ok(Precise::Float64),
        Ok(found) if found.is_equiv_to(&numpy::dtype::<f32>(py)) => Ok(Precise::Float32),
        _ => Err(Error::argument("dtype", given.repr()?.to_string(), "numpy.float64 or numpy.float32").into()),
    }
}
