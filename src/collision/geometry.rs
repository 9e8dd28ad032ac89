//! A shape with what its contacts are computed from.

#[cfg(feature = "collision")]
use super::hull;
use super::nearest::SAME;
use super::polyhedron::Polyhedron;
use super::solid::Solid;
use crate::spatial::RigidShift;
use nalgebra::Vector3;
use std::sync::Arc;

/// Number of corners of the polygon that stands for the end of a cylinder.
const CORNERS: usize = 16;

/// Ground falls away from a plane at a larger slope.
const FALLS: f64 = 1e-6;

/// A shape and the box about it.
#[derive(Debug, Clone)]
pub(crate) struct Geometry {
    pub kind: Kind,
    /// Center and half of the edges of the box about it, in its frame.
    pub center: Vector3<f64>,
    pub half: Vector3<f64>,
    /// A sphere or capsule is a point or line with this radius about it, m; zero for other shapes.
    pub rounding: f64,
}

#[derive(Debug, Clone)]
pub(crate) enum Kind {
    HalfSpace,
    Sphere,
    /// Half of the length of its line along z.
    Capsule(f64),
    Box(Vector3<f64>, Arc<Polyhedron>),
    /// Half of its length, and its radius.
    Cylinder(f64, f64),
    Hull(Arc<Polyhedron>),
    /// Triangles of the ground, row by row.
    Heights(Arc<Heights>),
}

/// The triangles of a height field.
#[derive(Debug, Clone)]
pub(crate) struct Heights {
    pub values: Arc<[f64]>,
    pub columns: usize,
    pub size: [f64; 2],
}

impl Geometry {
    /// Returns the fault of the shape, and the expected value.
    pub fn new(solid: &Solid) -> Result<Self, (String, &'static str)> {
        let kind = match solid {
            Solid::HalfSpace => Kind::HalfSpace,
            Solid::Sphere { .. } => Kind::Sphere,
            Solid::Capsule { length, .. } => Kind::Capsule(0.5 * length),
            Solid::Box { size } => {
                let half = size * 0.5;
                Kind::Box(half, Arc::new(Polyhedron::of_box(&half)))
            }
            Solid::Cylinder { radius, length } => Kind::Cylinder(0.5 * length, *radius),
            Solid::Hull { points } => Kind::Hull(hull_of(points)?),
            Solid::Heights { heights, columns, size } => {
                Kind::Heights(Arc::new(Heights { values: heights.clone(), columns: *columns, size: *size }))
            }
        };
        let rounding = match solid {
            Solid::Sphere { radius } | Solid::Capsule { radius, .. } => *radius,
            _ => 0.0,
        };
        let (center, half) = kind.bounds(rounding);
        if cfg!(feature = "collision") {
            return Ok(Self { kind, center, half, rounding });
        }
        Err(without_feature())
    }

    /// The largest distance of its points from a point, for the pose of the shape in the frame of the point.
    pub fn reach(&self, frame: &RigidShift<f64>) -> f64 {
        (frame.rotate(&self.center) + frame.lever).norm() + self.half.norm()
    }

    /// Half of the edges of the box about it along the axes of the base, for its pose there, and the center.
    pub fn bounds(&self, place: &RigidShift<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let center = place.rotate(&self.center) + place.lever;
        if matches!(self.kind, Kind::HalfSpace) {
            return (center, self.half);
        }
        (center, place.rotation.abs() * self.half)
    }

    /// Its polyhedron, if it is one.
    pub fn polyhedron(&self) -> Option<&Polyhedron> {
        match &self.kind {
            Kind::Box(_, of) | Kind::Hull(of) => Some(of),
            _ => None,
        }
    }
}

impl Kind {
    fn bounds(&self, rounding: f64) -> (Vector3<f64>, Vector3<f64>) {
        let round = Vector3::repeat(rounding);
        let (low, high) = match self {
            Self::HalfSpace => return (Vector3::zeros(), Vector3::repeat(f64::INFINITY)),
            Self::Sphere => (-round, round),
            Self::Capsule(half) => {
                let line = Vector3::new(0.0, 0.0, *half);
                (-line - round, line + round)
            }
            Self::Box(half, _) => (-half, *half),
            Self::Cylinder(half, radius) => {
                let corner = Vector3::new(*radius, *radius, *half);
                (-corner, corner)
            }
            Self::Hull(of) => {
                let first = of.corners[0];
                of.corners.iter().fold((first, first), |(low, high), x| (low.inf(x), high.sup(x)))
            }
            Self::Heights(of) => {
                let (low, high) =
                    of.values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &z| (l.min(z), h.max(z)));
                let half = [0.5 * of.size[0], 0.5 * of.size[1]];
                // Everything below the surface.
                let depth = of.size[0].max(of.size[1]);
                (Vector3::new(-half[0], -half[1], low - depth), Vector3::new(half[0], half[1], high))
            }
        };
        ((low + high) * 0.5, (high - low) * 0.5)
    }
}

