//! Arguments to contiguous float64 (or float32, where that was asked for) and results to arrays: the one place where either is done.

use super::kept;
use super::labels::{Axis, resolved};
use super::{masks, refusals};
use crate::batch::{Broadcast, shape_text};
use crate::error::Error;
use crate::memory;
use crate::scalar::Precision;
use numpy::ndarray::{ArrayD, ArrayView2, Dimension};
use numpy::{
    AsSliceError, BorrowError, Element, IxDyn, PyArray, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn,
    PyReadwriteArrayDyn, PyUntypedArray, PyUntypedArrayMethods, ToPyArray,
};
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use std::borrow::Cow;
use std::ops::Range;

/// Arguments and results up to this many numbers are copied: cheaper than keeping account of who borrows which array.
const FEW: usize = 64;

/// Larger results are made by Python, which raises where memory runs out.
const MANY: usize = 1 << 12;

/// What is said to ask for the memory of a result, until it is known which argument did.
const RESULT: &str = "result";

/// Copies take the GIL from others for so many numbers at a time, and then look at signals.
const AT_A_TIME: usize = 1 << 19;

/// One array argument: C-contiguous numbers of kind `P`, borrowed where it was that already, else converted.
pub(super) struct Input<'py, P: Element = f64> {
    /// What messages call it.
    pub name: Cow<'static, str>,
    width: usize,
    array: Bound<'py, PyArrayDyn<P>>,
    numbers: Numbers<'py, P>,
}

/// The numbers of an argument, row-major.
enum Numbers<'py, P: Element> {
    Copied(Vec<P>),
    Borrowed(PyReadonlyArrayDyn<'py, P>),
}

impl<'py> Input<'py> {
    /// Reads an argument of shape (..., entries of the axis) as float64.
    pub fn new<'a>(
        name: impl Into<Cow<'static, str>>,
        value: &Bound<'py, PyAny>,
        axis: impl Into<Axis<'a>>,
    ) -> PyResult<Self> {
        Self::in_kind(name, value, axis)
    }

    /// Reads an argument of that shape, or one number that stands for all of them.
    pub fn spread(name: &'static str, value: &Bound<'py, PyAny>, axis: Axis<'_>) -> PyResult<Self> {
        let array = read(name, value, axis)?;
        match (array.ndim(), array.len()) {
            (0, 1) => Self::filled(value.py(), name, array.to_vec()?[0], axis.width()),
            _ => Self::of(name.into(), array, axis.width()),
        }
    }

    /// One state of `width` equal numbers, for an argument that was not given.
    pub fn filled(py: Python<'py>, name: &'static str, number: f64, width: usize) -> PyResult<Self> {
        let mut output = Output::new(py, &[width])?;
        output.numbers()?.fill(number);
        Self::of(name.into(), output.finish(), width)
    }
}

impl<'py, P: Precision + Element> Input<'py, P> {
    /// Reads an argument of shape (..., entries of the axis) as numbers of kind `P`.
    pub fn in_kind<'a>(
        name: impl Into<Cow<'static, str>>,
        value: &Bound<'py, PyAny>,
        axis: impl Into<Axis<'a>>,
    ) -> PyResult<Self> {
        let (name, axis) = (name.into(), axis.into());
        let array = read(&name, value, axis)?;
        Self::of(name, array, axis.width())
    }

    /// Checks the last axis.
    fn of(name: Cow<'static, str>, array: Bound<'py, PyArrayDyn<P>>, width: usize) -> PyResult<Self> {
        if array.shape().last() != Some(&width) {
            return Err(wrong_shape(&name, array.shape(), format!("(..., {width})")));
        }
        let numbers = if array.len() <= FEW {
            Numbers::Copied(array.to_vec()?)
        } else {
            Numbers::Borrowed(array.try_readonly().map_err(|_| being_written(&name))?)
        };
        Ok(Self { name, width, array, numbers })
    }

    /// The axes before the last.
    pub fn leading(&self) -> &[usize] {
        let shape = self.array.shape();
        &shape[..shape.len().saturating_sub(1)]
    }

    /// Its states over those of a batch.
    pub fn over(&self, batch: &[usize]) -> PyResult<Broadcast<'_, P>> {
        Ok(Broadcast::new(&self.name, self.data()?, self.width, self.leading(), batch)?)
    }

    /// All numbers, row-major.
    pub fn data(&self) -> PyResult<&[P]> {
        match &self.numbers {
            Numbers::Copied(numbers) => Ok(numbers),
            Numbers::Borrowed(array) => Ok(array.as_slice()?),
        }
    }

    /// The addresses that the argument occupies.
    pub fn addresses(&self) -> Range<usize> {
        addresses(&self.array)
    }
}

