//! The method `Scene.estimate`: conditional means given measured joint torques (section 2).

use super::axis::Axis;
use super::call::BatchCall;
use super::choice::renamed;
use super::errors::refuse;
use super::input::{Input, is_bare};
use super::keywords::Keywords;
use super::object::{Object, imported};
use super::scene::PyScene;
use super::scratch::{Estimation, Scratch};
use crate::dynamics::{Estimate, EstimateCovariance, Measurements};
use crate::error::Error;
use crate::operators::BatchEstimate;
use crate::operators::dense::DENSE_CAP;
use crate::scene::Scene;
use nalgebra::{Matrix6, Vector6};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::iter::once;

/// Approximate time per body and state, ns (see `BatchCall::new`).
mod cost {
    pub const MEANS: usize = 250;
    pub const COVARIANCES: usize = 600;
    /// Divided by the cube of the degrees of freedom.
    pub const DENSE: usize = 200;
}

/// Number of values per degree of freedom: means, and means with covariances.
const MEANS: usize = 1 + 1 + 6 + 6;
const WITH_COVARIANCE: usize = MEANS + 1 + 1 + 36 + 36;

#[pymethods]
impl PyScene {
    /// Forces, accelerations and torques from noisy measurements of joint torques, in O(N) (2.1, 2.7).
    #[doc = parameters!(q qd)]
    /// tau : (..., nv) array_like
    ///     Measured joint torques, N m or N. Entries that a masked array masks are not measured.
    /// noise : float or (..., nv) array_like, default 0
    ///     Variance of each measurement, (N m)^2 or N^2; 0: exact, inf: not measured.
    /// measured : iterable of str or (nv,) array_like of bool, optional
    ///     Names of the measured joints, or a mask; tau and noise of the others are not read. None: all joints.
    /// prior_acceleration : (..., nv) array_like, optional
    ///     Prior mean a0 of the joint accelerations, zero by default.
    /// acceleration_variance : float, default 1
    ///     s: prior variance of the acceleration of 1 kg m^2, (rad/s^2)^2, and of 1 kg, (m/s^2)^2.
    #[doc = entries!(wrenches models)]
    /// covariance : bool, default False
    ///     If true, compute the covariances of the errors too.
    /// method : {"sequential", "batch"}, default "sequential"
    ///     Filter and smoother, or the dense equations of section 2 as a check: O(N^3), at most 300 degrees of freedom.
    #[doc = entries!(errors)]
    #[doc = section!(Returns)]
    /// estimate : Estimate
    ///     Named tuple with the means of acceleration, torque, force and process, the log likelihood, and the
    ///     covariances.
    #[doc = section!(Raises)]
    /// SingularJointError
    ///     A measured joint without inertia along its axis; with covariance, any joint.
    #[doc = entries!(arguments)]
    #[doc = section!(Notes)]
    /// Model: W ~ N(b + Q phi* H* a0, s Q), so the prior of the accelerations is N(a0, s M^-1). A joint that is not
    /// measured keeps its mean a0, as if it were locked there, and its variance; its torque follows. If all joints are
    /// measured without noise, the result is forward dynamics. Variances are accurate to eps times those of the prior
    /// (docs/estimation.md).
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.scenes.chain(3)
    /// >>> q, qd, tau = [0.3, 0.2, 0.1], [1.0, 0.5, 0.2], [0.1, 0.0, 0.0]
    /// >>> estimate = scene.estimate(q, qd, tau)
    /// >>> np.allclose(estimate.acceleration, scene.forward_dynamics(q, qd, tau))
    /// True
    /// >>> scene.estimate(q, qd, tau, measured=["j0"], covariance=True).acceleration_variance.shape
    /// (3,)
    #[pyo3(signature = (q, qd, tau=None, *, noise=None, measured=None, prior_acceleration=None,
                        acceleration_variance=1.0, wrenches=None, inertias=None, armature=None, covariance=false,
                        method="sequential", errors="raise", torque=None),
           text_signature = "($self, q, qd, tau, *, noise=0.0, measured=None, prior_acceleration=None, \
                             acceleration_variance=1.0, wrenches=None, inertias=None, armature=None, \
                             covariance=False, method='sequential', errors='raise')")]
    fn estimate<'py>(
        &self,
        py: Python<'py>,
        q: &Object<'py>,
        qd: &Object<'py>,
        tau: Option<&Object<'py>>,
        noise: Option<&Object<'py>>,
        measured: Option<&Object<'py>>,
        prior_acceleration: Option<&Object<'py>>,
        acceleration_variance: f64,
        wrenches: Option<&Object<'py>>,
        inertias: Option<&Object<'py>>,
        armature: Option<&Object<'py>>,
        covariance: bool,
        method: &str,
        errors: &str,
        torque: Option<&Object<'py>>,
    ) -> PyResult<Object<'py>> {
        renamed("torque", torque, "tau")?;
        let Some(tau) = tau else {
            return refuse("tau", "no value", "the measured torques, (..., nv)");
        };
        self.scene.check_independent()?;
        let nv = self.scene.nv();
        let dense = self.is_dense(method)?;
        let measured = measured.map(|measured| self.joint_mask("measured", measured)).transpose()?;
        let has_prior = prior_acceleration.is_some();
        self.scene.check_prior(acceleration_variance)?;
        let (torque, unknown) = with_mask("tau", tau, self.rates(), Input::new)?;
        let (noise, hidden) = match noise {
            Some(noise) => with_mask("noise", noise, self.rates(), Input::spread)?,
            None => (Input::filled(py, "noise", 0.0, nv)?, Input::filled(py, "noise", 0.0, nv)?),
        };
        let inputs = [
            self.configuration("q", q)?,
            self.rate("qd", qd)?,
            torque,
            noise,
            unknown,
            hidden,
            match prior_acceleration {
                Some(prior) => self.rate("prior_acceleration", prior)?,
                None => Input::filled(py, "prior_acceleration", 0.0, nv)?,
            },
        ];
        let bodies = (cost::MEANS + usize::from(covariance) * cost::COVARIANCES) * self.size();
        let cost = if dense { cost::DENSE * nv * nv * nv } else { bodies };
        let call =
            self.call_by(inputs, cost, &Keywords { errors, wrenches, inertias, armature, ..Keywords::none() })?;
        let width = 1 + nv * if covariance { WITH_COVARIANCE } else { MEANS };
        let mut results = call.scratch_results(py, width)?;
        let numbers = results.numbers()?;
        call.numbers(py, numbers, |scene, scratch, [q, qd, torque, noise, unknown, hidden, prior], out| {
            let Scratch { workspace, estimation, forces, .. } = scratch;
            let kept = estimation.get_or_insert_with(|| Estimation::new(scene));
            for (row, own) in kept.noise.iter_mut().enumerate() {
                let is_measured = measured.as_ref().is_none_or(|measured| measured[row]);
                // `hidden` is infinite at masked entries and zero elsewhere.
                *own = if is_measured { noise[row] + unknown[row] + hidden[row] } else { f64::INFINITY };
            }
            let prior_acceleration = has_prior.then_some(prior);
            let measurements = Measurements { torque, noise: &kept.noise, prior_acceleration, acceleration_variance };
            if dense {
                let batch = scene.estimate_batch(workspace, q, qd, &measurements, &forces[0], covariance);
                write_batch(&batch.map_err(in_python_words)?, out);
            } else {
                let room = covariance.then_some(&mut kept.covariance);
                let (scratch, estimate) = (&mut kept.scratch, &mut kept.estimate);
                let done = scene.estimate(workspace, scratch, q, qd, &measurements, &forces[0], estimate, room);
                done.map_err(in_python_words)?;
                write_sequential(scene, estimate, covariance.then_some(&kept.covariance), out);
            }
            Ok(())
        })?;
        result(&call, py, results.numbers()?, covariance)
    }
}

