//! Prismatic joint: translation along z, m.

use crate::scalar::Real;
use crate::spatial::RigidShift;
use nalgebra::{Vector3, Vector6};

/// phi at this displacement. 3 products.
#[inline(always)]
pub(super) fn shift<T: Real>(tree: &RigidShift<T>, distance: T) -> RigidShift<T> {
    RigidShift { rotation: tree.rotation, lever: along_z(tree, distance) }
}

/// Position of the origin in the parent frame after a displacement along z.
#[inline(always)]
pub(super) fn along_z<T: Real>(tree: &RigidShift<T>, distance: T) -> Vector3<T> {
    let (r, l) = (&tree.rotation, &tree.lever);
    Vector3::new(
        r[(0, 2)].mul_add(distance, l[0]),
        r[(1, 2)].mul_add(distance, l[1]),
        r[(2, 2)].mul_add(distance, l[2]),
    )
}

/// v x (H* qd), most of whose entries are zero.
#[inline(always)]
pub(super) fn velocity_product<T: Real>(v: &Vector6<T>, u: T) -> Vector6<T> {
    let o = u.constant(0.0);
    Vector6::new(o, o, o, v[1] * u, -(v[0] * u), o)
}