/// The addresses that a C-contiguous array occupies.
fn addresses<P: Element, D: Dimension>(array: &Bound<'_, PyArray<P, D>>) -> Range<usize> {
    let start = array.data().addr();
    start..start + array.len() * size_of::<P>()
}

/// An argument of exactly the given shape, as numbers in row-major order.
pub(super) fn fixed(name: &str, value: &Bound<'_, PyAny>, shape: &[usize]) -> PyResult<Vec<f64>> {
    let array = read::<f64>(name, value, shape.last().copied().unwrap_or(1).into())?;
    if array.shape() != shape {
        return Err(wrong_shape(name, array.shape(), shape_text(shape)));
    }
    copied(name, &array)
}

/// The numbers of an argument, row-major.
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

/// One state: an argument of shape (entries of the axis,).
pub(super) fn state(name: &str, value: &Bound<'_, PyAny>, axis: Axis<'_>) -> PyResult<Vec<f64>> {
    let (shape, numbers) = shaped(name, value, axis)?;
    if shape != [axis.width()] {
        return Err(wrong_shape(name, &shape, shape_text(&[axis.width()])));
    }
    Ok(numbers)
}

/// An argument of any shape, and that shape.
pub(super) fn shaped(name: &str, value: &Bound<'_, PyAny>, axis: Axis<'_>) -> PyResult<(Vec<usize>, Vec<f64>)> {
    let array = read::<f64>(name, value, axis)?;
    Ok((array.shape().to_vec(), copied(name, &array)?))
}

/// One number for all entries of the axis, or an array of them: the numbers.
pub(super) fn spread(name: &str, value: &Bound<'_, PyAny>, axis: Axis<'_>) -> PyResult<Vec<f64>> {
    let (shape, numbers) = shaped(name, value, axis)?;
    let width = axis.width();
    match shape[..] {
        [] => Ok(memory::filled("scene", width, numbers[0])?),
        [found] if found == width => Ok(numbers),
        _ => Err(wrong_shape(name, &shape, format!("() or ({width},)"))),
    }
}

/// A boolean array of exactly the entries of an axis; none where the argument has another dtype.
pub(super) fn mask(name: &str, value: &Bound<'_, PyAny>, axis: Axis<'_>) -> PyResult<Option<Vec<bool>>> {
    let length = axis.width();
    // What has labels without being a mask, an index of names for instance, is for the caller.
    let Ok(unlabelled) = as_array(value) else { return Ok(None) };
    if unlabelled.cast::<PyUntypedArray>()?.dtype().getattr("kind")?.extract::<String>()? != "b" {
        return Ok(None);
    }
    let array = as_array(&resolved(name, value, axis)?)?;
    let untyped = array.cast::<PyUntypedArray>()?;
    if untyped.shape() != [length] {
        return Err(wrong_shape(name, untyped.shape(), shape_text(&[length])));
    }
    Ok(Some(array.call_method0("tolist")?.extract()?))
}

/// An argument of the given shape, the same for all of `count` things, or of (count, *shape), one for each: their numbers.
pub(super) fn one_or_each(
    name: &str,
    value: &Bound<'_, PyAny>,
    count: usize,
    shape: &[usize],
) -> PyResult<Vec<Vec<f64>>> {
    let array = read::<f64>(name, value, shape.last().copied().unwrap_or(1).into())?;
    let numbers = copied(name, &array)?;
    if array.shape() == shape {
        return Ok(vec![numbers; count]);
    }
    let each = [&[count], shape].concat();
    if array.shape() != each {
        let expected = format!("{} or {}", shape_text(shape), shape_text(&each));
        return Err(wrong_shape(name, array.shape(), expected));
    }
    Ok(numbers.chunks_exact(shape.iter().product()).map(<[f64]>::to_vec).collect())
}

