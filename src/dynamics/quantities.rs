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
    state: (&[T], &[T], &[T]),
    out: &mut [T],
) {
    if !centroidal::quantity(model, workspace, what, state, out) {
        energy::quantity(model, workspace, what, state, out);
    }
}
