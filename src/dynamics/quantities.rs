//! The kinematic quantities, each by the function that computes it, for any scalar.

use super::{centroidal, energy};
use crate::algorithm::KinematicQuantity;
use crate::kinematics::{self, Link, derivatives, placements_base_to_tip, placements_on_base, velocities_base_to_tip};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{RigidShift, linear, zero};
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
            // Not with the accelerations: the compiler removes what only they need.
            let motion = kinematics::frame_motion(model, q, qd, None, &frame.cast());
            out.copy_from_slice(motion.velocity_in(reference).as_slice());
        }
        KinematicQuantity::Acceleration(frame, reference, _)
        | KinematicQuantity::JacobianRateProduct(frame, reference) => {
            let rates = matches!(what, KinematicQuantity::Acceleration(..)).then_some(qdd);
            let motion = kinematics::frame_motion(model, q, qd, rates, &frame.cast());
            let result = match *what {
                KinematicQuantity::Acceleration(.., kind) => motion.acceleration_in(reference, kind),
                _ => motion.rate_in(reference),
            };
            out.copy_from_slice(result.as_slice());
        }
        KinematicQuantity::Jacobian(frame, reference) => {
            kinematics::jacobian(model, q, &frame.cast(), reference, out);
        }
        KinematicQuantity::JacobianRate(frame, reference) => {
            kinematics::jacobian_rate(model, q, qd, &frame.cast(), reference, out);
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

/// Computes a quantity of all bodies into `out`, in O(N); does nothing for those of a frame. Each pass is compiled into
/// it once.
#[inline(always)]
pub(crate) fn of_all_bodies<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    what: &KinematicQuantity<'_>,
    (q, qd, qdd): (&[T], &[T], &[T]),
    out: &mut [T],
) {
    use KinematicQuantity as Of;
    placements_base_to_tip(model, q, &mut workspace.store.shifts);
    if let Of::Poses(links) = what {
        return poses(model, workspace, links, out);
    }
    if what.reads() > 1 {
        velocities_base_to_tip(model, &workspace.store.shifts, qd, &mut workspace.velocity);
    }
    if matches!(what, Of::CenterOfMass | Of::CenterOfMassJacobian | Of::PotentialEnergy | Of::Energy) {
        energy::first_moments_tip_to_base(model, workspace);
    }
    let (sums_forces, mut total) = (matches!(what, Of::CenterOfMassAcceleration), zero());
    if sums_forces || matches!(what, Of::CenterOfMassVelocity | Of::Momentum | Of::CentroidalMomentumDerivatives) {
        if sums_forces {
            centroidal::forces_of_bodies(model, workspace, (qd, qdd));
        } else {
            energy::momenta_of_bodies(model, workspace);
        }
        total = energy::total_on_base(model, workspace);
    }
    let has_composites = matches!(
        what,
        Of::CentroidalMomentumMatrix | Of::CentroidalMomentumMatrixRate | Of::CentroidalMomentumDerivatives
    );
    if has_composites {
        centroidal::composite_inertias_tip_to_base(model, workspace);
    }
    if matches!(what, Of::CentroidalMomentumMatrixRate) {
        centroidal::composite_rates_tip_to_base(model, workspace);
    }
    let mut center = None;
    if has_composites || matches!(what, Of::CenterOfMass | Of::CenterOfMassJacobian) {
        let of = |k: usize| if has_composites { workspace.composite[k].first() } else { workspace.first_moment[k] };
        let center = &*center.insert(centroidal::center(model, workspace, of));
        if !matches!(what, Of::CenterOfMass) {
            centroidal::placements_from(model, workspace, center);
        }
    }
    match (what, &center) {
        (Of::CenterOfMass, Some(center)) => out.copy_from_slice(center.position().as_slice()),
        (Of::CenterOfMassJacobian, Some(center)) => {
            centroidal::center_of_mass_jacobian(model, (workspace, center), out);
        }
        (Of::CentroidalMomentumMatrix, _) => centroidal::centroidal_momentum_matrix(model, workspace, out),
        (Of::CentroidalMomentumMatrixRate, Some(center)) => {
            centroidal::centroidal_momentum_matrix_rate(model, (workspace, center), out);
        }
        (Of::CentroidalMomentumDerivatives, Some(center)) => {
            let whole = linear(&total);
            centroidal::centroidal_momentum_derivatives(model, (workspace, center), (qd, &whole), out);
        }
        (Of::CenterOfMassVelocity | Of::CenterOfMassAcceleration, _) => {
            out.copy_from_slice(centroidal::divided(&linear(&total), centroidal::total_mass(model)).as_slice());
        }
        (Of::Momentum, _) => out.copy_from_slice(total.as_slice()),
        (Of::KineticEnergy, _) => out[0] = energy::kinetic_energy(model, workspace, qd),
        (Of::PotentialEnergy, _) => out[0] = energy::potential_energy(model, workspace),
        (Of::Energy, _) => {
            let kinetic = energy::kinetic_energy(model, workspace, qd);
            out.copy_from_slice(&[kinetic, energy::potential_energy(model, workspace)]);
        }
        _ => {}
    }
}

/// The poses of links as homogeneous matrices to the base, from phi of each body to its parent.
#[inline(always)]
fn poses<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, links: &[Link], out: &mut [T]) {
    let placements = &mut workspace.store.shifts;
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
