//! The mass centre of a scene and the momentum about it, at one state, with arguments checked and faults named.

use crate::dynamics::centroidal;
use crate::error::Error;
use crate::scene::Scene;
use crate::workspace::Workspace;
use nalgebra::Vector3;
use std::borrow::Cow;

impl Scene {
    /// Mass of all links that move, kg: those on fixed joints to them included, links on the base not, nor rotors (armature is no mass). O(N).
    #[must_use]
    pub fn total_mass(&self) -> f64 {
        centroidal::total_mass(self.model())
    }

    /// The mass centre of all links that move, from the base's origin and in its axes, m: mass and first moment, tip to base.
    ///
    /// `q` (nq). O(N), without allocation, as all of these.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, a workspace of another scene, and [`Error::Argument`] where nothing that moves has mass.
    pub fn center_of_mass(&self, workspace: &mut Workspace<f64>, q: &[f64]) -> Result<Vector3<f64>, Error> {
        let q = &*self.check_centroidal(workspace, q)?;
        let centre = centroidal::center_of_mass(self.model(), workspace, q);
        self.check_result("center of mass", centre.as_slice())?;
        Ok(centre)
    }

    /// The velocity of the mass centre in the base's axes, m/s.
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

    /// The acceleration of the mass centre in the base's axes, m/s^2, at joint accelerations `qdd`; gravity is not in it.
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

    /// The Jacobian of the mass centre, (3 x nv) row by row: its velocity in the base's axes is J qd.
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

    /// The centroidal momentum matrix A, (6 x nv) row by row: the momentum (angular about the mass centre, linear) of all links in the base's axes is
    /// A qd. Rotors add nothing. Column j is the momentum of all bodies outboard of joint k, as one, at a unit rate.
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

    /// The rate of the centroidal momentum matrix along `qd`, (6 x nv) row by row: the momentum about the mass centre changes at A qdd + A' qd.
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

    /// What all of these share; the configuration of the tree.
    fn check_centroidal<'a>(&self, workspace: &Workspace<f64>, q: &'a [f64]) -> Result<Cow<'a, [f64]>, Error> {
        self.check_has_mass()?;
        self.check_workspace(workspace)?;
        self.tree_configuration("q", q)
    }

    /// Whether there is a mass centre.
    pub(crate) fn check_has_mass(&self) -> Result<(), Error> {
        let mass = self.total_mass();
        if mass > 0.0 {
            return Ok(());
        }
        let found = format!("links that move of {mass} kg in all");
        Err(Error::argument("scene", found, "mass on a link that moves: without it there is no mass centre"))
    }
}
