//! Shapes as users describe them.

use crate::error::number;
use nalgebra::Vector3;
use std::sync::Arc;

/// A solid shape about the origin of its frame. Lengths are in m.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Solid {
    /// Everything below the plane z = 0 of its frame. It cannot move.
    HalfSpace,
    /// A sphere.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// A cylinder along z with a half sphere on each end.
    Capsule {
        /// Radius.
        radius: f64,
        /// Length of the cylinder, without the half spheres.
        length: f64,
    },
    /// A box with edges along the axes.
    Box {
        /// Lengths of the edges.
        size: Vector3<f64>,
    },
    /// A cylinder along z.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Length.
        length: f64,
    },
    /// The convex hull of points.
    Hull {
        /// The points; at least four, not in one plane.
        points: Arc<[Vector3<f64>]>,
    },
    /// The ground below the heights of a grid of points, in triangles. It cannot move.
    Heights {
        /// Heights along z, row by row: x increases within a row, y from row to row.
        heights: Arc<[f64]>,
        /// Number of heights in a row; at least two, as the number of rows.
        columns: usize,
        /// Size of the grid along x and y; its center is the origin.
        size: [f64; 2],
    },
}

impl Solid {
    /// Its name in messages.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::HalfSpace => "half space",
            Self::Sphere { .. } => "sphere",
            Self::Capsule { .. } => "capsule",
            Self::Box { .. } => "box",
            Self::Cylinder { .. } => "cylinder",
            Self::Hull { .. } => "hull",
            Self::Heights { .. } => "height field",
        }
    }

    /// True if it must be fixed to the base.
    #[must_use]
    pub fn is_ground(&self) -> bool {
        matches!(self, Self::HalfSpace | Self::Heights { .. })
    }

    /// A fault of its numbers: the value found, and the expected one.
    pub(crate) fn fault(&self) -> Option<(String, &'static str)> {
        let length = |what: &str, value: f64| {
            (!(value.is_finite() && value > 0.0))
                .then(|| (format!("{what} {}", number(value)), "a finite positive length, m"))
        };
        match self {
            Self::HalfSpace => None,
            Self::Sphere { radius } => length("radius", *radius),
            Self::Capsule { radius, length: along } | Self::Cylinder { radius, length: along } => {
                length("radius", *radius).or_else(|| length("length", *along))
            }
            Self::Box { size } => size.iter().find_map(|&edge| length("size", edge)),
            Self::Hull { points } => {
                let expected = "at least four points of finite numbers";
                if !points.iter().flatten().all(|x| x.is_finite()) {
                    return Some(("a point that is not finite".to_owned(), expected));
                }
                (points.len() < 4).then(|| (format!("{} points", points.len()), expected))
            }
            Self::Heights { heights, columns, size } => {
                let finite = heights.iter().all(|z| z.is_finite());
                let rows = heights.len().checked_div(*columns).unwrap_or(0);
                let fits = *columns >= 2 && rows >= 2 && rows * columns == heights.len();
                if !(finite && fits) {
                    return Some((
                        format!("{} heights in rows of {columns}", heights.len()),
                        "at least two rows and two columns of finite heights",
                    ));
                }
                size.iter().find_map(|&edge| length("size", edge))
            }
        }
    }
}
