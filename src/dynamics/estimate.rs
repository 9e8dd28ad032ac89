//! Estimation (section 2): forces, accelerations and torques given the torques of some of the joints, with noise.
//!
//! The prior is the random model: W ~ N(b + Q phi* H* a0, s Q), X = phi W, T = H X + v, v ~ N(r a0, s r) with the
//! armature r. s is the `acceleration_variance`: Q is an inertia, so s Q is a covariance of forces if s is the variance
//! of the acceleration of one kg m^2, (rad/s^2)^2, or of one kg, (m/s^2)^2. Torques are T ~ N(T0, s M), and the
//! accelerations a = M^-1 (T - H phi b) are N(a0, s M^-1): joints with large inertia are expected to accelerate less.
//! The measurements are y = T + n, n ~ N(0, noise).
//!
//! Divided by s, this is the filter of section 3 with measurement noise r + noise/s. A joint that is not measured has
//! infinite noise: its gain is zero, and its acceleration equals the prior mean, as for a locked joint (a0 = 0) or a
//! prescribed acceleration a0.

use super::forces::Motion;
use super::sweeps::{co_state_covariances, general};
use crate::filter::pivots::PivotMonitor;
use crate::filter::{riccati, smoothed};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::Symmetric6;
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// The measurements, their noise, and the prior; slices are (nv).
#[derive(Debug, Clone, Copy)]
pub struct Measurements<'a, T: Real> {
    /// Measured torques y, N m or N; ignored where the noise is infinite.
    pub torque: &'a [T],
    /// Variance of each measurement error, (N m)^2 or N^2: zero for an exact measurement, infinite for no measurement.
    ///
    /// Infinity requires a scalar with infinite values (f64, not `DoubleDouble`).
    pub noise: &'a [T],
    /// Mean a0 of the joint accelerations, rad/s^2 or m/s^2; None: zero.
    pub prior_acceleration: Option<&'a [T]>,
    /// s: the variance of the acceleration of one kg m^2, (rad/s^2)^2, and of one kg, (m/s^2)^2. Positive.
    pub acceleration_variance: T,
}

impl<T: Real> Measurements<'_, T> {
    /// True if degree of freedom `row` is measured.
    #[must_use]
    pub(crate) fn is_measured(&self, row: usize) -> bool {
        self.noise[row].lane(0) < f64::INFINITY
    }
}

/// Conditional means given the measured torques y; one estimate can be used for many states.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate<T: Real> {
    /// E(a|y) of each degree of freedom, rad/s^2 or m/s^2 (2.8).
    pub acceleration: Vec<T>,
    /// E(T|y) of each degree of freedom, N m or N: H E(X|y) + r E(a|y).
    pub torque: Vec<T>,
    /// E(X|y) of each body, (moment, force) through its joint in its frame: the state of every row of the joint (2.1).
    pub force: Vec<Vector6<T>>,
    /// E(W|y) of each body, (moment, force) that its motion requires, including the bias; it enters at its outermost
    /// row (2.7, 2.10).
    pub process: Vec<Vector6<T>>,
    /// Log of the prior density of the measured torques; zero if no torque is measured.
    pub log_likelihood: f64,
}

impl<T: Real> Estimate<T> {
    /// Estimates of `model`, initialized with NaN.
    #[must_use]
    pub fn new(model: &Model<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        let bodies = vec![Vector6::from_element(nan); model.bodies.len()];
        Self {
            acceleration: vec![nan; model.nv()],
            torque: vec![nan; model.nv()],
            force: bodies.clone(),
            process: bodies,
            log_likelihood: f64::NAN,
        }
    }
}

/// Covariances of the errors of an [`Estimate`]: the diagonal, by degree of freedom or by body.
#[derive(Debug, Clone, PartialEq)]
pub struct EstimateCovariance<T: Real> {
    /// Variance of each acceleration, (rad/s^2)^2 or (m/s^2)^2.
    pub acceleration: Vec<T>,
    /// Variance of each torque (T itself, not a new measurement of it), (N m)^2 or N^2.
    pub torque: Vec<T>,
    /// Covariance of each body's force X, (6 x 6), its diagonal block of 2.6.
    pub force: Vec<Symmetric6<T>>,
    /// Covariance of each body's W, (6 x 6), its diagonal block of 2.11.
    pub process: Vec<Symmetric6<T>>,
}

