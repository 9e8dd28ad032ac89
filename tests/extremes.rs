//! The ends of the range: nothing to move, ten thousand links, and no recursion on the way.

use crate::common::tolerance::{self, assert_near, size};
use crate::common::{Random, random_inertial, random_state};
use phipsi::kinematics::ReferenceFrame;
use phipsi::scene::{JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::{Scene, scenes};

const LINKS: usize = 10_000;

/// A stack that a call a link would overflow: 10,000 of two hundred bytes. (Without optimisation one kernel alone takes half a megabyte.)
const SMALL_STACK: usize = 2 * 1024 * 1024;

fn on_a_small_stack(work: impl FnOnce() + Send + 'static) {
    std::thread::Builder::new().stack_size(SMALL_STACK).spawn(work).unwrap().join().unwrap();
}

/// Forward dynamics, and inverse dynamics of what it gave.
#[track_caller]
fn assert_round_trip(scene: &Scene, q: &[f64], qd: &[f64], tau: &[f64]) {
    let mut workspace = scene.workspace();
    let mut bias = vec![f64::NAN; scene.nv()];
    scene.bias_torque(&mut workspace, q, qd, &mut bias).unwrap();
    let scale = size(&bias).max(size(tau));
    let (mut qdd, mut back) = (vec![f64::NAN; scene.nv()], vec![f64::NAN; scene.nv()]);
    scene.forward_dynamics(&mut workspace, q, qd, tau, &[], &mut qdd).unwrap();
    scene.inverse_dynamics(&mut workspace, q, qd, &qdd, &[], &mut back).unwrap();
    assert!(size(&qdd) > 0.0);
    assert_near("round trip", &back, tau, tolerance::product(scene.nv(), scale));
}

#[test]
fn a_chain_of_ten_thousand_links_works() {
    on_a_small_stack(|| {
        let scene = scenes::chain(LINKS).unwrap();
        assert_eq!(scene.nv(), LINKS);
        let mut random = Random::new(1);
        let (q, tau) = (random.array(LINKS, 0.5), random.array(LINKS, 1.0));
        assert_round_trip(&scene, &q, &vec![0.0; LINKS], &tau);
        assert!(scene.energy(&mut scene.workspace(), &q, &tau).unwrap().kinetic > 0.0);
        assert!(scene.momentum(&mut scene.workspace(), &q, &tau).unwrap().norm() > 0.0);
        assert_eq!(scene.placements(&q).unwrap().len(), LINKS + 1);
        let mut jacobian = vec![f64::NAN; 6 * LINKS];
        scene.jacobian(&q, &format!("link{}", LINKS - 1), ReferenceFrame::Local, &mut jacobian).unwrap();
    });
}

/// Ten thousand joints between ten thousand links, of which a few move.
fn mostly_fixed(parent: impl Fn(usize) -> usize) -> SceneBuilder {
    let mut random = Random::new(2);
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "link0".into(), inertial: None });
    for k in 1..LINKS {
        let kind = if k % 1000 == 1 { JointKind::Revolute } else { JointKind::Fixed };
        let mut joint =
            JointDescription::new(format!("joint{k}"), kind, format!("link{}", parent(k)), format!("link{k}"));
        joint.origin.lever = random.vector() * 0.01;
        joint.axis = random.vector();
        let inertial = (k % 10 == 1).then(|| random_inertial(&mut random));
        builder = builder.link(LinkDescription { name: format!("link{k}"), inertial }).joint(joint);
    }
    builder
}

#[test]
fn ten_thousand_links_welded_in_a_row_are_a_few_bodies() {
    on_a_small_stack(|| {
        let scene = mostly_fixed(|k| k - 1).build().unwrap();
        assert_eq!((scene.nv(), scene.model().bodies.len()), (10, 10));
        assert_eq!(scene.merged_joints().len(), LINKS - 11);
        let (q, qd, tau) = random_state(&scene, &mut Random::new(3));
        assert_round_trip(&scene, &q, &qd, &tau);
        let locked = scene.lock(&["joint1", "joint9001"], &q).unwrap();
        assert_eq!(locked.nv(), 8);
    });
}

#[test]
fn ten_thousand_links_on_one_base_work() {
    on_a_small_stack(|| {
        let scene = mostly_fixed(|_| 0).build().unwrap();
        assert_eq!(scene.nv(), 10, "each on its own");
        let (q, qd, tau) = random_state(&scene, &mut Random::new(4));
        assert_round_trip(&scene, &q, &qd, &tau);
    });
}

#[test]
fn a_scene_in_which_nothing_moves_works() {
    let mut random = Random::new(5);
    let rock = LinkDescription { name: "rock".into(), inertial: Some(random_inertial(&mut random)) };
    let moss = LinkDescription { name: "moss".into(), inertial: None };
    let alone = SceneBuilder::new().link(rock.clone()).build().unwrap();
    let overgrown = SceneBuilder::new()
        .link(rock)
        .link(moss)
        .joint(JointDescription::new("roots", JointKind::Fixed, "rock", "moss"))
        .build()
        .unwrap();
    for scene in [alone, overgrown] {
        assert_eq!((scene.nq(), scene.nv(), scene.joints().len()), (0, 0, 0));
        let mut w = scene.workspace();
        scene.forward_dynamics(&mut w, &[], &[], &[], &[], &mut []).unwrap();
        scene.inverse_dynamics(&mut w, &[], &[], &[], &[], &mut []).unwrap();
        scene.bias_torque(&mut w, &[], &[], &mut []).unwrap();
        scene.mass_matrix(&mut w, &[], &mut []).unwrap();
        scene.mass_matrix_inverse(&mut w, &mut scene.inverse_scratch(), &[], &mut []).unwrap();
        scene.jacobian(&[], "rock", ReferenceFrame::Local, &mut []).unwrap();
        scene.integrate(&[], &[], &mut []).unwrap();
        scene.difference(&[], &[], &mut []).unwrap();
        assert_eq!(scene.neutral(), [0.0; 0]);
        let energy = scene.energy(&mut w, &[], &[]).unwrap();
        assert_eq!((energy.kinetic, energy.potential), (0.0, 0.0), "a base has no energy");
        assert!(scene.momentum(&mut w, &[], &[]).unwrap().norm() == 0.0);
        assert_eq!(scene.placements(&[]).unwrap().len(), scene.links().len());
        assert!(scene.body_wrenches([("rock", nalgebra::Vector6::from_element(1.0))]).unwrap().is_empty());
        assert_eq!(scene.lock(&[], &[]).unwrap().nv(), 0);
        assert_eq!(scene.plan().bodies, 0);
    }
}

/// Locking every joint leaves nothing to move, wherever they stand.
#[test]
fn a_scene_with_every_joint_locked_does_not_move() {
    let scene = scenes::chain(7).unwrap();
    let (q, ..) = random_state(&scene, &mut Random::new(6));
    let names: Vec<&str> = scene.joints().iter().map(|joint| joint.name.as_str()).collect();
    let locked = scene.lock(&names, &q).unwrap();
    assert_eq!((locked.nq(), locked.nv()), (0, 0));
    let (found, expected) = (locked.placements(&[]).unwrap(), scene.placements(&q).unwrap());
    for (found, expected) in found.iter().zip(&expected) {
        assert_near("lever", found.lever.as_slice(), expected.lever.as_slice(), tolerance::product(7, 2.1));
        let bound = tolerance::product(7, 1.0);
        assert_near("rotation", found.rotation.as_slice(), expected.rotation.as_slice(), bound);
    }
}
