//! Conversion of arguments to contiguous float64; no other file converts.
//!
//! This file reads arrays of numbers. `phipsi._arguments` converts lists, tables, dicts and masked arrays to arrays and
//! matches labels with joints.

use super::axis::Axis;
use super::errors::no_room;
use super::object::{Object, imported};
use crate::batch::{Broadcast, shape_text};
use crate::error::Error;
use crate::memory;
use numpy::ndarray::Dimension;
use numpy::{
    Element, IntoPyArray, PyArray, PyArray1, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn,
    PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{PyFloat, PyInt, PyList, PyTuple};
use std::borrow::Cow;
use std::ops::Range;

/// Arguments of up to this many numbers are copied, which is cheaper than tracking the borrow of an array.
pub(super) const FEW: usize = 64;

/// Larger arrays are allocated by Python, which raises if memory runs out.
pub(super) const MANY: usize = 1 << 12;

/// An array argument: C-contiguous float64 numbers, borrowed if possible, otherwise converted.
pub(super) struct Input<'py> {
    /// Name in messages.
    pub name: Cow<'static, str>,
    width: usize,
    /// Number of axes of one state.
    own_axes: usize,
    array: Bound<'py, PyArrayDyn<f64>>,
    numbers: Numbers<'py>,
}

/// Values of an argument in row-major order.
enum Numbers<'py> {
    Copied(Vec<f64>),
    Borrowed(PyReadonlyArrayDyn<'py, f64>),
}

impl<'py> Input<'py> {
    /// Reads an argument of shape (..., entries of the axis), or one number for all entries.
    pub fn spread(name: &'static str, value: &Object<'py>, axis: Axis<'_>) -> PyResult<Self> {
        let array = read(name, value, axis)?;
        match (array.ndim(), array.len()) {
            (0, 1) => Self::filled(value.py(), name, array.to_vec()?[0], axis.width()),
            _ => Self::of(name.into(), array, axis.width()),
        }
    }

    /// One state of `width` equal numbers, the default of an argument.
    pub fn filled(py: Python<'py>, name: &'static str, number: f64, width: usize) -> PyResult<Self> {
        let numbers = memory::filled(name, width, number)?;
        Self::of(name.into(), numbers.into_pyarray(py).to_dyn().clone(), width)
    }

    /// Maps the values of each state to others, of equal number for all states.
    pub fn mapped(self, py: Python<'py>, map: impl Fn(&[f64]) -> Vec<f64>) -> PyResult<Self> {
        let width = map(&vec![0.0; self.width]).len();
        let mut numbers = memory::with_capacity(&self.name, self.array.len() / self.width.max(1) * width)?;
        for state in self.data()?.chunks_exact(self.width.max(1)) {
            numbers.extend(map(state));
        }
        let shape = [self.leading(), &[width]].concat();
        let array = numbers.into_pyarray(py).reshape(shape)?;
        Self::of(self.name, array, width)
    }

    /// Reads an argument of shape (..., entries of the axis).
    pub fn new<'a>(
        name: impl Into<Cow<'static, str>>,
        value: &Object<'py>,
        axis: impl Into<Axis<'a>>,
    ) -> PyResult<Self> {
        let (name, axis) = (name.into(), axis.into());
        let array = read(&name, value, axis)?;
        Self::of(name, array, axis.width())
    }

    /// Reads an argument of shape (..., rows, entries of the axis): one table per state.
    pub fn table<'a>(
        name: &'static str,
        value: &Object<'py>,
        rows: usize,
        axis: impl Into<Axis<'a>>,
    ) -> PyResult<Self> {
        let mut input = Self::new(name, value, axis)?;
        if input.leading().last() != Some(&rows) {
            return Err(wrong_shape(name, input.array.shape(), format!("(..., {rows}, {})", input.width)));
        }
        (input.width, input.own_axes) = (rows * input.width, 2);
        Ok(input)
    }

    /// The same values with another batch axis of length one, the last, such as that of paths.
    pub fn for_paths(self) -> PyResult<Self> {
        let shape = [self.leading(), &[1, self.width]].concat();
        Self::of(self.name, self.array.reshape(shape)?, self.width)
    }

    /// Checks the last axis.
    fn of(name: Cow<'static, str>, array: Bound<'py, PyArrayDyn<f64>>, width: usize) -> PyResult<Self> {
        if array.shape().last() != Some(&width) {
            return Err(wrong_shape(&name, array.shape(), format!("(..., {width})")));
        }
        let numbers = if array.len() <= FEW {
            Numbers::Copied(array.to_vec()?)
        } else {
            Numbers::Borrowed(array.try_readonly().map_err(|_| being_written(&name))?)
        };
        Ok(Self { name, width, own_axes: 1, array, numbers })
    }

    /// Leading (batch) axes.
    pub fn leading(&self) -> &[usize] {
        let shape = self.array.shape();
        &shape[..shape.len().saturating_sub(self.own_axes)]
    }

    pub fn py(&self) -> Python<'py> {
        self.array.py()
    }

    /// Number of values of one state.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Broadcasts the states to a batch.
    pub fn over(&self, batch: &[usize]) -> PyResult<Broadcast<'_>> {
        Ok(Broadcast::new(&self.name, self.data()?, self.width, self.leading(), batch)?)
    }

    /// All values in row-major order.
    pub fn data(&self) -> PyResult<&[f64]> {
        match &self.numbers {
            Numbers::Copied(numbers) => Ok(numbers),
            Numbers::Borrowed(array) => Ok(array.as_slice()?),
        }
    }

    /// Address range of the argument.
    pub fn addresses(&self) -> Range<usize> {
        addresses(&self.array)
    }
}

