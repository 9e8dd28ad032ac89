//! Every term of the dynamics is nonzero: agreement with a reference proves little if both sides are zero.
//!
//! Each test asserts that a term is clearly *not* zero, relative to the sum that it is a part of.

use crate::common::tolerance::{self, conditioning, size};
use crate::common::{ALL_KINDS, Random, Tree, random_inertial, random_state};
use nalgebra::Vector6;
use phipsi::Scene;
use phipsi::scene::{JointDescription, JointKind, LinkDescription, SceneBuilder};

/// Smallest fraction of the sum for which a term counts as nonzero.
const SHARE: f64 = 1e-3;

/// One tree with each type of joint alone, and mixed ones: seeds 0..8 and 8..16.
fn trees() -> impl Iterator<Item = Tree<'static>> {
    (0..16).map(|seed| {
        let at = usize::try_from(seed).unwrap();
        let kinds = if at < ALL_KINDS.len() { &ALL_KINDS[at..=at] } else { &ALL_KINDS[..] };
        Tree { seed, bodies: 3, kinds, branching: 0.0, armature: 0.3, floating: false }
    })
}

fn bias(scene: &Scene, q: &[f64], qd: &[f64]) -> Vec<f64> {
    let mut torque = vec![f64::NAN; scene.nv()];
    scene.bias_torque(&mut scene.workspace(), q, qd, &mut torque).unwrap();
    torque
}

fn acceleration(scene: &Scene, q: &[f64], qd: &[f64], tau: &[f64], wrenches: &[Vector6<f64>]) -> Vec<f64> {
    let mut qdd = vec![f64::NAN; scene.nv()];
    scene.forward_dynamics(&mut scene.workspace(), q, qd, tau, wrenches, &mut qdd).unwrap();
    qdd
}

fn minus(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(x, y)| x - y).collect()
}

#[track_caller]
fn assert_live(what: &str, part: &[f64], whole: &[f64]) {
    let (part, whole) = (size(part), size(whole));
    assert!(part >= SHARE * whole && part > 0.0, "{what}: {part:e} of {whole:e}");
}

/// Only prismatic joints have no velocity torque.
fn turns(kind: JointKind) -> bool {
    kind != JointKind::Prismatic
}

#[test]
fn velocity_enters_bias_and_accelerations() {
    for tree in trees() {
        let scene = tree.scene();
        let (q, qd, tau) = random_state(&scene, &mut Random::new(tree.seed));
        let still = vec![0.0; scene.nv()];
        let (moving, resting) = (bias(&scene, &q, &qd), bias(&scene, &q, &still));
        let change = minus(&moving, &resting);
        if tree.kinds.iter().all(|&kind| turns(kind)) || tree.kinds.len() > 1 {
            assert_live("velocity torque", &change, &moving);
            let found = acceleration(&scene, &q, &qd, &tau, &[]);
            let slow = acceleration(&scene, &q, &still, &tau, &[]);
            assert_live("velocity acceleration", &minus(&found, &slow), &found);
        } else {
            assert!(size(&change) <= tolerance::product(3, size(&moving)), "slides alone give no velocity torque");
        }
    }
}

#[test]
fn joints_couple_through_coriolis_terms() {
    for tree in trees().filter(|tree| tree.kinds.len() > 1 || turns(tree.kinds[0])) {
        let scene = tree.scene();
        let (q, qd, _) = random_state(&scene, &mut Random::new(tree.seed));
        let (first, last) = (&scene.joints()[0], &scene.joints()[scene.joints().len() - 1]);
        let only = |rows: std::ops::Range<usize>| -> Vec<f64> {
            (0..scene.nv()).map(|i| if rows.contains(&i) { qd[i] } else { 0.0 }).collect()
        };
        let (a, b) = (only(first.v.clone()), only(last.v.clone()));
        let both: Vec<f64> = a.iter().zip(&b).map(|(x, y)| x + y).collect();
        let rest = bias(&scene, &q, &vec![0.0; scene.nv()]);
        let together = minus(&bias(&scene, &q, &both), &rest);
        let (alone, other) = (minus(&bias(&scene, &q, &a), &rest), minus(&bias(&scene, &q, &b), &rest));
        assert_live("Coriolis coupling", &minus(&minus(&together, &alone), &other), &together);
    }
}

#[test]
fn gravity_enters() {
    for tree in trees() {
        let scene = tree.scene();
        let weightless = scene.source().clone().gravity([0.0; 3]).build().unwrap();
        let (q, qd, tau) = random_state(&scene, &mut Random::new(tree.seed));
        let found = bias(&scene, &q, &qd);
        assert_live("weight", &minus(&found, &bias(&weightless, &q, &qd)), &found);
        let found = acceleration(&scene, &q, &qd, &tau, &[]);
        assert_live("fall", &minus(&found, &acceleration(&weightless, &q, &qd, &tau, &[])), &found);
        let still = vec![0.0; scene.nv()];
        let energy = scene.energy(&mut scene.workspace(), &q, &still).unwrap();
        assert!(energy.kinetic == 0.0 && energy.potential.abs() > 1e-3);
    }
}

