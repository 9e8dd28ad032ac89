//! Masked arrays of `NumPy`: masked entries are refused, but where they say that something is not known.

use super::arrays::Input;
use super::labels::Axis;
use crate::error::Error;
use numpy::PyUntypedArray;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;

/// Masked entries of an array: how many, of how many, and where the first is.
pub(super) struct Masked {
    count: usize,
    total: usize,
    first: usize,
}

impl Masked {
    pub fn refuse(&self, name: &str) -> PyErr {
        let Self { count, total, first } = self;
        let found =
            format!("a masked array with {count} of {total} entries masked, the first at index {first} (flattened)");
        let expected = "numbers for all entries (only the torque and noise of estimate may be masked: not measured); \
                        .filled(value) puts a number in their place";
        Error::argument(name, found, expected).into()
    }
}

/// The masked array of `NumPy` that it is, if it is one.
fn as_masked<'a, 'py>(value: &'a Bound<'py, PyAny>) -> PyResult<Option<&'a Bound<'py, PyAny>>> {
    static MASKED: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let is_subclass = value.is_instance_of::<PyUntypedArray>() && !value.is_exact_instance_of::<PyUntypedArray>();
    if !is_subclass {
        return Ok(None);
    }
    let class = MASKED.import(value.py(), "numpy.ma", "MaskedArray")?;
    Ok(value.is_instance(class)?.then_some(value))
}

/// Whether it is a masked array, of which even the empty mask would not follow what is written.
pub(super) fn is_masked(value: &Bound<'_, PyAny>) -> PyResult<bool> {
    Ok(as_masked(value)?.is_some())
}

/// The masked entries of a masked array that has any.
pub(super) fn masked_entries(value: &Bound<'_, PyAny>) -> PyResult<Option<Masked>> {
    let Some(mask) = mask_of(value)? else { return Ok(None) };
    let flat = mask.call_method0("ravel")?;
    let count: usize = flat.call_method0("sum")?.extract()?;
    let (total, first) = (flat.len()?, flat.call_method0("argmax")?.extract()?);
    Ok(Some(Masked { count, total, first }))
}

/// The mask of a masked array, of its shape, where any entry is masked.
fn mask_of<'py>(value: &Bound<'py, PyAny>) -> PyResult<Option<Bound<'py, PyAny>>> {
    static MASK: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let Some(array) = as_masked(value)? else { return Ok(None) };
    let mask = MASK.import(value.py(), "numpy.ma", "getmaskarray")?.call1((array,))?;
    // Of a record each field has its own; such are refused for their dtype.
    if mask.getattr("dtype")?.getattr("kind")?.extract::<String>()? != "b" {
        return Ok(None);
    }
    Ok(mask.call_method0("any")?.is_truthy()?.then_some(mask))
}

impl<'py> Input<'py> {
    /// Reads an argument of which entries may be masked: zero where they are, and infinity there in a second, which is zero elsewhere.
    pub fn with_mask<'a>(
        name: &'static str,
        value: &Bound<'py, PyAny>,
        axis: Axis<'a>,
        read: impl Fn(&'static str, &Bound<'py, PyAny>, Axis<'a>) -> PyResult<Self>,
    ) -> PyResult<(Self, Self)> {
        let Some(mask) = mask_of(value)? else {
            return Ok((read(name, value, axis)?, Self::filled(value.py(), name, 0.0, axis.width())?));
        };
        let known = read(name, &value.call_method1("filled", (0,))?, axis)?;
        let unknown = value.py().import("numpy")?.call_method1("where", (mask, f64::INFINITY, 0.0))?;
        Ok((known, read(name, &unknown, axis)?))
    }
}
