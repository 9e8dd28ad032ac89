//! What is no array of real numbers, in words: its type, the entry at fault, and what gives one.

use super::labels::{DEEPEST, is_number, is_sequence};
use crate::error::Error;
use numpy::PyUntypedArray;
use pyo3::prelude::*;
use pyo3::types::PyString;

/// The error for a value that `NumPy` reads as that dtype, of no real numbers.
pub(super) fn of_dtype(name: &str, value: &Bound<'_, PyAny>, dtype: &Bound<'_, PyAny>, kind: &str) -> PyResult<PyErr> {
    let is_sequence = is_sequence(value);
    // Truth values and complex numbers are what their dtype says.
    if value.is_instance_of::<PyUntypedArray>() || (is_sequence && matches!(kind, "b" | "c")) {
        return Ok(no_numbers(name, &format!("dtype {dtype}"), None));
    }
    if is_sequence {
        return Ok(no_numbers(name, &format!("dtype {dtype}{}", culprit(value, 1)?), None));
    }
    Ok(no_numbers(name, &format!("dtype {dtype} from {}", described(value)?), remedy(value)))
}

/// The error for what is no array of real numbers.
pub(super) fn no_numbers(name: &str, found: &str, remedy: Option<&str>) -> PyErr {
    let expected = "an array of real numbers (float64; float32 and integers are converted)";
    let expected = remedy.map_or_else(|| expected.to_owned(), |remedy| format!("{expected}; {remedy}"));
    Error::argument(name, found, expected).into()
}

/// Type and module of an object, in words.
pub(super) fn described(value: &Bound<'_, PyAny>) -> PyResult<String> {
    if value.is_none() {
        return Ok("None".to_owned());
    }
    let class = value.get_type();
    let (module, name) = (class.module()?.to_string(), class.qualname()?.to_string());
    Ok(if module == "builtins" {
        format!("an object of type {name}")
    } else {
        format!("an object of type {module}.{name}")
    })
}

/// The first entry of a sequence, however deep, that is no real number; nothing where that is not to be told.
fn culprit(sequence: &Bound<'_, PyAny>, depth: usize) -> PyResult<String> {
    if depth > DEEPEST {
        return Ok(String::new());
    }
    for (at, entry) in sequence.try_iter()?.enumerate() {
        let entry = entry?;
        if is_sequence(&entry) {
            let within = culprit(&entry, depth + 1)?;
            if !within.is_empty() {
                return Ok(within);
            }
        } else if !is_number(&entry) && !entry.is_instance_of::<PyUntypedArray>() {
            return Ok(format!(" (entry {at} is {})", described(&entry)?));
        }
    }
    Ok(String::new())
}

/// What to do with an object that is no array of numbers.
fn remedy(value: &Bound<'_, PyAny>) -> Option<&'static str> {
    let class = value.get_type();
    let has = |attribute: &str| class.hasattr(attribute).unwrap_or(false);
    if value.is_instance_of::<PyString>() {
        return None;
    }
    if has("toarray") {
        return Some(".toarray() gives one");
    }
    if has("__next__") || has("__iter__") {
        return Some("list(..) or numpy.fromiter gives one, where it has an order");
    }
    None
}
