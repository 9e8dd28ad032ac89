//! The kinematic quantities, each by the function that computes it, for any scalar.

use super::{centroidal, energy};
use crate::algorithm::KinematicQuantity;
use crate::kinematics::{self, derivatives, placements_base_to_tip, placements_on_base};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::RigidShift;
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
        KinematicQuantity::VelocityDerivatives(frame, reference) => {
            derivatives::velocity_derivatives(model, (q, qd), &frame.cast(), reference, out);
        }
        KinematicQuantity::AccelerationDerivatives(frame, reference, kind) => {
            derivatives::acceleration_derivatives(model, (q, qd, qdd), &frame.cast(), (reference, kind), out);
        }
        KinematicQuantity::JacobianDerivatives(frame, reference) => {
            derivatives::jacobian_derivatives(model, q, &frame.cast(), reference, out);
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
        KinematicQuantity::Poses(links) => {
            let placements = &mut workspace.store.shifts;
            placements_base_to_tip(model, q, placements);
            placements_on_base(model, 0..model.bodies.len(), placements);
            for (link, out) in links.iter().zip(out.chunks_exact_mut(16)) {
                match link.body {
                    // Most links are at the frames of their bodies.
                    Some(body) if link.placement == RigidShift::identity() => placements[body].homogeneous(out),
                    Some(body) => placements[body].compose(&link.placement.cast()).homogeneous(out),
                    None => link.placement.cast().homogeneous(out),
                }
            }
        }
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
        KinematicQuantity::CentroidalMomentumDerivatives => {
            centroidal::centroidal_momentum_derivatives(model, workspace, q, qd, out);
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
