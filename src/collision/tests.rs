//! Contacts and distances in poses with known answers.

use super::{Against, Geometry, Near, Solid, contacts, distance};
use crate::spatial::RigidShift;
use nalgebra::{Rotation3, Vector3};

fn at(x: f64, y: f64, z: f64) -> RigidShift<f64> {
    RigidShift { rotation: nalgebra::Matrix3::identity(), lever: Vector3::new(x, y, z) }
}

fn turned(shift: RigidShift<f64>, axis: Vector3<f64>) -> RigidShift<f64> {
    RigidShift { rotation: *Rotation3::new(axis).matrix(), ..shift }
}

fn made(solid: &Solid) -> Geometry {
    Geometry::new(solid).unwrap()
}

fn cube(edge: f64) -> Solid {
    Solid::Box { size: Vector3::repeat(edge) }
}

fn found(a: &Geometry, b: &Geometry, pose: &RigidShift<f64>, reach: f64) -> Vec<Near> {
    let mut out = Vec::new();
    contacts(a, b, pose, reach, &mut out);
    out
}

/// The points of all contacts in the frame of a, and their gaps; a plane has the points on it.
fn places(of: &[Near], pose: &RigidShift<f64>) -> Vec<(Vector3<f64>, f64)> {
    let place = |near: &Near| {
        let center = if near.on_first { near.center } else { pose.rotate(&near.center) + pose.lever };
        (center, near.gap)
    };
    of.iter().map(place).collect()
}

#[test]
fn equal_cubes_on_each_other_touch_at_their_corners() {
    let (a, b) = (made(&cube(0.2)), made(&cube(0.2)));
    for gap in [0.0, 1e-12, -1e-12, 1e-5, -1e-5] {
        let pose = at(0.0, 0.0, 0.2 + gap);
        let all = found(&a, &b, &pose, 1e-4);
        assert!(all.len() == 4, "{gap}: {all:?}");
        for (point, found) in places(&all, &pose) {
            assert!((found - gap).abs() <= 1e-15 && (point[0].abs() - 0.1).abs() <= 1e-12, "{gap}: {point}, {found}");
        }
        for near in &all {
            let Against::Plane { normal, .. } = near.against else { panic!("{near:?}") };
            assert!((normal[2].abs() - 1.0).abs() <= 0.0, "{near:?}");
        }
    }
}

#[test]
fn a_turned_cube_touches_in_the_corners_of_the_common_area() {
    let (a, b) = (made(&cube(0.2)), made(&cube(0.2)));
    let pose = turned(at(0.0, 0.0, 0.2), Vector3::z() * std::f64::consts::FRAC_PI_4);
    let all = found(&a, &b, &pose, 1e-6);
    assert!(all.len() == 8, "{}", all.len());
    let shifted = found(&a, &b, &at(0.15, 0.15, 0.2), 1e-6);
    let low = places(&shifted, &at(0.15, 0.15, 0.2)).iter().fold(f64::INFINITY, |low, (x, _)| low.min(x[0].min(x[1])));
    assert!(shifted.len() == 4 && (low - 0.05).abs() <= 1e-12, "{low}");
}

#[test]
fn a_cube_that_slides_toward_a_flush_tile_does_not_hit_its_side() {
    let (tile, cube) = (made(&cube(0.2)), made(&cube(0.1)));
    for depth in [0.0, 1e-10, -1e-10] {
        // Beside the tile, at the height of its upper side, and beyond the seam.
        assert!(found(&tile, &cube, &at(0.151, 0.0, 0.15 - depth), 0.01).is_empty(), "{depth}");
        assert!(found(&tile, &cube, &at(0.15, 0.0, 0.15 - depth), 0.01).is_empty(), "{depth}");
        let over = found(&tile, &cube, &at(0.149, 0.0, 0.15 - depth), 0.01);
        assert!(over.len() == 4, "{over:?}");
    }
    // A lower cube hits the side.
    let hit = found(&tile, &cube, &at(0.151, 0.0, 0.14), 0.01);
    assert!(hit.len() == 4 && hit.iter().all(|near| (near.gap - 1e-3).abs() <= 1e-12), "{hit:?}");
}

#[test]
fn edges_that_cross_touch_in_one_point() {
    let (a, b) = (made(&cube(0.2)), made(&cube(0.2)));
    // Both stand on an edge, which cross at a right angle.
    let down = *Rotation3::new(Vector3::x() * std::f64::consts::FRAC_PI_4).matrix();
    let up = *Rotation3::new(Vector3::y() * std::f64::consts::FRAC_PI_4).matrix();
    let height = 0.2 * 2.0_f64.sqrt();
    let rotation = down.transpose() * up;
    let pose = RigidShift { rotation, lever: down.transpose() * Vector3::new(0.0, 0.0, height + 1e-6) };
    let all = found(&a, &b, &pose, 1e-5);
    assert!(all.len() == 1 && (all[0].gap - 1e-6).abs() <= 1e-9, "{all:?}");
}

