//! Operations on the configuration manifold: neutral configuration, integration of velocities, difference.

use super::Scene;
use crate::error::{Error, check_length};

impl Scene {
    /// The neutral configuration: zero for all coordinates, the identity for quaternions.
    #[must_use]
    pub fn neutral(&self) -> Vec<f64> {
        self.joints().iter().flat_map(|joint| joint.kind.neutral()).collect()
    }

    /// Integrates the constant velocity `v` (nv) from `q` (nq) over unit time; resulting quaternions have unit norm.
    ///
    /// A spherical joint rotates by the exponential of its angular velocity in its body frame. A free joint moves along
    /// the screw of its twist (exponential of SE(3)).
    ///
    /// ```
    /// # fn main() -> Result<(), phipsi::Error> {
    /// let scene = phipsi::scenes::chain(2)?;
    /// let (mut q, mut v) = ([f64::NAN; 2], [f64::NAN; 2]);
    /// scene.integrate(&[0.125, 0.25], &[0.5, -0.5], &mut q)?;
    /// assert_eq!(q, [0.625, -0.25]);
    /// scene.difference(&[0.125, 0.25], &q, &mut v)?;
    /// assert_eq!(v, [0.5, -0.5]);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], and an error for a result that overflows.
    pub fn integrate(&self, q: &[f64], v: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.check_coordinates("q", q)?;
        self.check_rates("v", v)?;
        check_length("out", out.len(), self.nq())?;
        for joint in self.joints() {
            joint.kind.integrate(&q[joint.q.clone()], &v[joint.v.clone()], &mut out[joint.q.clone()]);
        }
        self.check_result("integrate", out)
    }

    /// The constant velocity (nv) that moves `q0` to `q1` in unit time, the inverse of [`Scene::integrate`]. Rotations
    /// take the shortest path.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], and an error for a result that overflows.
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