impl<T: Real> EstimateCovariance<T> {
    /// Covariances of `model`, initialized with NaN.
    #[must_use]
    pub fn new(model: &Model<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        let bodies = vec![Symmetric6::filled(nan); model.bodies.len()];
        Self {
            acceleration: vec![nan; model.nv()],
            torque: vec![nan; model.nv()],
            force: bodies.clone(),
            process: bodies,
        }
    }
}

/// Scratch for estimation, in addition to the workspace.
#[derive(Debug, Clone)]
pub struct EstimateScratch<T: Real> {
    /// The scene's model with the noise of the measurements of this state, r + noise/s.
    pub(crate) model: Model<T>,
    /// y - r a0; zero where not measured.
    measurement: Vec<T>,
    /// P^+ and Lambda^- of each body.
    filtered: Vec<Symmetric6<T>>,
    co_state_covariance: Vec<Symmetric6<T>>,
    /// The diagonal of (H R H* + r + noise/s)^-1.
    information: Vec<T>,
    /// Identity of the model.
    pub(crate) identity: u64,
}

impl<T: Real> EstimateScratch<T> {
    /// Scratch for `model`.
    #[must_use]
    pub fn new(model: &Model<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        Self {
            model: model.clone(),
            measurement: vec![nan; model.nv()],
            filtered: vec![Symmetric6::filled(nan); model.bodies.len()],
            co_state_covariance: vec![Symmetric6::filled(nan); model.bodies.len()],
            information: vec![nan; model.nv()],
            identity: model.identity(),
        }
    }
}

/// E(a|y), E(T|y), E(X|y), E(W|y) and the likelihood of y in O(N): filter and smoother, then inverse dynamics at the
/// estimate.
///
/// `q` (nq) and `qd` (nv) are one state, `wrenches` as in [`forward_dynamics`](super::forward_dynamics). If all joints
/// are measured without noise, the result equals forward dynamics. About 1150 operations per joint with one axis. The
/// returned monitor refers to the pivots of the system of [`EstimateScratch`]; if one is lost, `out` is undefined.
#[allow(clippy::too_many_arguments)] // a state, what is known of it, and where results go
pub fn estimate<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut EstimateScratch<T>,
    q: &[T],
    qd: &[T],
    measurements: &Measurements<'_, T>,
    wrenches: &[Vector6<T>],
    out: &mut Estimate<T>,
) -> PivotMonitor<T> {
    for row in 0..model.nv() {
        let armature = model.system.noise[row];
        scratch.model.system.noise[row] = armature + measurements.noise[row] / measurements.acceleration_variance;
        // The mean of v is not part of H X.
        let mean = measurements.prior_acceleration.map_or_else(T::zero, |prior| armature * prior[row]);
        let is_measured = measurements.is_measured(row);
        scratch.measurement[row] = if is_measured { measurements.torque[row] - mean } else { T::zero() };
    }
    let (scene, store) = workspace.passes(&scratch.model);
    general::forces::<T, false>(scene, store, Motion { q, qd, qdd: measurements.prior_acceleration, wrenches });
    let accelerations = &mut out.acceleration;
    let monitor = general::filter_forces(scene, store, &scratch.measurement, accelerations);
    out.log_likelihood = log_likelihood(measurements, &store.measured, accelerations);
    // The rows write the same D and g again.
    let mut measured = std::mem::take(&mut store.measured);
    for (filtered, body) in scratch.filtered.iter_mut().zip(scene.1.swept()) {
        let body = (&scene.0.system, body, scene.1.load(body));
        *filtered = store.filtered_covariance(body, &mut measured, false, |_, _| {});
    }
    store.measured = measured;
    // The smoother computes the corrections of a0 by the measurements.
    general::smooth(scene, store, accelerations);
    if let Some(prior) = measurements.prior_acceleration {
        for (a, &prior) in accelerations.iter_mut().zip(prior) {
            *a += prior;
        }
    }
    // 2.10 and 2.1: inverse dynamics computes W = b + Q lambda and X = phi W.
    let (scene, store) = workspace.passes(model);
    general::forces::<T, false>(scene, store, Motion { q, qd, qdd: Some(accelerations), wrenches });
    out.process.iter_mut().zip(store.forces()).for_each(|(process, force)| *process = force);
    general::predict(scene, store, &mut out.torque);
    out.force.iter_mut().zip(store.forces()).for_each(|(whole, force)| *whole = force);
    for ((torque, &a), &armature) in out.torque.iter_mut().zip(accelerations.iter()).zip(&model.system.noise) {
        *torque += armature * a;
    }
    monitor
}

