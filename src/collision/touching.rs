//! The normal of shapes that touch or overlap.
//!
//! The distance of two convex shapes is the largest gap between their supporting planes over all normals, also if it is
//! negative. The search of parry3d can end with a normal whose gap is far smaller, or without a result, if the shapes
//! just touch or if their difference is flat, as for two lines that cross. Its normal is therefore compared with those
//! of faces, of pairs of edges, and of round sides.

use super::geometry::{Geometry, Kind};
use super::nearest::Nearest;
use super::polyhedron::{FEW_FACES, Face};
use crate::spatial::RigidShift;
use nalgebra::Vector3;
use std::f64::consts::FRAC_PI_4;

/// Distances up to this are checked, relative to the size of the shapes.
const TOUCHING: f64 = 1e-6;

/// A gap is larger only beyond this, relative to the size of the shapes.
const LARGER: f64 = 1e-9;

/// The same for shapes with round sides.
const ROUND: f64 = 1e-7;

/// First and last angle of the search for the normal of a round side.
const FIRST_STEP: f64 = 0.1;
const LAST_STEP: f64 = 1e-6;

/// Polyhedra with more corners have too many pairs of edges.
const FEW_CORNERS: usize = 8;

impl Geometry {
    /// Directions of its edges or of its axis, in its frame.
    fn edges(&self) -> Vec<Vector3<f64>> {
        match &self.kind {
            Kind::Box(..) => vec![Vector3::x(), Vector3::y(), Vector3::z()],
            Kind::Capsule(_) | Kind::Cylinder(..) => vec![Vector3::z()],
            Kind::Hull(of) if of.corners.len() <= FEW_CORNERS => {
                let ends = |face: &Face| {
                    let polygon = of.polygon(face);
                    (0..polygon.len()).map(|i| polygon[(i + 1) % polygon.len()] - polygon[i]).collect::<Vec<_>>()
                };
                of.faces.iter().flat_map(ends).collect()
            }
            _ => Vec::new(),
        }
    }

    /// Normals of its faces, and of its round side toward a point, in its frame.
    fn normals(&self, toward: &Vector3<f64>) -> Vec<Vector3<f64>> {
        match &self.kind {
            Kind::Box(..) => vec![Vector3::x(), Vector3::y(), Vector3::z()],
            Kind::Cylinder(..) => vec![Vector3::z(), Vector3::new(toward[0], toward[1], 0.0)],
            Kind::Capsule(_) => vec![Vector3::new(toward[0], toward[1], 0.0)],
            Kind::Hull(of) if of.faces.len() <= FEW_FACES => of.faces.iter().map(|face| face.normal).collect(),
            _ => Vec::new(),
        }
    }
}

/// The gap between the supporting planes of two shapes without their rounding, with this normal.
fn gap(a: &Geometry, b: &Geometry, b_in_a: &RigidShift<f64>, normal: &Vector3<f64>) -> f64 {
    let low = b_in_a.rotate(&b.farthest(&-b_in_a.rotate_back(normal))) + b_in_a.lever;
    normal.dot(&(low - a.farthest(normal)))
}

/// A normal with a larger gap near this one, by a search in its neighborhood: round sides have normals between those of
/// the candidates.
fn climbed((a, b): (&Geometry, &Geometry), b_in_a: &RigidShift<f64>, from: (f64, Vector3<f64>)) -> (f64, Vector3<f64>) {
    let axis = if matches!(a.kind, Kind::Cylinder(..)) { Vector3::z() } else { b_in_a.rotate(&Vector3::z()) };
    let ((mut value, mut normal), mut step, mut turn) = (from, FIRST_STEP, 0.0_f64);
    while step > LAST_STEP {
        // Around and along the axis of the round side, where its normals have kinks, and then in other directions.
        let around = normal.cross(&axis);
        let around = if around.norm() > 1e-6 { around } else { normal.cross(&Vector3::ith(normal.iamin(), 1.0)) };
        let around = around.normalize();
        let along = normal.cross(&around);
        let mut best = (value, normal);
        for k in 0..8 {
            let (sin, cos) = (turn + FRAC_PI_4 * f64::from(k)).sin_cos();
            let trial = (normal + (around * cos + along * sin) * step).normalize();
            let gap = gap(a, b, b_in_a, &trial);
            if gap > best.0 {
                best = (gap, trial);
            }
        }
        if best.0 > value {
            (value, normal) = best;
        } else {
            step *= 0.4;
            turn = if turn > 0.0 { 0.0 } else { step.sqrt() };
        }
    }
    (value, normal)
}

