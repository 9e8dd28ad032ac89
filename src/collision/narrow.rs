//! The points of contact of two shapes, and their distance.
//!
//! The nearest points of both shapes give the normal. If it is the normal of a face, the points of the other shape that
//! can be reached are within the sides of this face, and touch its plane; else there is one point, or two for parallel
//! lines.

#[cfg(feature = "collision")]
use super::convex;
use super::geometry::{Geometry, Heights, Kind, rim};
use super::nearest::{Nearest, SAME};
use super::polygon::{clip, spanning};
use super::polyhedron::{FEW_FACES, Face, Polyhedron};
use crate::spatial::RigidShift;
use nalgebra::Vector3;

/// The largest angle between the normal of the nearest points and that of a face that touches.
const ALIGNED: f64 = 1e-4;

/// A face in whose plane another shape slides has a gap of at most this, relative to the smaller shape, and a normal
/// whose cosine is below the second.
const SLIDES: f64 = 1e-7;
const OTHER: f64 = 0.99;

/// The end of a cylinder lies flat at a smaller sine of its angle.
const FLAT: f64 = 0.05;

/// Lines at a smaller sine of their angle are parallel.
const PARALLEL: f64 = 1e-3;

/// A ridge of the ground penetrates a shape at most to this depth relative to its size; a deeper shape has points below
/// the ground.
const SHALLOW: f64 = 0.02;

/// A possible contact of a pair.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Near {
    /// True if the point belongs to the first shape.
    pub on_first: bool,
    /// Center and radius of the sphere, or the point, in the frame of its shape.
    pub center: Vector3<f64>,
    pub radius: f64,
    /// The axis of the rim of a disk with this center and radius, which touches a plane instead of the sphere.
    pub rim: Option<Vector3<f64>>,
    /// The surface on the other shape, in its frame.
    pub against: Against,
    /// True if the surface is a face, or a box with faces; false for an edge or a corner.
    pub is_face: bool,
    /// Distance, m; negative for penetration.
    pub gap: f64,
}

/// A surface that a sphere touches on the other shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Against {
    /// A plane n . x = offset.
    Plane {
        normal: Vector3<f64>,
        offset: f64,
    },
    Sphere {
        center: Vector3<f64>,
        radius: f64,
    },
    /// A line with a radius about it.
    Line {
        ends: [Vector3<f64>; 2],
        radius: f64,
    },
    /// The box that the other shape is.
    Box(Vector3<f64>),
}

impl Near {
    /// True for points on the same plane, up to rounding.
    fn shares_plane(&self, other: &Self) -> bool {
        let (Against::Plane { normal, offset }, Against::Plane { normal: of_other, offset: other_offset }) =
            (&self.against, &other.against)
        else {
            return false;
        };
        let apart = (offset - other_offset).abs();
        self.on_first == other.on_first && (normal - of_other).norm() <= SAME && apart <= SAME * (1.0 + offset.abs())
    }

    /// True for the same point and the same surface, up to rounding.
    fn is_again(&self, other: &Self) -> bool {
        let is_near = |x: &Vector3<f64>, y: &Vector3<f64>| (x - y).norm() <= SAME * (1.0 + self.radius);
        let is_same = match (&self.against, &other.against) {
            (Against::Plane { .. }, Against::Plane { .. }) => self.shares_plane(other),
            (Against::Sphere { center, .. }, Against::Sphere { center: other, .. }) => is_near(center, other),
            (Against::Line { ends: [a, b], .. }, Against::Line { ends: [c, d], .. }) => {
                (is_near(a, c) && is_near(b, d)) || (is_near(a, d) && is_near(b, c))
            }
            (one, other) => one == other,
        };
        is_same && self.on_first == other.on_first && is_near(&self.center, &other.center)
    }
}

#[cfg(feature = "collision")]
fn nearest(a: &Geometry, b: &Geometry, b_in_a: &RigidShift<f64>, limit: f64) -> Option<Nearest> {
    convex::nearest(a, b, b_in_a, limit)
}