/// An argument of shape (rows, width), at least one row: how many, and the numbers in row-major order.
pub(super) fn rows(name: &str, value: &Bound<'_, PyAny>, width: usize) -> PyResult<(usize, Vec<f64>)> {
    let array = read::<f64>(name, value, width.into())?;
    match *array.shape() {
        [rows, found] if found == width && rows > 0 => Ok((rows, copied(name, &array)?)),
        _ => Err(wrong_shape(name, array.shape(), format!("(k, {width}), k at least 1"))),
    }
}

/// Three numbers.
pub(super) fn triple(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
    let numbers = fixed(name, value, &[3])?;
    Ok([numbers[0], numbers[1], numbers[2]])
}

pub(super) fn wrong_shape(name: &str, found: &[usize], expected: String) -> PyErr {
    Error::Shape { argument: name.to_owned(), found: shape_text(found), expected }.into()
}

/// C-contiguous and aligned numbers of kind `P` as they are; any other real numbers converted; the rest refused by name.
pub(super) fn read<'py, P: Precision + Element>(
    name: &str,
    value: &Bound<'py, PyAny>,
    axis: Axis<'_>,
) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    match value.cast::<PyArrayDyn<P>>() {
        Ok(array) if in_order(array) && is_bare(value) => Ok(array.clone()),
        _ => convert(name, &resolved(name, value, axis)?),
    }
}

/// Whether it is an array and no subclass: such have masks or units.
fn is_bare(value: &Bound<'_, PyAny>) -> bool {
    value.is_exact_instance_of::<PyUntypedArray>()
}

/// Whether the numbers of an array can be read as they lie.
fn in_order<P: Element, D: Dimension>(array: &Bound<'_, PyArray<P, D>>) -> bool {
    array.is_c_contiguous() && array.data().is_aligned()
}

/// The numbers of one state and their addresses, where they are (width,) float64 as they lie, and few.
#[inline(always)] // what it returns would be stored and loaded again
pub(super) fn plain(value: &Bound<'_, PyAny>, width: usize) -> Option<(Vec<f64>, Range<usize>)> {
    let array = value.cast::<PyArray1<f64>>().ok()?;
    if width > FEW || array.len() != width || !in_order(array) || !is_bare(value) {
        return None;
    }
    Some((array.to_vec().ok()?, addresses(array)))
}

/// What NumPy makes of `value`.
pub(super) fn as_array<'py>(value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    static ASARRAY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    ASARRAY.import(value.py(), "numpy", "asarray")?.call1((value,))
}

/// A fresh C-contiguous array of kind `P` with the numbers of `value`.
fn convert<'py, P: Precision + Element>(name: &str, value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    let py = value.py();
    let array = as_array(value).map_err(|cause| {
        if cause.is_instance_of::<PyMemoryError>(py) {
            return no_room(name, &cause, py, None);
        }
        let error = refusals::no_numbers(name, &format!("what NumPy cannot read ({})", cause.value(py)), None);
        error.set_cause(py, Some(cause));
        error
    })?;
    let untyped = array.cast::<PyUntypedArray>()?;
    let dtype = untyped.dtype();
    let kind: String = dtype.getattr("kind")?.extract()?;
    if !matches!(kind.as_str(), "f" | "i" | "u") {
        return Err(refusals::of_dtype(name, value, dtype.as_any(), &kind)?);
    }
    let bytes = memory::bytes_of::<P>(&[array.cast::<PyUntypedArray>()?.len()]);
    memory::room(name, bytes)?;
    let converted = array.call_method1("astype", (P::NAME, "C"));
    Ok(converted.map_err(|cause| no_room(name, &cause, py, Some(bytes)))?.cast_into()?)
}

