//! Planar scenes: the same recursions in 3-vectors (moment, `f_x`, `f_y`) instead of spatial 6-vectors.
//!
//! Where every joint turns about one and the same direction or slides across it, on a fixed base, the bodies move in planes, and forces
//! across these do no work. Of a spatial force three components are left, of M(k) three numbers (mass, first moment, inertia about the
//! normal), and phi is an angle and a lever:
//!
//! ```text
//! force at the parent = (m + l x R f, R f)        motion at the child = (w, R* (v + w e x l))        e the normal
//! ```
//!
//! [`model`] tells such a scene from its geometry; the other files are the algorithms. Covariance form only: where a pivot, or a result,
//! is in doubt, whoever calls does the state again in 6-vectors, and so do the forms that watch their digits.

pub mod forward;
pub mod inverse;
mod inward;
pub mod mass_inverse;
pub mod mass_matrix;
pub mod model;
mod outward;
mod scratch;

pub use model::{Direction, PlanarBody, PlanarModel};
pub use scratch::PlanarScratch;

use crate::algorithm::Algorithm;
use crate::filter::Form;
use crate::scalar::{ColumnsOf, Real};
use nalgebra::Vector6;

/// Whether an algorithm has a planar way.
#[must_use]
pub fn covers(algorithm: Algorithm) -> bool {
    match algorithm {
        Algorithm::ForwardDynamics(form) | Algorithm::MassMatrixInverse(form) => form == Form::Covariance,
        Algorithm::InverseDynamics | Algorithm::BiasTorque | Algorithm::MassMatrix => true,
    }
}

/// One algorithm that [`covers`] says yes to, on one state (q, qd, u); gives the lanes in which a pivot did not stand clear, as bits.
///
/// Arguments and results are those of the functions of [`dynamics`](crate::dynamics): wrenches are spatial forces in the frames of the
/// model's bodies.
#[inline(always)]
pub fn run<T: Real, C: ColumnsOf<T>>(
    algorithm: Algorithm,
    model: &PlanarModel<T>,
    scratch: &mut PlanarScratch<T, C>,
    (q, qd, u): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    results: &mut [T],
) -> u64 {
    let pivots = match algorithm {
        Algorithm::ForwardDynamics(_) => forward::forward_dynamics(model, scratch, (q, qd, u), wrenches, results),
        Algorithm::InverseDynamics => {
            inverse::inverse_dynamics(model, scratch, (q, qd, u), wrenches, results);
            return 0;
        }
        Algorithm::BiasTorque => {
            inverse::bias_torque(model, scratch, (q, qd), wrenches, results);
            return 0;
        }
        Algorithm::MassMatrix => {
            mass_matrix::mass_matrix(model, scratch, q, results);
            return 0;
        }
        Algorithm::MassMatrixInverse(_) => mass_inverse::mass_matrix_inverse(model, scratch, q, results),
    };
    let mut doubt = 0;
    for lane in 0..T::LANES {
        doubt |= u64::from(!pivots.clear(lane)) << lane;
    }
    doubt
}
