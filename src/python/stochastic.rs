//! The class `RandomModel`: the spatially random model of a scene at one configuration.

use super::axis::Axis;
use super::choice::choose;
use super::counts::{count, count_or, number};
use super::errors::asked_by;
use super::input::state;
use super::interrupts::detached_checked;
use super::object::{Object, imported};
use super::output::{Output, from_numbers};
use super::scene::PyScene;
use crate::error::Error;
use crate::memory;
use crate::report::emergence::{ROUTES, emergence};
use crate::stochastic::{MassEstimate, Method, Points, RandomModel};
use numpy::PyArrayDyn;
use pyo3::prelude::*;
use std::ops::Range;

/// The spatially random model of a scene at one configuration (1.1 to 1.6): w(k) ~ N(b(k), s M(k)), X = phi W, T = H X + v.
///
/// Made by Scene.random_model. s is the acceleration variance, (rad/s^2)^2 of one kg m^2; v has the variance s times the armature.
#[pyclass(frozen, name = "RandomModel", module = "phipsi")]
pub(crate) struct PyRandomModel {
    model: RandomModel,
    scene: Py<PyScene>,
    q: Vec<f64>,
    qd: Option<Vec<f64>>,
    acceleration_variance: f64,
}

impl PyRandomModel {
    fn new(scene: &Bound<'_, PyScene>, q: Vec<f64>, qd: Option<Vec<f64>>, variance: f64) -> PyResult<Self> {
        let model = scene.get().scene.random_model(&q, qd.as_deref(), variance)?;
        Ok(Self { model, scene: scene.clone().unbind(), q, qd, acceleration_variance: variance })
    }
}

/// The model of what RandomModel.__reduce__ gave.
#[pyfunction]
#[pyo3(name = "_rebuild_random_model", signature = (scene, q, qd, acceleration_variance, /))]
pub(super) fn rebuild_random_model(
    scene: &Bound<'_, PyScene>,
    q: Vec<f64>,
    qd: Option<Vec<f64>>,
    acceleration_variance: f64,
) -> PyResult<PyRandomModel> {
    PyRandomModel::new(scene, q, qd, acceleration_variance)
}

#[pymethods]
impl PyScene {
    /// The spatially random model at q (1.1 to 1.6), to draw from: forces on the bodies, the joint torques that they cause.
    ///
    /// q: (nq,). qd: (nv,), rates: the mean of the forces is then the bias force b(k), gravity included; without rates the
    /// model is centred. acceleration_variance: (rad/s^2)^2, of one kg m^2 of inertia; it scales all covariances.
    ///
    /// Raises ArgumentError for a variance that is not positive, and for an inertia that no body can have, naming the link;
    /// ShapeError or NotFiniteError for bad arrays.
    #[pyo3(signature = (q, qd=None, *, acceleration_variance=1.0))]
    fn random_model(
        slf: &Bound<'_, Self>,
        q: &Object<'_>,
        qd: Option<&Object<'_>>,
        acceleration_variance: f64,
    ) -> PyResult<PyRandomModel> {
        let q = state("q", q, slf.get().coordinates())?;
        let qd = qd.map(|qd| state("qd", qd, slf.get().rates())).transpose()?;
        PyRandomModel::new(slf, q, qd, acceleration_variance)
    }
}

#[pymethods]
impl PyRandomModel {
    /// Number of degrees of freedom.
    #[getter]
    fn nv(&self) -> usize {
        self.model.nv()
    }

    /// Random numbers a sample: six a body (fewer for rods, point masses and frames), one a joint with armature.
    #[getter]
    fn dimension(&self) -> usize {
        self.model.dimension()
    }

    /// s, (rad/s^2)^2 of one kg m^2.
    #[getter]
    fn acceleration_variance(&self) -> f64 {
        self.acceleration_variance
    }

