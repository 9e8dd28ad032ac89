//! The kinematic quantities, each by the function that computes it, for any scalar.

use super::{centroidal, energy};
use crate::algorithm::KinematicQuantity;
use crate::kinematics;
use crate::model::Model;
use crate::scalar::Real;
use crate::workspace::Workspace;

/// Computes a quantity of a frame, which needs no scratch, into `out`; returns false for others. It reads the part of
/// the state that `what` requires.
#[inline(always)]
pub(crate) fn of_frame<T: Real>(
    model: &Model<T>,
    what: &KinematicQuantity<'_>,
    (q, qd, qdd): (&[T], &[T], &[T]),
    out: &mut [T],
) -> bool {
    match *what {
        KinematicQuantity::Placement(frame) => kinematics::placement(model, q, &frame.cast()).homogeneous(out),
        KinematicQuantity::Velocity(frame, reference) => {
            let motion = kinematics::frame_motion(model, q, qd, None, &frame.cast());
            out.copy_from_slice(motion.velocity_in(reference).as_slice());
        }
        KinematicQuantity::Acceleration(frame, reference, kind) => {
            let motion = kinematics::frame_motion(model, q, qd, Some(qdd), &frame.cast());
            out.copy_from_slice(motion.acceleration_in(reference, kind).as_slice());
        }
        KinematicQuantity::Jacobian(frame, reference) => {
            kinematics::jacobian(model, q, &frame.cast(), reference, out);
        }
        KinematicQuantity::JacobianRate(frame, reference) => {
            kinematics::jacobian_rate(model, q, qd, &frame.cast(), reference, out);
        }
        KinematicQuantity::JacobianRateProduct(frame, reference) => {
            let motion = kinematics::frame_motion(model, q, qd, None, &frame.cast());
            out.copy_from_slice(motion.rate_in(reference).as_slice());
        }
        _ => return false,
    }
    true
}

/// Computes a quantity of all bodies into `out`; does nothing for those of a frame.
#[inline(always)]
pub(crate) fn of_all_bodies<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    what: &KinematicQuantity<'_>,
    (q, qd, qdd): (&[T], &[T], &[T]),
    out: &mut [T],
) {
    match what {
        KinematicQuantity::CenterOfMass => {
            out.copy_from_slice(centroidal::center_of_mass(model, workspace, q).as_slice());
        }
        KinematicQuantity::CenterOfMassVelocity => {
            out.copy_from_slice(centroidal::center_of_mass_velocity(model, workspace, q, qd).as_slice());
        }
        KinematicQuantity::CenterOfMassAcceleration => {
            out.copy_from_slice(centroidal::center_of_mass_acceleration(model, workspace, q, qd, qdd).as_slice());
        }
        KinematicQuantity::CenterOfMassJacobian => centroidal::center_of_mass_jacobian(model, workspace, q, out),
        KinematicQuantity::CentroidalMomentumMatrix => centroidal::centroidal_momentum_matrix(model, workspace, q, out),
        KinematicQuantity::CentroidalMomentumMatrixRate => {
            centroidal::centroidal_momentum_matrix_rate(model, workspace, q, qd, out);
        }
        KinematicQuantity::Momentum => out.copy_from_slice(energy::momentum(model, workspace, q, qd).as_slice()),
        KinematicQuantity::KineticEnergy => out[0] = energy::kinetic_energy(model, workspace, q, qd),
        KinematicQuantity::PotentialEnergy => out[0] = energy::potential_energy(model, workspace, q),
        KinematicQuantity::Energy => {
            let both = energy::energy(model, workspace, q, qd);
            out.copy_from_slice(&[both.kinetic, both.potential]);
        }
        _ => {}
    }
}
