//! The regressor of a scene, checked.

use crate::dynamics::derivatives::{self, RegressorScratch};
use crate::error::Error;
use crate::scene::Scene;

impl Scene {
    /// Scratch for [`Scene::regressor`].
    #[must_use]
    pub fn regressor_scratch(&self) -> RegressorScratch<f64> {
        RegressorScratch::new(self.model())
    }

    /// The derivative of the torques of inverse dynamics by the inertial parameters of each body, (nv x bodies x 10)
    /// into `out`; see [`joint_torque_regressor`](derivatives::joint_torque_regressor).
    ///
    /// `q` (nq), `qd`, `qdd` (nv), SI units.
    ///
    /// # Errors
    ///
    /// Names the argument that has the wrong length or is not finite, and a scratch of another scene.
    pub fn regressor(
        &self,
        scratch: &mut RegressorScratch<f64>,
        q: &[f64],
        qd: &[f64],
        qdd: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.check_scratch("scratch", scratch.identity(), "scene.regressor_scratch()")?;
        self.check_configuration("q", q)?;
        self.check_rates("qd", qd)?;
        self.check_rates("qdd", qdd)?;
        let expected = self.nv() * self.model().bodies.len() * 10;
        if out.len() != expected {
            return Err(Error::argument("out", format!("{} numbers", out.len()), format!("{expected}")));
        }
        derivatives::joint_torque_regressor(self.model(), scratch, (q, qd, qdd), out);
        self.check_result("regressor", out)
    }
}
