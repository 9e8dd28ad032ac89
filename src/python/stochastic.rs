//! The class `RandomModel`: the spatially random model of a scene at one configuration.

use super::axis::Axis;
use super::choice::{choose, refuse_unknown};
use super::counts::{count, count_or, number};
use super::errors::{asked_by, refuse};
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
use pyo3::types::PyDict;
use std::ops::Range;

/// Random forces on the bodies at one configuration, and the joint torques that they cause (1.1 to 1.6).
///
/// Create it with Scene.random_model. s is the acceleration variance, (rad/s^2)^2 of 1 kg m^2; v has the variance s
/// times the armature.
#[doc = section!(Examples)]
/// >>> model = phipsi.scenes.chain(3).random_model([0.3, 0.2, 0.1])
/// >>> model.nv, model.dimension
/// (3, 18)
#[pyclass(frozen, name = "RandomModel", module = "phipsi")]
pub(crate) struct PyRandomModel {
    model: RandomModel,
    scene: Py<PyScene>,
    q: Vec<f64>,
    qd: Option<Vec<f64>>,
    acceleration_variance: f64,
}

/// Creates a model, or rebuilds it from the result of RandomModel.__reduce__.
#[pyfunction]
#[pyo3(name = "_rebuild_random_model", signature = (scene, q, qd, acceleration_variance, /))]
pub(super) fn rebuild_random_model(
    scene: &Bound<'_, PyScene>,
    q: Vec<f64>,
    qd: Option<Vec<f64>>,
    acceleration_variance: f64,
) -> PyResult<PyRandomModel> {
    let model = scene.get().scene.random_model(&q, qd.as_deref(), acceleration_variance)?;
    Ok(PyRandomModel { model, scene: scene.clone().unbind(), q, qd, acceleration_variance })
}

typed_methods! {
    in PyScene;

    /// Create a model with random forces on bodies at q, to sample joint torques (1.1 to 1.6).
    #[doc = section!(Parameters)]
    /// q : (nq,) array_like
    ///     Joint positions, rad or m.
    /// qd : (nv,) array_like, optional
    ///     Joint velocities, rad/s or m/s: the mean force is the bias force b(k), including gravity. None: the mean is
    ///     zero.
    /// acceleration_variance : float, default 1
    ///     s: variance of the acceleration of 1 kg m^2, (rad/s^2)^2. It scales all covariances.
    #[doc = section!(Returns)]
    /// model : RandomModel
    ///     The model.
    #[doc = section!(Raises)]
    /// ShapeError, NotFiniteError, ArgumentError
    ///     An invalid array, a variance that is not positive, or an inertia that no rigid body can have, with its link.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> model = scene.random_model([0.3, 0.2, 0.1])
    /// >>> np.allclose(model.mass_matrix(method="sigma-points").mass_matrix, scene.mass_matrix([0.3, 0.2, 0.1]))
    /// True
    fn random_model[slf: &Bound<'py, Self>](
        q: &Object<'py>, qd: Option<&Object<'py>> = None; acceleration_variance: f64 = 1.0, **unknown
    ) -> PyResult<PyRandomModel> {
        refuse_unknown(slf.py(), "Scene.random_model", unknown)?;
        let q = state("q", q, slf.get().coordinates())?;
        let qd = qd.map(|qd| state("qd", qd, slf.get().rates())).transpose()?;
        rebuild_random_model(slf, q, qd, acceleration_variance)
    }
}

getters! {
    in PyRandomModel;

    /// Number of degrees of freedom.
    nv: usize = |of, _| of.model.nv();

    /// Random numbers per sample: six per body (rods and point masses: fewer), one per joint with armature.
    dimension: usize = |of, _| of.model.dimension();

    /// Acceleration variance s, (rad/s^2)^2 of 1 kg m^2.
    acceleration_variance: f64 = |of, _| of.acceleration_variance;
}