/// Sum over the measured rows of -(e^2 / (s D) + log(2 pi s D)) / 2: innovations are independent. In f64, because the
/// scalars have no logarithm.
fn log_likelihood<T: Real>(
    measurements: &Measurements<'_, T>,
    measured: &[riccati::Measured<T>],
    innovations: &[T],
) -> f64 {
    let s = measurements.acceleration_variance.lane(0);
    let constant = (2.0 * std::f64::consts::PI).ln() + s.ln();
    let mut total = 0.0;
    for (row, (m, &e)) in measured.iter().zip(innovations).enumerate() {
        if measurements.is_measured(row) {
            let square = (e * e * m.pivot_inverse).lane(0) / s;
            total -= 0.5 * (square + m.pivot.lane(0).ln() + constant);
        }
    }
    total
}

/// The covariances of the last [`estimate()`] with the same workspace, scratch and measurements, in O(N).
///
/// Forces and process noise follow from 2.6 and 2.11, torques from these and from the noise. Accelerations are s
/// ((M^-1)(i,i) - W(i,i)), where W is the inverse of the covariance of the measurements over s, from a second Riccati
/// sweep. The errors of this difference and of those in 2.6 and 2.11 are eps times the prior variance, not eps times
/// the result. The first is exactly zero if all joints are measured without noise. Results are not clipped. About 2700
/// operations per joint with one axis. The returned monitor refers to the pivots of the scene.
pub fn estimate_covariance<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut EstimateScratch<T>,
    measurements: &Measurements<'_, T>,
    out: &mut EstimateCovariance<T>,
) -> PivotMonitor<T> {
    let s = measurements.acceleration_variance;
    let EstimateScratch { model: measured_model, filtered, co_state_covariance, information, .. } = &mut *scratch;
    let (system, store) = (&measured_model.system, &workspace.store);
    co_state_covariances(system, (&store.shifts, &store.measured), co_state_covariance, |(k, row), lambda, _| {
        information[row] = smoothed::information(&store.measured[row], lambda);
        // On the inboard side of the joint, where the zeros of noise-free measurements in P^+ make H P = 0 exact.
        if row == system.stages[k].first_row {
            out.force[k] = smoothed::remaining(&filtered[k], lambda);
        }
    });
    for (k, (body, stage)) in model.bodies.iter().zip(&model.system.stages).enumerate() {
        let lambda = &scratch.co_state_covariance[k];
        out.process[k] = smoothed::remaining(&body.inertia.to_symmetric(), lambda).scaled(s);
        for i in 0..stage.rows.count() {
            let row = stage.first_row + i;
            let hinge = stage.rows.row(i);
            let remaining = hinge.project(&hinge.covariance_column(&out.force[k]));
            let armature = model.system.noise[row];
            out.torque[row] = torque_variance(measurements, row, remaining, armature, scratch.information[row]);
        }
        out.force[k] = out.force[k].scaled(s);
    }

    let (scene, store) = workspace.passes(model);
    let monitor = general::refactor(scene, store);
    let (measured, accelerations) = (&store.measured, &mut out.acceleration);
    let co_states = &mut scratch.co_state_covariance;
    let told = &scratch.information;
    co_state_covariances(&model.system, (&store.shifts, measured), co_states, |(_, row), lambda, _| {
        accelerations[row] = s * (smoothed::information(&measured[row], lambda) - told[row]);
    });
    monitor
}

/// The variance of T = H x + v given all measurements; `remaining` is H (P - P Lambda P) H* (before s), W
/// `information`.
///
/// Not measured: s (H.H* + r), because no measurement contains v. Measured: with h the variance of H x given the other
/// rows and c = r + noise/s, W = 1/(h + c) and `remaining` = h c/(h + c), so that noise (1 - noise/s W) = noise
/// (`remaining`/c + r W). The first form is exact for zero noise, the second for noise far above the prior variance;
/// each is used in its range.
fn torque_variance<T: Real>(
    measurements: &Measurements<'_, T>,
    row: usize,
    remaining: T,
    armature: T,
    information: T,
) -> T {
    let (s, noise) = (measurements.acceleration_variance, measurements.noise[row]);
    if !measurements.is_measured(row) {
        return s * (remaining + armature);
    }
    let told = noise / s * information;
    if told.lane(0) <= 0.5 {
        noise * (T::one() - told)
    } else {
        noise * (remaining / (armature + noise / s) + armature * information)
    }
}
