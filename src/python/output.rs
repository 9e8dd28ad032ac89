//! Results as arrays; no other file creates them.

use super::dtype::Dtype;
use super::fresh::{entries, unwritten, zeros};
use super::input::{FEW, MANY, addresses, is_bare, wrong_shape};
use super::object::{Object, imported};
use crate::batch::shape_text;
use crate::error::Error;
use numpy::ndarray::{ArrayD, ArrayView2, ArrayView3};
use numpy::{
    AsSliceError, BorrowError, PyArrayDyn, PyArrayMethods, PyReadwriteArrayDyn, PyUntypedArray, PyUntypedArrayMethods,
    ToPyArray,
};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PySlice, PyTuple};
use std::ops::Range;

/// Result of most methods.
pub(super) type Array<'py> = PyResult<Bound<'py, PyArrayDyn<f64>>>;

/// Result of properties that list names or sizes.
pub(super) type Names<'py> = PyResult<Bound<'py, PyTuple>>;

/// Number of values that are copied between two checks for signals.
const AT_A_TIME: usize = 1 << 19;

/// Memory of a result: a new array, or the caller's `out`.
pub(super) enum Output<'py, P: Dtype = f64> {
    /// Few numbers, which become an array at the end; this is cheaper than tracking the borrow of an array.
    Copied(Python<'py>, ArrayD<P>),
    Borrowed(Bound<'py, PyArrayDyn<P>>, PyReadwriteArrayDyn<'py, P>),
}

impl<'py, P: Dtype> Output<'py, P> {
    /// New array of zeros of the given shape.
    pub fn new(py: Python<'py>, shape: &[usize]) -> PyResult<Self> {
        Self::made(py, shape, zeros)
    }

    /// New uninitialized array of the given shape, which is written completely before it is read.
    pub fn unwritten(py: Python<'py>, shape: &[usize]) -> PyResult<Self> {
        Self::made(py, shape, unwritten)
    }

    fn made(
        py: Python<'py>,
        shape: &[usize],
        make: impl FnOnce(Python<'py>, &[usize]) -> PyResult<Bound<'py, PyArrayDyn<P>>>,
    ) -> PyResult<Self> {
        if entries(shape).is_some_and(|entries| entries <= FEW) {
            return Ok(Self::Copied(py, ArrayD::from_elem(shape, P::default())));
        }
        Self::borrowed(make(py, shape)?)
    }

    /// Checks the caller's array: C-contiguous numbers of type `P` of the given shape, writable, without overlap with
    /// the arguments.
    pub fn given(out: &Object<'py>, shape: &[usize], inputs: impl IntoIterator<Item = Range<usize>>) -> PyResult<Self> {
        let expected = || format!("a C-contiguous {} array", P::NAME);
        let refuse = |found: String| PyErr::from(Error::argument("out", found, expected()));
        let Ok(untyped) = out.cast::<PyUntypedArray>() else {
            return Err(refuse(format!("an object of type {}", out.get_type().name()?)));
        };
        if !is_bare(out) {
            let is_masked = imported!(out.py(), "phipsi._arguments", "is_masked")?;
            if is_masked.call1((out,))?.extract()? {
                return Err(refuse("a masked array".to_owned()));
            }
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

    /// Values in row-major order.
    pub fn numbers(&mut self) -> PyResult<&mut [P]> {
        match self {
            Self::Copied(_, numbers) => Ok(numbers.as_slice_mut().ok_or(AsSliceError)?),
            Self::Borrowed(_, write) => Ok(write.as_slice_mut()?),
        }
    }

    /// Copies rows of `width` numbers each, with checks for signals.
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

    /// The finished array, or a NumPy scalar for the empty shape.
    pub fn finish_or_scalar(self) -> PyResult<Object<'py>> {
        let array = self.finish();
        if array.ndim() == 0 { array.get_item(()) } else { Ok(array.into_any()) }
    }

    /// The finished array.
    pub fn finish(self) -> Bound<'py, PyArrayDyn<P>> {
        match self {
            Self::Copied(py, numbers) => numbers.to_pyarray(py),
            Self::Borrowed(array, _) => array,
        }
    }
}

fn refused_output(error: &BorrowError) -> PyErr {
    let found = match error {
        BorrowError::NotWriteable => "a read-only array",
        _ => "memory that is shared with an argument, or that another call is using",
    };
    Error::argument("out", found, "a writable array that overlaps no argument").into()
}

/// New array with these numbers in row-major order, or a NumPy scalar for the empty shape.
pub(super) fn from_numbers<'py>(py: Python<'py>, numbers: &[f64], shape: &[usize]) -> PyResult<Object<'py>> {
    match *shape {
        [length] if length == numbers.len() && length <= MANY => return Ok(numbers.to_pyarray(py).into_any()),
        [rows, columns] if numbers.len() <= MANY => {
            if let Ok(matrix) = ArrayView2::from_shape((rows, columns), numbers) {
                return Ok(matrix.to_pyarray(py).into_any());
            }
        }
        [count, rows, columns] if numbers.len() <= MANY => {
            if let Ok(matrices) = ArrayView3::from_shape((count, rows, columns), numbers) {
                return Ok(matrices.to_pyarray(py).into_any());
            }
        }
        _ => {}
    }
    let mut output = Output::new(py, shape)?;
    let width = shape.last().copied().unwrap_or(1);
    output.gather(py, width, numbers.chunks_exact(width.max(1)))?;
    output.finish_or_scalar()
}

/// New read-only array of a property of an object, because changes of it would have no effect.
pub(super) fn property<'py>(py: Python<'py>, numbers: &[f64], shape: &[usize]) -> PyResult<Object<'py>> {
    let array = from_numbers(py, numbers, shape)?;
    array.call_method1("setflags", (false,))?;
    Ok(array)
}

/// A named tuple of three fields: the matrices that are consecutive in the result of each state.
pub(super) fn three_matrices<'py>(class: &Object<'py>, all: &Object<'py>) -> PyResult<Object<'py>> {
    static NEW: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let py = all.py();
    // A call of the class would run Python code, which takes longer than the rest.
    let new = NEW.get_or_try_init(py, || py.get_type::<PyTuple>().getattr("__new__").map(Bound::unbind))?;
    new.bind(py).call1((class, three_parts(all, 2)?))
}

/// The three vectors or matrices (one or two axes) that are consecutive in the result of each state.
pub(super) fn three_parts<'py>(all: &Object<'py>, axes: usize) -> PyResult<(Object<'py>, Object<'py>, Object<'py>)> {
    Ok((part(all, axes, 0)?, part(all, axes, 1)?, part(all, axes, 2)?))
}

/// View of one of the vectors or matrices (one or two axes) that are consecutive in the result of each state.
fn part<'py>(all: &Object<'py>, axes: usize, which: usize) -> PyResult<Object<'py>> {
    if all.cast::<PyUntypedArray>()?.ndim() == axes + 1 {
        return all.get_item(which);
    }
    let (py, whole) = (all.py(), PySlice::full(all.py()));
    if axes == 1 {
        all.get_item((py.Ellipsis(), which, whole))
    } else {
        all.get_item((py.Ellipsis(), which, &whole, &whole))
    }
}
