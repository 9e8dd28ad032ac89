//! Transforms between the frames of a body and its parent: phi(k, k-1) of the paper, with the fewest operations for
//! each type of joint.
//!
//! Sweeps do not depend on the type of joint. They call a [`Transform`] to propagate a force, an inertia or a
//! covariance to the parent, or a motion to the child; all differences between joint types are in this module.
//!
//! - [`Axial`]: a revolute joint. Its angle rotates two planes; the parent axes are permuted ([`axes`]); an oblique
//!   axis adds one or two constant rotations ([`ConstantRotation`]); its [`Offset`] is constant.
//! - [`Prismatic`]: a constant rotation, which is applied to P by constant angles.
//! - [`Base`]: the base, to which floating bodies propagate nothing.
//! - [`RigidShift`](super::RigidShift): any joint, by a rotation matrix.

mod axes;
mod axial;
mod axial_rotation;
mod base;
mod constant_rotation;
mod covariance;
mod decomposed;
mod general;
mod offset;
mod prismatic;
mod rotation;
#[cfg(test)]
mod tests;

pub(crate) use axes::{Axes, Axis, Order, PARENT_FRAME, about};
pub(crate) use axial::Axial;
pub(crate) use axial_rotation::AxialRotation;
pub(crate) use base::Base;
pub(crate) use constant_rotation::ConstantRotation;
pub(crate) use covariance::{packed, unpacked};
pub(crate) use decomposed::{AboutAxis, rotates_about_a_parent_axis, rotates_about_an_oblique_axis};
pub(crate) use offset::Offset;
pub(crate) use prismatic::{ConstantSlide, Prismatic};
pub(crate) use rotation::{ObliqueRotation, Rotates};

use super::body_inertia::BodyInertia;
use super::root::{Root6, RootColumns};
use crate::scalar::Real;

/// Factor of [`Transform::send_terms`]. It covers the rounding error of P, and the ratio of the square of a sum to the
/// sum of squares. Entry i of R A R* is at most the square of the sum of `|R_ij| sqrt(A_jj)`, which is at most the
/// trace and at most three times the sum of the squares; for the cross product with an offset the factor is two.
pub(crate) const TERMS_SPREAD: f64 = 4.0;

/// The transform of one joint, between the frames of a body and of its parent. Sums accumulate in the parent over its
/// children; `begins` is set for the first child.
pub(crate) trait Transform<T: Real> {
    /// Squared norm l . l of the offset l from the parent origin to the body origin, m^2.
    fn offset_square(&self) -> T;

    /// R v: a free vector from the child frame to the parent frame.
    fn rotate_to_parent(&self, v: [T; 3]) -> [T; 3];

    /// R* v: a free vector from the parent frame to the child frame.
    fn rotate_to_child(&self, v: [T; 3]) -> [T; 3];

    /// The offset l from the parent origin to the child origin, in the parent frame.
    fn offset_at_parent(&self) -> [T; 3];

    /// Adds phi z: the force z (moment, force) at the parent origin, in the parent frame.
    fn send_force(&self, z: &[T; 6], begins: bool, sum: &mut [T; 6]);

    /// phi* lambda: the motion lambda (angular, linear) of the parent at the child origin, in the child frame.
    fn carry_motion(&self, lambda: &[T; 6]) -> [T; 6];

    /// Adds phi P phi*: a covariance in 6 + 9 + 6 entries (angular, coupling by rows, linear).
    fn send_covariance(&self, p: &[T; 21], begins: bool, sum: &mut [T; 21]);

    /// phi r phi*: the composite inertia about the parent origin, in the parent frame.
    fn composite_to_parent(&self, r: &BodyInertia<T>) -> BodyInertia<T>;

    /// Adds bounds on the diagonal entries of phi P phi*, from those of P.
    fn send_terms(&self, diagonal: &[T; 6], begins: bool, sum: &mut [T; 6]);

    /// phi L: the columns of the root L of a covariance, in the parent frame.
    fn root_to_parent(&self, root: &Root6<T>, columns: &mut RootColumns<T>);
}

/// Adds the contribution of one child to a sum, or begins the sum with it.
#[inline(always)]
pub(crate) fn accumulate<T: Real, const N: usize>(sent: &[T; N], begins: bool, sum: &mut [T; N]) {
    if begins {
        put(sent, sum);
    } else {
        for (sum, &sent) in sum.iter_mut().zip(sent) {
            *sum += sent;
        }
    }
}

/// Copies entry by entry for large arrays: a block copy would read data that was just written in parts, and stall.
#[inline(always)]
fn put<T: Copy, const N: usize>(sent: &[T; N], to: &mut [T; N]) {
    if let (Some(sent), Some(to)) = (sent.first_chunk::<21>(), to.first_chunk_mut::<21>()) {
        let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *sent;
        (to[0], to[1], to[2], to[3], to[4], to[5], to[6]) = (a0, a1, a2, a3, a4, a5, c0);
        (to[7], to[8], to[9], to[10], to[11], to[12], to[13]) = (c1, c2, c3, c4, c5, c6, c7);
        (to[14], to[15], to[16], to[17], to[18], to[19], to[20]) = (c8, b0, b1, b2, b3, b4, b5);
    } else {
        *to = *sent;
    }
}