#[cfg(not(feature = "collision"))]
fn nearest(_: &Geometry, _: &Geometry, _: &RigidShift<f64>, _: f64) -> Option<Nearest> {
    None
}

/// The nearest points of two shapes up to a distance; `None` beyond it. `b_in_a` is the pose of b in the frame of a.
pub(crate) fn distance(a: &Geometry, b: &Geometry, b_in_a: &RigidShift<f64>, limit: f64) -> Option<Nearest> {
    match (&a.kind, &b.kind) {
        (Kind::HalfSpace, _) => {
            let down = b_in_a.rotate_back(&-Vector3::z());
            let low = b_in_a.rotate(&b.farthest(&down)) + b_in_a.lever;
            let gap = low[2] - b.rounding;
            let on_a = Vector3::new(low[0], low[1], 0.0);
            let on_b = Vector3::new(low[0], low[1], gap);
            (gap <= limit).then_some(Nearest { on_a, on_b, normal: Vector3::z(), distance: gap })
        }
        (_, Kind::HalfSpace | Kind::Heights(_)) if !matches!(a.kind, Kind::Heights(_)) => {
            let back = b_in_a.inverse();
            Some(distance(b, a, &back, limit)?.exchanged(&back))
        }
        (Kind::Heights(of), _) => {
            let each = near_triangles(of, b, b_in_a, limit);
            let each = each.into_iter().filter_map(|triangle| {
                let ground = Geometry::of_triangle(&triangle);
                distance(&ground, b, b_in_a, limit).map(|found| (ground, found))
            });
            // The other side of a hill is below the nearest triangle.
            let nearest = each.min_by(|(_, x), (_, y)| x.distance.total_cmp(&y.distance));
            nearest.map(|(ground, found)| above(&ground, found, b, b_in_a))
        }
        _ => {
            let both = a.rounding + b.rounding;
            nearest(a, b, b_in_a, limit + both).map(|found| found.rounded(a.rounding, b.rounding))
        }
    }
    .filter(|found| found.distance <= limit)
}

/// A contact with a triangle of the ground is above it: below, its distance is that of the lowest point.
fn above(ground: &Geometry, found: Nearest, b: &Geometry, b_in_a: &RigidShift<f64>) -> Nearest {
    let Some(face) = ground.polyhedron().and_then(|of| of.faces.first().map(|face| (face.normal, of.corners[0])))
    else {
        return found;
    };
    let (normal, corner) = face;
    if found.normal.dot(&normal) > 0.0 && found.distance >= -SHALLOW * b.half.norm() {
        return found;
    }
    let low = b_in_a.rotate(&b.farthest(&b_in_a.rotate_back(&-normal))) + b_in_a.lever - normal * b.rounding;
    let depth = normal.dot(&(low - corner));
    Nearest { on_a: low - normal * depth, on_b: low, normal, distance: depth }
}

/// The possible contacts of two shapes whose gap is at most `reach`. `b_in_a` is the pose of b in the frame of a.
pub(crate) fn contacts(a: &Geometry, b: &Geometry, b_in_a: &RigidShift<f64>, reach: f64, out: &mut Vec<Near>) {
    let first = out.len();
    match (&a.kind, &b.kind) {
        (Kind::HalfSpace, _) => {
            let normal = b_in_a.rotate_back(&Vector3::z());
            // n . x = offset in the frame of b.
            let offset = -b_in_a.lever[2];
            if normal.dot(&b.center) - normal.abs().dot(&b.half) - offset > reach {
                return;
            }
            let plane = Plane { normal, offset, sides: &[] };
            let against = Against::Plane { normal: Vector3::z(), offset: 0.0 };
            on_plane(b, &plane, reach, (false, against), out);
        }
        (Kind::Heights(of), _) if !b.is_ground() => on_heights(of, b, b_in_a, reach, out),
        (_, Kind::HalfSpace | Kind::Heights(_)) if !a.is_ground() => {
            contacts(b, a, &b_in_a.inverse(), reach, out);
            exchange(&mut out[first..]);
        }
        (Kind::Heights(_), _) => {}
        (Kind::Sphere, Kind::Box(half, _)) => {
            let center = b_in_a.rotate_back(&-b_in_a.lever);
            let (radius, gap, center) = (a.rounding, from_box(half, &center) - a.rounding, Vector3::zeros());
            push(
                out,
                reach,
                Near { on_first: true, center, radius, rim: None, against: Against::Box(*half), is_face: true, gap },
            );
        }
        (Kind::Box(..), Kind::Sphere) => {
            contacts(b, a, &b_in_a.inverse(), reach, out);
            exchange(&mut out[first..]);
        }
        _ => on_convex(a, b, b_in_a, reach, out),
    }
}

