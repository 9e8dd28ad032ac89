//! Center of mass and centroidal momentum of a scene at one state. Each method checks its arguments before it computes.

use super::declared::quantities;
use crate::algorithm::KinematicQuantity;
use crate::dynamics::centroidal;
use crate::error::Error;
use crate::scene::Scene;
use crate::workspace::Workspace;
use nalgebra::Vector3;

impl Scene {
    /// Total mass of all moving links, kg. O(N).
    ///
    /// Links fixed to moving links count, links fixed to the base do not. Armature adds no mass.
    #[must_use]
    pub fn total_mass(&self) -> f64 {
        centroidal::total_mass(self.model())
    }

    /// Checks that the center of mass exists: some moving link has mass.
    pub(crate) fn check_has_mass(&self) -> Result<(), Error> {
        let mass = self.total_mass();
        if mass > 0.0 {
            return Ok(());
        }
        let found = format!("moving links with a total mass of {mass} kg");
        Err(Error::argument("scene", found, "mass on at least one moving link, which the center of mass requires"))
    }
}

quantities! {
    /// Center of mass of all moving links in the base frame, m.
    ///
    /// `q` (nq). A sweep from tip to base accumulates mass and first moment. O(N); does not allocate. Both hold for all
    /// methods of this file.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], and [`Error::Argument`] for a workspace of another scene or if no moving
    /// link has mass.
    fn center_of_mass(q) -> Vector3 = CenterOfMass;

    /// Velocity of the center of mass in the base frame, m/s.
    ///
    /// `q` (nq), `qd` (nv).
    ///
    /// # Errors
    ///
    /// As [`Scene::center_of_mass`].
    fn center_of_mass_velocity(q, qd) -> Vector3 = CenterOfMassVelocity;

    /// Acceleration of the center of mass in the base frame, m/s^2, for the joint accelerations `qdd`. Gravity is
    /// excluded.
    ///
    /// `q` (nq), `qd`, `qdd` (nv).
    ///
    /// # Errors
    ///
    /// As [`Scene::center_of_mass`].
    fn center_of_mass_acceleration(q, qd, qdd) -> Vector3 = CenterOfMassAcceleration;

    /// Jacobian J of the center of mass, (3 x nv), row-major: its velocity in the base frame is J qd.
    ///
    /// # Errors
    ///
    /// As [`Scene::center_of_mass`].
    fn center_of_mass_jacobian(q) -> _ = CenterOfMassJacobian;

    /// Centroidal momentum matrix A, (6 x nv), row-major.
    ///
    /// A qd is the momentum of all links in base axes: (angular about the center of mass, linear). Armature is
    /// excluded. Column j is the momentum of all bodies outboard of joint j, moving as one rigid body at unit joint
    /// velocity.
    ///
    /// # Errors
    ///
    /// As [`Scene::center_of_mass`].
    fn centroidal_momentum_matrix(q) -> _ = CentroidalMomentumMatrix;

    /// Time derivative A' of the centroidal momentum matrix for the joint velocities `qd`, (6 x nv), row-major: the
    /// momentum about the center of mass changes at the rate A qdd + A' qd.
    ///
    /// # Errors
    ///
    /// As [`Scene::center_of_mass`].
    fn centroidal_momentum_matrix_rate(q, qd) -> _ = CentroidalMomentumMatrixRate;

    /// Derivatives of the centroidal momentum A qd with respect to q and qd, (2 x 6 x nv) row by row; the second is
    /// [`Scene::centroidal_momentum_matrix`].
    ///
    /// Derivatives by q are along the tangent space, as those of the dynamics.
    ///
    /// # Errors
    ///
    /// As [`Scene::center_of_mass`].
    fn centroidal_momentum_derivatives(q, qd) -> _ = CentroidalMomentumDerivatives;
}
