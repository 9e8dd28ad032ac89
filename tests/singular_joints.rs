//! Pivots: singular ones are errors that name joint, link and remedy; small ones are not; and overflow
//! is reported.

use crate::common::arm::{assembled, link, parts, solid};
use nalgebra::{Matrix3, Vector3};
use phipsi::scene::{Inertial, JointDescription, JointKind};
use phipsi::spatial::{RigidShift, Symmetric3};
use phipsi::{Error, Scene};

/// A joint that moves no inertia about its axis, in a scene that is valid otherwise.
#[track_caller]
fn assert_singular(scene: &Scene, joint: &str, link: &str) {
    let nv = scene.nv();
    let (q, zero) = (scene.neutral(), vec![0.0; nv]);
    let mut workspace = scene.workspace();
    let forward = scene.forward_dynamics(&mut workspace, &q, &zero, &zero, &[], &mut vec![f64::NAN; nv]);
    let mut matrix = vec![f64::NAN; nv * nv];
    let inverse = scene.mass_matrix_inverse(&mut workspace, &mut scene.inverse_scratch(), &q, &mut matrix);
    for error in [forward.unwrap_err(), inverse.unwrap_err()] {
        let Error::SingularJoint { joint: found, link: of, state: None, .. } = &error else { panic!("{error}") };
        assert_eq!((found.as_str(), of.as_str()), (joint, link), "{error}");
        let message = error.to_string();
        assert!(message.starts_with(&format!("joint {joint:?} (of link {link:?}): the inertia along its axis is")));
        let remedy = format!("scene.with_properties([({joint:?}, Property::Armature, 1e-3)])");
        assert!(message.contains(&format!("give the joint armature, for instance {remedy}")), "{message}");
        assert!(error.in_state(3).to_string().contains(&format!("(of link {link:?}) in state 3: ")));
    }
    // Algorithms without pivots work.
    scene.mass_matrix(&mut workspace, &q, &mut matrix).unwrap();
    scene.inverse_dynamics(&mut workspace, &q, &zero, &zero, &[], &mut vec![f64::NAN; nv]).unwrap();
    scene.placements(&q).unwrap();
}

/// The arm with a joint "tip" of a given type and armature at the hand, and a link "needle" on it.
fn with_needle(kind: JointKind, armature: f64, needle: Option<Inertial>) -> Scene {
    let mut tip = JointDescription::new("tip", kind, "hand", "needle");
    tip.origin.lever = Vector3::new(0.0, 0.1, 0.3);
    tip.armature = armature;
    assembled(parts()).link(link("needle", needle)).joint(tip).build().unwrap()
}

#[test]
fn a_tip_without_mass_is_singular() {
    let massless = Inertial { mass: 0.0, center: Vector3::zeros(), central: Symmetric3::zero() };
    for kind in [
        JointKind::Revolute,
        JointKind::Prismatic,
        JointKind::Spherical,
        JointKind::Planar,
        JointKind::Floating,
        JointKind::Screw { pitch: 0.1 },
    ] {
        for inertial in [None, Some(massless)] {
            assert_singular(&with_needle(kind, 0.0, inertial), "tip", "needle");
        }
        // With armature the joint moves an inertia.
        let scene = with_needle(kind, 1e-6, None);
        let zero = vec![0.0; scene.nv()];
        let mut qdd = vec![f64::NAN; scene.nv()];
        scene.forward_dynamics(&mut scene.workspace(), &scene.neutral(), &zero, &zero, &[], &mut qdd).unwrap();
    }
}

#[test]
fn a_point_mass_on_its_axis_is_singular() {
    let point = Inertial { mass: 1.0, center: Vector3::new(0.0, 0.0, 0.5), central: Symmetric3::zero() };
    assert_singular(&with_needle(JointKind::Revolute, 0.0, Some(point)), "tip", "needle");
}

/// A point mass that a fixed joint places on the axis: the terms of its inertia cancel up to rounding, not to
/// zero, and none of them was subtracted by a measurement update.
#[test]
fn a_point_mass_welded_onto_the_axis_is_singular() {
    for i in 1..20_i32 {
        let center = Vector3::new(0.1, -0.3, 0.7) * f64::from(i);
        let point = Inertial { mass: 1.3, center, central: Symmetric3::zero() };
        let mut weld = JointDescription::new("weld", JointKind::Fixed, "needle", "weight");
        weld.origin.lever = -center;
        let mut tip = JointDescription::new("tip", JointKind::Revolute, "hand", "needle");
        tip.axis = Vector3::new(0.2, 0.5, -0.4);
        let (links, joints) = parts();
        let scene = assembled((links, joints))
            .link(link("needle", None))
            .link(link("weight", Some(point)))
            .joint(tip)
            .joint(weld)
            .build()
            .unwrap();
        assert_singular(&scene, "tip", "needle");
    }
}

