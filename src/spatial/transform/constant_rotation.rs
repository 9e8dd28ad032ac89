//! Constant rotations for oblique joint axes: one about x, and a second one about z if necessary.
//!
//! A general constant rotation to the parent is decomposed into the joint rotation and one or two such rotations of a
//! plane. Everything else is as for a joint axis along an axis of the parent.

use super::axes::Axis;
use nalgebra::{Matrix3, Vector3};

/// The rotation from the joint frame at zero angle to the parent frame: about x, about z, then a permutation of axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ConstantRotation<N> {
    /// The parent axis along z before both rotations.
    pub axis: Axis,
    /// Sine and cosine.
    pub about_x: [N; 2],
    pub about_z: [N; 2],
    /// True if the second rotation is needed.
    pub turns_about_z: bool,
}

impl ConstantRotation<f64> {
    /// The constant rotation that maps z from this axis to a direction; with `in_plane`, a direction in the plane of
    /// the axis and the preceding one.
    pub fn to(direction: &Vector3<f64>, axis: Axis, in_plane: bool) -> Self {
        let [x, y, z] = (axis.rotation().transpose() * direction).into();
        if in_plane {
            let length = y.hypot(z);
            return Self { axis, about_x: [-y / length, z / length], about_z: [0.0, 1.0], turns_about_z: false };
        }
        let across = x.hypot(y);
        let length = across.hypot(z);
        Self { axis, about_x: [across / length, z / length], about_z: [x / across, -y / across], turns_about_z: true }
    }

    /// The constant rotation by pi that maps z to the negative axis.
    pub fn against(axis: Axis) -> Self {
        Self { axis, about_x: [0.0, -1.0], about_z: [0.0, 1.0], turns_about_z: false }
    }

    /// No rotation: z is along this axis.
    pub fn none(axis: Axis) -> Self {
        Self { axis, about_x: [0.0, 1.0], about_z: [0.0, 1.0], turns_about_z: false }
    }

    /// The rotation matrix.
    pub fn matrix(&self) -> Matrix3<f64> {
        let ([sx, cx], [sz, cz]) = (self.about_x, self.about_z);
        let about_x = Matrix3::new(1.0, 0.0, 0.0, 0.0, cx, -sx, 0.0, sx, cx);
        self.axis.rotation() * Matrix3::new(cz, -sz, 0.0, sz, cz, 0.0, 0.0, 0.0, 1.0) * about_x
    }
}

impl<N: Copy> ConstantRotation<N> {
    /// Converts each value.
    pub fn map<M>(&self, number: impl Fn(N) -> M) -> ConstantRotation<M> {
        let [sx, cx] = self.about_x;
        let [sz, cz] = self.about_z;
        ConstantRotation {
            axis: self.axis,
            about_x: [number(sx), number(cx)],
            about_z: [number(sz), number(cz)],
            turns_about_z: self.turns_about_z,
        }
    }
}
