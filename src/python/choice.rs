//! Arguments that are names: of forms, links and joints.

pub(super) use crate::error::choose;

use super::errors::refuse;
use super::object::{Object, imported};
use crate::algorithm::Algorithm;
use crate::error::{Error, name_in};
use crate::filter::{FORMS, Form};
use crate::scene::{MimicJoints, Scene};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyString};

/// Refuses keywords that a method does not have, with the name of what was probably meant: PyO3 would not suggest one.
pub(super) fn refuse_unknown(py: Python<'_>, method: &str, unknown: Option<&Bound<'_, PyDict>>) -> PyResult<()> {
    let Some((name, _)) = unknown.and_then(|unknown| unknown.iter().next()) else { return Ok(()) };
    let hint: String = imported!(py, "phipsi._glossary", "of_keyword")?.call1((method, &name))?.extract()?;
    Err(PyTypeError::new_err(format!("{method}() got an unexpected keyword argument '{name}'{hint}")))
}

/// The error of a function in Python that a method calls with its keywords: that of [`refuse_unknown`] if the method
/// does not have one of them.
pub(super) fn of_unknown(py: Python<'_>, method: &str, given: Option<&Bound<'_, PyDict>>, error: PyErr) -> PyErr {
    let refused = || -> PyResult<()> {
        let unknown = imported!(py, "phipsi._glossary", "unknown_keywords")?.call1((method, given))?;
        refuse_unknown(py, method, Some(unknown.cast::<PyDict>()?))
    };
    if error.is_instance_of::<PyTypeError>(py) { refused().err().unwrap_or(error) } else { error }
}

/// Reads the argument `form`.
pub(super) fn read_form(form: &str) -> Result<Form, Error> {
    choose("form", form, FORMS)
}

/// Reads the form of an algorithm of a scene, and checks that the tolerance applies to it. Calls that factor M and are
/// not one of the algorithms are judged as M^-1.
pub(super) fn read_judged(
    scene: &Scene,
    (form, tolerance): (&str, Option<f64>),
    algorithm: impl Fn(Form) -> Algorithm,
) -> Result<Form, Error> {
    let form = read_form(form)?;
    scene.check_tolerance(algorithm(form), tolerance)?;
    Ok(form)
}

/// Treatments of mimic joints, by name.
const MIMIC: [(&str, MimicJoints); 2] = [("couple", MimicJoints::Coupled), ("free", MimicJoints::Free)];

/// Reads the argument `mimic`.
pub(super) fn read_mimic(mimic: &str) -> Result<MimicJoints, Error> {
    choose("mimic", mimic, &MIMIC)
}

/// Name of the treatment.
pub(super) fn name_of_mimic(mimic: MimicJoints) -> &'static str {
    name_in(&mimic, &MIMIC)
}

/// Name of a form.
pub(super) fn name_of(form: Form) -> &'static str {
    name_in(&form, FORMS)
}

/// Raises if an argument is given by its former name.
pub(super) fn renamed(former: &str, given: Option<&Object<'_>>, name: &str) -> Result<(), Error> {
    match given {
        None => Ok(()),
        Some(_) => Err(Error::argument(former, "a value", format!("{name}, the present name of this argument"))),
    }
}

/// Reads one name, or an iterable of names; `expected` is part of the error message.
pub(super) fn names(argument: &str, given: &Object<'_>, expected: &str) -> PyResult<Vec<String>> {
    // The characters of a string are no names.
    if given.is_instance_of::<PyString>() {
        return Ok(vec![given.extract()?]);
    }
    // The keys of a dict would be accepted and its values silently ignored.
    let is_none = given.is_instance_of::<PyMapping>();
    let read = || given.try_iter().ok()?.map(|name| name.and_then(|name| name.extract()).ok()).collect();
    match if is_none { None } else { read() } {
        Some(names) => Ok(names),
        None => refuse(argument, given.repr()?.to_string(), expected),
    }
}

/// Reads the entries of a mapping whose keys are strings; `expected` is part of the error message.
pub(super) fn items<'py>(
    argument: &str,
    mapping: &Bound<'py, PyMapping>,
    expected: &str,
) -> PyResult<Vec<(String, Object<'py>)>> {
    let mut items = Vec::with_capacity(mapping.len()?);
    for item in mapping.items()? {
        let (key, value): (Object<'py>, Object<'py>) = item.extract()?;
        let Ok(key) = key.extract::<String>() else {
            return refuse(argument, format!("the key {}", key.repr()?), expected);
        };
        items.push((key, value));
    }
    Ok(items)
}