#[test]
fn a_cylinder_has_the_points_of_its_rims_and_side() {
    let ground = made(&Solid::HalfSpace);
    let coin = made(&Solid::Cylinder { radius: 0.1, length: 0.02 });
    let flat = found(&ground, &coin, &at(0.0, 0.0, 0.01), 1e-6);
    assert!(flat.len() == 8 && flat.iter().all(|near| near.radius == 0.0 && near.gap.abs() <= 1e-15), "{flat:?}");
    let lying = found(&ground, &coin, &turned(at(0.0, 0.0, 0.1), Vector3::x() * std::f64::consts::FRAC_PI_2), 1e-6);
    assert!(lying.len() == 2 && lying.iter().all(|near| (near.radius - 0.1).abs() <= 1e-15), "{lying:?}");
    // A tilted coin touches at the lowest point of its rim.
    let tilt = 0.7_f64;
    let height = 0.1 * tilt.sin() + 0.01 * tilt.cos();
    let tilted = found(&ground, &coin, &turned(at(0.0, 0.0, height), Vector3::x() * tilt), 1e-6);
    assert!(tilted.len() == 1 && tilted[0].gap.abs() <= 1e-15, "{tilted:?}");
    assert!((tilted[0].radius - 0.1).abs() <= 1e-15 && tilted[0].rim == Some(Vector3::z()));
}

#[test]
fn round_shapes_touch_as_spheres() {
    let (ball, tube) = (made(&Solid::Sphere { radius: 0.1 }), made(&Solid::Capsule { radius: 0.05, length: 0.4 }));
    let one = found(&ball, &tube, &at(0.16, 0.0, 0.05), 0.02);
    assert!(one.len() == 1 && (one[0].gap - 0.01).abs() <= 1e-14, "{one:?}");
    let across = turned(at(0.0, 0.11, 0.0), Vector3::x() * std::f64::consts::FRAC_PI_2);
    assert!(found(&tube, &tube, &turned(at(0.11, 0.0, 0.0), Vector3::x() * 1.0), 0.02).len() == 1);
    assert!(found(&tube, &tube, &at(0.11, 0.0, 0.1), 0.02).len() == 2);
    let deep = distance(&ball, &ball, &at(0.0, 0.05, 0.0), 1.0).unwrap();
    assert!((deep.distance + 0.15).abs() <= 1e-12 && (deep.normal - Vector3::y()).amax() <= 1e-9, "{deep:?}");
    // The end of one beside the middle of the other.
    let beside = distance(&tube, &tube, &across, 1.0).unwrap();
    assert!((beside.distance + 0.1).abs() <= 1e-9, "{beside:?}");
}

#[test]
fn many_points_on_the_ground_become_eight() {
    let points = (0..2000).map(|i| {
        let angle = f64::from(i) * 0.003_141_592_653;
        let z = if i % 2 == 0 { 0.0 } else { 0.1 };
        Vector3::new(0.1 * angle.cos(), 0.1 * angle.sin(), z)
    });
    let hull = made(&Solid::Hull { points: points.collect() });
    let all = found(&made(&Solid::HalfSpace), &hull, &at(0.0, 0.0, 0.0), 1e-6);
    assert!(all.len() == super::polygon::MOST, "{}", all.len());
}

#[test]
fn a_ball_on_a_height_field_touches_its_triangles() {
    let heights: Vec<f64> = (0..9).map(|i| if i == 4 { 0.5 } else { 0.0 }).collect();
    let field = made(&Solid::Heights { heights: heights.into(), columns: 3, size: [2.0, 2.0] });
    let ball = made(&Solid::Sphere { radius: 0.1 });
    let above = found(&field, &ball, &at(0.0, 0.0, 0.605), 0.01);
    assert!(above.len() == 1 && (above[0].gap - 0.005).abs() <= 1e-12, "{above:?}");
    // A flat corner, and below the surface there.
    let flat = Solid::Heights { heights: vec![0.0; 9].into(), columns: 3, size: [2.0, 2.0] };
    for z in [0.1, 0.099, 0.02] {
        let all = found(&made(&flat), &ball, &at(0.4, 0.3, z), 0.01);
        assert!(all.len() == 1 && (all[0].gap - (z - 0.1)).abs() <= 1e-12, "{z}: {all:?}");
    }
    assert!(found(&field, &ball, &at(0.0, 0.0, 0.7), 0.01).is_empty());
}