/// The distance of a point from a box; negative inside.
fn from_box(half: &Vector3<f64>, x: &Vector3<f64>) -> f64 {
    let beyond = x.zip_map(half, |x, half| x.abs() - half);
    let outside = beyond.map(|x| x.max(0.0)).norm();
    if outside > 0.0 { outside } else { beyond.max() }
}

fn exchange(of: &mut [Near]) {
    for near in of {
        near.on_first = !near.on_first;
    }
}

fn push(out: &mut Vec<Near>, reach: f64, near: Near) {
    if near.gap <= reach {
        out.push(near);
    }
}

/// A face by its normal and its corners.
type Polygon = (Vector3<f64>, Vec<Vector3<f64>>);

/// A plane in the frame of the shape that touches it, and the sides of its face there; without sides it has no end.
struct Plane<'a> {
    normal: Vector3<f64>,
    offset: f64,
    sides: &'a [Vector3<f64>],
}

impl Geometry {
    pub fn is_ground(&self) -> bool {
        matches!(self.kind, Kind::HalfSpace | Kind::Heights(_))
    }

    /// The farthest point in a direction, without rounding.
    pub(super) fn farthest(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        let lines = |half: f64| Vector3::new(0.0, 0.0, half.copysign(direction[2]));
        match &self.kind {
            Kind::HalfSpace | Kind::Heights(_) | Kind::Sphere => Vector3::zeros(),
            Kind::Capsule(half) => lines(*half),
            Kind::Box(half, _) => half.zip_map(direction, f64::copysign),
            Kind::Cylinder(half, radius) => {
                let across = direction[0].hypot(direction[1]);
                let out = if across > 0.0 { radius / across } else { 0.0 };
                lines(*half) + Vector3::new(direction[0] * out, direction[1] * out, 0.0)
            }
            Kind::Hull(of) => of.farthest(direction),
        }
    }

    fn of_triangle(corners: &[Vector3<f64>; 3]) -> Self {
        let of = Polyhedron::of_triangle(corners);
        let (low, high) = (corners[0].inf(&corners[1]).inf(&corners[2]), corners[0].sup(&corners[1]).sup(&corners[2]));
        Self { kind: Kind::Hull(of.into()), center: (low + high) * 0.5, half: (high - low) * 0.5, rounding: 0.0 }
    }

    /// The face whose normal is nearest to a direction: its normal and its corners.
    fn face_toward(&self, direction: &Vector3<f64>) -> Option<Polygon> {
        if let Kind::Cylinder(half, radius) = self.kind {
            let up = 1.0_f64.copysign(direction[2]);
            let mut corners = rim(half * up, radius, &Vector3::x());
            if up < 0.0 {
                corners.reverse();
            }
            return Some((Vector3::z() * up, corners));
        }
        let of = self.polyhedron()?;
        of.face_toward(direction).map(|face| (face.normal, of.polygon(face)))
    }

    /// The sphere that stands for the shape about one of its points without rounding, with the normal there: that of
    /// its side for a cylinder.
    fn sphere_about(&self, x: &Vector3<f64>, normal: &Vector3<f64>) -> (Vector3<f64>, f64) {
        match self.kind {
            Kind::Cylinder(_, radius) if normal[2].abs() <= PARALLEL && x[0].hypot(x[1]) > radius * (1.0 - 1e-6) => {
                (Vector3::new(0.0, 0.0, x[2]), radius)
            }
            _ => (*x, self.rounding),
        }
    }

