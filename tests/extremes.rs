//! Limits of the size: no moving joint, ten thousand links, without recursion.

use crate::common::tolerance::{self, assert_near, size};
use crate::common::{Random, random_inertial, random_state};
use phipsi::codegen::{Function, Width, sources};
use phipsi::inverse_kinematics::{Goal, Options, RateOptions, Task};
use phipsi::kinematics::ReferenceFrame;
use phipsi::motion::{Method, Settings, Simulator, Torque};
use phipsi::scene::{
    Connection, ConnectionKind, Inertial, JointDescription, JointKind, LinkDescription, Mimic, MimicJoints,
    SceneBuilder,
};
use phipsi::spatial::{RigidShift, Symmetric3};
use phipsi::{Error, Scene, interrupt, scenes};

const LINKS: usize = 10_000;

/// A stack that overflows with one call per link: 10,000 of two hundred bytes. (Without optimization one kernel alone
/// takes half a megabyte.)
const SMALL_STACK: usize = 2 * 1024 * 1024;

fn on_a_small_stack(work: impl FnOnce() + Send + 'static) {
    std::thread::Builder::new().stack_size(SMALL_STACK).spawn(work).unwrap().join().unwrap();
}

/// Forward dynamics, and inverse dynamics of its result.
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

/// Ten thousand joints between ten thousand links, few of them movable.
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

/// If every joint is locked, in any configuration, nothing moves.
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

/// An overflow is an error: of configurations, differences, poses of links, joint velocities of inverse kinematics,
/// lengths of rods, constants of code.
#[test]
fn results_that_are_not_finite_are_errors() {
    let chain = scenes::chain(2).unwrap();
    let floating = chain.source().clone().floating_base(true).build().unwrap();
    let (neutral, mut out) = (floating.neutral(), [0.0; 9]);
    floating.integrate(&neutral, &[1.0; 8], &mut out).unwrap();
    assert!(floating.integrate(&neutral, &[1e300; 8], &mut out).is_err());
    let (mut far, mut near) = (neutral.clone(), neutral.clone());
    (far[0], near[0]) = (1e308, -1e308);
    floating.difference(&neutral, &far, &mut out[..8]).unwrap();
    assert!(floating.difference(&near, &far, &mut out[..8]).is_err());

    let mut sliding = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
    for (name, parent) in [("one", "base"), ("two", "one")] {
        let inertial = Some(random_inertial(&mut Random::new(1)));
        let mut joint = JointDescription::new(format!("to_{name}"), JointKind::Prismatic, parent, name);
        joint.axis = [1.0, 0.0, 0.0].into();
        sliding = sliding.link(LinkDescription { name: name.into(), inertial }).joint(joint);
    }
    let scene = sliding.clone().build().unwrap();
    scene.placements(&[1e308, 0.0]).unwrap();
    assert!(scene.placements(&[1e308, 1e308]).is_err() && scene.placement(&[1e308, 1e308], "two").is_err());

    let goal = |scale: f64| {
        Task::new(Goal::Position { frame: scene.frame(&"two".into()).unwrap(), target: [scale, 0.0, 0.0].into() })
    };
    let options = RateOptions::new(0.01).with_gain(0.1).with_damping(1e-3).with_limits(false);
    let mut solver = scene.inverse_kinematics(&Options::default()).unwrap();
    let (mut workspace, mut qd) = (scene.workspace(), [0.0; 2]);
    solver.rates(&mut workspace, &[goal(1.0)], &[0.0; 2], &options, &mut qd).unwrap();
    assert!(solver.rates(&mut workspace, &[goal(1e308)], &[0.0; 2], &options, &mut qd).is_err());
    let precise = goal(1.0).with_position(1e-200);
    assert!(solver.rates(&mut workspace, &[precise], &[0.0; 2], &options, &mut qd).is_err());

    let rod = |at: f64| {
        let mut rod = Connection::new("rod", ConnectionKind::Distance(None), "two", None);
        rod.other_frame = Some(RigidShift { lever: [0.0, 3.0, at].into(), ..RigidShift::identity() });
        sliding.clone().connect(rod).build()
    };
    assert_eq!(rod(4.0).unwrap().connections()[0].kind, ConnectionKind::Distance(Some(5.0)));
    let refused = rod(1e300).unwrap_err().to_string();
    assert!(refused.contains("\"rod\"") && refused.contains("finite length"), "{refused}");

    let code = |mass: f64, away: f64, width: Width| {
        let payload = Inertial { mass, center: [0.0, 0.0, away].into(), central: Symmetric3::zero() };
        let scene = chain.with_payload("link1", &payload).unwrap();
        sources(&scene, "robot", &[Function::MassMatrix], (width, false)).map_err(|error| error.to_string())
    };
    code(1.0, 0.1, Width::Single).unwrap();
    code(1e50, 0.1, Width::Double).unwrap();
    assert!(code(1e50, 0.1, Width::Single).unwrap_err().contains("float64 holds this one"));
    assert!(code(1e200, 1e60, Width::Double).unwrap_err().contains("products are finite"));
}

/// A long call ends when its interruption callback requests it, and leaves the states unchanged.
#[test]
fn a_simulator_can_be_stopped_within_a_call() {
    let scene = scenes::chain(3).unwrap();
    for method in [Method::Auto, Method::RungeKutta4] {
        let mut settings = Settings::new(&scene, 1e-9);
        settings.method = method;
        let mut simulator = Simulator::new(&scene, settings, &[0.3; 3], &[0.0; 3]).unwrap();
        simulator.step(&Torque::Zero, 10).unwrap();
        let before = simulator.state(0).0.to_vec();
        let fault = interrupt::during(|| true, || simulator.step(&Torque::Zero, usize::MAX >> 1)).unwrap_err();
        assert_eq!(fault.error, Error::Interrupted);
        assert!(simulator.steps() == 10 && simulator.state(0).0 == before);
        simulator.step(&Torque::Zero, 10).unwrap();
    }
}

/// Each joint follows the next one: resolved once, so that long chains build in linear time.
#[test]
fn a_long_chain_of_joints_that_follow_each_other() {
    let plain = scenes::chain(LINKS).unwrap();
    let mut builder = SceneBuilder::new();
    for link in plain.source().links() {
        builder = builder.link(link.clone());
    }
    for (k, joint) in plain.source().joints().iter().enumerate() {
        let mut joint = joint.clone();
        let source = format!("j{}", k + 1);
        joint.mimic = (k + 1 < LINKS).then(|| Mimic::of(source).with_multiplier(-1.0).with_offset(1.0));
        builder = builder.joint(joint);
    }
    let scene = builder.mimic_joints(MimicJoints::Coupled).build().unwrap();
    assert_eq!((scene.nv(), scene.tree().nv()), (1, LINKS));
    let q = scene.coupling().unwrap().configuration(&[0.25]);
    let expected: Vec<f64> = (0..LINKS).rev().map(|k| if k % 2 == 0 { 0.25 } else { 0.75 }).collect();
    assert_eq!(q, expected);
}
