//! Center of mass and centroidal momentum of a scene at one state. Each method checks its arguments before it computes.

use crate::dynamics::centroidal;
use crate::error::Error;
use crate::scene::Scene;
use crate::workspace::Workspace;
use nalgebra::Vector3;
use std::borrow::Cow;

impl Scene {
    /// Total mass of all moving links, kg. O(N).
    ///
    /// Links fixed to moving links count, links fixed to the base do not. Armature adds no mass.
    #[must_use]
    pub fn total_mass(&self) -> f64 {
        centroidal::total_mass(self.model())
    }

    /// Center of mass of all moving links in the base frame, m.
    ///
    /// `q` (nq). A sweep from tip to base accumulates mass and first moment. O(N); does not allocate. Both hold for all
    /// methods of this file.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], and [`Error::Argument`] for a workspace of another scene or if no moving
    /// link has mass.
    pub fn center_of_mass(&self, workspace: &mut Workspace<f64>, q: &[f64]) -> Result<Vector3<f64>, Error> {
        let q = &*self.check_centroidal(workspace, q)?;
        let center = centroidal::center_of_mass(self.model(), workspace, q);
        self.check_result("center of mass", center.as_slice())?;
        Ok(center)
    }

    /// Velocity of the center of mass in the base frame, m/s.
    ///
    /// `q` (nq), `qd` (nv).
    ///
    /// # Errors
    ///
    /// As [`Scene::center_of_mass`].
    pub fn center_of_mass_velocity(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
    ) -> Result<Vector3<f64>, Error> {
        let (q, qd) = (&*self.check_centroidal(workspace, q)?, &*self.tree_rates("qd", qd)?);
        let velocity = centroidal::center_of_mass_velocity(self.model(), workspace, q, qd);
        self.check_result("center of mass velocity", velocity.as_slice())?;
        Ok(velocity)
    }

    /// Acceleration of the center of mass in the base frame, m/s^2, for the joint accelerations `qdd`. Gravity is
    /// excluded.
    ///
    /// `q` (nq), `qd`, `qdd` (nv).
    ///
    /// # Errors
    ///
    /// As [`Scene::center_of_mass`].
    pub fn center_of_mass_acceleration(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        qdd: &[f64],
    ) -> Result<Vector3<f64>, Error> {
        let q = &*self.check_centroidal(workspace, q)?;
        let (qd, qdd) = (&*self.tree_rates("qd", qd)?, &*self.tree_rates("qdd", qdd)?);
        let acceleration = centroidal::center_of_mass_acceleration(self.model(), workspace, q, qd, qdd);
        self.check_result("center of mass acceleration", acceleration.as_slice())?;
        Ok(acceleration)
    }

    /// Jacobian J of the center of mass, (3 x nv), row-major: its velocity in the base frame is J qd.
    ///
    /// # Errors
    ///
    /// As [`Scene::center_of_mass`].
    pub fn center_of_mass_jacobian(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let q = &*self.check_centroidal(workspace, q)?;
        self.tree_columns(3, out, |out| centroidal::center_of_mass_jacobian(self.model(), workspace, q, out))?;
        self.check_result("center of mass jacobian", out)
    }

    /// Centroidal momentum matrix A, (6 x nv), row-major.
    ///
    /// A qd is the momentum of all links in base axes: (angular about the center of mass, linear). Armature is
    /// excluded. Column j is the momentum of all bodies outboard of joint j, moving as one rigid body at unit joint
    /// velocity.
    ///
    /// # Errors
    ///
    /// As [`Scene::center_of_mass`].
    pub fn centroidal_momentum_matrix(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let q = &*self.check_centroidal(workspace, q)?;
        self.tree_columns(6, out, |out| centroidal::centroidal_momentum_matrix(self.model(), workspace, q, out))?;
        self.check_result("centroidal momentum matrix", out)
    }

    /// Time derivative A' of the centroidal momentum matrix for the joint velocities `qd`, (6 x nv), row-major: the
    /// momentum about the center of mass changes at the rate A qdd + A' qd.
    ///
    /// # Errors
    ///
    /// As [`Scene::center_of_mass`].
    pub fn centroidal_momentum_matrix_rate(
        &self,
        workspace: &mut Workspace<f64>,
        q: &[f64],
        qd: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let (q, qd) = (&*self.check_centroidal(workspace, q)?, &*self.tree_rates("qd", qd)?);
        self.tree_columns(6, out, |out| {
            centroidal::centroidal_momentum_matrix_rate(self.model(), workspace, q, qd, out);
        })?;
        self.check_result("centroidal momentum matrix rate", out)
    }

    /// Checks that the methods of this file share; returns the configuration of the tree.
    fn check_centroidal<'a>(&self, workspace: &Workspace<f64>, q: &'a [f64]) -> Result<Cow<'a, [f64]>, Error> {
        self.check_has_mass()?;
        self.check_workspace(workspace)?;
        self.tree_configuration("q", q)
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
