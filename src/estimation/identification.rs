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
    /// `q` (nq), `qd`, `qdd` (nv), SI units. With joints that follow others, G^T Y at (G q + o, G qd, G qdd); the
    /// forces of connections and contacts are not part of these torques.
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
        let q = self.tree_configuration("q", q)?;
        let (qd, qdd) = (self.tree_rates("qd", qd)?, self.tree_rates("qdd", qdd)?);
        let width = self.model().bodies.len() * 10;
        let expected = self.nv() * width;
        if out.len() != expected {
            return Err(Error::argument("out", format!("{} numbers", out.len()), format!("{expected}")));
        }
        let mut on_tree = |out: &mut [f64]| {
            derivatives::joint_torque_regressor(self.model(), scratch, (&q, &qd, &qdd), out);
        };
        match self.coupling() {
            None => on_tree(out),
            Some(coupling) => {
                let mut rows = vec![f64::NAN; self.model().nv() * width];
                on_tree(&mut rows);
                coupling.reduce_rows(&rows, width, out);
            }
        }
        self.check_result("regressor", out)
    }
}