/// The error of an array that `NumPy` could not make for want of memory, for which it says how much unless it is known; another error as it is.
fn no_room(name: &str, cause: &PyErr, py: Python<'_>, bytes: Option<u128>) -> PyErr {
    // A shape that overflows is a ValueError in NumPy.
    if !(cause.is_instance_of::<PyMemoryError>(py) || bytes.is_some() && cause.is_instance_of::<PyValueError>(py)) {
        return cause.clone_ref(py);
    }
    let bytes = bytes.or_else(|| cause.value(py).getattr("_total_size").ok()?.extract().ok());
    match bytes {
        Some(bytes) => Error::memory(name, bytes, None).into(),
        None => PyMemoryError::new_err(format!("{name}: {}", cause.value(py))),
    }
}

/// Where a call writes its result: an array of its own, or the caller's `out`.
pub(super) enum Output<'py, P: Element = f64> {
    /// Few numbers, which become an array in the end: cheaper than keeping account of one.
    Copied(Python<'py>, ArrayD<P>),
    Borrowed(Bound<'py, PyArrayDyn<P>>, PyReadwriteArrayDyn<'py, P>),
}

impl<'py, P: Precision + Element> Output<'py, P> {
    /// A new array of zeros of the given shape.
    pub fn new(py: Python<'py>, shape: &[usize]) -> PyResult<Self> {
        Self::made(py, shape, true)
    }

    /// A new array of the given shape, all of which will be written or nothing be read.
    pub fn unwritten(py: Python<'py>, shape: &[usize]) -> PyResult<Self> {
        Self::made(py, shape, false)
    }

    fn made(py: Python<'py>, shape: &[usize], zeroed: bool) -> PyResult<Self> {
        if entries(shape).is_some_and(|entries| entries <= FEW) {
            return Ok(Self::Copied(py, ArrayD::from_elem(shape, P::default())));
        }
        Self::borrowed(fresh(py, shape, zeroed)?)
    }

    /// The caller's array: C-contiguous numbers of kind `P` in the given shape, writable, apart from the addresses of the arguments.
    pub fn given(
        out: &Bound<'py, PyAny>,
        shape: &[usize],
        inputs: impl IntoIterator<Item = Range<usize>>,
    ) -> PyResult<Self> {
        let expected = || format!("a C-contiguous {} array", P::NAME);
        let refuse = |found: String| PyErr::from(Error::argument("out", found, expected()));
        let Ok(untyped) = out.cast::<PyUntypedArray>() else {
            return Err(refuse(format!("an object of type {}", out.get_type().name()?)));
        };
        if masks::is_masked(out)? {
            return Err(refuse("a masked array".to_owned()));
        }
        let Ok(array) = out.cast::<PyArrayDyn<P>>() else {
            return Err(refuse(format!("dtype {}", untyped.dtype())));
        };
        if array.shape() != shape {
            return Err(wrong_shape("out", array.shape(), shape_text(shape)));
        }
        if !array.is_c_contiguous() {
            return Err(refuse(format!("an array with strides {:?} (in bytes)", array.strides())));
        }
        if !array.data().is_aligned() {
            return Err(refuse("an array that is not aligned".to_owned()));
        }
        let own = addresses(array);
        let shared = |other: Range<usize>| own.start.max(other.start) < own.end.min(other.end);
        if inputs.into_iter().any(shared) {
            return Err(refused_output(&BorrowError::AlreadyBorrowed));
        }
        Self::borrowed(array.clone())
    }

    fn borrowed(array: Bound<'py, PyArrayDyn<P>>) -> PyResult<Self> {
        let write = array.try_readwrite().map_err(|error| refused_output(&error))?;
        Ok(Self::Borrowed(array, write))
    }

    /// The numbers, row-major.
    pub fn numbers(&mut self) -> PyResult<&mut [P]> {
        match self {
            Self::Copied(_, numbers) => Ok(numbers.as_slice_mut().ok_or(AsSliceError)?),
            Self::Borrowed(_, write) => Ok(write.as_slice_mut()?),
        }
    }