    /// Center and radius of the rim of a cylinder with this point.
    fn rim_about(&self, x: &Vector3<f64>) -> Option<(Vector3<f64>, f64)> {
        let Kind::Cylinder(half, radius) = self.kind else { return None };
        let is_on = x[0].hypot(x[1]) > radius * (1.0 - 1e-6);
        is_on.then_some((Vector3::new(0.0, 0.0, half.copysign(x[2])), radius))
    }

    /// The face whose normal is a direction, up to a sine, and that sine.
    fn aligned(&self, toward: &Vector3<f64>, slack: f64) -> Option<(f64, Polygon)> {
        let face = self.face_toward(toward)?;
        let sine = face.0.cross(toward).norm();
        (face.0.dot(toward) > 0.0 && sine <= slack).then_some((sine, face))
    }

    /// The line that touches in a direction, by its ends and the radius about it: that of a capsule or of the side of a
    /// cylinder, if it is across, or an edge.
    fn line_toward(&self, direction: &Vector3<f64>) -> Option<([Vector3<f64>; 2], f64)> {
        let along = |half: f64| [-half, half].map(|z| Vector3::new(0.0, 0.0, z));
        let is_across = direction[2].abs() <= PARALLEL;
        match &self.kind {
            Kind::Capsule(half) if is_across => Some((along(*half), self.rounding)),
            Kind::Cylinder(half, radius) if is_across => Some((along(*half), *radius)),
            Kind::Box(_, of) | Kind::Hull(of) if of.faces.len() <= FEW_FACES => {
                let first = of.farthest(direction);
                let is_level = |x: &&Vector3<f64>| direction.dot(&(first - *x)) <= PARALLEL * (first - *x).norm();
                let mut level = of.corners.iter().filter(is_level);
                let ends = [*level.next()?, *level.next()?];
                level.next().is_none().then_some((ends, 0.0))
            }
            _ => None,
        }
    }
}

/// The contacts of a shape with a plane, given in its frame.
fn on_plane(
    shape: &Geometry,
    plane: &Plane<'_>,
    reach: f64,
    (on_first, against): (bool, Against),
    out: &mut Vec<Near>,
) {
    let (n, sides) = (&plane.normal, plane.sides);
    let height = |x: &Vector3<f64>| n.dot(x) - plane.offset;
    let inside = |points: Vec<Vector3<f64>>| if sides.is_empty() { points } else { clip(points, sides, n) };
    let mut add = |center: Vector3<f64>, radius: f64| {
        let gap = height(&center) - radius;
        push(out, reach, Near { on_first, center, radius, rim: None, against, is_face: true, gap });
    };
    let points = match &shape.kind {
        Kind::HalfSpace | Kind::Heights(_) => return,
        Kind::Sphere => vec![Vector3::zeros()],
        Kind::Capsule(half) => vec![Vector3::new(0.0, 0.0, -half), Vector3::new(0.0, 0.0, *half)],
        Kind::Cylinder(half, radius) => {
            let across = Vector3::new(n[0], n[1], 0.0);
            let sine = across.norm();
            if sine >= FLAT {
                let lowest = across * (-radius / sine);
                let ends = [-half, *half].map(|z| lowest + Vector3::new(0.0, 0.0, z)).to_vec();
                for point in inside(ends) {
                    let (center, gap) = (Vector3::new(0.0, 0.0, point[2]), height(&point));
                    let rim = Some(Vector3::z());
                    push(out, reach, Near { on_first, center, radius: *radius, rim, against, is_face: true, gap });
                }
                return;
            }
            let lowest = if sine > 1e-9 { -across } else { Vector3::x() };
            rim(-half.copysign(n[2]), *radius, &lowest)
        }
        Kind::Box(_, of) | Kind::Hull(of) => {
            let mut low = of.below(n, reach + plane.offset);
            if !sides.is_empty() {
                low.retain(|x| !clip(vec![*x], sides, n).is_empty());
                // Where the sides cut the lowest face.
                if let Some(face) = of.face_toward(&-n) {
                    let cut = clip(of.polygon(face), sides, n);
                    let size = shape.half.norm();
                    let is_new = |x: &Vector3<f64>| !low.iter().any(|known| (known - x).norm() <= 1e-9 * size);
                    let cut: Vec<_> = cut.into_iter().filter(|x| height(x) <= reach && is_new(x)).collect();
                    low.extend(cut);
                }
            }
            let gaps: Vec<f64> = low.iter().map(height).collect();
            for i in spanning(&low, &gaps, n) {
                add(low[i], 0.0);
            }
            return;
        }
    };
    let points: Vec<_> = inside(points).into_iter().filter(|x| height(x) - shape.rounding <= reach).collect();
    let gaps: Vec<f64> = points.iter().map(height).collect();
    for i in spanning(&points, &gaps, n) {
        add(points[i], shape.rounding);
    }
}

