//! Frames of joints: their axes on z.

use crate::spatial::RigidShift;
use nalgebra::{Matrix3, Vector3};

/// A rotation R with R `e_z` = axis; exact where the axis is a coordinate axis.
pub(super) fn axis_onto_z(axis: &Vector3<f64>) -> Matrix3<f64> {
    let z = unit(axis);
    if z == Vector3::z() {
        return Matrix3::identity();
    }
    // The coordinate axis least along z gives x by projection; along z itself it would be lost.
    let helper = Vector3::ith(z.iamin(), 1.0);
    let x = (helper - z * z.dot(&helper)).normalize();
    Matrix3::from_columns(&[x, z.cross(&x), z])
}

/// A vector of length 1 in that direction. Lengths whose square is no number of 64 bits are scaled first; others keep their
/// rounding.
fn unit(axis: &Vector3<f64>) -> Vector3<f64> {
    let size = axis.amax();
    let axis = if (1e-100..1e100).contains(&size) { *axis } else { axis / size };
    axis / axis.norm()
}

/// A pure rotation, orthonormal to rounding.
pub(super) fn turn(rotation: Matrix3<f64>) -> RigidShift<f64> {
    RigidShift { rotation, lever: Vector3::zeros() }.compose_rounded(&RigidShift::identity())
}
