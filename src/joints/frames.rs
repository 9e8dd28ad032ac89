//! Joint frames, whose z axis is the joint axis.

use crate::spatial::RigidShift;
use nalgebra::{Matrix3, Vector3};

/// A rotation R with R `e_z` = axis; exact if the axis is a coordinate axis.
pub(super) fn axis_onto_z(axis: &Vector3<f64>) -> Matrix3<f64> {
    let z = unit(axis);
    if z == Vector3::z() {
        return Matrix3::identity();
    }
    // x is the projection of the coordinate axis least aligned with z; the projection of an aligned axis would cancel.
    let helper = Vector3::ith(z.iamin(), 1.0);
    let x = (helper - z * z.dot(&helper)).normalize();
    Matrix3::from_columns(&[x, z.cross(&x), z])
}

/// The unit vector of a direction. Vectors are scaled only if the square of their norm over- or underflows, which
/// preserves the rounding of all others.
fn unit(axis: &Vector3<f64>) -> Vector3<f64> {
    let size = axis.amax();
    let axis = if (1e-100..1e100).contains(&size) { *axis } else { axis / size };
    axis / axis.norm()
}

/// A pure rotation, orthonormalized to rounding.
pub(super) fn turn(rotation: Matrix3<f64>) -> RigidShift<f64> {
    RigidShift { rotation, lever: Vector3::zeros() }.compose_rounded(&RigidShift::identity())
}