/// The nearest points that were found, if their normal is right; else those of the normal with the largest gap, or none
/// beyond a limit. `again` finds nearest points for another pose.
pub(super) fn settled(
    (a, b): (&Geometry, &Geometry),
    b_in_a: &RigidShift<f64>,
    limit: f64,
    found: Option<Nearest>,
    again: impl Fn(&RigidShift<f64>) -> Option<Nearest>,
) -> Option<Nearest> {
    let size = a.half.norm() + b.half.norm();
    let is_round = [a, b].iter().any(|of| matches!(of.kind, Kind::Cylinder(..)));
    if found.is_some_and(|found| found.distance > TOUCHING * size && !is_round) || !size.is_finite() {
        return found;
    }
    // The gap is a lower bound of the distance, and points of both shapes are an upper one unless they overlap.
    // Overlaps of polyhedra are found exactly.
    let slack = if is_round { ROUND } else { LARGER } * size;
    let closed = |found: &Nearest| gap(a, b, b_in_a, &found.normal) >= found.distance - slack;
    let bounds =
        |found: &Nearest| found.distance >= -LARGER * size || (a.polyhedron().is_some() && b.polyhedron().is_some());
    if found.is_some_and(|found| bounds(&found) && closed(&found)) {
        return found;
    }
    let back = |x: &Vector3<f64>| b_in_a.rotate_back(&(x - b_in_a.lever));
    let (center_a, center_b) = (a.center, b_in_a.rotate(&b.center) + b_in_a.lever);
    let (on_a, on_b) = found.map_or((center_b, center_a), |found| (found.on_b, found.on_a));
    let turned = |of: Vec<Vector3<f64>>| of.into_iter().map(|x| b_in_a.rotate(&x)).collect::<Vec<_>>();
    let (edges_a, edges_b) = (a.edges(), turned(b.edges()));
    let crossed = edges_a.iter().flat_map(|x| edges_b.iter().map(move |y| x.cross(y)));
    let own = [a.normals(&on_a), a.normals(&center_b)].into_iter().flatten();
    let other = [turned(b.normals(&back(&on_b))), turned(b.normals(&back(&center_a)))].into_iter().flatten();
    let between = [center_b - center_a, found.map_or_else(Vector3::zeros, |found| found.normal)];
    // Points and lines without a common direction: across both.
    let across = edges_a.iter().chain(&edges_b).map(|x| x.cross(&Vector3::ith(x.iamin(), 1.0)));
    let mut best = (f64::NEG_INFINITY, Vector3::zeros());
    for normal in between.into_iter().chain(own).chain(other).chain(crossed).chain(across) {
        let length = normal.norm();
        if !(length > 1e-9 * (1.0 + normal.amax())) {
            continue;
        }
        for normal in [normal / length, normal / -length] {
            let gap = gap(a, b, b_in_a, &normal);
            if gap > best.0 {
                best = (gap, normal);
            }
        }
    }
    if is_round {
        best = climbed((a, b), b_in_a, best);
    }
    let (distance, normal) = best;
    let is_right = |found: &Nearest| closed(found) && found.distance >= distance - slack;
    if found.is_some_and(|found| is_right(&found)) || !distance.is_finite() {
        return found;
    }
    if distance > limit {
        return None;
    }
    // The nearest points of the shapes, moved apart along the normal.
    let apart = RigidShift { lever: b_in_a.lever + normal * (0.01 * size - distance), ..*b_in_a };
    let on_a = again(&apart).or(found)?.on_a;
    Some(Nearest { on_a, on_b: on_a + normal * distance, normal, distance })
}

#[cfg(test)]
mod tests {
    use super::super::narrow::distance;
    use super::super::solid::Solid;
    use super::*;
    use nalgebra::Rotation3;
    use std::f64::consts::FRAC_PI_2;

    fn pose(at: [f64; 3], axis: usize, angle: f64) -> RigidShift<f64> {
        let turn = Rotation3::new(Vector3::ith(axis, angle));
        RigidShift { rotation: *turn.matrix(), lever: at.into() }
    }

    /// Distance and normal.
    fn found(a: &Solid, b: &Solid, b_in_a: &RigidShift<f64>) -> (f64, Vector3<f64>) {
        let [a, b] = [a, b].map(|of| Geometry::new(of).expect("a shape"));
        let found = distance(&a, &b, b_in_a, f64::INFINITY).expect("no limit");
        assert!((found.on_b - found.on_a - found.normal * found.distance).norm() <= 1e-7);
        assert!((gap(&a, &b, b_in_a, &found.normal) - a.rounding - b.rounding - found.distance).abs() <= 1e-7);
        (found.distance, found.normal)
    }

    #[test]
    fn lines_that_cross_have_a_distance() {
        let capsule = Solid::Capsule { radius: 0.08, length: 0.3 };
        for at in [[1e-9, 0.0, 1e-9], [0.0, 1e-9, 0.05], [0.0; 3]] {
            let (d, n) = found(&capsule, &capsule, &pose(at, 0, FRAC_PI_2));
            assert!((d + 0.16).abs() <= 1e-7 && (n[0].abs() - 1.0).abs() <= 1e-3, "{d} {n}");
        }
    }

    #[test]
    fn a_point_on_a_surface_has_its_normal() {
        let (ball, block) = (Solid::Sphere { radius: 0.15 }, Solid::Box { size: Vector3::new(0.2, 0.3, 0.4) });
        let rod = Solid::Cylinder { radius: 0.1, length: 0.3 };
        // The center is on a face, whose normal from the box is +x.
        let (d, n) = found(&ball, &block, &pose([-0.2, 0.05, 0.05], 1, FRAC_PI_2));
        assert!((d + 0.15).abs() <= 1e-7 && (n + Vector3::x()).norm() <= 1e-3, "{d} {n}");
        let (d, n) = found(&ball, &rod, &pose([1e-9, -0.1, 0.1], 2, 0.0));
        assert!((d + 0.15).abs() <= 1e-7 && (n + Vector3::y()).norm() <= 1e-3, "{d} {n}");
        let capsule = Solid::Capsule { radius: 0.08, length: 0.3 };
        let (d, n) = found(&capsule, &rod, &pose([0.0, 1e-9, 0.05], 0, FRAC_PI_2));
        assert!((d + 0.18).abs() <= 1e-7 && (n[0].abs() - 1.0).abs() <= 1e-3, "{d} {n}");
    }

    #[test]
    fn boxes_that_touch_at_an_edge_have_a_gap_of_zero() {
        let block = Solid::Box { size: Vector3::new(0.2, 0.3, 0.4) };
        let (d, _) = found(&block, &block, &pose([0.1, 0.3, -0.1], 1, FRAC_PI_2));
        assert!(d.abs() <= 1e-7, "{d}");
    }
}