/// The contacts of two convex shapes.
fn on_convex(a: &Geometry, b: &Geometry, b_in_a: &RigidShift<f64>, reach: f64, out: &mut Vec<Near>) {
    let first = out.len();
    let core_reach = reach + a.rounding + b.rounding;
    let Some(found) = nearest(a, b, b_in_a, core_reach) else { return };
    let (normal, into_b) = (found.normal, -b_in_a.rotate_back(&found.normal));
    // A normal between points that almost touch has the rounding errors of their positions.
    let size = a.half.norm().min(1e6) + b.half.norm().min(1e6);
    let slack = ALIGNED + 1e-14 * size / found.distance.abs().max(1e-30);
    let slack = slack.min(0.1);
    let back = b_in_a.inverse();
    let least = SLIDES * a.half.norm().min(b.half.norm());
    let gap = found.distance - a.rounding - b.rounding;
    if gap >= -least {
        let along_a = sliding(a, b, b_in_a, &normal, least).map(|face| (b, face, *b_in_a, false));
        let slides = along_a.or_else(|| sliding(b, a, &back, &into_b, least).map(|face| (a, face, back, true)));
        if let Some((point, face, pose, against_b)) = slides {
            // Nothing holds shapes that touch along a common rim in both directions.
            if gap > least {
                on_face(point, face, &pose, reach, against_b, out);
            }
            return;
        }
    }
    let (on_a, on_b) = (a.aligned(&normal, slack), b.aligned(&into_b, slack));
    let by_b = match (&on_a, &on_b) {
        (Some(a), Some(b)) => b.0 <= a.0 + ALIGNED,
        (None, Some(_)) => true,
        _ => false,
    };
    let (point, face, pose, against_b) = match (on_a, on_b) {
        (_, Some((_, face))) if by_b => (a, face, back, true),
        (Some((_, face)), _) => (b, face, *b_in_a, false),
        _ => {
            on_features(a, b, b_in_a, reach, &found, out);
            return;
        }
    };
    on_face(point, face, &pose, reach, against_b, out);
    if out.len() == first {
        on_features(a, b, b_in_a, reach, &found, out);
    }
}

/// The contacts of a shape with a face of another, given by its normal and corners; `pose` is that of the shape in the
/// frame of the face.
fn on_face(
    shape: &Geometry,
    (face_normal, corners): Polygon,
    pose: &RigidShift<f64>,
    reach: f64,
    on_first: bool,
    out: &mut Vec<Near>,
) {
    let offset = face_normal.dot(&corners[0]);
    let normal = pose.rotate_back(&face_normal);
    let sides: Vec<Vector3<f64>> = corners.iter().map(|x| pose.rotate_back(&(x - pose.lever))).collect();
    let plane = Plane { normal, offset: offset - face_normal.dot(&pose.lever), sides: &sides };
    on_plane(shape, &plane, reach, (on_first, Against::Plane { normal: face_normal, offset }), out);
}