/// An error of the measurements with the name of the argument in Python.
fn in_python_words(mut error: Error) -> Error {
    if let Error::NotFinite { argument, .. } = &mut error
        && argument == "torque"
    {
        "tau".clone_into(argument);
    }
    error
}

impl PyScene {
    /// Reads the argument `method`: whether it is the dense one.
    fn is_dense(&self, method: &str) -> Result<bool, Error> {
        let nv = self.scene.nv();
        match method {
            "sequential" => Ok(false),
            "batch" if nv <= DENSE_CAP => Ok(true),
            "batch" => Err(Error::argument(
                "method",
                format!("\"batch\" for {nv} degrees of freedom"),
                format!("at most {DENSE_CAP} for 6N x 6N matrices; use \"sequential\""),
            )),
            _ => Err(Error::argument("method", format!("{method:?}"), "\"sequential\" or \"batch\"")),
        }
    }
}

/// Reads an argument with masked entries: its values with zero at masked entries, and an array with infinity there.
fn with_mask<'a, 'py>(
    name: &'static str,
    value: &Object<'py>,
    axis: Axis<'a>,
    read: impl Fn(&'static str, &Object<'py>, Axis<'a>) -> PyResult<Input<'py>>,
) -> PyResult<(Input<'py>, Input<'py>)> {
    let py = value.py();
    let split = imported!(py, "phipsi._arguments", "split_mask")?;
    let parts = if is_bare(value) { None } else { split.call1((value,))?.extract::<Option<[Object<'py>; 2]>>()? };
    match parts {
        Some([known, unknown]) => Ok((read(name, &known, axis)?, read(name, &unknown, axis)?)),
        None => Ok((read(name, value, axis)?, Input::filled(py, name, 0.0, axis.width())?)),
    }
}

/// Writes the results of one state in the order of the fields, one block per degree of freedom.
fn write_sequential(
    scene: &Scene,
    estimate: &Estimate<f64>,
    covariance: Option<&EstimateCovariance<f64>>,
    out: &mut [f64],
) {
    // (body, whether the body's inertia enters at this row)
    let rows = || {
        scene.model().system.stages.iter().enumerate().flat_map(|(k, stage)| {
            let count = stage.rows.count();
            (0..count).map(move |i| (k, i + 1 == count))
        })
    };
    let vector = |v: Vector6<f64>| <[f64; 6]>::from(v);
    let process = |(k, enters): (usize, bool)| vector(if enters { estimate.process[k] } else { Vector6::zeros() });
    let means = once(estimate.log_likelihood)
        .chain(estimate.acceleration.iter().copied())
        .chain(estimate.torque.iter().copied())
        .chain(rows().flat_map(|(k, _)| vector(estimate.force[k])))
        .chain(rows().flat_map(process));
    let covariances = covariance.into_iter().flat_map(|covariance| {
        // The matrix is symmetric, so column-major order equals row-major order.
        let matrix = |m: Matrix6<f64>| (0..36).map(move |i| m[i]);
        let process = move |(k, enters): (usize, bool)| {
            matrix(if enters { covariance.process[k].to_matrix() } else { Matrix6::zeros() })
        };
        let variances = covariance.acceleration.iter().chain(&covariance.torque).copied();
        let forces = rows().flat_map(move |(k, _)| matrix(covariance.force[k].to_matrix()));
        variances.chain(forces).chain(rows().flat_map(process))
    });
    write(means.chain(covariances), out);
}

/// The same for the dense method.
fn write_batch(estimate: &BatchEstimate, out: &mut [f64]) {
    let nv = estimate.acceleration.len();
    let BatchEstimate { log_likelihood, acceleration, torque, force, process, covariance } = estimate;
    let means = once(log_likelihood).chain(acceleration).chain(torque).chain(force).chain(process);
    let covariances = covariance.iter().flat_map(|covariance| {
        let [a, t] = [&covariance.acceleration, &covariance.torque];
        let variances = (0..nv).map(|i| a[(i, i)]).chain((0..nv).map(|i| t[(i, i)]));
        let blocks = [&covariance.force, &covariance.process]
            .into_iter()
            .flat_map(move |m| (0..nv).flat_map(move |k| (0..36).map(move |i| m[(6 * k + i / 6, 6 * k + i % 6)])));
        variances.chain(blocks)
    });
    write(means.copied().chain(covariances), out);
}

fn write(numbers: impl Iterator<Item = f64>, out: &mut [f64]) {
    for (to, from) in out.iter_mut().zip(numbers) {
        *to = from;
    }
}

/// Creates the named tuple of arrays from the results of all states.
fn result<'py>(call: &BatchCall<'_, 'py>, py: Python<'py>, results: &[f64], covariance: bool) -> PyResult<Object<'py>> {
    let nv = call.scene.scene.nv();
    let all: [(&str, &[usize]); 9] = [
        ("log_likelihood", &[]),
        ("acceleration", &[nv]),
        ("torque", &[nv]),
        ("force", &[nv, 6]),
        ("process", &[nv, 6]),
        ("acceleration_variance", &[nv]),
        ("torque_variance", &[nv]),
        ("force_covariance", &[nv, 6, 6]),
        ("process_covariance", &[nv, 6, 6]),
    ];
    let (names, shapes): (Vec<_>, Vec<_>) = all[..if covariance { 9 } else { 5 }].iter().copied().unzip();
    let fields = PyDict::new(py);
    for (name, array) in names.into_iter().zip(call.pieces(py, results, &shapes)?) {
        fields.set_item(name, array)?;
    }
    imported!(py, "phipsi._results", "Estimate")?.call((), Some(&fields))
}
