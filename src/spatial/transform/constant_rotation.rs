//! Joints' axes that are along none of their parent's: a constant rotation about x, and one about z where that is not enough.
//!
//! What a general rotation of the tree does beside the joint's own angle, a turn or two of a plane do, and everything else about the joint
//! is as if its axis were along one of its parent's.

use super::axes::Axis;
use nalgebra::{Matrix3, Vector3};

/// The rotation from the joint's frame at zero angle to its parent's: about x, about z, and axes by their names there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ConstantRotation<N> {
    /// What z is there before both.
    pub axis: Axis,
    /// Sine and cosine.
    pub about_x: [N; 2],
    pub about_z: [N; 2],
    /// Whether the second is there.
    pub turns_about_z: bool,
}

impl ConstantRotation<f64> {
    /// One that brings z from this axis to this direction; in the plane of that axis and the one before it if it is `in_plane`.
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

    /// One that brings z to this axis and against it.
    pub fn against(axis: Axis) -> Self {
        Self { axis, about_x: [0.0, -1.0], about_z: [0.0, 1.0], turns_about_z: false }
    }

    /// One that does nothing but to have z on this axis.
    pub fn none(axis: Axis) -> Self {
        Self { axis, about_x: [0.0, 1.0], about_z: [0.0, 1.0], turns_about_z: false }
    }

    /// As a matrix.
    pub fn matrix(&self) -> Matrix3<f64> {
        let ([sx, cx], [sz, cz]) = (self.about_x, self.about_z);
        let about_x = Matrix3::new(1.0, 0.0, 0.0, 0.0, cx, -sx, 0.0, sx, cx);
        self.axis.rotation() * Matrix3::new(cz, -sz, 0.0, sz, cz, 0.0, 0.0, 0.0, 1.0) * about_x
    }
}

impl<N: Copy> ConstantRotation<N> {
    /// The same with other numbers.
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