impl Heights {
    pub fn rows(&self) -> usize {
        self.values.len() / self.columns
    }

    /// A point of the grid.
    pub fn corner(&self, row: usize, column: usize) -> Vector3<f64> {
        #[allow(clippy::cast_precision_loss)] // indices of a grid
        let along = |at: usize, count: usize, size: f64| size * (at as f64 / (count - 1) as f64 - 0.5);
        let (x, y) = (along(column, self.columns, self.size[0]), along(row, self.rows(), self.size[1]));
        Vector3::new(x, y, self.values[row * self.columns + column])
    }

    /// True if the ground falls away about one of its points, seen along a normal, and no triangle rises there by more
    /// than a height: edges and corners in a plane or a valley are hidden by their triangles.
    pub fn is_exposed(&self, x: &Vector3<f64>, normal: &Vector3<f64>, height: f64) -> bool {
        let slack = SAME * self.size[0].max(self.size[1]);
        let holds = |t: &[Vector3<f64>; 3]| {
            let left = |i: usize| {
                let (along, to) = (t[(i + 1) % 3] - t[i], x - t[i]);
                along[0] * to[1] - along[1] * to[0] >= -slack * along.norm()
            };
            (0..3).all(left)
        };
        let mut falls = (0..2).any(|axis| x[axis].abs() >= 0.5 * self.size[axis] - slack);
        let near = self.triangles([x[0] - slack, x[1] - slack], [x[0] + slack, x[1] + slack]).filter(holds);
        for to in near.flatten().map(|corner| corner - x) {
            let rise = normal.dot(&to);
            if rise > height {
                return false;
            }
            falls |= rise < -FALLS * (to.norm() + slack);
        }
        falls
    }

    /// The triangles above a rectangle, each with its normal upward.
    pub fn triangles(&self, low: [f64; 2], high: [f64; 2]) -> impl Iterator<Item = [Vector3<f64>; 3]> + '_ {
        let cells = |axis: usize, count: usize| {
            #[allow(clippy::cast_precision_loss, clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped
            let at =
                |x: f64| (((x / self.size[axis] + 0.5) * (count - 1) as f64).floor().max(0.0) as usize).min(count - 2);
            at(low[axis])..=at(high[axis])
        };
        let columns = cells(0, self.columns);
        cells(1, self.rows()).flat_map(move |row| {
            columns.clone().flat_map(move |column| {
                let [a, b] = [self.corner(row, column), self.corner(row, column + 1)];
                let [c, d] = [self.corner(row + 1, column), self.corner(row + 1, column + 1)];
                [[a, b, c], [b, d, c]]
            })
        })
    }
}

/// The corners of the end of a cylinder at this height, counterclockwise seen from +z, the first of them in this
/// direction.
pub(super) fn rim(height: f64, radius: f64, first: &Vector3<f64>) -> Vec<Vector3<f64>> {
    let from = first[1].atan2(first[0]);
    #[allow(clippy::cast_precision_loss)] // small counts
    let corner = |i: usize| {
        let (sin, cos) = (from + std::f64::consts::TAU * i as f64 / CORNERS as f64).sin_cos();
        Vector3::new(radius * cos, radius * sin, height)
    };
    (0..CORNERS).map(corner).collect()
}

#[cfg(feature = "collision")]
fn hull_of(points: &Arc<[Vector3<f64>]>) -> Result<Arc<Polyhedron>, (String, &'static str)> {
    hull::hull(points)
}

#[cfg(not(feature = "collision"))]
fn hull_of(_: &Arc<[Vector3<f64>]>) -> Result<Arc<Polyhedron>, (String, &'static str)> {
    Err(without_feature())
}

fn without_feature() -> (String, &'static str) {
    ("without the crate feature \"collision\"".to_owned(), "phipsi with features = [\"collision\"]")
}
