//! Collision geometry: which points of two shapes can touch, and how far the shapes are apart.
//!
//! Nearest points, penetration depths and convex hulls are those of parry3d (feature `collision`). A pair of shapes has
//! at most eight points of contact. Each is a sphere or point on one of them, and a plane, sphere or box on the other
//! ([`Against`]): the contacts that the dynamics knows. Spheres, boxes, half spaces and the rims of cylinders are
//! exact; elsewhere the features that touch are those of the moment.
//!
//! No robotics here: shapes and relative poses.

#[cfg(feature = "collision")]
mod convex;
mod geometry;
#[cfg(feature = "collision")]
mod hull;
mod narrow;
mod nearest;
mod polygon;
mod polyhedron;
mod solid;
#[cfg(feature = "collision")]
mod touching;

pub(crate) use geometry::Geometry;
pub(crate) use narrow::{Against, Near, contacts, distance, on_line};
pub use solid::Solid;

#[cfg(all(test, feature = "collision"))]
mod tests;
