//! New scenes from a scene: other joint properties, payloads, and mimic relations as given.

use crate::common::arm::{assembled, parts};
use crate::common::tolerance::{assert_near, product};
use phipsi::motion::Properties;
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, Mimic, Property, ROOT_JOINT};
use phipsi::spatial::Symmetric3;
use phipsi::{Error, Scene};

fn arm() -> Scene {
    let (links, joints) = parts();
    assembled((links, joints)).build().unwrap()
}

/// M at the neutral configuration.
fn mass_matrix(scene: &Scene) -> Vec<f64> {
    let mut out = vec![f64::NAN; scene.nv() * scene.nv()];
    scene.mass_matrix(&mut scene.workspace(), &scene.neutral(), &mut out).unwrap();
    out
}

#[test]
fn properties_of_some_joints_change_and_no_others() {
    let scene = arm();
    let first = scene.joints()[0].name.clone();
    let changes = [(&*first, Property::Armature, 0.5), (&*first, Property::Damping, 0.25)];
    let changed = scene.with_properties(changes).unwrap();
    let (before, after) = (Properties::of(&scene), Properties::of(&changed));
    assert_eq!((after.armature[0], after.damping[0]), (0.5, 0.25));
    assert_eq!((&after.armature[1..], &after.damping[1..]), (&before.armature[1..], &before.damping[1..]));
    assert_eq!((after.friction, after.stiffness), (before.friction, before.stiffness));
    let difference = mass_matrix(&changed)[0] - mass_matrix(&scene)[0];
    assert_near("armature", &[difference], &[0.5 - before.armature[0]], product(2, mass_matrix(&changed)[0].abs()));
}

#[test]
fn the_free_joint_of_a_floating_base_has_properties_too_until_it_is_locked() {
    let (links, joints) = parts();
    let scene = assembled((links, joints)).floating_base(true).build().unwrap();
    let changed = scene.with_properties([(ROOT_JOINT, Property::Armature, 0.5)]).unwrap();
    assert_eq!(changed.model().system.noise[..6], [0.5; 6]);
    let again = changed.source().clone().build().unwrap();
    assert_eq!(again.model(), changed.model());
    let locked = changed.lock(&[ROOT_JOINT], &changed.neutral()).unwrap();
    assert_eq!(locked.nv(), scene.nv() - 6);
    assert_eq!(locked.source().clone().build().unwrap().model(), locked.model());
}

#[test]
fn properties_that_cannot_be_are_refused_by_their_name() {
    let scene = arm();
    let first = scene.joints()[0].name.clone();
    for (joint, value) in [("knee", 1.0), (&*first, -1.0), (&*first, f64::NAN), (&*first, f64::INFINITY)] {
        // The terms of friction of either sign.
        let signed = |of: Property| value < 0.0 && matches!(of, Property::FrictionOffset | Property::Stribeck);
        for &property in Property::ALL.iter().filter(|&&property| !signed(property)) {
            let error = scene.with_properties([(joint, property, value)]).unwrap_err();
            assert!(matches!(&error, Error::Argument { argument, .. } if argument == property.name()), "{error}");
        }
    }
    scene.with_properties([(&*first, Property::FrictionOffset, -1.0)]).unwrap();
    let error = scene.with_properties([(&*first, Property::Stribeck, -1e3)]).unwrap_err();
    assert!(error.to_string().contains("stribeck -1000 with friction"), "{error}");
}

#[test]
fn a_payload_is_a_link_that_is_fixed_on() {
    let scene = arm();
    let payload = Inertial {
        mass: 2.0,
        center: [0.1, -0.2, 0.3].into(),
        central: Symmetric3::new([0.03, 0.001, 0.0, 0.04, 0.0, 0.05]),
    };
    let carrier = scene.joints()[1].child.clone();
    let found = scene.with_payload(&carrier, &payload).unwrap();
    let expected = scene
        .source()
        .clone()
        .link(LinkDescription { name: "load".into(), inertial: Some(payload) })
        .joint(JointDescription::new("clamp", JointKind::Fixed, &*carrier, "load"))
        .build()
        .unwrap();
    let (found, expected) = (mass_matrix(&found), mass_matrix(&expected));
    let size = expected.iter().fold(0.0, |size: f64, x| size.max(x.abs()));
    assert_near("M with a load", &found, &expected, product(20, size));
}

#[test]
fn payloads_that_cannot_be_are_refused() {
    let scene = arm();
    let valid = Inertial { mass: 1.0, center: [0.0; 3].into(), central: Symmetric3::zero() };
    let carrier = scene.joints()[0].child.clone();
    assert!(scene.with_payload(&carrier, &valid).is_ok());
    for (link, payload) in [
        ("hand?", valid),
        (&*carrier, Inertial { mass: -1.0, ..valid }),
        (&*carrier, Inertial { mass: f64::NAN, ..valid }),
        (&*carrier, Inertial { center: [0.0, f64::INFINITY, 0.0].into(), ..valid }),
        (&*carrier, Inertial { central: Symmetric3::new([f64::NAN; 6]), ..valid }),
    ] {
        let error = scene.with_payload(link, &payload).unwrap_err();
        assert!(matches!(error, Error::Argument { .. } | Error::NotFinite { .. }), "{error}");
    }
}

#[test]
fn a_mimic_keeps_its_numbers() {
    let (links, mut joints) = parts();
    let mimic = Mimic::of(joints[1].name.clone()).with_multiplier(-0.5).with_offset(0.25);
    joints[0].mimic = Some(mimic.clone());
    let scene = assembled((links, joints)).build().unwrap();
    assert_eq!(scene.source().joints()[0].mimic, Some(mimic));
}