    /// Samples of the model: the named tuple Samples(process, force, torque).
    ///
    /// samples: how many; seed: an integer from 0 to 2^64 - 1; first: the number of the first sample, 0 if not given. Sample i
    /// of a seed is the same whatever is drawn with it and on however many threads. process and force: (samples, nv, 6), W and
    /// X = phi W in body frames, a block a degree of freedom as in Factor; torque: (samples, nv), T = H X + v.
    ///
    /// Raises ArgumentError for a bad count or seed; OutOfMemoryError for more samples than there is room for.
    #[pyo3(signature = (samples, *, seed, first=None))]
    fn sample<'py>(
        &self,
        py: Python<'py>,
        samples: &Object<'py>,
        seed: &Object<'py>,
        first: Option<&Object<'py>>,
    ) -> PyResult<Object<'py>> {
        let (points, range) = points_of(samples, seed, first)?;
        let count = usize::try_from(range.end - range.start)?;
        let nv = self.model.nv();
        memory::room("samples", self.model.bytes_of_samples(count))?;
        let unset = |shape: &[usize]| asked_by(py, "samples", Output::unwritten(py, shape));
        let [mut process, mut force, mut torque] =
            [unset(&[count, nv, 6])?, unset(&[count, nv, 6])?, unset(&[count, nv])?];
        let all = [process.numbers()?, force.numbers()?, torque.numbers()?];
        detached_checked(py, || self.model.sample_into(&points, range, all))?;
        imported!(py, "phipsi._results", "Samples")?.call1((process.finish(), force.finish(), torque.finish()))
    }

    /// The torques alone of the same samples, (samples, nv): arguments and errors as of sample().
    #[pyo3(signature = (samples, *, seed, first=None))]
    fn sample_torque<'py>(
        &self,
        py: Python<'py>,
        samples: &Object<'py>,
        seed: &Object<'py>,
        first: Option<&Object<'py>>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let (points, range) = points_of(samples, seed, first)?;
        let count = usize::try_from(range.end - range.start)?;
        let mut torque = asked_by(py, "samples", Output::unwritten(py, &[count, self.model.nv()]))?;
        let numbers = torque.numbers()?;
        detached_checked(py, || self.model.sample_into(&points, range, [&mut [], &mut [], numbers]))?;
        Ok(torque.finish())
    }

    /// The mass matrix as the covariance of T (5.1), with what is known of its error: the named tuple MassEstimate.
    ///
    /// method: "monte-carlo", independent samples, whose error falls as samples^-1/2; "sobol", scrambled Sobol points, samples
    /// being replicates times a power of two, about samples^-1; "sigma-points", exact, which takes neither samples nor seed.
    /// confidence: of the interval of each entry, between 0 and 1. replicates: scrambles, at least 2, for "sobol" only.
    ///
    /// Memory does not grow with the samples.
    ///
    /// Raises ArgumentError, naming the argument; OutOfMemoryError for more replicates than there is room for.
    #[pyo3(signature = (samples=None, *, seed=None, method="monte-carlo", confidence=0.95, replicates=None),
           text_signature = "($self, samples=None, *, seed=None, method='monte-carlo', confidence=0.95, replicates=8)")]
    #[allow(clippy::too_many_arguments)] // keywords, in Python
    fn mass_matrix<'py>(
        &self,
        py: Python<'py>,
        samples: Option<&Object<'py>>,
        seed: Option<&Object<'py>>,
        method: &str,
        confidence: f64,
        replicates: Option<&Object<'py>>,
    ) -> PyResult<Object<'py>> {
        let drawn = || -> PyResult<(usize, u64)> {
            let missing = |name: &str| Error::argument(name, "none", format!("an integer, for method {method:?}"));
            let samples = count("samples", samples.ok_or_else(|| missing("samples"))?, 1)?;
            Ok((at_most("samples", samples)?, number("seed", seed.ok_or_else(|| missing("seed"))?)?))
        };
        let method = match method {
            "monte-carlo" => {
                let (samples, seed) = drawn()?;
                Method::MonteCarlo { samples, seed, confidence }
            }
            "sobol" => {
                let (samples, seed) = drawn()?;
                let replicates = at_most("replicates", count_or("replicates", replicates, 1, 8)?)?;
                Method::Sobol { samples, seed, replicates, confidence }
            }
            "sigma-points" => Method::SigmaPoints,
            _ => {
                let expected = "one of \"monte-carlo\", \"sobol\", \"sigma-points\"";
                return Err(Error::argument("method", format!("{method:?}"), expected).into());
            }
        };
        let estimate = detached_checked(py, || self.model.mass_matrix(method))?;
        to_python(py, &estimate, self.model.nv(), confidence)
    }

    /// What the model is made of.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Object<'py>, Remade)> {
        let rebuild = py.import("phipsi._core")?.getattr("_rebuild_random_model")?;
        Ok((rebuild, (self.scene.clone_ref(py), self.q.clone(), self.qd.clone(), self.acceleration_variance)))
    }

    /// The model itself: it cannot change.
    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// The model itself: it cannot change.
    #[pyo3(signature = (memo, /))]
    fn __deepcopy__(slf: Py<Self>, memo: &Object<'_>) -> Py<Self> {
        let _ = memo;
        slf
    }

    fn __repr__(&self) -> String {
        format!("<phipsi.RandomModel of {} torques, {} random numbers a sample>", self.nv(), self.dimension())
    }
}

