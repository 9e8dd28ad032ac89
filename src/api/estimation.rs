//! Estimation of forces, accelerations and torques of one state. Each method checks its arguments before it computes.

use crate::dynamics::{self, Estimate, EstimateCovariance, EstimateScratch, Measurements};
use crate::error::{Error, check_finite, check_length};
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::Workspace;

impl Scene {
    /// Scratch memory for [`Scene::estimate`].
    #[must_use]
    pub fn estimate_scratch(&self) -> EstimateScratch<f64> {
        EstimateScratch::new(self.model())
    }

    /// Estimates spatial forces, accelerations and joint torques from the measured torques of some joints.
    ///
    /// See [`dynamics::estimate()`] for the equations, and [`dynamics::estimate_covariance`] for the variances, which
    /// are computed if `covariance` is given. `q` (nq) and `qd` (nv) are in SI units; `wrenches` is as in
    /// [`Scene::forward_dynamics`]. Create `estimate` with [`Estimate::new`] and `covariance` with
    /// [`EstimateCovariance::new`]. O(N); does not allocate.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`]; [`Error::NotFinite`] (torques of unmeasured joints are not read); [`Error::Argument`] for
    /// noise that is negative or NaN and for an acceleration variance that is not positive; [`Error::SingularJoint`] if
    /// the pivot of a measured joint, or of any joint if covariances are computed, has no significant digits.
    #[allow(clippy::too_many_arguments)] // a state has several arrays; the caller owns scratch and results
    pub fn estimate(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut EstimateScratch<f64>,
        q: &[f64],
        qd: &[f64],
        measurements: &Measurements<'_, f64>,
        wrenches: &[SpatialVector<f64>],
        estimate: &mut Estimate<f64>,
        covariance: Option<&mut EstimateCovariance<f64>>,
    ) -> Result<(), Error> {
        self.check_no_connections("estimate")?;
        self.check_configuration("q", q)?;
        self.check_rates("qd", qd)?;
        self.check_measurements(measurements)?;
        self.check_wrenches(wrenches)?;
        self.check_workspace(workspace)?;
        self.check_scratch("scratch", scratch.identity, "scene.estimate_scratch()")?;
        let (nv, bodies) = (self.nv(), self.model().bodies.len());
        let Estimate { acceleration, torque, force, process, .. } = &*estimate;
        check_lengths("estimate", [acceleration.len(), torque.len(), force.len(), process.len()], [nv, bodies])?;
        if let Some(EstimateCovariance { acceleration, torque, force, process }) = covariance.as_deref() {
            check_lengths("covariance", [acceleration.len(), torque.len(), force.len(), process.len()], [nv, bodies])?;
        }
        let monitor = dynamics::estimate(self.model(), workspace, scratch, q, qd, measurements, wrenches, estimate);
        if let Some(lost) = workspace.lost_pivot_of(self.model(), &scratch.model.system, &monitor) {
            return Err(self.singular(lost));
        }
        self.check_result("estimated acceleration", &estimate.acceleration)?;
        self.check_result("estimated torque", &estimate.torque)?;
        estimate.force.iter().try_for_each(|force| self.check_result("estimated force", force.as_slice()))?;
        self.check_result("log-likelihood", &[estimate.log_likelihood])?;
        let Some(covariance) = covariance else { return Ok(()) };
        let monitor = dynamics::estimate_covariance(self.model(), workspace, scratch, measurements, covariance);
        self.check_pivots(workspace, monitor)?;
        self.check_result("variance of the acceleration", &covariance.acceleration)?;
        self.check_result("variance of the torque", &covariance.torque)
    }

    /// The estimate of [`Scene::estimate`], computed with dense matrices from the definitions of section 2 as a
    /// reference: see [`crate::operators::estimate_batch()`].
    ///
    /// # Errors
    ///
    /// As [`Scene::estimate`], and [`Error::Argument`] beyond 300 degrees of freedom.
    #[cfg(feature = "dense")]
    #[allow(clippy::too_many_arguments)] // as above
    pub fn estimate_batch(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        measurements: &Measurements<'_, f64>,
        wrenches: &[SpatialVector<f64>],
        with_covariance: bool,
    ) -> Result<crate::operators::BatchEstimate, Error> {
        self.check_no_connections("estimate")?;
        self.check_configuration("q", q)?;
        self.check_rates("qd", qd)?;
        self.check_measurements(measurements)?;
        self.check_wrenches(wrenches)?;
        self.check_workspace(workspace)?;
        let state = (q, qd, wrenches);
        let estimate = crate::operators::estimate_batch(self.model(), workspace, state, measurements, with_covariance)?;
        self.check_result("estimated acceleration", &estimate.acceleration)?;
        self.check_result("estimated force", &estimate.force)?;
        Ok(estimate)
    }

    /// Checks that measured torques are finite, noise is nonnegative, and the acceleration variance is positive.
    fn check_measurements(&self, measurements: &Measurements<'_, f64>) -> Result<(), Error> {
        let s = measurements.acceleration_variance;
        self.check_prior(s)?;
        check_length("torque", measurements.torque.len(), self.nv())?;
        check_length("noise", measurements.noise.len(), self.nv())?;
        for (row, (&noise, &torque)) in measurements.noise.iter().zip(measurements.torque).enumerate() {
            if !(noise >= 0.0) {
                let found = format!("{noise} for joint {:?}", self.joint_of_row(row));
                let expected = "a variance in (N m)^2: zero or positive, or infinity for a joint that is not measured";
                return Err(Error::argument("noise", found, expected));
            }
            if !measurements.is_measured(row) {
                continue;
            }
            if !(noise / s).is_finite() {
                let found = format!(
                    "{noise} for joint {:?} over acceleration_variance {s}, which overflows",
                    self.joint_of_row(row)
                );
                return Err(Error::argument("noise", found, "infinity for a joint that is not measured"));
            }
            if !torque.is_finite() {
                return Err(Error::NotFinite { argument: "torque".to_owned(), index: row, value: torque, state: None });
            }
        }
        if let Some(prior) = measurements.prior_acceleration {
            check_length("prior_acceleration", prior.len(), self.nv())?;
            check_finite("prior_acceleration", prior)?;
        }
        Ok(())
    }

    /// Checks the conditions that all states of a batch share: the scene supports estimation, and the acceleration
    /// variance is positive and finite.
    pub(crate) fn check_prior(&self, s: f64) -> Result<(), Error> {
        self.model().simplifications.check_every_body_moves("scene")?;
        if s > 0.0 && s.is_finite() {
            return Ok(());
        }
        let expected = "a variance of the acceleration of one kg m^2, (rad/s^2)^2: positive and finite";
        Err(Error::argument("acceleration_variance", s.to_string(), expected))
    }

    /// Name of the joint that owns degree of freedom `row`.
    fn joint_of_row(&self, row: usize) -> &str {
        self.joints().iter().find(|joint| joint.v.contains(&row)).map_or("", |joint| &joint.name)
    }
}

/// Checks the lengths of the four arrays of an estimate: two per degree of freedom and two per body.
fn check_lengths(argument: &str, found: [usize; 4], [nv, bodies]: [usize; 2]) -> Result<(), Error> {
    let parts = [("acceleration", nv), ("torque", nv), ("force", bodies), ("process", bodies)];
    // The name is formatted only on failure, so that a successful call does not allocate.
    match found.into_iter().zip(parts).find(|(found, (_, expected))| found != expected) {
        Some((found, (part, expected))) => check_length(&format!("{argument}.{part}"), found, expected),
        None => Ok(()),
    }
}
