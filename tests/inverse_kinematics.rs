//! Inverse kinematics: reached targets, satisfied constraints, and covariance.

use nalgebra::{DMatrix, Matrix3, Rotation3, Vector3};
use phipsi::inverse_kinematics::{Goal, Options, Outcome, Task};
use phipsi::kinematics::ReferenceFrame;
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, Scene, SceneBuilder};
use phipsi::spatial::{RigidShift, Symmetric3};

fn uniform(state: &mut u64) -> f64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    f64::from(u32::try_from(*state >> 33).unwrap()) / f64::from(1_u32 << 31)
}

/// A typical arm with seven revolute joints with limits.
fn arm() -> Scene {
    let axes = [
        [0.0, 0.0, 1.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, -1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
    ];
    let levers = [
        [0.0, 0.0, 0.33],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 0.32],
        [0.08, 0.0, 0.0],
        [-0.08, 0.0, 0.38],
        [0.0, 0.0, 0.0],
        [0.09, 0.0, 0.1],
    ];
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "link0".into(), inertial: None });
    for k in 0..7 {
        let inertial = Inertial {
            mass: 1.0,
            center: Vector3::zeros(),
            central: Symmetric3::new([0.01, 0.0, 0.0, 0.01, 0.0, 0.01]),
        };
        builder = builder.link(LinkDescription { name: format!("link{}", k + 1), inertial: Some(inertial) });
        let mut joint = JointDescription::new(
            format!("joint{k}"),
            JointKind::Revolute,
            format!("link{k}"),
            format!("link{}", k + 1),
        );
        (joint.axis, joint.origin) =
            (axes[k].into(), RigidShift { rotation: Matrix3::identity(), lever: levers[k].into() });
        (joint.limits.lower, joint.limits.upper) = if k % 2 == 0 { (-2.8, 2.8) } else { (-1.7, 2.1) };
        builder = builder.joint(joint);
    }
    builder.build().expect("an arm")
}

/// An arm with the dimensions and limits of a panda, whose limits end most descents without a solution.
fn panda() -> Scene {
    let half = std::f64::consts::FRAC_PI_2;
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "link0".into(), inertial: None });
    let joints = [
        ([0.0, 0.0, 0.333], 0.0, (-2.8973, 2.8973)),
        ([0.0, 0.0, 0.0], -half, (-1.7628, 1.7628)),
        ([0.0, -0.316, 0.0], half, (-2.8973, 2.8973)),
        ([0.0825, 0.0, 0.0], half, (-3.0718, -0.0698)),
        ([-0.0825, 0.384, 0.0], -half, (-2.8973, 2.8973)),
        ([0.0, 0.0, 0.0], half, (-0.0175, 3.7525)),
        ([0.088, 0.0, 0.0], half, (-2.8973, 2.8973)),
    ];
    for (k, (lever, roll, limits)) in joints.into_iter().enumerate() {
        let (parent, child) = (format!("link{k}"), format!("link{}", k + 1));
        builder = builder.link(LinkDescription { name: child.clone(), inertial: None });
        let mut joint = JointDescription::new(format!("joint{k}"), JointKind::Revolute, parent, child);
        joint.axis = Vector3::z();
        joint.origin = RigidShift {
            rotation: *Rotation3::from_axis_angle(&Vector3::x_axis(), roll).matrix(),
            lever: lever.into(),
        };
        (joint.limits.lower, joint.limits.upper) = limits;
        builder = builder.joint(joint);
    }
    builder.build().expect("an arm")
}

fn within(scene: &Scene, state: &mut u64) -> Vec<f64> {
    scene
        .joints()
        .iter()
        .map(|joint| joint.limits.lower + uniform(state) * (joint.limits.upper - joint.limits.lower))
        .collect()
}

fn pose_of(scene: &Scene, q: &[f64]) -> Task {
    let frame = scene.frame(&"link7".into()).expect("a link");
    Task::new(Goal::Pose { frame, target: scene.placement(q, frame).expect("a place") })
}