#[test]
fn armature_enters_everywhere_it_should() {
    for tree in trees() {
        let geared = tree.scene();
        let plain = Tree { armature: 0.0, ..tree }.scene();
        let (q, qd, tau) = random_state(&geared, &mut Random::new(tree.seed));
        let nv = geared.nv();
        let mass = |scene: &Scene| {
            let mut m = vec![f64::NAN; nv * nv];
            scene.mass_matrix(&mut scene.workspace(), &q, &mut m).unwrap();
            m
        };
        let difference = minus(&mass(&geared), &mass(&plain));
        for i in 0..nv {
            for j in 0..nv {
                let expected = if i == j { geared.model().system.noise[i] } else { 0.0 };
                let bound = tolerance::product(3, size(&mass(&geared)));
                assert!((difference[i * nv + j] - expected).abs() <= bound);
                assert!(i != j || expected >= 0.03, "every joint has armature here");
            }
        }
        let inverse_dynamics = |scene: &Scene| {
            let mut torque = vec![f64::NAN; nv];
            scene.inverse_dynamics(&mut scene.workspace(), &q, &qd, &tau, &[], &mut torque).unwrap();
            torque
        };
        let with = inverse_dynamics(&geared);
        assert_live("armature in inverse dynamics", &minus(&with, &inverse_dynamics(&plain)), &with);
        assert_eq!(bias(&geared, &q, &qd), bias(&plain, &q, &qd), "armature is no part of the bias");
        let with = acceleration(&geared, &q, &qd, &tau, &[]);
        assert_live("armature in accelerations", &minus(&with, &acceleration(&plain, &q, &qd, &tau, &[])), &with);
        let kinetic = |scene: &Scene| scene.energy(&mut scene.workspace(), &q, &qd).unwrap().kinetic;
        let rotors: f64 = geared.model().system.noise.iter().zip(&qd).map(|(r, v)| 0.5 * r * v * v).sum();
        let gained = kinetic(&geared) - kinetic(&plain);
        assert!(rotors > 0.0 && (gained - rotors).abs() <= tolerance::product(3, kinetic(&geared)));
        let momentum = |scene: &Scene| scene.momentum(&mut scene.workspace(), &q, &qd).unwrap();
        assert_eq!(momentum(&geared), momentum(&plain), "rotors are no bodies");
    }
}

#[test]
fn wrenches_enter_on_every_body() {
    for tree in trees() {
        let scene = tree.scene();
        let mut random = Random::new(tree.seed);
        let (q, qd, tau) = random_state(&scene, &mut random);
        let free = acceleration(&scene, &q, &qd, &tau, &[]);
        for link in scene.links().iter().filter(|link| link.body.is_some()) {
            let wrench = Vector6::from_fn(|_, _| random.uniform(1.0, 5.0));
            let on_bodies = scene.body_wrenches([(link.name.as_str(), wrench)]).unwrap();
            let pushed = acceleration(&scene, &q, &qd, &tau, &on_bodies);
            assert_live(&format!("wrench on {}", link.name), &minus(&pushed, &free), &free);
        }
        let on_base = scene.body_wrenches([("base", Vector6::from_element(7.0))]).unwrap();
        assert_eq!(acceleration(&scene, &q, &qd, &tau, &on_base), free, "the base does not move");
    }
}

/// Two arms on one trunk: M has no entry between them; M^-1 has one, unless the trunk is locked.
#[test]
fn branches_couple_in_the_inverse_alone() {
    for (trunk, coupled) in [(JointKind::Spherical, true), (JointKind::Revolute, true), (JointKind::Fixed, false)] {
        let mut random = Random::new(77);
        let mut builder = SceneBuilder::new();
        for name in ["base", "trunk", "left", "left_hand", "right", "right_hand"] {
            builder = builder.link(LinkDescription { name: name.into(), inertial: Some(random_inertial(&mut random)) });
        }
        let joints =
            [("base", "trunk"), ("trunk", "left"), ("left", "left_hand"), ("trunk", "right"), ("right", "right_hand")];
        for (parent, child) in joints {
            let kind = if parent == "base" { trunk } else { JointKind::Revolute };
            let mut joint = JointDescription::new(child, kind, parent, child);
            joint.origin.lever = random.vector();
            joint.axis = random.vector();
            builder = builder.joint(joint);
        }
        let scene = builder.build().unwrap();
        let (q, ..) = random_state(&scene, &mut random);
        let (nv, mut workspace) = (scene.nv(), scene.workspace());
        let (mut mass, mut inverse) = (vec![f64::NAN; nv * nv], vec![f64::NAN; nv * nv]);
        scene.mass_matrix(&mut workspace, &q, &mut mass).unwrap();
        scene.mass_matrix_inverse(&mut workspace, &mut scene.inverse_scratch(), &q, &mut inverse).unwrap();
        let rows = |names: [&str; 2]| names.map(|name| scene.joint(name).unwrap().v.start);
        for i in rows(["left", "left_hand"]) {
            for j in rows(["right", "right_hand"]) {
                assert_eq!(mass[i * nv + j].to_bits(), 0, "M between branches is an exact zero");
                let entry = inverse[i * nv + j].abs();
                if coupled {
                    assert!(entry > SHARE * size(&inverse), "M^-1 between branches: {entry:e}");
                } else {
                    assert!(entry == 0.0, "nothing moves between them");
                }
            }
        }
        assert!(conditioning(nv, &mass).number < 1e6, "the example is a tame one");
    }
}
