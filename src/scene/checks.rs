//! Checks of the arguments and results of calls on a scene.

use super::{Joint, Scene};
use crate::error::{Error, check_finite, check_length, number};
use crate::filter::Form;
use crate::filter::pivots::LostPivot;
use crate::joints::quaternion::QUATERNION_SLACK;
use crate::spatial::SpatialVector;

impl Scene {
    /// Checks a configuration: its length, finite entries, and quaternions within 1e-3 of unit norm.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], or [`Error::Argument`], which names the joint of the quaternion; and
    /// [`Error::Argument`] for a scene with coupled joints.
    pub(crate) fn check_configuration(&self, argument: &str, q: &[f64]) -> Result<(), Error> {
        self.check_independent()?;
        self.check_coordinates(argument, q)
    }

    /// As [`Scene::check_configuration`], for methods that support coupled joints.
    pub(crate) fn check_coordinates(&self, argument: &str, q: &[f64]) -> Result<(), Error> {
        check_length(argument, q.len(), self.nq())?;
        check_finite(argument, q)?;
        for joint in self.joints() {
            let Some(quaternion) = joint.quaternion() else { continue };
            let norm = q[quaternion].iter().map(|x| x * x).sum::<f64>().sqrt();
            if !((norm - 1.0).abs() <= QUATERNION_SLACK) {
                return Err(Error::argument(
                    argument,
                    format!("a quaternion of norm {norm} for joint {:?}", joint.name),
                    "unit norm, to within 1e-3",
                ));
            }
        }
        Ok(())
    }

    /// Checks a vector of joint velocities, accelerations or torques of one state.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] or [`Error::NotFinite`].
    pub(crate) fn check_rates(&self, argument: &str, values: &[f64]) -> Result<(), Error> {
        check_length(argument, values.len(), self.nv())?;
        check_finite(argument, values)
    }

    /// The error for a singular pivot, which names the joint.
    pub(crate) fn singular(&self, lost: LostPivot) -> Error {
        let joint = self.joint_of_body(lost.stage);
        let name = |of: fn(&Joint) -> &String| joint.map(of).cloned().unwrap_or_default();
        if let Some(&value) = [lost.pivot, lost.terms].iter().find(|value| !value.is_finite()) {
            let what = name(|joint| &joint.name);
            let argument = format!("inertia along the axis of joint {what:?} (result; the arguments overflow)");
            return Error::NotFinite { argument, index: lost.row, value, state: None };
        }
        Error::SingularJoint {
            joint: name(|joint| &joint.name),
            link: name(|joint| &joint.child),
            state: None,
            pivot: lost.pivot,
            terms: lost.terms,
        }
    }

    /// Checks that every inertia has a square root if the form is the square-root form.
    pub(crate) fn check_roots(&self, form: Form) -> Result<(), Error> {
        if form != Form::SquareRoot {
            return Ok(());
        }
        self.model.inertia_roots.iter().position(Option::is_none).map_or(Ok(()), |body| Err(self.indefinite(body)))
    }

    /// The error for an inertia without a square root.
    pub(crate) fn indefinite(&self, body: usize) -> Error {
        let link = self.joint_of_body(body).map(|joint| joint.child.clone()).unwrap_or_default();
        Error::argument(
            format!("inertia of link {link:?}"),
            "a negative principal inertia",
            "a positive semidefinite inertia, which the square-root form requires; use form \"auto\" or \"covariance\"",
        )
    }

    /// Checks spatial forces on bodies: none, or one per body.
    pub(crate) fn check_wrenches(&self, wrenches: &[SpatialVector<f64>]) -> Result<(), Error> {
        if !wrenches.is_empty() {
            check_length("wrenches", wrenches.len(), self.model.bodies.len())?;
            wrenches.iter().try_for_each(|wrench| check_finite("wrenches", wrench.as_slice()))?;
        }
        Ok(())
    }

    /// Checks that a result is finite: finite arguments can still overflow.
    #[allow(clippy::unused_self)] // a method for symmetry with the other checks
    pub(crate) fn check_result(&self, what: &str, values: &[f64]) -> Result<(), Error> {
        // The name is formatted only on failure, because every call runs this check.
        if values.iter().all(|value| value.is_finite()) {
            return Ok(());
        }
        check_finite(&format!("{what} (result; the arguments overflow)"), values)
    }
}

impl Joint {
    /// Indices in q of the quaternion of the joint, if it has one.
    #[must_use]
    pub fn quaternion(&self) -> Option<std::ops::Range<usize>> {
        let of_joint = self.kind.quaternion()?;
        Some(self.q.start + of_joint.start..self.q.start + of_joint.end)
    }
}

/// Checks that a tolerance is valid and that the form has an acceptance test. `judges_roots`: the square-root form has
/// one too.
pub(crate) fn check_tolerance(form: Form, tolerance: f64, judges_roots: bool) -> Result<(), Error> {
    if !(tolerance > 0.0 && tolerance < 1.0) {
        let expected = "an error relative to the largest entry of the result, above 0 and below 1";
        return Err(Error::argument("tolerance", number(tolerance), expected));
    }
    if form == Form::Auto || judges_roots && form == Form::SquareRoot {
        return Ok(());
    }
    let found = format!("{} with form \"{form}\", which has no error test", number(tolerance));
    Err(Error::argument("tolerance", found, "form \"auto\", or no tolerance"))
}