/// The face of one shape in whose plane the other slides, if their nearest points have another normal: a box that
/// slides over flush tiles does not hit their sides.
fn sliding(
    one: &Geometry,
    other: &Geometry,
    other_in_one: &RigidShift<f64>,
    normal: &Vector3<f64>,
    slack: f64,
) -> Option<Polygon> {
    let of = one.polyhedron().filter(|of| of.faces.len() <= FEW_FACES)?;
    let touches = |face: &&Face| {
        let n = &face.normal;
        let low = other_in_one.rotate(&other.farthest(&other_in_one.rotate_back(&-n))) + other_in_one.lever;
        let gap = n.dot(&(low - of.corners[face.corners[0]])) - other.rounding;
        gap.abs() <= slack && n.dot(normal) < OTHER
    };
    of.faces.iter().find(touches).map(|face| (face.normal, of.polygon(face)))
}

/// The contact of edges, corners and round sides: one point, or two of parallel lines.
fn on_features(a: &Geometry, b: &Geometry, b_in_a: &RigidShift<f64>, reach: f64, found: &Nearest, out: &mut Vec<Near>) {
    let lines = (a.line_toward(&found.normal), b.line_toward(&-b_in_a.rotate_back(&found.normal)));
    // The shape without a line, or with the thicker one, has the sphere.
    let swaps = lines.0.is_some_and(|own| lines.1.is_none_or(|other| other.1 > own.1));
    let (a, b, (own, line), b_in_a, found) = if swaps {
        (b, a, (lines.1, lines.0), b_in_a.inverse(), found.exchanged(b_in_a))
    } else {
        (a, b, lines, *b_in_a, *found)
    };
    let into_b = |x: &Vector3<f64>| b_in_a.rotate_back(&(x - b_in_a.lever));
    let (center, radius) = a.sphere_about(&found.on_a, &found.normal);
    let (other, other_radius) = match line {
        Some((ends, radius)) => (on_line(&ends, &into_b(&center)), radius),
        None => b.sphere_about(&into_b(&found.on_b), &b_in_a.rotate_back(&found.normal)),
    };
    let beside = own.zip(line).and_then(|((own, radius), (ends, _))| Some((beside(own, ends, &b_in_a)?, radius)));
    let (pairs, radius) = beside.map_or(([[center, other]; 2], radius), |(pairs, radius)| (pairs, radius));
    let both = radius + other_radius;
    for [center, other] in pairs.into_iter().take(if beside.is_some() { 2 } else { 1 }) {
        let apart = b_in_a.rotate(&other) + b_in_a.lever - center;
        let is_outside = both > 0.0 && (found.distance > 0.0 || apart.dot(&found.normal) > 0.0);
        let (against, distance) = match line {
            Some((ends, radius)) if is_outside => (Against::Line { ends, radius }, apart.norm()),
            None if is_outside => (Against::Sphere { center: other, radius: other_radius }, apart.norm()),
            _ => {
                // The normal stays on b.
                let normal = -b_in_a.rotate_back(&found.normal);
                (Against::Plane { normal, offset: normal.dot(&other) + other_radius }, apart.dot(&found.normal))
            }
        };
        let (on_first, is_face, gap) = (!swaps, false, distance - both);
        let near = Near { on_first, center, radius, rim: None, against, is_face, gap };
        let of_rim = matches!(against, Against::Plane { .. }).then(|| a.rim_about(&center)).flatten();
        push(
            out,
            reach,
            of_rim.map_or(near, |(center, radius)| Near { center, radius, rim: Some(Vector3::z()), ..near }),
        );
    }
}

