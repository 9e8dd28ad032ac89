//! Contacts in the form that the sweeps read: points on bodies and planes of the world, by index.

use nalgebra::{Matrix3, Vector3};

/// A sphere on a body and a plane of the world.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ContactPoint {
    /// Its name.
    pub name: String,
    /// The body that carries the sphere.
    pub body: usize,
    /// Center of the sphere in the body frame, m.
    pub center: Vector3<f64>,
    /// Radius of the sphere, m; zero for a point.
    pub radius: f64,
    /// Rows t1, t2, n in the base frame: n is the unit normal of the plane toward the free side, t1 and t2 are
    /// tangents.
    pub axes: Matrix3<f64>,
    /// The plane is n . y = offset, m.
    pub offset: f64,
    /// Coefficient of friction.
    pub friction: f64,
    /// Coefficient of restitution.
    pub restitution: f64,
    /// The bodies from this one to the base, outermost first.
    pub path: Vec<usize>,
}

impl ContactPoint {
    /// Unit normal of the plane.
    pub fn normal(&self) -> Vector3<f64> {
        self.axes.row(2).transpose()
    }
}

/// Rows t1, t2, n for the unit normal n of a plane: t1 = e x n / |e x n|, where e is the base axis least aligned with
/// n, and t2 = n x t1.
pub(crate) fn plane_axes(normal: &Vector3<f64>) -> Matrix3<f64> {
    let mut axis = Vector3::zeros();
    axis[normal.iamin()] = 1.0;
    let first = axis.cross(normal).normalize();
    Matrix3::from_rows(&[first.transpose(), normal.cross(&first).transpose(), normal.transpose()])
}
