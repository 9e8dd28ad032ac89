//! Revolute joint: rotation about z, rad.

use crate::scalar::Real;
use crate::spatial::{RigidShift, from_rows, minus, row};
use nalgebra::{Matrix3, Vector6};

/// phi at this angle. 12 products.
#[inline(always)]
pub(super) fn shift<T: Real>(tree: &RigidShift<T>, angle: T) -> RigidShift<T> {
    RigidShift { rotation: turned_about_z(&tree.rotation, angle), lever: tree.lever }
}

/// R Rz(angle).
#[inline(always)]
pub(super) fn turned_about_z<T: Real>(r: &Matrix3<T>, angle: T) -> Matrix3<T> {
    let (s, c) = angle.sin_cos();
    from_rows(turned_row(row(r, 0), s, c), turned_row(row(r, 1), s, c), turned_row(row(r, 2), s, c))
}

/// One row of R Rz.
#[inline(always)]
fn turned_row<T: Real>(r: [T; 3], s: T, c: T) -> [T; 3] {
    [r[0].mul_add(c, r[1] * s), minus(r[1], c, r[0], s), r[2]]
}

/// v x (H* qd), most of whose entries are zero.
#[inline(always)]
pub(super) fn velocity_product<T: Real>(v: &Vector6<T>, w: T) -> Vector6<T> {
    let o = w.constant(0.0);
    Vector6::new(v[1] * w, -(v[0] * w), o, v[4] * w, -(v[3] * w), o)
}