/// Address range of a C-contiguous array.
pub(super) fn addresses<P: Element, D: Dimension>(array: &Bound<'_, PyArray<P, D>>) -> Range<usize> {
    let start = array.data().addr();
    start..start + array.len() * size_of::<P>()
}

/// Values of an argument in row-major order.
fn copied(name: &str, array: &Bound<'_, PyArrayDyn<f64>>) -> PyResult<Vec<f64>> {
    if array.len() <= MANY {
        return Ok(array.to_vec()?);
    }
    let borrowed = array.try_readonly().map_err(|_| being_written(name))?;
    Ok(memory::copied(name, borrowed.as_slice()?)?)
}

fn being_written(name: &str) -> Error {
    Error::argument(name, "an array that another call is writing to", "an array that does not change during the call")
}

/// Reads an argument of any shape, with that shape.
pub(super) fn shaped<'a>(
    name: &str,
    value: &Object<'_>,
    axis: impl Into<Axis<'a>>,
) -> PyResult<(Vec<usize>, Vec<f64>)> {
    let array = read(name, value, axis.into())?;
    Ok((array.shape().to_vec(), copied(name, &array)?))
}

/// Reads an argument of exactly the given shape, in row-major order.
pub(super) fn fixed(name: &str, value: &Object<'_>, shape: &[usize]) -> PyResult<Vec<f64>> {
    exactly(name, shaped(name, value, shape.last().copied().unwrap_or(1))?, shape)
}

fn exactly(name: &str, (found, numbers): (Vec<usize>, Vec<f64>), shape: &[usize]) -> PyResult<Vec<f64>> {
    if found == shape { Ok(numbers) } else { Err(wrong_shape(name, &found, shape_text(shape))) }
}

/// Reads one state, an argument of shape (entries of the axis,).
pub(super) fn state(name: &str, value: &Object<'_>, axis: Axis<'_>) -> PyResult<Vec<f64>> {
    exactly(name, shaped(name, value, axis)?, &[axis.width()])
}

/// True for a number without axes.
pub(super) fn is_one_number(value: &Object<'_>) -> bool {
    value.extract::<f64>().is_ok() && value.getattr("ndim").is_ok_and(|axes| axes.eq(0).unwrap_or(false))
        || value.is_instance_of::<PyFloat>()
        || value.is_instance_of::<PyInt>()
}

/// Reads one number for all entries of the axis, or an array of them.
pub(super) fn spread(name: &str, value: &Object<'_>, axis: Axis<'_>) -> PyResult<Vec<f64>> {
    let (shape, numbers) = shaped(name, value, axis)?;
    let width = axis.width();
    match shape[..] {
        [] => Ok(memory::filled("scene", width, numbers[0])?),
        [found] if found == width => Ok(numbers),
        _ => Err(wrong_shape(name, &shape, format!("() or ({width},)"))),
    }
}

/// Reads an argument of the given shape, shared by `count` items, or of shape (count, *shape), one for each.
pub(super) fn one_or_each(name: &str, value: &Object<'_>, count: usize, shape: &[usize]) -> PyResult<Vec<Vec<f64>>> {
    let (found, numbers) = shaped(name, value, shape.last().copied().unwrap_or(1))?;
    let each = [&[count], shape].concat();
    if found == shape {
        Ok(vec![numbers; count])
    } else if found == each {
        Ok(numbers.chunks_exact(shape.iter().product()).map(<[f64]>::to_vec).collect())
    } else {
        Err(wrong_shape(name, &found, format!("{} or {}", shape_text(shape), shape_text(&each))))
    }
}