    /// Writes rows that lie elsewhere, `width` numbers each; signals are looked at on the way.
    pub fn gather<'a>(
        &mut self,
        py: Python<'py>,
        width: usize,
        mut rows: impl Iterator<Item = &'a [P]>,
    ) -> PyResult<()> {
        if width == 0 {
            return Ok(());
        }
        let together = (AT_A_TIME / width).max(1);
        for numbers in self.numbers()?.chunks_mut(together * width) {
            for (to, from) in numbers.chunks_exact_mut(width).zip(&mut rows) {
                to.copy_from_slice(from);
            }
            py.check_signals()?;
        }
        Ok(())
    }

    /// Writes all numbers, row-major; signals are looked at on the way.
    pub fn copy_from(&mut self, py: Python<'py>, numbers: &[P]) -> PyResult<()> {
        let own = self.numbers()?;
        debug_assert_eq!(own.len(), numbers.len());
        for (to, from) in own.chunks_mut(AT_A_TIME).zip(numbers.chunks(AT_A_TIME)) {
            to.copy_from_slice(from);
            py.check_signals()?;
        }
        Ok(())
    }

    /// The array, written; a `NumPy` scalar for the empty shape.
    pub fn finish_or_scalar(self) -> PyResult<Bound<'py, PyAny>> {
        let array = self.finish();
        if array.ndim() == 0 { array.get_item(()) } else { Ok(array.into_any()) }
    }

    /// The array, written.
    pub fn finish(self) -> Bound<'py, PyArrayDyn<P>> {
        match self {
            Self::Copied(py, numbers) => numbers.to_pyarray(py),
            Self::Borrowed(array, _) => array,
        }
    }
}

/// How many numbers an array of this shape has; none where that is no number.
fn entries(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1, |product: usize, &length| product.checked_mul(length))
}

fn refused_output(error: &BorrowError) -> PyErr {
    let found = match error {
        BorrowError::NotWriteable => "a read-only array",
        _ => "memory that is shared with an argument, or that another call is using",
    };
    Error::argument("out", found, "a writable array that overlaps no argument").into()
}

/// A new array; of zeros, or where it is large and need not be, of whatever was there: to zero megabytes takes a tenth of computing M.
fn fresh<'py, P: Precision + Element>(
    py: Python<'py>,
    shape: &[usize],
    zeroed: bool,
) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    static ZEROS: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    match entries(shape) {
        Some(entries) if entries <= MANY => return Ok(PyArray::zeros(py, IxDyn(shape), false)),
        Some(entries) if !zeroed && kept::is_for::<P>(entries) => return kept::array(py, (entries, shape)),
        _ => {}
    }
    if zeroed { made_by(py, (&ZEROS, "zeros"), shape) } else { empty(py, shape) }
}

/// A new array of whatever was there.
pub(super) fn empty<'py, P: Precision + Element>(
    py: Python<'py>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    static EMPTY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    made_by(py, (&EMPTY, "empty"), shape)
}

/// What a function of `NumPy`, to be imported once, makes of a shape.
fn made_by<'py, P: Precision + Element>(
    py: Python<'py>,
    (function, name): (&PyOnceLock<Py<PyAny>>, &str),
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<P>>> {
    let bytes = memory::bytes_of::<P>(shape);
    memory::room(RESULT, bytes)?;
    let made = function.import(py, "numpy", name)?.call1((shape.to_vec(), P::NAME));
    Ok(made.map_err(|cause| no_room(RESULT, &cause, py, Some(bytes)))?.cast_into()?)
}

/// A new array with these numbers in row-major order; a `NumPy` scalar for the empty shape.
pub(super) fn from_numbers<'py>(py: Python<'py>, numbers: &[f64], shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    match *shape {
        [length] if length == numbers.len() && length <= MANY => return Ok(numbers.to_pyarray(py).into_any()),
        [rows, columns] if numbers.len() <= MANY => {
            if let Ok(matrix) = ArrayView2::from_shape((rows, columns), numbers) {
                return Ok(matrix.to_pyarray(py).into_any());
            }
        }
        _ => {}
    }
    let mut output = Output::new(py, shape)?;
    output.copy_from(py, numbers)?;
    output.finish_or_scalar()
}
