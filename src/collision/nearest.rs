//! The nearest points of two shapes.

use crate::spatial::RigidShift;
use nalgebra::Vector3;

/// Largest distance of equal points, m, and of equal normals.
pub(super) const SAME: f64 = 1e-9;

/// The nearest points of two shapes, in the frame of the first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Nearest {
    pub on_a: Vector3<f64>,
    pub on_b: Vector3<f64>,
    /// Unit normal from the first shape to the second.
    pub normal: Vector3<f64>,
    /// Distance, m; negative for penetration.
    pub distance: f64,
}

impl Nearest {
    /// The same with the shapes exchanged, for the pose of b in the frame of a.
    pub fn exchanged(&self, b_in_a: &RigidShift<f64>) -> Self {
        let into = |x: &Vector3<f64>| b_in_a.rotate_back(&(x - b_in_a.lever));
        Self { on_a: into(&self.on_b), on_b: into(&self.on_a), normal: -b_in_a.rotate_back(&self.normal), ..*self }
    }

    /// The nearest points of the shapes with their roundings.
    pub fn rounded(&self, a: f64, b: f64) -> Self {
        Self {
            on_a: self.on_a + self.normal * a,
            on_b: self.on_b - self.normal * b,
            distance: self.distance - a - b,
            ..*self
        }
    }
}
