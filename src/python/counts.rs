//! Integer arguments.

use super::errors::refuse;
use super::object::Object;
use crate::error::Error;
use pyo3::prelude::*;
use pyo3::types::PyBool;

/// Reads an integer (Python or NumPy) that is at least `least` and at most the largest size in bytes.
pub(super) fn count(name: &str, value: &Object<'_>, least: usize) -> PyResult<usize> {
    let most = isize::MAX.unsigned_abs();
    match whole(name, value, || format!("a whole number, at least {least}"))?.extract::<usize>() {
        Ok(number) if number >= least && number <= most => Ok(number),
        _ => {
            let at_least = value.lt(least).is_ok_and(|below| below);
            let expected = if at_least { String::new() } else { format!(" and at most {most}") };
            refuse(name, value.to_string(), format!("a whole number, at least {least}{expected}"))
        }
    }
}

/// The same with a default.
pub(super) fn count_or(name: &str, value: Option<&Object<'_>>, least: usize, usual: usize) -> PyResult<usize> {
    value.map_or(Ok(usual), |value| count(name, value, least))
}

/// Reads a seed of a random stream or the number of a sample, from 0 to 2^64 - 1.
pub(super) fn number(name: &str, value: &Object<'_>) -> PyResult<u64> {
    let expected = || "an integer from 0 to 2^64 - 1".to_owned();
    let index = whole(name, value, expected)?;
    index.extract().map_err(|_| Error::argument(name, index.to_string(), expected()).into())
}

/// Reads a Python integer; bool is rejected.
fn whole<'py>(name: &str, value: &Object<'py>, expected: impl Fn() -> String) -> PyResult<Object<'py>> {
    let index = if value.is_instance_of::<PyBool>() { None } else { value.call_method0("__index__").ok() };
    index.ok_or_else(|| {
        let found = value.repr().map_or_else(|_| "an object".to_owned(), |text| text.to_string());
        Error::argument(name, found, expected()).into()
    })
}