/// Reads an argument of shape (rows, width) with at least one row: the number of rows, and the values in row-major
/// order.
pub(super) fn rows(name: &str, value: &Object<'_>, width: usize) -> PyResult<(usize, Vec<f64>)> {
    let (shape, numbers) = shaped(name, value, width)?;
    match shape[..] {
        [rows, found] if found == width && rows > 0 => Ok((rows, numbers)),
        _ => Err(wrong_shape(name, &shape, format!("(k, {width}), k at least 1"))),
    }
}

/// Reads three numbers.
pub(super) fn triple(name: &str, value: &Object<'_>) -> PyResult<[f64; 3]> {
    if is_of_numbers(value)
        && let Ok(numbers) = value.extract()
    {
        return Ok(numbers);
    }
    let numbers = fixed(name, value, &[3])?;
    Ok([numbers[0], numbers[1], numbers[2]])
}

pub(super) fn wrong_shape(name: &str, found: &[usize], expected: String) -> PyErr {
    Error::shape(name, shape_text(found), expected).into()
}

/// Calls a function of `phipsi._arguments` with an argument.
pub(super) fn in_python<'py>(
    function: &Object<'py>,
    name: &str,
    value: &Object<'py>,
    axis: Axis<'_>,
) -> PyResult<Object<'py>> {
    function.call1((name, value, axis.joints(), axis.width()))
}

/// Reads an array: C-contiguous aligned float64 numbers without a copy, other real numbers by conversion; the rest
/// raises.
pub(super) fn read<'py>(name: &str, value: &Object<'py>, axis: Axis<'_>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    match value.cast::<PyArrayDyn<f64>>() {
        Ok(array) if in_order(array) && is_bare(value) => Ok(array.clone()),
        _ => convert(name, value, axis),
    }
}

/// True for an array that is not of a subclass, which can have masks or units.
pub(super) fn is_bare(value: &Object<'_>) -> bool {
    value.is_exact_instance_of::<PyUntypedArray>()
}

/// True for a list or a tuple of Python numbers only, without labels or masks.
fn is_of_numbers(value: &Object<'_>) -> bool {
    let is_number =
        |entry: Object<'_>| entry.is_exact_instance_of::<PyFloat>() || entry.is_exact_instance_of::<PyInt>();
    match value.cast_exact::<PyList>() {
        Ok(list) => list.iter().all(is_number),
        Err(_) => value.cast_exact::<PyTuple>().is_ok_and(|tuple| tuple.iter().all(is_number)),
    }
}

/// True if the memory of an array can be read without a copy.
fn in_order<P: Element, D: Dimension>(array: &Bound<'_, PyArray<P, D>>) -> bool {
    array.is_c_contiguous() && array.data().is_aligned()
}

/// Values of one state and their address range, for a small (width,) float64 array that needs no conversion.
#[inline(always)] // what it returns would be stored and loaded again
pub(super) fn plain(value: &Object<'_>, width: usize) -> Option<(Vec<f64>, Range<usize>)> {
    let array = value.cast_exact::<PyArray1<f64>>().ok()?;
    if width > FEW || array.len() != width || !in_order(array) {
        return None;
    }
    Some((array.to_vec().ok()?, addresses(array)))
}

/// New C-contiguous float64 array with the numbers of `value`.
fn convert<'py>(name: &str, value: &Object<'py>, axis: Axis<'_>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let py = value.py();
    let is_real = |array: &Bound<'_, PyUntypedArray>| matches!(array.dtype().kind(), b'f' | b'i' | b'u');
    let found = if is_bare(value) {
        Some(value.clone())
    } else if is_of_numbers(value) {
        imported!(py, "numpy", "asarray")?.call1((value,)).ok()
    } else {
        None
    };
    let array = if let Some(array) = found.and_then(|found| found.cast_into().ok()).filter(is_real) {
        array
    } else {
        let array = in_python(imported!(py, "phipsi._arguments", "array_of")?, name, value, axis);
        array.map_err(|cause| no_room(py, name, &cause, None))?.cast_into()?
    };
    let bytes = memory::bytes_of::<f64>(&[array.len()]);
    memory::room(name, bytes)?;
    let converted = array.call_method1("astype", ("float64", "C"));
    Ok(converted.map_err(|cause| no_room(py, name, &cause, Some(bytes)))?.cast_into()?)
}