#[test]
fn a_ball_in_a_valley_touches_both_sides() {
    let heights: Vec<f64> = (0..9).map(|i| 0.5 * (f64::from(i % 3) - 1.0).abs()).collect();
    let field = made(&Solid::Heights { heights: heights.into(), columns: 3, size: [2.0, 2.0] });
    let ball = made(&Solid::Sphere { radius: 0.15 });
    let all = found(&field, &ball, &at(0.0, 0.03, 0.15 * 1.25_f64.sqrt()), 1e-6);
    assert!(all.len() == 2 && all.iter().all(|near| near.gap.abs() <= 1e-15), "{all:?}");
}

#[test]
fn round_shapes_and_edges_touch_an_edge_along_their_common_length() {
    let step = made(&cube(0.2));
    let beside = |x: f64| Vector3::new(0.1, 0.1, 0.1) + Vector3::new(0.6, 0.0, 0.8) * x;
    let along_y = Vector3::x() * std::f64::consts::FRAC_PI_2;
    for shape in [Solid::Capsule { radius: 0.05, length: 0.1 }, Solid::Cylinder { radius: 0.05, length: 0.1 }] {
        let shape = made(&shape);
        // The middle of its line is at y = 0.08: beside the edge from 0.03 to 0.1.
        let pose = turned(RigidShift { lever: beside(0.051) - Vector3::y() * 0.02, ..at(0.0, 0.0, 0.0) }, along_y);
        let all = found(&step, &shape, &pose, 0.01);
        let mut y: Vec<f64> = places(&all, &pose).iter().map(|(x, _)| x[1]).collect();
        y.sort_by(f64::total_cmp);
        assert!(all.len() == 2 && (y[0] - 0.03).abs() <= 1e-12 && (y[1] - 0.1).abs() <= 1e-12, "{all:?}");
        assert!(all.iter().all(|near| (near.gap - 1e-3).abs() <= 1e-9), "{all:?}");
    }
    // The edge of a cube that stands on an edge, 20 mm above.
    let lever = Vector3::new(0.101 + 0.1 * 2.0_f64.sqrt(), 0.05, 0.12);
    let pose = turned(RigidShift { lever, ..at(0.0, 0.0, 0.0) }, Vector3::y() * std::f64::consts::FRAC_PI_4);
    let all = found(&step, &step, &pose, 0.02);
    let mut y: Vec<f64> = places(&all, &pose).iter().map(|(x, _)| x[1]).collect();
    y.sort_by(f64::total_cmp);
    assert!(all.len() == 2 && (y[0] + 0.05).abs() <= 1e-12 && (y[1] - 0.1).abs() <= 1e-12, "{all:?}");
}

#[test]
fn equal_points_have_one_hull() {
    let points =
        || Solid::Hull { points: (0..8).map(|i| Vector3::from([0, 1, 2].map(|k| f64::from(i >> k & 1)))).collect() };
    let [one, other] = [made(&points()), made(&points())];
    assert!(one.polyhedron().zip(other.polyhedron()).is_some_and(|(one, other)| std::ptr::eq(one, other)));
}

#[test]
fn flat_triangles_are_one_face() {
    let field = made(&Solid::Heights { heights: vec![0.0; 41 * 41].into(), columns: 41, size: [2.0, 2.0] });
    let ground = made(&Solid::HalfSpace);
    for shape in [cube(0.4), Solid::Cylinder { radius: 0.2, length: 0.4 }] {
        let (shape, pose) = (made(&shape), at(0.013, 0.027, 0.2));
        let all = found(&field, &shape, &pose, 1e-6);
        assert!(all.len() <= super::polygon::MOST && all.iter().all(|near| near.gap.abs() <= 1e-15), "{}", all.len());
        // They span the area of the face.
        let far = |of: &[Near], x: f64, y: f64| {
            of.iter().fold(0.0_f64, |far, near| far.max(near.center[0] * x + near.center[1] * y))
        };
        let expected = found(&ground, &shape, &pose, 1e-6);
        for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
            let (found, expected) = (far(&all, x, y), far(&expected, x, y));
            assert!((found - expected).abs() <= 0.1 * expected, "{found} {expected}");
        }
    }
}

#[test]
fn broken_hulls_are_refused() {
    for points in [vec![[0.0, 0.0, 0.0]; 6], vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]] {
        let points = points.into_iter().map(Vector3::from).collect();
        assert!(Geometry::new(&Solid::Hull { points }).is_err());
    }
    let tiny = [[0.0, 0.0, 0.0], [1e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 1e-6]];
    assert!(Geometry::new(&Solid::Hull { points: tiny.map(Vector3::from).into() }).is_ok());
}