#[test]
fn a_light_link_is_no_singularity() {
    for inertia in [1e-6, 1e-12, 1e-18] {
        // Small total mass, and small inertia about the axis alone.
        let light = Inertial {
            mass: 1e-6,
            center: Vector3::zeros(),
            central: Symmetric3::new([inertia, 0.0, 0.0, inertia, 0.0, inertia]),
        };
        let needle = Inertial {
            mass: 1.0,
            center: Vector3::new(0.0, 0.0, 0.5),
            central: Symmetric3::new([0.1, 0.0, 0.0, 0.1, 0.0, inertia]),
        };
        for inertial in [light, needle] {
            let scene = with_needle(JointKind::Revolute, 0.0, Some(inertial));
            let zero = vec![0.0; scene.nv()];
            let mut tau = zero.clone();
            // A corresponding torque: the needle alone accelerates, by one radian per second squared.
            tau[scene.joint("tip").unwrap().v.start] = inertia;
            let mut qdd = vec![f64::NAN; scene.nv()];
            let mut workspace = scene.workspace();
            scene.forward_dynamics(&mut workspace, &scene.neutral(), &zero, &tau, &[], &mut qdd).unwrap();
            let mut still = qdd.clone();
            scene.forward_dynamics(&mut workspace, &scene.neutral(), &zero, &zero, &[], &mut still).unwrap();
            let turned = qdd[scene.nv() - 1] - still[scene.nv() - 1];
            // The difference is the effect of the torque on the hand (of about 0.03 kg m^2).
            assert!((turned - 1.0).abs() <= 100.0 * inertia + 1e-9, "{turned} for {inertia:e}");
        }
    }
}

/// Two hinges on one axis with no inertia between them: the outer one removes all inertia about the axis of the inner
/// one.
fn doubled(kind: JointKind, rotation: Matrix3<f64>, between: Option<Inertial>) -> Scene {
    let mut inner = JointDescription::new("inner", kind, "hand", "ring");
    inner.origin = RigidShift { rotation, lever: Vector3::new(0.1, -0.2, 0.3) };
    let mut outer = JointDescription::new("outer", kind, "ring", "needle");
    (inner.axis, outer.axis) = (Vector3::new(0.3, -0.7, 0.5), Vector3::new(0.3, -0.7, 0.5));
    assembled(parts())
        .link(link("ring", between))
        .link(link("needle", Some(solid())))
        .joint(inner)
        .joint(outer)
        .build()
        .unwrap()
}

#[test]
fn two_hinges_on_one_axis_are_singular() {
    let turned = *nalgebra::Rotation3::new(Vector3::new(0.3, 1.1, -0.4)).matrix();
    for kind in [JointKind::Revolute, JointKind::Prismatic] {
        for rotation in [Matrix3::identity(), turned] {
            assert_singular(&doubled(kind, rotation, None), "inner", "ring");
        }
    }
    let scene = doubled(JointKind::Revolute, turned, Some(solid()));
    let zero = vec![0.0; scene.nv()];
    let mut qdd = vec![f64::NAN; scene.nv()];
    scene.forward_dynamics(&mut scene.workspace(), &scene.neutral(), &zero, &zero, &[], &mut qdd).unwrap();
}

#[test]
fn two_screws_of_one_pitch_are_singular() {
    for pitch in [0.5, -0.5, 2.0, -2.0] {
        let turned = *nalgebra::Rotation3::new(Vector3::new(0.3, 1.1, -0.4)).matrix();
        assert_singular(&doubled(JointKind::Screw { pitch }, turned, None), "inner", "ring");
    }
}

#[test]
fn overflow_is_an_error_and_no_nan() {
    let mut slides = parts();
    slides.1[0].kind = JointKind::Prismatic;
    let scene = assembled(slides).build().unwrap();
    let (q, zero) = (scene.neutral(), vec![0.0; 4]);
    let mut workspace = scene.workspace();
    let mut out = vec![f64::NAN; 4];
    let fast = vec![1e200; 4];
    let huge = vec![f64::MAX; 4];
    let overflows = |what: &str, result: Result<(), Error>| {
        let error = result.expect_err(what);
        assert!(matches!(error, Error::NotFinite { .. }), "{error}");
        assert!(error.to_string().starts_with(&format!("{what} (result; the arguments overflow): found ")), "{error}");
    };
    overflows("bias torque", scene.bias_torque(&mut workspace, &q, &fast, &mut out));
    overflows("inverse dynamics", scene.inverse_dynamics(&mut workspace, &q, &fast, &zero, &[], &mut out));
    overflows("inverse dynamics", scene.inverse_dynamics(&mut workspace, &q, &zero, &huge, &[], &mut out));
    overflows("forward dynamics", scene.forward_dynamics(&mut workspace, &q, &fast, &zero, &[], &mut out));
    overflows("forward dynamics", scene.forward_dynamics(&mut workspace, &q, &zero, &huge, &[], &mut out));
    overflows("energy", scene.energy(&mut workspace, &q, &fast).map(|_| ()));
    overflows("momentum", scene.momentum(&mut workspace, &q, &huge).map(|_| ()));
}

#[test]
fn an_inertia_that_overflows_is_not_called_singular() {
    // Finite values whose moments overflow: more inertia would not help.
    let (mut links, joints) = parts();
    links[2].inertial.as_mut().unwrap().center = Vector3::new(1e200, 0.0, 0.0);
    let result = assembled((links, joints)).build().and_then(|scene| {
        let zero = vec![0.0; scene.nv()];
        let mut qdd = vec![f64::NAN; scene.nv()];
        scene.forward_dynamics(&mut scene.workspace(), &scene.neutral(), &zero, &zero, &[], &mut qdd)
    });
    let error = result.expect_err("infinite inertia");
    assert!(matches!(error, Error::NotFinite { .. }), "{error}");
    let words = "inertia along the axis of joint \"wrist\" (result; the arguments overflow): found ";
    assert!(error.to_string().starts_with(words), "{error}");
}
