//! Exact results, their sensitivity, and the error and time of each method on one state.

use super::choice::choose;
use super::counts::{count, count_or, number};
use super::errors::refuse;
use super::input::{fixed, state};
use super::interrupts::{detached, detached_checked};
use super::object::Object;
use super::output::from_numbers;
use super::scene::PyScene;
use crate::report::accuracy::{States, measure};
use crate::report::sensitivity::{Difference, Exact, QUANTITIES, Quantity, State, sensitivity};
use crate::report::stability::{FORMS, Failure, forward_error, recursion_error};
use crate::scalar::{DoubleDouble, Real};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// A difference in two norms: the max-norm, and each component relative to its own size.
type Norms<'py> = (f64, Object<'py>);

/// Quantity of one state in double-double arithmetic, and errors measured against it.
///
/// quantity: one of QUANTITIES; q: (nq,), qd: (nv,); u: (nv,), torques, or accelerations for "inverse dynamics".
/// Raises ArgumentError for an unknown quantity, ShapeError and NotFiniteError for arrays, and SingularJointError.
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
    fn new(
        scene: &Bound<'_, PyScene>,
        quantity: &str,
        q: &Object<'_>,
        qd: &Object<'_>,
        u: &Object<'_>,
    ) -> PyResult<Self> {
        let quantity = choose("quantity", quantity, QUANTITIES)?;
        let own = scene.get();
        let q = state("q", q, own.coordinates())?;
        let [qd, u] = [state("qd", qd, own.rates())?, state("u", u, own.rates())?];
        let given = State { q: &q, qd: &qd, u: &u };
        let exact = detached_checked(scene.py(), || Exact::new(&own.scene, quantity, given))?;
        Ok(Self { scene: scene.clone().unbind(), quantity, q, qd, u, exact })
    }

    /// Exact result rounded to float64, (nv,) or (nv * nv,).
    fn toarray<'py>(&self, py: Python<'py>) -> PyResult<Object<'py>> {
        let rounded: Vec<f64> = self.exact.values.iter().map(|value| value.lane(0)).collect();
        from_numbers(py, &rounded, &[rounded.len()])
    }

    /// Relative error of a result of another program: the max-norm, and each component relative to its own size.
    #[pyo3(signature = (found, /))]
    fn difference<'py>(&self, py: Python<'py>, found: &Object<'py>) -> PyResult<Norms<'py>> {
        let found = fixed("found", found, &[self.exact.values.len()])?;
        let wide: Vec<DoubleDouble> = found.into_iter().map(DoubleDouble::from_f64).collect();
        norms(py, &self.exact.difference(&wide))
    }

    /// Error of a method: (max-norm, components, reason).
    ///
    /// method: one of FORMS; for other quantities than forward dynamics, the recursion of the library. After a failure,
    /// the errors are NaN and the reason is a text, otherwise None.
    fn error<'py>(&self, py: Python<'py>, method: &str) -> PyResult<(f64, Object<'py>, Option<&'static str>)> {
        let method = choose("method", method, FORMS)?;
        let (scene, state, exact) = (&self.scene.get().scene, self.state(), &self.exact);
        let found = detached(py, || match self.quantity {
            Quantity::ForwardDynamics => forward_error(scene, method, state, exact),
            quantity => recursion_error(scene, quantity, state, exact),
        })?;
        let nothing = || Difference { norm: f64::NAN, components: vec![f64::NAN; exact.values.len()] };
        let reason = found.as_ref().err().map(|failure| Failure::reason(*failure));
        let (norm, components) = norms(py, &found.unwrap_or_else(|_| nothing()))?;
        Ok((norm, components, reason))
    }

    /// Median time (ns) of a method of forward dynamics on this state over repeats calls.
    fn time(&self, py: Python<'_>, method: &str, repeats: &Object<'_>) -> PyResult<f64> {
        let repeats = count("repeats", repeats, 1)?;
        let method = choose("method", method, FORMS)?;
        if self.quantity != Quantity::ForwardDynamics {
            return refuse("quantity", format!("{:?}", self.quantity), "forward dynamics");
        }
        let (scene, values) = (&self.scene.get().scene, &self.exact.values);
        let states = States { q: &self.q, qd: &self.qd, tau: &self.u };
        let measured = detached_checked(py, || measure(scene, method, states, values, repeats))?;
        Ok(measured.ns)
    }
}

typed_methods! {
    in PyExact;

    /// Change of the exact result for one unit in the last place of an input: kind to (max-norm, components).
    fn sensitivity[&self, py: Python<'py>](
        draws: Option<&Object<'py>> = None => "4", seed: Option<&Object<'py>> = None => "0"
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
}

fn norms<'py>(py: Python<'py>, difference: &Difference) -> PyResult<Norms<'py>> {
    let components = from_numbers(py, &difference.components, &[difference.components.len()])?;
    Ok((difference.norm, components))
}
