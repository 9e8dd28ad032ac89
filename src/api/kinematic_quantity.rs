//! One entry point for all kinematic quantities of one state, selected by value.

use crate::algorithm::Everyday;
use crate::error::{Error, check_length};
use crate::scene::Scene;
use crate::workspace::Workspace;

impl Scene {
    /// Evaluates the quantity `what` at one state (q, qd, qdd) and writes it to `out`.
    ///
    /// Calls the method that `what` names, which reads the first [`Everyday::reads`] arrays of the state.
    ///
    /// # Errors
    ///
    /// As that method, and [`Error::Shape`] for a wrong length of `out`.
    pub fn everyday(
        &self,
        workspace: &mut Workspace<f64>,
        what: &Everyday<'_>,
        [q, qd, qdd]: [&[f64]; 3],
        out: &mut [f64],
    ) -> Result<(), Error> {
        check_length("out", out.len(), what.width(self.nv()))?;
        match *what {
            Everyday::Placement(frame) => self.placement(q, *frame)?.homogeneous(out),
            Everyday::Velocity(frame, reference) => {
                out.copy_from_slice(self.velocity(q, qd, *frame, reference)?.as_slice());
            }
            Everyday::Acceleration(frame, reference, kind) => {
                out.copy_from_slice(self.acceleration(q, qd, qdd, *frame, reference, kind)?.as_slice());
            }
            Everyday::Jacobian(frame, reference) => self.jacobian(q, *frame, reference, out)?,
            Everyday::JacobianRate(frame, reference) => self.jacobian_rate(q, qd, *frame, reference, out)?,
            Everyday::JacobianRateProduct(frame, reference) => {
                out.copy_from_slice(self.jacobian_rate_product(q, qd, *frame, reference)?.as_slice());
            }
            Everyday::CenterOfMass => out.copy_from_slice(self.center_of_mass(workspace, q)?.as_slice()),
            Everyday::CenterOfMassVelocity => {
                out.copy_from_slice(self.center_of_mass_velocity(workspace, q, qd)?.as_slice());
            }
            Everyday::CenterOfMassAcceleration => {
                out.copy_from_slice(self.center_of_mass_acceleration(workspace, q, qd, qdd)?.as_slice());
            }
            Everyday::CenterOfMassJacobian => self.center_of_mass_jacobian(workspace, q, out)?,
            Everyday::CentroidalMomentumMatrix => self.centroidal_momentum_matrix(workspace, q, out)?,
            Everyday::CentroidalMomentumMatrixRate => {
                self.centroidal_momentum_matrix_rate(workspace, q, qd, out)?;
            }
            Everyday::Momentum => out.copy_from_slice(self.momentum(workspace, q, qd)?.as_slice()),
            Everyday::KineticEnergy => out[0] = self.kinetic_energy(workspace, q, qd)?,
            Everyday::Energy => {
                let both = self.energy(workspace, q, qd)?;
                out.copy_from_slice(&[both.kinetic, both.potential]);
            }
        }
        Ok(())
    }
}
