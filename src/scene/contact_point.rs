//! Contacts as the sweeps read them: points on bodies and planes of the world, by index.

use nalgebra::{Matrix3, Vector3};

/// One contact: a sphere on a body above a plane of the world.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ContactPoint {
    /// Its name.
    pub name: String,
    /// The body that carries the sphere.
    pub body: usize,
    /// The sphere's center in the body's frame, m.
    pub center: Vector3<f64>,
    /// Its radius, m; zero for a point.
    pub radius: f64,
    /// Rows t1, t2, n in the base frame: n the plane's unit normal out of the ground, t1 and t2 in the plane.
    pub axes: Matrix3<f64>,
    /// The plane is where n y = offset, m.
    pub offset: f64,
    /// Coefficient of friction.
    pub friction: f64,
    /// Coefficient of restitution.
    pub restitution: f64,
    /// The bodies from this one to the base, the outermost first.
    pub path: Vec<usize>,
}

impl ContactPoint {
    /// The plane's normal.
    pub fn normal(&self) -> Vector3<f64> {
        self.axes.row(2).transpose()
    }
}

/// Rows t1, t2, n of a plane's unit normal: t1 = e x n / |e x n|, e the base axis least along n; t2 = n x t1.
pub(crate) fn plane_axes(normal: &Vector3<f64>) -> Matrix3<f64> {
    let mut axis = Vector3::zeros();
    axis[normal.iamin()] = 1.0;
    let first = axis.cross(normal).normalize();
    Matrix3::from_rows(&[first.transpose(), normal.cross(&first).transpose(), normal.transpose()])
}