typed_methods! {
    in PyRandomModel;

    /// Samples of the process W, the force X = phi W and the torque T = H X + v.
    #[doc = parameters!(samples)]
    /// first : int, optional
    ///     Number of the first sample, 0 by default. Sample i of a seed does not depend on the others or on the
    ///     threads.
    #[doc = section!(Returns)]
    /// samples : Samples
    ///     Named tuple: process and force, (samples, nv, 6), in body frames with one block per degree of freedom as in
    ///     Factor; torque, (samples, nv).
    #[doc = raises!(arguments memory)]
    #[doc = section!(Examples)]
    /// >>> model = phipsi.scenes.chain(3).random_model([0.3, 0.2, 0.1])
    /// >>> one, other = model.sample(4, seed=1), model.sample(2, seed=1, first=2)
    /// >>> np.array_equal(one.torque[2:], other.torque)
    /// True
    fn sample[&self, py: Python<'py>](
        samples: &Object<'py>; seed: &Object<'py>, first: Option<&Object<'py>> = None
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

    /// Samples of the joint torques T = H X + v only, equal to those of sample.
    #[doc = parameters!(samples)]
    /// first : int, optional
    ///     Number of the first sample, 0 by default.
    #[doc = section!(Returns)]
    /// torque : (samples, nv) ndarray
    ///     Joint torques, N m or N.
    #[doc = raises!(arguments memory)]
    #[doc = section!(Examples)]
    /// >>> model = phipsi.scenes.chain(3).random_model([0.3, 0.2, 0.1])
    /// >>> np.array_equal(model.sample_torque(4, seed=1), model.sample(4, seed=1).torque)
    /// True
    fn sample_torque[&self, py: Python<'py>](
        samples: &Object<'py>; seed: &Object<'py>, first: Option<&Object<'py>> = None
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let (points, range) = points_of(samples, seed, first)?;
        let count = usize::try_from(range.end - range.start)?;
        let mut torque = asked_by(py, "samples", Output::unwritten(py, &[count, self.model.nv()]))?;
        let numbers = torque.numbers()?;
        detached_checked(py, || self.model.sample_into(&points, range, [&mut [], &mut [], numbers]))?;
        Ok(torque.finish())
    }

    /// Estimate the mass matrix from sampled joint torques, with confidence intervals (5.1).
    #[doc = section!(Parameters)]
    /// samples : int, optional
    ///     Number of samples; for "sobol" replicates times a power of two, for "sigma-points" none.
    /// seed : int, optional
    ///     Seed, from 0 to 2^64 - 1; for "sigma-points" none.
    /// method : {"monte-carlo", "sobol", "sigma-points"}, default "monte-carlo"
    ///     Independent samples, with an error of samples^-1/2; scrambled Sobol points, about samples^-1; or sigma
    ///     points, exact.
    /// confidence : float, default 0.95
    ///     Confidence of the interval of each entry, between 0 and 1.
    /// replicates : int, default 8
    ///     Number of scrambles, at least 2, for "sobol" only.
    #[doc = section!(Returns)]
    /// estimate : MassEstimate
    ///     Named tuple (mass_matrix, standard_error, low, high, samples, confidence).
    #[doc = raises!(arguments memory)]
    #[doc = section!(Notes)]
    /// The memory does not grow with the number of samples.
    #[doc = section!(Examples)]
    /// >>> model = phipsi.scenes.chain(3).random_model([0.3, 0.2, 0.1])
    /// >>> estimate = model.mass_matrix(2000, seed=1)
    /// >>> bool((estimate.low <= estimate.high).all())
    /// True
    fn mass_matrix[&self, py: Python<'py>](
        samples: Option<&Object<'py>> = None; seed: Option<&Object<'py>> = None, method: &str = "monte-carlo",
        confidence: f64 = 0.95, replicates: Option<&Object<'py>> = None => "8"
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
                return refuse("method", format!("{method:?}"), "one of \"monte-carlo\", \"sobol\", \"sigma-points\"");
            }
        };
        let estimate = detached_checked(py, || self.model.mass_matrix(method))?;
        to_python(py, &estimate, self.model.nv(), confidence)
    }
}

copied_as_itself!(PyRandomModel);

#[pymethods]
impl PyRandomModel {
    /// Arguments of the model.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Object<'py>, Remade)> {
        let rebuild = py.import("phipsi._core")?.getattr("_rebuild_random_model")?;
        Ok((rebuild, (self.scene.clone_ref(py), self.q.clone(), self.qd.clone(), self.acceleration_variance)))
    }

    fn __repr__(&self) -> String {
        format!(
            "<phipsi.RandomModel of {} torques, {} random numbers a sample>",
            self.model.nv(),
            self.model.dimension()
        )
    }
}

/// Arguments of a model: scene, q, qd, acceleration variance.
type Remade = (Py<PyScene>, Vec<f64>, Option<Vec<f64>>, f64);

/// Named tuple of an estimate.
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

/// Generator and numbers of the requested samples.
fn points_of(samples: &Object<'_>, seed: &Object<'_>, first: Option<&Object<'_>>) -> PyResult<(Points, Range<u64>)> {
    let samples = count("samples", samples, 1)? as u64;
    let first = first.map_or(Ok(0), |first| number("first", first))?;
    let Some(end) = first.checked_add(samples) else {
        return refuse("first", first.to_string(), "a number of the first sample such that all are below 2^64");
    };
    Ok((Points::random(number("seed", seed)?), first..end))
}

/// Checks an upper bound far beyond any practical number of samples.
fn at_most(name: &str, count: usize) -> Result<usize, Error> {
    const MOST: usize = 1 << 40;
    if count > MOST { Err(Error::argument(name, count.to_string(), "at most 2^40")) } else { Ok(count) }
}

/// Median time (ns) of a route from q to the mass matrix, and its error relative to double-double arithmetic.
///
/// route: one of ROUTES; samples and seed: for "monte-carlo" and "sobol" (a power of two); repeats: number of
/// timings. The error is in the Frobenius norm.
#[pyfunction(name = "emergence")]
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
    let route = choose("route", route, ROUTES)?;
    detached_checked(py, || emergence(scene, &q, route, (samples, seed), repeats))
}