/// What a model is made of: scene, q, qd, acceleration variance.
type Remade = (Py<PyScene>, Vec<f64>, Option<Vec<f64>>, f64);

/// The named tuple of an estimate.
fn to_python<'py>(py: Python<'py>, estimate: &MassEstimate, nv: usize, confidence: f64) -> PyResult<Object<'py>> {
    let class = imported!(py, "phipsi._results", "MassEstimate")?;
    let matrix = |numbers: &[f64]| from_numbers(py, numbers, &[nv, nv]);
    let m = matrix(&estimate.mass_matrix)?;
    match &estimate.spread {
        None => class.call1((m, py.None(), py.None(), py.None(), estimate.samples, py.None())),
        Some(spread) => {
            let (low, high) = (matrix(&spread.low)?, matrix(&spread.high)?);
            class.call1((m, matrix(&spread.standard_error)?, low, high, estimate.samples, confidence))
        }
    }
}

/// The generator and the numbers of the samples asked for.
fn points_of(samples: &Object<'_>, seed: &Object<'_>, first: Option<&Object<'_>>) -> PyResult<(Points, Range<u64>)> {
    let samples = count("samples", samples, 1)? as u64;
    let first = first.map_or(Ok(0), |first| number("first", first))?;
    let Some(end) = first.checked_add(samples) else {
        return Err(Error::argument("first", first.to_string(), "samples that are numbered below 2^64").into());
    };
    Ok((Points::random(number("seed", seed)?), first..end))
}

/// More than that nobody waits for.
fn at_most(name: &str, count: usize) -> Result<usize, Error> {
    const MOST: usize = 1 << 40;
    if count > MOST { Err(Error::argument(name, count.to_string(), "at most 2^40")) } else { Ok(count) }
}

/// Median time (ns) of one route from q to the mass matrix, and its relative error (Frobenius norm, against double-double).
///
/// route: one of ROUTES; samples and seed are for "monte-carlo" and "sobol" (a power of two); repeats: how often it is timed.
#[pyfunction(name = "emergence")]
#[pyo3(signature = (scene, q, route, samples, seed, repeats))]
pub(super) fn emergence_of(
    py: Python<'_>,
    scene: &PyScene,
    q: &Object<'_>,
    route: &str,
    samples: &Object<'_>,
    seed: &Object<'_>,
    repeats: &Object<'_>,
) -> PyResult<(f64, f64)> {
    let samples = at_most("samples", count("samples", samples, 1)?)?;
    let (seed, repeats) = (number("seed", seed)?, count("repeats", repeats, 1)?);
    let scene = &scene.scene;
    let q = state("q", q, Axis::Coordinates(scene))?;
    let route = choose("route", route, &ROUTES)?;
    detached_checked(py, || emergence(scene, &q, route, (samples, seed), repeats))
}
