//! Variances of accelerations and torques on one state of a scene, with arguments checked and faults named.

use crate::dynamics::derivatives::{Parameters, of_body};
use crate::error::{Error, check_finite, check_length};
use crate::estimation::{self, JointCovariance, ParameterRoots, TorqueVariance, VarianceScratch, Variances};
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::Workspace;

/// q, qd, and torques or accelerations.
type State<'a> = (&'a [f64], &'a [f64], &'a [f64]);

impl Scene {
    /// Scratch for [`Scene::forward_dynamics_variance`] and [`Scene::inverse_dynamics_variance`].
    #[must_use]
    pub fn variance_scratch(&self) -> VarianceScratch<f64> {
        VarianceScratch::new(self.model())
    }

    /// Roots of the covariances of the links' parameters: `columns` has those of each joint's child link, in the order
    /// of the joints and in the link's frame.
    ///
    /// # Errors
    ///
    /// The wrong number of links, and numbers that are not finite.
    pub fn parameter_roots(&self, columns: &[Vec<Parameters<f64>>]) -> Result<ParameterRoots<f64>, Error> {
        check_length("parameters", columns.len(), self.joints().len())?;
        let mut of_bodies = vec![Vec::new(); self.model().bodies.len()];
        for ((body, placement), columns) in self.links_of_joints().zip(columns) {
            for column in columns {
                check_finite("parameters", column)?;
                of_bodies[body].push(of_body(&placement, column));
            }
        }
        Ok(ParameterRoots::new(of_bodies))
    }

    /// Variances of the joint accelerations of forward dynamics at one state: see
    /// [`estimation::forward_dynamics_variance`].
    ///
    /// # Errors
    ///
    /// As [`Scene::forward_dynamics`]; connections and mimic joints, by name; wrong lengths and variances that are not
    /// finite or below zero.
    #[allow(clippy::too_many_arguments)] // a state, what is uncertain, and where results go
    pub fn forward_dynamics_variance(
        &self,
        workspace: &mut Workspace<f64>,
        scratch: &mut VarianceScratch<f64>,
        state: State<'_>,
        wrenches: &[SpatialVector<f64>],
        parameters: &ParameterRoots<f64>,
        torque: &TorqueVariance<'_, f64>,
        out: &mut Variances<'_, f64>,
    ) -> Result<(), Error> {
        self.check_no_connections("forward_dynamics_variance")?;
        self.check_state_and_uncertainty(scratch, ("tau", state), parameters, torque)?;
        self.check_wrenches(wrenches)?;
        self.check_workspace(workspace)?;
        self.check_form(workspace)?;
        check_length("out.joints", out.joints.len(), self.nv())?;
        if !out.bodies.is_empty() {
            check_length("out.bodies", out.bodies.len(), self.model().bodies.len())?;
        }
        let model = self.model();
        let monitor =
            estimation::forward_dynamics_variance(model, workspace, scratch, state, wrenches, parameters, torque, out);
        self.check_pivots(workspace, monitor)?;
        self.check_result("variance of the acceleration", out.joints)
    }

    /// Variances of the joint torques of inverse dynamics at one state: see [`estimation::inverse_dynamics_variance`].
    ///
    /// # Errors
    ///
    /// As [`Scene::forward_dynamics_variance`]; connections are no obstacle.
    pub fn inverse_dynamics_variance(
        &self,
        scratch: &mut VarianceScratch<f64>,
        state: State<'_>,
        parameters: &ParameterRoots<f64>,
        torque: &TorqueVariance<'_, f64>,
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.check_state_and_uncertainty(scratch, ("qdd", state), parameters, torque)?;
        check_length("out", out.len(), self.nv())?;
        estimation::inverse_dynamics_variance(self.model(), scratch, state, parameters, torque, out);
        self.check_result("variance of the torque", out)
    }

    fn check_state_and_uncertainty(
        &self,
        scratch: &VarianceScratch<f64>,
        (third, (q, qd, u)): (&str, State<'_>),
        parameters: &ParameterRoots<f64>,
        torque: &TorqueVariance<'_, f64>,
    ) -> Result<(), Error> {
        self.check_independent()?;
        self.check_configuration("q", q)?;
        self.check_rates("qd", qd)?;
        self.check_rates(third, u)?;
        self.check_scratch("scratch", scratch.identity, "scene.variance_scratch()")?;
        check_length("parameters", parameters.bodies(), self.model().bodies.len())?;
        check_length("torque.noise", torque.noise.len(), self.nv())?;
        check_finite("torque.noise", torque.noise)?;
        if let Some(noise) = torque.noise.iter().find(|&&noise| noise < 0.0) {
            return Err(Error::argument("torque.noise", noise.to_string(), "variances, zero or positive"));
        }
        if !torque.joints.is_empty() {
            check_length("torque.joints", torque.joints.len(), self.nv())?;
            torque.joints.iter().try_for_each(|joint: &JointCovariance<f64>| {
                joint.iter().try_for_each(|row| check_finite("torque.joints", row))
            })?;
        }
        let is_speed = torque.friction_speed > 0.0 && torque.friction_speed.is_finite();
        if !torque.joints.is_empty() && !is_speed {
            let found = torque.friction_speed.to_string();
            return Err(Error::argument(
                "torque.friction_speed",
                found,
                "a speed in rad/s or m/s, finite and positive",
            ));
        }
        Ok(())
    }
}
