//! The ten inertial parameters of a body, (m, m c, I) about an origin, and their order.
//!
//! I is the rotational inertia about that origin. The order is (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz).

use super::{BodyInertia, Symmetric3};
use crate::scalar::Real;
use nalgebra::Vector3;

/// (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz), or the cotangents of these.
pub type Parameters<T> = [T; 10];

/// Row and column in I of the last six.
pub(crate) const ENTRIES: [[usize; 2]; 6] = [[0, 0], [0, 1], [1, 1], [0, 2], [1, 2], [2, 2]];

/// The index of an entry of I among the ten.
pub(crate) fn place([i, j]: [usize; 2]) -> usize {
    let (i, j) = (i.min(j), i.max(j));
    4 + [[0, 1, 3], [1, 2, 4], [3, 4, 5]][i][j]
}

/// The parameters of an inertia.
pub fn parameters<T: Real>(inertia: &BodyInertia<T>) -> Parameters<T> {
    let (h, [xx, xy, xz, yy, yz, zz]) = (&inertia.first_moment, inertia.rotational.entries);
    [inertia.mass, h[0], h[1], h[2], xx, xy, yy, xz, yz, zz]
}

/// The inertia from its ten parameters, or the change of the inertia from their changes.
#[inline(always)]
pub fn inertia<T: Real>(parameters: &Parameters<T>) -> BodyInertia<T> {
    let [mass, x, y, z, xx, xy, yy, xz, yz, zz] = *parameters;
    BodyInertia { mass, first_moment: Vector3::new(x, y, z), rotational: Symmetric3::new([xx, xy, xz, yy, yz, zz]) }
}