/// The point of a line that is nearest to another.
pub(crate) fn on_line([from, to]: &[Vector3<f64>; 2], x: &Vector3<f64>) -> Vector3<f64> {
    let along = to - from;
    from + along * ((x - from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0)
}

/// Two pairs of points of two lines, each in the frame of its shape, if the lines are parallel and beside each other.
fn beside(
    own: [Vector3<f64>; 2],
    other: [Vector3<f64>; 2],
    b_in_a: &RigidShift<f64>,
) -> Option<[[Vector3<f64>; 2]; 2]> {
    let [(along, length), (along_other, length_other)] = [own, other].map(|[from, to]| {
        let length = (to - from).norm();
        ((to - from) / length, length)
    });
    let turned = b_in_a.rotate(&along_other);
    if !(along.cross(&turned).norm() <= PARALLEL) {
        return None;
    }
    let sign = 1.0_f64.copysign(along.dot(&turned));
    let start = along.dot(&(b_in_a.rotate(&other[0]) + b_in_a.lever - own[0]));
    let end = start + sign * length_other;
    let (low, high) = (start.min(end).max(0.0), start.max(end).min(length));
    let at = |along_own: f64| [own[0] + along * along_own, other[0] + along_other * (sign * (along_own - start))];
    (low < high).then(|| [low, high].map(at))
}

/// The triangles of the ground near a shape.
fn near_triangles(of: &Heights, shape: &Geometry, pose: &RigidShift<f64>, reach: f64) -> Vec<[Vector3<f64>; 3]> {
    let (center, half) = shape.bounds(pose);
    let low = [center[0] - half[0] - reach, center[1] - half[1] - reach];
    let high = [center[0] + half[0] + reach, center[1] + half[1] + reach];
    let bottom = center[2] - half[2] - reach;
    of.triangles(low, high).filter(|t| t.iter().any(|x| x[2] >= bottom)).collect()
}

/// The contacts of a shape with a height field.
fn on_heights(of: &Heights, b: &Geometry, b_in_a: &RigidShift<f64>, reach: f64, out: &mut Vec<Near>) {
    let first = out.len();
    for corners in near_triangles(of, b, b_in_a, reach) {
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0])).normalize();
        let sides = corners.map(|x| b_in_a.rotate_back(&(x - b_in_a.lever)));
        let offset = normal.dot(&corners[0]);
        let plane =
            Plane { normal: b_in_a.rotate_back(&normal), offset: offset - normal.dot(&b_in_a.lever), sides: &sides };
        let from = out.len();
        on_plane(b, &plane, reach, (false, Against::Plane { normal, offset }), out);
        if out.len() > from {
            continue;
        }
        // A ridge or a peak.
        let ground = Geometry::of_triangle(&corners);
        let Some(found) = nearest(&ground, b, b_in_a, reach + b.rounding) else { continue };
        let is_above = found.distance > -SHALLOW * b.half.norm() && found.normal.dot(&normal) > 0.0;
        if is_above && of.is_exposed(&found.on_a, &found.normal, reach) {
            match b.aligned(&-b_in_a.rotate_back(&found.normal), PARALLEL) {
                Some((_, face)) => on_face(&ground, face, &b_in_a.inverse(), reach, true, out),
                None => on_features(&ground, b, b_in_a, reach, &found, out),
            }
        }
    }
    // Neighbors share corners, and triangles in one plane are one face.
    let mut rest: Vec<Near> = Vec::new();
    for near in out.drain(first..) {
        if !rest.iter().any(|known| known.is_again(&near)) {
            rest.push(near);
        }
    }
    while let Some(one) = rest.first().copied() {
        let (face, others): (Vec<Near>, _) = rest.into_iter().partition(|near| near == &one || one.shares_plane(near));
        rest = others;
        let Against::Plane { normal, .. } = one.against else {
            out.extend(face);
            continue;
        };
        let normal = if one.on_first { b_in_a.rotate(&normal) } else { b_in_a.rotate_back(&normal) };
        let (points, gaps): (Vec<_>, Vec<_>) = face.iter().map(|near| (near.center, near.gap)).unzip();
        out.extend(spanning(&points, &gaps, &normal).into_iter().map(|i| face[i]));
    }
}
