//! Everyday functions of as many states as a scalar has lanes.

use super::arms::Vectorized;
use crate::algorithm::Everyday;
use crate::dynamics::{centroidal, energy};
use crate::kinematics;
use crate::model::Model;
use crate::scalar::Real;
use crate::workspace::Workspace;

/// Scratch of those that go over all bodies, made when one is first asked for, and results.
#[derive(Debug)]
pub(super) struct EverydayKernel<T: Vectorized> {
    workspace: Option<Box<Workspace<T>>>,
    results: Vec<T>,
}

impl<T: Vectorized> Default for EverydayKernel<T> {
    fn default() -> Self {
        Self { workspace: None, results: Vec::new() }
    }
}

/// The results, of states (q, qd, qdd) of which `what` reads what it needs.
#[inline(always)]
pub(super) fn run<'k, T: Vectorized>(
    model: &Model<T>,
    kernel: &'k mut EverydayKernel<T>,
    what: &Everyday<'_>,
    (q, qd, qdd): (&[T], &[T], &[T]),
) -> &'k [T] {
    let EverydayKernel { workspace, results } = kernel;
    results.resize(what.width(model.nv()), T::zero());
    let out = &mut results[..];
    if !of_frame(model, what, (q, qd, qdd), out) {
        let workspace = workspace.get_or_insert_with(|| Box::new(Workspace::new(model)));
        of_all_bodies(model, workspace, what, (q, qd, qdd), out);
    }
    results
}

/// Of a frame, which needs no scratch; false where it is another.
#[inline(always)]
fn of_frame<T: Real>(model: &Model<T>, what: &Everyday<'_>, (q, qd, qdd): (&[T], &[T], &[T]), out: &mut [T]) -> bool {
    match *what {
        Everyday::Placement(frame) => kinematics::placement(model, q, &frame.cast()).homogeneous(out),
        Everyday::Velocity(frame, reference) => {
            let motion = kinematics::frame_motion(model, q, qd, None, &frame.cast());
            out.copy_from_slice(motion.velocity_in(reference).as_slice());
        }
        Everyday::Acceleration(frame, reference, kind) => {
            let motion = kinematics::frame_motion(model, q, qd, Some(qdd), &frame.cast());
            out.copy_from_slice(motion.acceleration_in(reference, kind).as_slice());
        }
        Everyday::Jacobian(frame, reference) => kinematics::jacobian(model, q, &frame.cast(), reference, out),
        Everyday::JacobianRate(frame, reference) => {
            kinematics::jacobian_rate(model, q, qd, &frame.cast(), reference, out);
        }
        Everyday::JacobianRateProduct(frame, reference) => {
            let motion = kinematics::frame_motion(model, q, qd, None, &frame.cast());
            out.copy_from_slice(motion.rate_in(reference).as_slice());
        }
        _ => return false,
    }
    true
}

/// Of the whole robot; nothing where it is of a frame.
#[inline(always)]
fn of_all_bodies<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    what: &Everyday<'_>,
    (q, qd, qdd): (&[T], &[T], &[T]),
    out: &mut [T],
) {
    match *what {
        Everyday::CenterOfMass => {
            out.copy_from_slice(centroidal::center_of_mass(model, workspace, q).as_slice());
        }
        Everyday::CenterOfMassVelocity => {
            out.copy_from_slice(centroidal::center_of_mass_velocity(model, workspace, q, qd).as_slice());
        }
        Everyday::CenterOfMassAcceleration => {
            out.copy_from_slice(centroidal::center_of_mass_acceleration(model, workspace, q, qd, qdd).as_slice());
        }
        Everyday::CenterOfMassJacobian => centroidal::center_of_mass_jacobian(model, workspace, q, out),
        Everyday::CentroidalMomentumMatrix => centroidal::centroidal_momentum_matrix(model, workspace, q, out),
        Everyday::CentroidalMomentumMatrixRate => {
            centroidal::centroidal_momentum_matrix_rate(model, workspace, q, qd, out);
        }
        Everyday::Momentum => out.copy_from_slice(energy::momentum(model, workspace, q, qd).as_slice()),
        Everyday::KineticEnergy => out[0] = energy::kinetic_energy(model, workspace, q, qd),
        Everyday::Energy => {
            let both = energy::energy(model, workspace, q, qd);
            out.copy_from_slice(&[both.kinetic, both.potential]);
        }
        _ => {}
    }
}
