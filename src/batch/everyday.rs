//! Everyday functions of as many states as a scalar has lanes.

use super::arms::Vectorised;
use crate::algorithm::Everyday;
use crate::dynamics::{centroidal, energy};
use crate::kinematics::{self, Frame};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::RigidShift;
use crate::workspace::Workspace;

/// Scratch of those that go over all bodies, and results; made when one is first asked for.
#[derive(Debug)]
pub(super) struct EverydayKernel<T: Vectorised> {
    workspace: Workspace<T>,
    results: Vec<T>,
}

impl<T: Vectorised> EverydayKernel<T> {
    #[cold]
    pub fn new(model: &Model<T>) -> Self {
        Self { workspace: Workspace::new(model), results: Vec::new() }
    }
}

/// The results, of states (q, qd, qdd) of which `what` reads what it needs.
#[inline(always)]
pub(super) fn run<'k, T: Vectorised>(
    model: &Model<T>,
    kernel: &'k mut EverydayKernel<T>,
    what: &Everyday<'_>,
    (q, qd, qdd): (&[T], &[T], &[T]),
) -> &'k [T] {
    let EverydayKernel { workspace, results } = kernel;
    results.resize(what.width(model.nv()), T::zero());
    let out = &mut results[..];
    match *what {
        Everyday::Placement(frame) => homogeneous(&kinematics::placement(model, q, &splat(frame)), out),
        Everyday::Velocity(frame, reference) => {
            let motion = kinematics::frame_motion(model, q, qd, None, &splat(frame));
            out.copy_from_slice(motion.velocity_in(reference).as_slice());
        }
        Everyday::Acceleration(frame, reference, kind) => {
            let motion = kinematics::frame_motion(model, q, qd, Some(qdd), &splat(frame));
            out.copy_from_slice(motion.acceleration_in(reference, kind).as_slice());
        }
        Everyday::Jacobian(frame, reference) => kinematics::jacobian(model, q, &splat(frame), reference, out),
        Everyday::JacobianRate(frame, reference) => {
            kinematics::jacobian_rate(model, q, qd, &splat(frame), reference, out);
        }
        Everyday::JacobianRateProduct(frame, reference) => {
            let motion = kinematics::frame_motion(model, q, qd, None, &splat(frame));
            out.copy_from_slice(motion.rate_in(reference).as_slice());
        }
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
    }
    results
}

/// A frame in every lane.
#[inline(always)]
fn splat<T: Real>(frame: &Frame<f64>) -> Frame<T> {
    let RigidShift { rotation, lever } = &frame.placement;
    Frame {
        body: frame.body,
        placement: RigidShift { rotation: rotation.map(T::from_f64), lever: lever.map(T::from_f64) },
    }
}

/// Writes [[R, p], [0, 1]].
#[inline(always)]
pub(crate) fn homogeneous<T: Real>(shift: &RigidShift<T>, out: &mut [T]) {
    let zero = shift.lever[0].constant(0.0);
    for i in 0..3 {
        for j in 0..3 {
            out[4 * i + j] = shift.rotation[(i, j)];
        }
        out[4 * i + 3] = shift.lever[i];
    }
    out[12..16].copy_from_slice(&[zero, zero, zero, zero.constant(1.0)]);
}
