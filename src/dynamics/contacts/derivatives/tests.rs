//! Gradients of the rows of contacts, compared with differences of J w.

use super::super::{ContactScratch, LimitRow};
use super::RowDerivatives;
use crate::scene::{Contact, Inertial, JointDescription, JointKind, LinkDescription, Scene, SceneBuilder};
use crate::scenes::draw::Draw;
use crate::spatial::Symmetric3;
use nalgebra::{DVector, Rotation3, Vector3};

/// A floating robot with every kind of joint, and spheres on tilted planes at three of its links.
fn scene() -> Scene {
    let mut random = Draw::new(11);
    let inertial = || Inertial {
        mass: 1.0,
        center: Vector3::zeros(),
        central: Symmetric3::new([0.04, 0.0, 0.0, 0.05, 0.0, 0.03]),
    };
    let kinds = [
        JointKind::Spherical,
        JointKind::Revolute,
        JointKind::Prismatic,
        JointKind::Screw { pitch: 0.2 },
        JointKind::Planar,
        JointKind::Revolute,
    ];
    let mut vector = |size: f64| Vector3::from_fn(|_, _| size * random.uniform(-1.0, 1.0));
    let mut builder = SceneBuilder::new()
        .floating_base(true)
        .link(LinkDescription { name: "base".into(), inertial: Some(inertial()) });
    for (k, kind) in kinds.into_iter().enumerate() {
        let parent = if k < 2 { "base".to_owned() } else { format!("l{}", k - 2) };
        let mut joint = JointDescription::new(format!("j{k}"), kind, parent, format!("l{k}"));
        joint.origin.lever = vector(0.4);
        joint.axis = vector(1.0);
        builder = builder.link(LinkDescription { name: format!("l{k}"), inertial: Some(inertial()) }).joint(joint);
    }
    for (link, radius) in [("l5", 0.3), ("l4", 0.1), ("base", 0.2), ("l1", 0.0)] {
        let mut contact = Contact::new(link, link);
        (contact.point, contact.normal, contact.radius) = (vector(0.3), vector(1.0), radius);
        builder = builder.contact(contact);
    }
    builder.build().expect("a scene")
}

/// A central difference of order four.
fn slope(f: &mut dyn FnMut(f64) -> f64) -> f64 {
    const STEP: f64 = 1e-3;
    (8.0 * (f(STEP) - f(-STEP)) - (f(2.0 * STEP) - f(-2.0 * STEP))) / (12.0 * STEP)
}

#[test]
fn gradients_of_rows_and_planes_are_differences() {
    let scene = scene();
    let (model, points) = (scene.model(), scene.contact_points());
    let mut random = Draw::new(5);
    let limits = vec![LimitRow { body: 2, row: 9, coordinate: 11, upper: true, bound: 0.3 }];
    let near = [0, 1, 2, 3, 4];
    for _ in 0..5 {
        let mut many = |count: usize| -> Vec<f64> { (0..count).map(|_| random.uniform(-1.0, 1.0)).collect() };
        let (start, along, w, p) = (scene.neutral(), many(scene.nv()), many(scene.nv()), DVector::from(many(15)));
        let mut q = start.clone();
        scene.integrate(&start, &along, &mut q).expect("a configuration");
        let mut rows = ContactScratch::new(model, points, limits.clone());
        rows.place(model, points, &q);
        let (mut found, mut turns) = (vec![0.0; scene.nv()], vec![Vector3::zeros(); points.len()]);
        let mut scratch = RowDerivatives::new(model);
        rows.add_gradient((model, points), &mut scratch, (&near, &p, &w), (&mut found, &mut turns));
        let mut torques = vec![0.0; scene.nv()];
        rows.add_torques(model, points, (&near, &p), &mut torques);
        let power: f64 = torques.iter().zip(&w).map(|(torque, w)| torque * w).sum();
        assert!((power - rows.velocities(model, points, &w).dot(&p)).abs() <= 1e-13 * (1.0 + power.abs()));
        let mut other = rows.clone();
        let mut nearby = q.clone();
        for (row, &found) in found.iter().enumerate() {
            let expected = slope(&mut |step| {
                let mut v = vec![0.0; scene.nv()];
                v[row] = step;
                scene.integrate(&q, &v, &mut nearby).expect("a configuration");
                other.place(model, points, &nearby);
                other.velocities(model, points, &w).dot(&p)
            });
            assert!((found - expected).abs() <= 1e-9, "row {row}: {found} {expected}");
        }
        for (i, turn) in turns.iter().enumerate() {
            for axis in 0..3 {
                let expected = slope(&mut |step| {
                    let mut turned = points.to_vec();
                    let rotation = Rotation3::new(Vector3::ith(axis, step));
                    turned[i].axes *= rotation.matrix().transpose();
                    other.place(model, &turned, &q);
                    other.velocities(model, &turned, &w).dot(&p)
                });
                assert!((turn[axis] - expected).abs() <= 1e-9, "plane {i}: {} {expected}", turn[axis]);
            }
        }
        assert!(found.iter().all(|x| x.is_finite()) && turns.iter().all(|turn| turn.amax() > 1e-3));
    }
}
