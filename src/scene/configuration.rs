//! Configurations as a manifold: the neutral one, steps along velocities, and the velocity between two.

use super::Scene;
use crate::error::{Error, check_length};

impl Scene {
    /// The neutral configuration: zero splat, the identity for quaternions.
    #[must_use]
    pub fn neutral(&self) -> Vec<f64> {
        self.joints().iter().flat_map(|joint| joint.kind.neutral()).collect()
    }

    /// The configuration reached from `q` by the constant velocity `v` in unit time; quaternions come out unit.
    ///
    /// A spherical joint turns by exp of its rate in its own frame; a free joint moves along the screw of its twist (SE(3)).
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, and a result that overflows.
    pub fn integrate(&self, q: &[f64], v: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.check_coordinates("q", q)?;
        self.check_rates("v", v)?;
        check_length("out", out.len(), self.nq())?;
        for joint in self.joints() {
            joint.kind.integrate(&q[joint.q.clone()], &v[joint.v.clone()], &mut out[joint.q.clone()]);
        }
        self.check_result("integrate", out)
    }

    /// The velocity that takes `q0` to `q1` in unit time, the inverse of [`Scene::integrate`]; rotations the short way.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, and a result that overflows.
    pub fn difference(&self, q0: &[f64], q1: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.check_coordinates("q0", q0)?;
        self.check_coordinates("q1", q1)?;
        check_length("out", out.len(), self.nv())?;
        for joint in self.joints() {
            joint.kind.difference(&q0[joint.q.clone()], &q1[joint.q.clone()], &mut out[joint.v.clone()]);
        }
        self.check_result("difference", out)
    }
}