#[test]
fn poses_within_the_limits_are_reached() {
    let scene = arm();
    let (mut state, mut failures, mut q) = (1, 0, vec![f64::NAN; 7]);
    let mut solver = scene.inverse_kinematics(&Options::default()).unwrap();
    for _ in 0..200 {
        let (there, start) = (within(&scene, &mut state), within(&scene, &mut state));
        let task = pose_of(&scene, &there);
        let outcome = solver.solve(&mut scene.workspace(), &[task], &start, None, &mut q).unwrap();
        assert!(scene.joints().iter().zip(&q).all(|(joint, &at)| at >= joint.limits.lower && at <= joint.limits.upper));
        if !outcome.reached {
            failures += 1;
            continue;
        }
        // The result is confirmed by forward kinematics of the scene.
        let Goal::Pose { frame, target } = task.goal else { unreachable!() };
        let found = scene.placement(&q, frame).unwrap();
        assert!((found.lever - target.lever).norm() <= 1e-9 && (found.rotation - target.rotation).abs().max() <= 2e-9);
    }
    assert!(failures <= 1, "{failures} of 200");
}

#[test]
fn ten_starts_reach_nearly_every_pose_of_a_panda() {
    let scene = panda();
    let (mut state, mut q, mut first, mut failures) = (3, vec![f64::NAN; 7], 0, 0);
    let mut solver = scene.inverse_kinematics(&Options::default().with_starts(10)).unwrap();
    for _ in 0..1000 {
        let task = pose_of(&scene, &within(&scene, &mut state));
        let start = within(&scene, &mut state);
        let outcome = solver.solve(&mut scene.workspace(), &[task], &start, None, &mut q).unwrap();
        failures += usize::from(!outcome.reached);
        first += usize::from(outcome.reached && outcome.starts == 1);
    }
    assert!(failures <= 6 && first >= 480, "{failures} of 1000 are not reached, {first} by the first start");
}

#[test]
fn a_joint_that_may_turn_more_than_a_turn_is_not_held_at_its_limits() {
    let turn = std::f64::consts::TAU;
    let mut builder = SceneBuilder::new();
    for k in 0..3 {
        builder = builder.link(LinkDescription { name: format!("link{k}"), inertial: None });
    }
    for k in 0..2 {
        let (parent, child) = (format!("link{k}"), format!("link{}", k + 1));
        let mut joint = JointDescription::new(format!("joint{k}"), JointKind::Revolute, parent, child);
        (joint.axis, joint.origin.lever) = (Vector3::z(), Vector3::new(1.0, 0.0, 0.0));
        (joint.limits.lower, joint.limits.upper) = (-turn, 6.25);
        builder = builder.joint(joint);
    }
    let scene = builder.build().expect("an arm");
    let frame = scene.frame(&"link2".into()).unwrap();
    let frame = phipsi::kinematics::Frame {
        placement: RigidShift { rotation: Matrix3::identity(), lever: Vector3::new(1.0, 0.0, 0.0) },
        ..frame
    };
    let solve = |goal: Goal, options: Options| {
        let mut q = [f64::NAN; 2];
        let options = options.with_starts(1);
        let mut solver = scene.inverse_kinematics(&options).unwrap();
        let outcome = solver.solve(&mut scene.workspace(), &[Task::new(goal)], &[6.2, 0.0], None, &mut q).unwrap();
        (outcome.reached, q)
    };
    // From just before the limit the shortest path exceeds it: the same orientation is within the limits one turn
    // back.
    let there = scene.placement(&[0.5, 0.7], frame).unwrap();
    let (reached, q) = solve(Goal::Pose { frame, target: there }, Options::default());
    assert!(reached && (q[0] - 0.5).abs() < 1e-8 && (q[1] - 0.7).abs() < 1e-8, "{q:?}");
    let (reached, q) = solve(Goal::Pose { frame, target: there }, Options::default().with_limits(false));
    assert!(reached && (q[0] - 0.5 - turn).abs() < 1e-8, "{q:?}");
    // Its position is a target, or a prior: full turns are distinguished.
    let (reached, q) = solve(Goal::Joint { joint: 0, target: 6.8 }, Options::default());
    assert!(!reached && (q[0] - 6.25).abs() < 1e-15, "{q:?}");
    let (_, q) = solve(Goal::Pose { frame, target: there }, Options::default().with_posture(1.0));
    assert!(q[0] > 3.0, "{q:?}");
}

#[test]
fn the_same_call_gives_the_same_bits() {
    let scene = arm();
    let mut state = 5;
    let task = pose_of(&scene, &within(&scene, &mut state));
    let run = || {
        let mut q = vec![f64::NAN; 7];
        let outcome = scene
            .inverse_kinematics(&Options::default())
            .unwrap()
            .solve(&mut scene.workspace(), &[task], &[0.0; 7], None, &mut q)
            .unwrap();
        (outcome, q)
    };
    let (one, other): ((Outcome, _), _) = (run(), run());
    assert_eq!(one, other);
}

