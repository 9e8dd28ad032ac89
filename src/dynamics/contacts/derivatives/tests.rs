//! Gradients of the rows of contacts, compared with differences of J w.

use super::super::{ContactScratch, LimitRow};
use super::RowDerivatives;
use crate::dynamics::constraints::robot;
use crate::model::Model;
use crate::scene::contact_point::ContactPoint;
use crate::scene::{Contact, Scene, Surface};
use crate::scenes::draw::Draw;
use nalgebra::{DVector, Matrix3, Rotation3, Vector3};

/// A floating robot with every kind of joint, spheres on tilted planes at four of its links, and contacts with planes,
/// spheres and boxes of other links and of the base.
fn scene() -> Scene {
    let mut random = Draw::new(11);
    let mut vector = |size: f64| Vector3::from_fn(|_, _| size * random.uniform(-1.0, 1.0));
    let mut builder = robot(&mut vector);
    for (link, radius) in [("l5", 0.3), ("l4", 0.1), ("base", 0.2), ("l1", 0.0)] {
        let mut contact = Contact::new(link, link);
        (contact.point, contact.normal, contact.radius) = (vector(0.3), vector(1.0), radius);
        builder = builder.contact(contact);
    }
    let size = Vector3::new(0.2, 0.3, 0.25);
    for (k, (link, other, surface)) in [
        ("l5", Some("l0"), Surface::Plane),
        ("l2", Some("l4"), Surface::Sphere { radius: 0.1 }),
        ("l3", Some("base"), Surface::Box { size }),
        ("l5", Some("l1"), Surface::Box { size }),
        ("l4", None, Surface::Box { size }),
        ("l2", None, Surface::Sphere { radius: 0.2 }),
    ]
    .into_iter()
    .enumerate()
    {
        let mut contact = Contact::new(format!("pair{k}"), link).with_radius(0.07).with_surface(surface);
        (contact.point, contact.normal, contact.other) = (vector(0.3), vector(1.0), other.map(str::to_owned));
        (contact.other_frame.lever, contact.other_frame.rotation) = (vector(0.2), turned(&vector(1.0)));
        builder = builder.contact(contact);
    }
    builder.build().expect("a scene")
}

fn turned(by: &Vector3<f64>) -> Matrix3<f64> {
    *Rotation3::new(*by).matrix()
}

/// p* J w for impulses whose axes turn with the normals from those of `rows` to those of `moved`, by the least rotation
/// relative to the bodies that carry the surfaces.
fn power(
    (rows, moved): (&ContactScratch, &mut ContactScratch),
    (model, points): (&Model<f64>, &[ContactPoint]),
    (p, w): (&DVector<f64>, &[f64]),
) -> f64 {
    let mut impulses = p.clone();
    for (i, point) in points.iter().enumerate() {
        let [(before, at_start), (after, at_end)] = [rows, &*moved].map(|of| (of.axes[i], of.other_place(point)));
        let n = at_start.rotate_back(&before.row(2).transpose());
        let axis = n.cross(&at_end.rotate_back(&after.row(2).transpose()));
        let turn = Rotation3::new(axis.try_normalize(1e-12).map_or(axis, |unit| unit * axis.norm().asin()));
        let force = turn * at_start.rotate_back(&before.tr_mul(&p.fixed_rows::<3>(3 * i)));
        impulses.fixed_rows_mut::<3>(3 * i).copy_from(&(after * at_end.rotate(&force)));
    }
    moved.velocities(model, points, w).dot(&impulses)
}

/// A central difference of order four, if that with half of the step agrees: near an edge of a box it does not.
fn slope(f: &mut dyn FnMut(f64) -> f64) -> Option<f64> {
    const STEP: f64 = 2e-4;
    let mut of = |step: f64| (8.0 * (f(step) - f(-step)) - (f(2.0 * step) - f(-2.0 * step))) / (12.0 * step);
    let (coarse, fine) = (of(STEP), of(0.5 * STEP));
    ((coarse - fine).abs() <= 1e-8).then_some(fine)
}

#[test]
fn gradients_of_rows_and_planes_are_differences() {
    let scene = scene();
    let (model, points) = (scene.model(), scene.contact_points());
    let mut random = Draw::new(5);
    let limits = vec![LimitRow { body: 2, row: 9, coordinate: 11, upper: true, bound: 0.3 }];
    let near: Vec<usize> = (0..=points.len()).collect();
    let mut edges = 0;
    for _ in 0..5 {
        let mut many = |count: usize| -> Vec<f64> { (0..count).map(|_| random.uniform(-1.0, 1.0)).collect() };
        let (start, along, w) = (scene.neutral(), many(scene.nv()), many(scene.nv()));
        let p = DVector::from(many(3 * near.len()));
        let mut q = start.clone();
        scene.integrate(&start, &along, &mut q).expect("a configuration");
        let mut rows = ContactScratch::new(model, points, limits.clone());
        rows.place(model, points, &q);
        let (mut found, mut normals) = (vec![0.0; scene.nv()], vec![Vector3::zeros(); points.len()]);
        let mut scratch = RowDerivatives::new(model);
        rows.add_gradient((model, points), &mut scratch, (&near, &p, &w), (&mut found, &mut normals));
        let mut torques = vec![0.0; scene.nv()];
        rows.add_torques(model, points, (&near, &p), &mut torques);
        let whole: f64 = torques.iter().zip(&w).map(|(torque, w)| torque * w).sum();
        assert!((whole - rows.velocities(model, points, &w).dot(&p)).abs() <= 1e-13 * (1.0 + whole.abs()));
        let mut other = rows.clone();
        let mut nearby = q.clone();
        for (row, &found) in found.iter().enumerate() {
            let expected = slope(&mut |step| {
                let mut v = vec![0.0; scene.nv()];
                v[row] = step;
                scene.integrate(&q, &v, &mut nearby).expect("a configuration");
                other.place(model, points, &nearby);
                power((&rows, &mut other), (model, points), (&p, &w))
            });
            edges += usize::from(expected.is_none());
            assert!(expected.is_none_or(|x| (found - x).abs() <= 1e-8), "row {row}: {found} {expected:?}");
        }
        for (i, point) in points.iter().enumerate() {
            for axis in 0..3 {
                let turn = |step: f64| turned(&Vector3::ith(axis, step));
                let expected = slope(&mut |step| {
                    let mut turned = points.to_vec();
                    turned[i].axes *= turn(step).transpose();
                    if let Some(other) = &mut turned[i].other {
                        other.frame.rotation = turn(step) * other.frame.rotation;
                    }
                    other.place(model, &turned, &q);
                    power((&rows, &mut other), (model, &turned), (&p, &w))
                });
                let normal = point.other.map_or(point.normal(), |other| other.frame.rotation.column(2).into());
                let found = normals[i].dot(&Vector3::ith(axis, 1.0).cross(&normal));
                let is_right = expected.is_some_and(|expected| (found - expected).abs() <= 1e-8);
                assert!(is_right || !point.is_plane(), "plane {i}: {found} {expected:?}");
            }
            assert!((normals[i].amax() > 1e-3) == point.is_plane());
        }
        assert!(found.iter().all(|x| x.is_finite()));
    }
    assert!(edges <= scene.nv() / 4, "{edges} differences across edges");
}
