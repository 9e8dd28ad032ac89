//! Exact answers, their sensitivity, and the error and time of each method on one state.

use super::arrays;
use super::choice::choose;
use super::counts::{count, count_or, number};
use super::interrupts::{detached, detached_checked};
use super::labels::Axis;
use super::scene::PyScene;
use crate::error::Error;
use crate::report::accuracy::{Method, States, measure};
use crate::report::sensitivity::{Difference, Exact, QUANTITIES, Quantity, State, sensitivity};
use crate::report::stability::{FORMS, Failure, forward_error, recursion_error};
use crate::scalar::{DoubleDouble, Real};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// A difference in two norms: the largest over the largest number, and each over its own.
type Norms<'py> = (f64, Bound<'py, PyAny>);

/// A quantity of one state in double-double arithmetic, and what is measured against it.
///
/// quantity: one of QUANTITIES; q: (nq,), qd: (nv,); u: (nv,), torques, or accelerations for "inverse dynamics".
/// Raises ArgumentError for an unknown quantity, ShapeError and NotFiniteError for arrays, SingularJointError.
#[pyclass(frozen, name = "Exact", module = "phipsi._core")]
pub(crate) struct PyExact {
    scene: Py<PyScene>,
    quantity: Quantity,
    q: Vec<f64>,
    qd: Vec<f64>,
    u: Vec<f64>,
    exact: Exact,
}

impl PyExact {
    fn state(&self) -> State<'_> {
        State { q: &self.q, qd: &self.qd, u: &self.u }
    }
}

#[pymethods]
impl PyExact {
    #[new]
    #[pyo3(signature = (scene, quantity, q, qd, u))]
    fn new(
        scene: &Bound<'_, PyScene>,
        quantity: &str,
        q: &Bound<'_, PyAny>,
        qd: &Bound<'_, PyAny>,
        u: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let quantity = choose("quantity", quantity, &QUANTITIES)?;
        let inner = &scene.get().scene;
        let q = arrays::state("q", q, Axis::Coordinates(inner))?;
        let qd = arrays::state("qd", qd, Axis::Rates(inner))?;
        let u = arrays::state("u", u, Axis::Rates(inner))?;
        let state = State { q: &q, qd: &qd, u: &u };
        let exact = detached_checked(scene.py(), || Exact::new(inner, quantity, state))?;
        Ok(Self { scene: scene.clone().unbind(), quantity, q, qd, u, exact })
    }

    /// The answer rounded to float64, (nv,) or (nv * nv,).
    fn toarray<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let rounded: Vec<f64> = self.exact.values.iter().map(|value| value.lane(0)).collect();
        arrays::from_numbers(py, &rounded, &[rounded.len()])
    }

    /// How far numbers of another program are from it, relative: the max-norm, and each component against its own size.
    #[pyo3(signature = (found, /))]
    fn difference<'py>(&self, py: Python<'py>, found: &Bound<'py, PyAny>) -> PyResult<Norms<'py>> {
        let found = arrays::fixed("found", found, &[self.exact.values.len()])?;
        let wide: Vec<DoubleDouble> = found.into_iter().map(DoubleDouble::from_f64).collect();
        norms(py, &self.exact.difference(&wide))
    }

    /// The error of one method (one of FORMS; the library's recursion for other quantities than forward dynamics) in
    /// "float64" or "float32": (max-norm, components, reason); NaN and a reason where the method failed, else None.
    #[pyo3(signature = (method, precision="float64"))]
    fn error<'py>(
        &self,
        py: Python<'py>,
        method: &str,
        precision: &str,
    ) -> PyResult<(f64, Bound<'py, PyAny>, Option<&'static str>)> {
        let (method, single) = (choose("method", method, &FORMS)?, is_single(precision)?);
        let (scene, state, exact) = (&self.scene.get().scene, self.state(), &self.exact);
        let found = detached(py, || match (self.quantity, single) {
            (Quantity::ForwardDynamics, false) => forward_error::<f64>(scene, method, state, exact),
            (Quantity::ForwardDynamics, true) => forward_error::<f32>(scene, method, state, exact),
            (quantity, false) => recursion_error::<f64>(scene, quantity, state, exact),
            (quantity, true) => recursion_error::<f32>(scene, quantity, state, exact),
        })?;
        let (difference, reason) = match found {
            Ok(difference) => (difference, None),
            Err(failure) => (nothing(exact.values.len()), Some(Failure::reason(failure))),
        };
        let (norm, components) = norms(py, &difference)?;
        Ok((norm, components, reason))
    }

    /// By how much the answer changes when numbers move by one unit in the last place: kind of number to (max-norm, components).
    #[pyo3(signature = (draws=None, seed=None), text_signature = "($self, draws=4, seed=0)")]
    fn sensitivity<'py>(
        &self,
        py: Python<'py>,
        draws: Option<&Bound<'py, PyAny>>,
        seed: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let draws = count_or("draws", draws, 0, 4)?;
        let seed = seed.map_or(Ok(0), |seed| number("seed", seed))?;
        let scene = &self.scene.get().scene;
        let found = detached_checked(py, || sensitivity(scene, self.quantity, self.state(), draws, seed))?;
        let all = PyDict::new(py);
        for (name, difference) in found {
            all.set_item(name, norms(py, &difference)?)?;
        }
        Ok(all)
    }

    /// Median time of one method on this state over `repeats` calls, ns; for forward dynamics.
    #[pyo3(signature = (method, precision, repeats))]
    fn time(&self, py: Python<'_>, method: &str, precision: &str, repeats: &Bound<'_, PyAny>) -> PyResult<f64> {
        let repeats = count("repeats", repeats, 1)?;
        let (method, single) = (choose("method", method, &FORMS)?, is_single(precision)?);
        if self.quantity != Quantity::ForwardDynamics {
            return Err(Error::argument("quantity", format!("{:?}", self.quantity), "forward dynamics").into());
        }
        let (scene, values) = (&self.scene.get().scene, &self.exact.values);
        let states = States { q: &self.q, qd: &self.qd, tau: &self.u };
        let measured = detached_checked(py, || {
            if single {
                measure::<f32>(scene, method, states, values, repeats)
            } else {
                measure::<f64>(scene, method, states, values, repeats)
            }
        })?;
        Ok(measured.ns)
    }
}

fn norms<'py>(py: Python<'py>, difference: &Difference) -> PyResult<Norms<'py>> {
    let components = arrays::from_numbers(py, &difference.components, &[difference.components.len()])?;
    Ok((difference.norm, components))
}

fn nothing(count: usize) -> Difference {
    Difference { norm: f64::NAN, components: vec![f64::NAN; count] }
}

fn is_single(precision: &str) -> Result<bool, Error> {
    match precision {
        "float64" => Ok(false),
        "float32" => Ok(true),
        _ => Err(Error::argument("precision", format!("{precision:?}"), "\"float64\" or \"float32\"")),
    }
}

/// The names of FORMS, for Python.
pub(super) fn forms() -> [&'static str; FORMS.len()] {
    FORMS.map(|(name, _): (&str, Method)| name)
}

/// The names of QUANTITIES, for Python.
pub(super) fn quantities() -> [&'static str; QUANTITIES.len()] {
    QUANTITIES.map(|(name, _)| name)
}