#[test]
fn what_is_out_of_reach_is_said_and_brought_near() {
    let scene = arm();
    let frame = scene.frame(&"link7".into()).unwrap();
    let task = Task::new(Goal::Position { frame, target: Vector3::new(0.0, 0.0, 5.0) });
    let mut q = vec![f64::NAN; 7];
    let outcome = scene
        .inverse_kinematics(&Options::default())
        .unwrap()
        .solve(&mut scene.workspace(), &[task], &[0.3; 7], None, &mut q)
        .unwrap();
    // The search ends when the least minimum has been found often.
    assert!(!outcome.reached && (40..100).contains(&outcome.starts), "{}", outcome.starts);
    // Stretched upward as far as possible.
    let height = scene.placement(&q, frame).unwrap().lever[2];
    assert!((5.0 - height - outcome.position_error).abs() < 1e-3 && height > 1.1, "{height}");
}

#[test]
fn a_path_is_followed_in_place() {
    let scene = arm();
    let mut solver = scene.inverse_kinematics(&Options::default()).unwrap();
    let along = |share: f64| [0.1 + 1.5 * share, 0.4, -0.2, -0.8 - share, 0.3 + share, 1.0, 0.2];
    let mut workspace = scene.workspace();
    let mut q = along(0.0).to_vec();
    for at in 0..100 {
        let there = along(f64::from(at) / 100.0);
        let before = q.clone();
        let outcome = solver.follow(&mut workspace, &[pose_of(&scene, &there)], None, &mut q).unwrap();
        assert!(outcome.reached && outcome.starts == 1);
        assert!(q.iter().zip(&before).all(|(q, before)| (q - before).abs() < 0.1), "{q:?} {before:?}");
    }
    let last = q.clone();
    let frame = scene.frame(&"link7".into()).unwrap();
    // Out of reach: the minimum next to the solution before, here with the arm stretched upward.
    let far = Task::new(Goal::Position { frame, target: Vector3::new(0.0, 0.0, 5.0) });
    let outcome = solver.follow(&mut workspace, &[far], None, &mut q).unwrap();
    let mut alone = vec![f64::NAN; 7];
    let mut one = scene.inverse_kinematics(&Options::default().with_starts(1)).unwrap();
    one.solve(&mut workspace, &[far], &last, None, &mut alone).unwrap();
    assert!(!outcome.reached && outcome.starts > 1);
    assert!(q.iter().zip(&alone).all(|(q, alone)| q.to_bits() == alone.to_bits()), "{q:?} {alone:?}");
    let broken = Task::new(Goal::Position { frame, target: Vector3::new(0.0, f64::NAN, 5.0) });
    assert!(solver.follow(&mut workspace, &[broken], None, &mut q).is_err());
    assert!(q.iter().zip(&alone).all(|(q, alone)| q.to_bits() == alone.to_bits()));
    assert!(solver.follow(&mut workspace, &[far], None, &mut [0.0; 9]).is_err());
}

#[test]
fn a_posture_decides_where_the_task_does_not() {
    let scene = arm();
    let frame = scene.frame(&"link7".into()).unwrap();
    let posture = [0.1, 0.4, -0.2, -0.8, 0.3, 1.0, 0.2];
    let target = scene.placement(&posture, frame).unwrap().lever + Vector3::new(0.02, -0.03, 0.01);
    let task = Task::new(Goal::Position { frame, target }).with_position(1e-5);
    let options = Options::default().with_posture(0.5).with_tolerance(1e-6);
    let (mut q, mut covariance) = (vec![f64::NAN; 7], vec![f64::NAN; 49]);
    let mut solver = scene.inverse_kinematics(&options).unwrap();
    let outcome = solver.solve(&mut scene.workspace(), &[task], &posture, Some(&mut covariance), &mut q).unwrap();
    assert!(outcome.reached && outcome.starts == 1);
    // At the minimum of F, the gradient of the posture is in the row space of the task: its projection on the null
    // space is zero.
    let mut jacobian = vec![0.0; 42];
    scene.jacobian(&q, frame, ReferenceFrame::LocalWorldAligned, &mut jacobian).unwrap();
    let linear = DMatrix::from_row_slice(3, 7, &jacobian[21..]);
    let away = DMatrix::from_fn(7, 1, |i, _| q[i] - posture[i]);
    let told = linear.transpose() * (&linear * linear.transpose()).try_inverse().unwrap() * &linear;
    assert!((&away - &told * &away).norm() < 1e-6 * away.norm(), "{away}");
    // Its covariance is the inverse of J^T J / s^2 + 1 / p^2, by dense algebra.
    let expected = (linear.transpose() * &linear * 1e10 + DMatrix::identity(7, 7) * 4.0).try_inverse().unwrap();
    let found = DMatrix::from_row_slice(7, 7, &covariance);
    assert!((found - &expected).abs().max() < 1e-7 * expected.abs().max());
}

