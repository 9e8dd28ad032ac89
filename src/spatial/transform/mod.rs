//! How one joint carries what crosses it: phi(k, k-1) of the paper, in the fewest operations that each kind of joint needs.
//!
//! A sweep knows no kind of joint. It asks a [`Transform`] to send a force, an inertia or a covariance to the parent, or a motion to the child, and what differs
//! between joints differs here and nowhere else.
//!
//! - [`Axial`]: a revolute joint. Its angle turns two planes; the axes of its parent come in an order ([`axes`]); an oblique axis adds one constant rotation
//!   or two ([`ConstantRotation`]); its [`Offset`] is constant.
//! - [`Prismatic`]: a rotation that is constant, and of P by constant angles.
//! - [`Base`]: nothing goes on from a body that floats.
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
pub(crate) use decomposed::{AboutAxis, turns_about_a_tilted_axis, turns_about_an_axis};
pub(crate) use offset::Offset;
pub(crate) use prismatic::{ConstantSlide, Prismatic};
pub(crate) use rotation::{ObliqueRotation, Rotates};

use super::body_inertia::BodyInertia;
use super::root::{Root6, RootColumns};
use crate::scalar::Real;

/// As [`Transform::send_terms`] multiplies: the rounding of P itself, and what the square of a sum has more than the sum of squares. Of R A R*, entry i is formed
/// of at most the square of the sum of `|R_ij| sqrt(A_jj)`, which is below the trace, and below three times the sum of the squares; of an offset's cross product
/// likewise, with two.
pub(crate) const TERMS_SPREAD: f64 = 4.0;

/// What crosses one joint, between the frame of a body and that of its parent. Sums are the parent's, over its children: the first of them `begins` the sum.
pub(crate) trait Transform<T: Real> {
    /// l . l of the offset l from the parent's origin to the body's, m^2.
    fn offset_square(&self) -> T;

    /// R v: a free vector of the child's frame in the parent's.
    fn rotate_to_parent(&self, v: [T; 3]) -> [T; 3];

    /// The offset l from the parent's origin to the child's, in the parent's frame.
    fn offset_at_parent(&self) -> [T; 3];

    /// Adds phi z: the force z (moment, force) at the parent's origin, in its frame.
    fn send_force(&self, z: &[T; 6], begins: bool, sum: &mut [T; 6]);

    /// phi* lambda: the motion lambda (angular, linear) of the parent at the child's origin, in its frame.
    fn carry_motion(&self, lambda: &[T; 6]) -> [T; 6];

    /// Adds phi P phi*: a covariance in 6 + 9 + 6 numbers (angular, coupling by rows, linear).
    fn send_covariance(&self, p: &[T; 21], begins: bool, sum: &mut [T; 21]);

    /// phi r phi*: the composite inertia about the parent's origin, in its frame.
    fn composite_to_parent(&self, r: &BodyInertia<T>) -> BodyInertia<T>;

    /// Adds a bound on each entry of the diagonal of phi P phi*, by the terms of the diagonal of P.
    fn send_terms(&self, diagonal: &[T; 6], begins: bool, sum: &mut [T; 6]);

    /// phi L: the columns of the root L of a covariance, at the parent.
    fn root_to_parent(&self, root: &Root6<T>, columns: &mut RootColumns<T>);
}

/// Adds what one child sends to what is there already, or begins with it.
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

/// A copy, number by number where there are many: that of the whole would read at once what was just written in parts, and wait for it.
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