#[test]
fn without_a_posture_a_free_motion_has_infinite_variance() {
    let scene = arm();
    let frame = scene.frame(&"link7".into()).unwrap();
    let target = scene.placement(&[0.4; 7], frame).unwrap().lever;
    let mut covariance = vec![f64::NAN; 49];
    let mut solver = scene.inverse_kinematics(&Options::default()).unwrap();
    solver
        .solve(
            &mut scene.workspace(),
            &[Task::new(Goal::Position { frame, target })],
            &[0.3; 7],
            Some(&mut covariance),
            &mut [0.0; 7],
        )
        .unwrap();
    assert!(covariance.iter().all(|entry| *entry == f64::INFINITY));
}

#[test]
fn a_free_base_and_a_posture_meet_several_tasks() {
    let scene = arm().source().clone().floating_base(true).build().unwrap();
    let hand = scene.frame(&"link7".into()).unwrap();
    let tasks = [
        Task::new(Goal::CenterOfMass(Vector3::new(0.3, -0.2, 0.9))),
        Task::new(Goal::LookAt { frame: hand, axis: Vector3::z(), target: Vector3::new(1.0, 2.0, 0.5) }),
        Task::new(Goal::Joint { joint: 3, target: 0.4 }),
    ];
    let mut q = vec![f64::NAN; scene.nq()];
    let mut start = scene.neutral();
    start[7..].fill(0.2);
    let outcome = scene
        .inverse_kinematics(&Options::default())
        .unwrap()
        .solve(&mut scene.workspace(), &tasks, &start, None, &mut q)
        .unwrap();
    assert!(outcome.reached, "{outcome:?}");
    let com = scene.center_of_mass(&mut scene.workspace(), &q).unwrap();
    assert!((com - Vector3::new(0.3, -0.2, 0.9)).norm() < 1e-9);
    let place = scene.placement(&q, hand).unwrap();
    let way = (Vector3::new(1.0, 2.0, 0.5) - place.lever).normalize();
    assert!((place.rotation * Vector3::z() - way).norm() < 1e-9);
}

#[test]
fn bad_arguments_are_named() {
    let scene = arm();
    let frame = scene.frame(&"link7".into()).unwrap();
    let refused = |options: Options| scene.inverse_kinematics(&options).unwrap_err().to_string();
    assert!(refused(Options::default().with_starts(0)).contains("starts"));
    assert!(refused(Options::default().with_tolerance(0.0)).contains("tolerance"));
    assert!(refused(Options::default().with_posture(f64::NAN)).contains("posture"));
    let mut solver = scene.inverse_kinematics(&Options::default()).unwrap();
    let mut fails = |task: Task, start: &[f64]| {
        solver.solve(&mut scene.workspace(), &[task], start, None, &mut [0.0; 7]).unwrap_err().to_string()
    };
    let fine = Task::new(Goal::Position { frame, target: Vector3::zeros() });
    assert!(fails(fine.with_position(-1.0), &[0.0; 7]).contains("position deviation of task 0"));
    assert!(
        fails(Task::new(Goal::Position { frame, target: Vector3::new(f64::NAN, 0.0, 0.0) }), &[0.0; 7])
            .contains("target of task 0")
    );
    assert!(
        fails(Task::new(Goal::Orientation { frame, target: Matrix3::zeros() }), &[0.0; 7])
            .contains("a rotation matrix")
    );
    assert!(
        fails(Task::new(Goal::Direction { frame, axis: Vector3::zeros(), target: Vector3::z() }), &[0.0; 7])
            .contains("axis of task 0")
    );
    assert!(fails(Task::new(Goal::Joint { joint: 9, target: 0.0 }), &[0.0; 7]).contains("joint of task 0"));
    assert!(fails(fine, &[0.0; 6]).contains("q0"));
}
