//! States in lanes, with every instruction set of this processor: the results of one state at a time in plain
//! f64, bitwise equal in any lane, and the same errors.

use crate::common::lanes::{
    ALGORITHMS, aligned, arguments, arms, crowd, evaluate, forces, limbed, on_a_large_stack, plainly, states, trees,
};
use crate::common::{ALL_KINDS, Random, Tree, tolerance};
use nalgebra::{Matrix3, Rotation3, Vector3};
use phipsi::batch::Evaluator;
use phipsi::filter::Form;
use phipsi::kinematics::REFERENCE_FRAMES;
use phipsi::kinematics::{AccelerationKind, Frame};
use phipsi::scalar::{Fused, Real};
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder, StateModel};
use phipsi::spatial::{SpatialVector, Symmetric3};
use phipsi::{Algorithm, Arguments, KinematicQuantity, Products};
use phipsi::{Error, Scene};
use std::f64::consts::FRAC_PI_2;

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |size, x| x.abs().max(size))
}

/// Difference due to rounding; for M^-1 the condition number is that of the trees of these tests.
fn allowed(scene: &Scene, algorithm: Algorithm, plain: &[f64]) -> f64 {
    match algorithm {
        _ if algorithm.form().is_some() => tolerance::inverse(tolerance::CONDITION_OF_TREES, largest(plain)),
        _ => tolerance::product(scene.nv(), tolerance::TERMS_OF_TREES * largest(plain)),
    }
}

#[test]
fn every_arm_gives_what_plain_numbers_give() {
    on_a_large_stack(|| {
        for scene in trees() {
            let states = states(&scene, 21);
            let forces = forces(&scene, states.len());
            for arm in arms() {
                let mut evaluator = Evaluator::on(arm, &scene);
                assert_eq!(evaluator.instruction_set(), arm);
                for algorithm in ALGORITHMS {
                    let all: Vec<_> = states.iter().zip(&forces).map(|(s, w)| arguments(algorithm, s, w)).collect();
                    let width = scene.width(algorithm);
                    let found = evaluate(&scene, &mut evaluator, algorithm, &all);
                    for (state, found) in all.iter().zip(found.chunks_exact(width)) {
                        let plain = plainly(&scene, algorithm, state);
                        let bound = allowed(&scene, algorithm, &plain);
                        for (a, b) in found.iter().zip(&plain) {
                            assert!((a - b).abs() <= bound, "{arm:?} {algorithm:?}: {a} beside {b}, bound {bound:e}");
                        }
                    }
                }
            }
        }
    });
}

/// Products along changes of constants: every instruction set like plain scalars, each state bitwise equal to the
/// single state, and no value that is not finite is missed.
#[test]
fn directions_of_what_is_constant() {
    on_a_large_stack(|| {
        for scene in trees() {
            let (states, nv) = (states(&scene, 19), scene.nv());
            let forces = forces(&scene, states.len());
            for which in [
                Products::tangent(None).with_constants(),
                Products::tangent(Some(Form::Auto)).with_constants(),
                Products::tangent(Some(Form::Covariance)).with_constants(),
                Products::tangent(Some(Form::SquareRoot)).with_constants(),
            ] {
                let algorithm = Algorithm::Products(which);
                let mut random = Random::new(7);
                let width = scene.seed_width(algorithm, 2);
                assert_eq!(width, 2 * nv + 3 + 16 * scene.model().bodies.len());
                let thirds: Vec<Vec<f64>> =
                    states.iter().map(|_| (0..width).map(|_| random.uniform(-1.0, 1.0)).collect()).collect();
                let all: Vec<_> = (0..states.len())
                    .map(|i| {
                        let (q, qd, u) = &states[i];
                        Arguments { q, qd, u, wrenches: &forces[i], seed: [u, qd, &thirds[i]], ..Arguments::default() }
                    })
                    .collect();
                for arm in arms() {
                    let mut evaluator = Evaluator::on(arm, &scene);
                    let found = evaluate(&scene, &mut evaluator, algorithm, &all);
                    for (state, found) in all.iter().zip(found.chunks_exact(nv)) {
                        let plain = plainly(&scene, algorithm, state);
                        let bound = allowed(&scene, algorithm, &plain);
                        for (a, b) in found.iter().zip(&plain) {
                            assert!((a - b).abs() <= bound, "{arm:?} {which:?}: {a} beside {b}, bound {bound:e}");
                        }
                        assert_eq!(found, evaluate(&scene, &mut evaluator, algorithm, std::slice::from_ref(state)));
                    }
                    for bad in [0, nv, 2 * nv, 2 * nv + 3, width - 1] {
                        let mut third = thirds[0].clone();
                        third[bad] = f64::NAN;
                        let state = Arguments { seed: [all[0].seed[0], all[0].seed[1], &third], ..all[0] };
                        assert!(scene.evaluate(&mut evaluator, algorithm, &[state], &mut vec![0.0; nv]).is_err());
                    }
                }
            }
        }
    });
}

/// M^-1 uses one algorithm for shallow trees and another for deep ones; frames
/// that differ only by signs and angles have separate code, in every algorithm.
#[test]
fn deep_trees_and_aligned_ones() {
    on_a_large_stack(|| {
        let scenes = [
            aligned(31, 7, 0.0),
            aligned(32, 13, 0.4),
            aligned(33, 40, 0.0),
            aligned(34, 61, 0.03),
            aligned(35, 61, 0.3),
            Tree { seed: 36, bodies: 45, kinds: &ALL_KINDS, branching: 0.04, armature: 1.0, floating: true }.scene(),
            // Fewer joints than a register has lanes.
            aligned(40, 1, 0.0),
            aligned(41, 2, 0.0),
            aligned(42, 3, 0.5),
            // Deep trees.
            Tree { seed: 37, bodies: 80, kinds: &ALL_KINDS, branching: 0.02, armature: 1.0, floating: true }.scene(),
            aligned(38, 80, 0.02),
        ];
        let crowds = [crowd(60, 2, 3), crowd(61, 3, 2), crowd(62, 5, 5)];
        for (which, scene) in scenes.into_iter().chain(crowds).chain(branched()).chain([pendula()]).enumerate() {
            let scene = &scene;
            let states = states(scene, 9);
            let forces = forces(scene, states.len());
            for arm in arms() {
                let mut evaluator = Evaluator::on(arm, scene);
                for algorithm in ALGORITHMS {
                    let all: Vec<_> = states.iter().zip(&forces).map(|(s, w)| arguments(algorithm, s, w)).collect();
                    // Twice: no values of the first call may remain.
                    for all in [&all[..], &all[4..5], &all[..]] {
                        let found = evaluate(scene, &mut evaluator, algorithm, all);
                        for (state, found) in all.iter().zip(found.chunks_exact(scene.width(algorithm))) {
                            let plain = plainly(scene, algorithm, state);
                            let bound = allowed(scene, algorithm, &plain);
                            for (at, (a, b)) in found.iter().zip(&plain).enumerate() {
                                assert!(
                                    (a - b).abs() <= bound,
                                    "scene {which}, {arm:?} {algorithm:?}, entry {at}: {a} beside {b}, bound {bound:e}"
                                );
                            }
                        }
                    }
                }
            }
        }
    });
}

/// Trunks with limbs of equal structure, complete ones and ones that lack a body.
fn branched() -> impl Iterator<Item = Scene> {
    let kinds = [(50, 2, 6, true), (51, 4, 3, true), (52, 3, 5, false), (53, 6, 3, true), (54, 5, 2, false)];
    kinds.into_iter().flat_map(|(seed, limbs, length, floating)| {
        [false, true].map(|ragged| limbed(seed, limbs, length, floating, ragged))
    })
}

/// Two pendula on the base, whose joints all move in one plane: bodies of equal structure.
fn pendula() -> Scene {
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
    for name in ["left", "right"] {
        let central = Symmetric3::new([0.1, 0.0, 0.0, 0.1, 0.0, 0.1]);
        let inertial = Some(Inertial { mass: 1.0, center: Vector3::new(0.3, 0.1, 0.0), central });
        let mut joint = JointDescription::new(format!("to_{name}"), JointKind::Revolute, "base", name);
        joint.axis = Vector3::z();
        builder = builder.link(LinkDescription { name: name.into(), inertial }).joint(joint);
    }
    builder.gravity([0.0, -9.81, 0.0]).build().expect("pendula")
}

/// The bits of a state depend only on the state: alone, in any lane, with any other states, in an incomplete chunk.
#[test]
fn neighbours_change_no_bit() {
    on_a_large_stack(|| {
        check_neighbours(&trees().nth(2).unwrap(), 19);
        branched().for_each(|scene| check_neighbours(&scene, 9));
        check_neighbours(&pendula(), 9);
        // Deeper than the trees, but not deep enough for the other algorithm of M^-1.
        check_neighbours(&phipsi::scenes::chain(40).unwrap(), 9);
        // Too deep for M^-1 as a product: the recursion computes it.
        check_neighbours(&phipsi::scenes::chain(310).unwrap(), 2);
    });
}

fn check_neighbours(scene: &Scene, count: u64) {
    let mut states = states(scene, count);
    // Some at rest, for which terms of moving states would be skipped.
    for state in states.iter_mut().step_by(3) {
        state.1.fill(0.0);
    }
    let given = forces(scene, states.len());
    for arm in arms() {
        let mut evaluator = Evaluator::on(arm, scene);
        for (algorithm, forced) in ALGORITHMS.into_iter().flat_map(|one| [(one, false), (one, true)]) {
            let forces_on = |i: usize| if forced { &given[i][..] } else { &[] };
            let all: Vec<_> = states.iter().enumerate().map(|(i, s)| arguments(algorithm, s, forces_on(i))).collect();
            let width = scene.width(algorithm);
            let together = evaluate(scene, &mut evaluator, algorithm, &all);
            let mut backwards = all.clone();
            backwards.reverse();
            let reversed = evaluate(scene, &mut evaluator, algorithm, &backwards);
            let last = all.len() - 1;
            for (i, state) in all.iter().enumerate() {
                // A zero may differ in its sign, because lanes that are idle at a body add zeros there.
                let bits = |x: &[f64]| x.iter().map(|x| (x + 0.0).to_bits()).collect::<Vec<_>>();
                let here = bits(&together[i * width..(i + 1) * width]);
                assert_eq!(here, bits(&reversed[(last - i) * width..(last - i + 1) * width]), "{arm:?} {algorithm:?}");
                let alone = evaluate(scene, &mut evaluator, algorithm, std::slice::from_ref(state));
                assert_eq!(here, bits(&alone), "{arm:?} {algorithm:?}: state {i} alone");
            }
        }
    }
}

/// Any value that is not finite flags its state only.
#[test]
fn one_bad_number_is_seen_wherever_it_is() {
    on_a_large_stack(|| {
        for scene in [trees().nth(2).unwrap(), branched().next().unwrap(), phipsi::scenes::chain(37).unwrap()] {
            for arm in arms() {
                let mut evaluator = Evaluator::on(arm, &scene);
                for algorithm in [Algorithm::ForwardDynamics(Form::Covariance), Algorithm::InverseDynamics] {
                    let mut out = vec![0.0; scene.nv()];
                    let (good, force) = (states(&scene, 1).remove(0), []);
                    assert_eq!(evaluator.run(algorithm, &[arguments(algorithm, &good, &force)], &mut out) & 1, 0);
                    for argument in 0..3 {
                        for at in 0..[scene.nq(), scene.nv(), scene.nv()][argument] {
                            for bad in [f64::NAN, f64::INFINITY] {
                                let mut state = good.clone();
                                [&mut state.0, &mut state.1, &mut state.2][argument][at] = bad;
                                let doubt = evaluator.run(algorithm, &[arguments(algorithm, &state, &force)], &mut out);
                                assert_eq!(doubt & 1, 1, "{arm:?} {algorithm:?}: {bad} at {at} of {argument}");
                            }
                        }
                    }
                }
            }
        }
    });
}

/// An error of one state is reported for that state, and the others are computed.
#[test]
fn a_bad_state_is_named() {
    on_a_large_stack(|| {
        let scene = trees().nth(2).unwrap();
        for arm in arms() {
            let mut evaluator = Evaluator::on(arm, &scene);
            for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                for (argument, name) in ["q", "qd", "tau"].into_iter().enumerate() {
                    let mut states = states(&scene, 11);
                    let state = &mut states[6];
                    let numbers = [&mut state.0, &mut state.1, &mut state.2];
                    numbers.into_iter().nth(argument).unwrap()[0] = bad;
                    let algorithm = Algorithm::ForwardDynamics(Form::Auto);
                    let all: Vec<_> = states.iter().map(|s| arguments(algorithm, s, &[])).collect();
                    let mut out = vec![0.0; scene.nv() * all.len()];
                    let fault = scene.evaluate(&mut evaluator, algorithm, &all, &mut out).unwrap_err();
                    assert_eq!(fault.state, 6);
                    assert!(
                        matches!(fault.error, Error::NotFinite { ref argument, .. } if argument == name),
                        "{fault:?}"
                    );
                }
            }
            let mut states = states(&scene, 3);
            for x in &mut states[1].0[3..7] {
                *x *= 1.01;
            }
            let all: Vec<_> = states.iter().map(|s| arguments(Algorithm::MassMatrix, s, &[])).collect();
            let mut out = vec![0.0; scene.width(Algorithm::MassMatrix) * all.len()];
            let fault = scene.evaluate(&mut evaluator, Algorithm::MassMatrix, &all, &mut out).unwrap_err();
            assert!(fault.state == 1 && fault.error.to_string().contains("quaternion"), "{fault:?}");
        }
    });
}

/// Two links on prismatic joints in series, the second with mass.
fn slides(mass: f64, kind: JointKind, lever: f64) -> Scene {
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
    for (name, parent, kind) in [("first", "base", kind), ("second", "first", JointKind::Prismatic)] {
        let inertial = Some(Inertial {
            mass,
            center: Vector3::zeros(),
            central: Symmetric3::new([mass, 0.0, 0.0, mass, 0.0, mass]),
        });
        let mut joint = JointDescription::new(format!("to_{name}"), kind, parent, name);
        joint.axis = Vector3::z();
        joint.origin.lever = Vector3::x() * lever;
        builder = builder.link(LinkDescription { name: name.into(), inertial }).joint(joint);
    }
    builder.build().expect("slides")
}

/// Entries of matrices that overflow from finite values: for one state and in lanes.
#[test]
fn a_matrix_that_overflows_is_refused() {
    on_a_large_stack(|| {
        let cases = [
            (slides(1e200, JointKind::Revolute, 1e60), Algorithm::MassMatrix),
            (slides(1e-310, JointKind::Prismatic, 0.1), Algorithm::MassMatrixInverse(Form::Covariance)),
        ];
        for (scene, algorithm) in cases {
            for (arm, count) in arms().flat_map(|arm| [(arm, 1), (arm, 9)]) {
                let states = states(&scene, count);
                let all: Vec<_> = states.iter().map(|state| arguments(algorithm, state, &[])).collect();
                let mut out = vec![f64::NAN; scene.width(algorithm) * all.len()];
                let found = scene.evaluate(&mut Evaluator::on(arm, &scene), algorithm, &all, &mut out);
                assert!(found.is_err(), "{arm:?} {algorithm:?}: {out:?}");
            }
        }
    });
}

#[test]
fn wrong_lengths_are_refused() {
    on_a_large_stack(|| {
        let scene = trees().nth(1).unwrap();
        let mut evaluator = scene.evaluator();
        let states = states(&scene, 2);
        let algorithm = Algorithm::InverseDynamics;
        let all: Vec<_> = states.iter().map(|s| arguments(algorithm, s, &[])).collect();
        let mut out = vec![0.0; 2 * scene.nv()];
        let mut refused = |all: &[Arguments<'_>], out: &mut [f64]| {
            scene
                .evaluate(&mut evaluator, algorithm, all, out)
                .is_err_and(|fault| matches!(fault.error, Error::Shape { .. }))
        };
        assert!(!refused(&all, &mut out));
        assert!(refused(&all, &mut out[1..]));
        for field in 0..3 {
            let mut short = all.clone();
            let state = &mut short[1];
            let numbers = [&mut state.q, &mut state.qd, &mut state.u].into_iter().nth(field).unwrap();
            *numbers = &numbers[1..];
            assert!(refused(&short, &mut out));
        }
        let wrench = [SpatialVector::zeros()];
        let mut wrong = all.clone();
        wrong[0].wrenches = &wrench;
        assert!(refused(&wrong, &mut out));
    });
}

/// States with a loss of precision in covariance form are recomputed, and only those.
#[test]
fn auto_is_as_exact_in_lanes_as_alone() {
    on_a_large_stack(|| {
        let case = phipsi::scenes::extreme("heavy-tip", Some(1e9), None, 0).unwrap();
        let scene = &case.scene;
        let algorithm = Algorithm::ForwardDynamics(Form::Auto);
        let states = states(scene, 16);
        let all: Vec<_> = states.iter().map(|s| arguments(algorithm, s, &[])).collect();
        for arm in arms() {
            let found = evaluate(scene, &mut Evaluator::on(arm, scene), algorithm, &all);
            for (state, found) in all.iter().zip(found.chunks_exact(scene.nv())) {
                let plain = plainly(scene, Algorithm::ForwardDynamics(Form::SquareRoot), state);
                let size = largest(&plain);
                for (a, b) in found.iter().zip(&plain) {
                    assert!((a - b).abs() <= 2.0 * tolerance::ALL_DIGITS * size, "{arm:?}: {a} beside {b}");
                }
            }
        }
    });
}

/// Rods, which have no inertia about their own axes, all except one along a coordinate axis: the square roots of
/// their inertias differ in permuted frames.
fn rods() -> Scene {
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "link0".into(), inertial: None });
    for k in 1..5 {
        let axes = *Rotation3::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2 + 4e-6).matrix();
        let central = axes * Matrix3::from_diagonal(&Vector3::new(0.0, 0.2, 0.2)) * axes.transpose();
        let central = Symmetric3::from_upper(&central);
        let inertial = Some(Inertial { mass: 1.0, center: axes * Vector3::new(0.4, 0.0, 0.0), central });
        let kind = JointKind::Revolute;
        let mut joint = JointDescription::new(format!("joint{k}"), kind, format!("link{}", k - 1), format!("link{k}"));
        joint.axis = if k % 2 == 0 { Vector3::y() } else { Vector3::x() };
        joint.origin.lever = [0.3, 0.2, 0.5].into();
        builder = builder.link(LinkDescription { name: format!("link{k}"), inertial }).joint(joint);
    }
    builder.build().expect("rods")
}

/// Results of the square-root kernels that are not flagged have full precision, for heavy tips, limbs and rods; and
/// few are flagged.
#[test]
#[cfg_attr(not(feature = "lanes"), ignore = "without the feature lanes the square-root form has no kernels")]
fn the_square_root_form_keeps_all_digits_in_lanes() {
    on_a_large_stack(|| {
        let heavy = |weight| phipsi::scenes::extreme("heavy-tip", Some(weight), None, 0).unwrap().scene;
        let scenes =
            [heavy(1e3), heavy(1e9), rods(), aligned(37, 20, 0.3)].into_iter().chain(branched()).chain(trees());
        let algorithm = Algorithm::ForwardDynamics(Form::SquareRoot);
        for (which, scene) in scenes.enumerate() {
            let states = states(&scene, 16);
            let all: Vec<_> = states.iter().map(|s| arguments(algorithm, s, &[])).collect();
            let exact: Vec<_> = all.iter().map(|state| plainly(&scene, algorithm, state)).collect();
            for arm in arms() {
                let mut evaluator = Evaluator::on(arm, &scene);
                // One at a time, and one per lane.
                for count in [1, evaluator.lanes()] {
                    let mut kept = 0;
                    for (given, exact) in all.chunks(count).zip(exact.chunks(count)) {
                        let mut out = vec![f64::NAN; scene.nv() * given.len()];
                        let doubt = evaluator.run(algorithm, given, &mut out);
                        for (lane, (found, exact)) in out.chunks_exact(scene.nv()).zip(exact).enumerate() {
                            if doubt >> lane & 1 == 1 {
                                continue;
                            }
                            kept += 1;
                            let bound = 2.0 * tolerance::ALL_DIGITS * largest(exact);
                            for (a, b) in found.iter().zip(exact) {
                                assert!((a - b).abs() <= bound, "scene {which}, {arm:?}, {count}: {a} beside {b}");
                            }
                        }
                    }
                    // For the heaviest tip, and for rods whose rotation needs a force outside the range of their
                    // square root, all may be flagged.
                    assert!(
                        kept * 2 >= all.len() || which == 1 || which == 2,
                        "scene {which}, {arm:?}, {count} at once: {kept}"
                    );
                }
            }
        }
    });
}

/// Sine and cosine of the fused scalar compared with double-double arithmetic: about one unit in the last place.
#[test]
fn sine_and_cosine_are_good_to_two_units_in_the_last_place() {
    let mut random = Random::new(5);
    let ulp = |x: f64| (f64::from_bits(x.abs().to_bits() + 1) - x.abs()).max(f64::MIN_POSITIVE);
    let mut angles: Vec<f64> = [1.0, 10.0, 1e3, 1e6, 1e-3, 1e-9, 1e-300, 1e12, 1e300]
        .iter()
        .flat_map(|&size| (0..5_000).map(|_| random.uniform(-size, size)).collect::<Vec<_>>())
        .collect();
    angles.extend((0..4_000).map(|k| f64::from(k) * std::f64::consts::FRAC_PI_2));
    angles.extend([0.0, -0.0, f64::MIN_POSITIVE, 1e6, -1e6]);
    for angle in angles {
        let (s, c) = Fused(angle).sin_cos();
        let (exact_s, exact_c) = angle.sin_cos();
        assert!((s.0 - exact_s).abs() <= 2.0 * ulp(exact_s), "sin {angle}: {} beside {exact_s}", s.0);
        assert!((c.0 - exact_c).abs() <= 2.0 * ulp(exact_c), "cos {angle}: {} beside {exact_c}", c.0);
    }
    let (s, c) = Fused(-0.0).sin_cos();
    assert!(s.0 == 0.0 && s.0.is_sign_negative() && c == Fused(1.0));
    for bad in [f64::NAN, f64::INFINITY] {
        let (s, c) = Fused(bad).sin_cos();
        assert!(s.0.is_nan() && c.0.is_nan());
    }
}

/// Kinematic and centroidal quantities for frames on every second link and for the whole robot.
fn kinematic_quantities(frames: &[Frame<f64>]) -> Vec<KinematicQuantity<'_>> {
    let mut all = vec![
        KinematicQuantity::CenterOfMass,
        KinematicQuantity::CenterOfMassVelocity,
        KinematicQuantity::CenterOfMassAcceleration,
        KinematicQuantity::CenterOfMassJacobian,
        KinematicQuantity::CentroidalMomentumMatrix,
        KinematicQuantity::CentroidalMomentumMatrixRate,
        KinematicQuantity::Momentum,
        KinematicQuantity::KineticEnergy,
        KinematicQuantity::PotentialEnergy,
        KinematicQuantity::Energy,
    ];
    for frame in frames {
        all.push(KinematicQuantity::Placement(frame));
        for &(_, reference) in REFERENCE_FRAMES {
            all.extend([
                KinematicQuantity::Velocity(frame, reference),
                KinematicQuantity::Acceleration(frame, reference, AccelerationKind::Spatial),
                KinematicQuantity::Acceleration(frame, reference, AccelerationKind::Classical),
                KinematicQuantity::Jacobian(frame, reference),
                KinematicQuantity::JacobianRate(frame, reference),
                KinematicQuantity::JacobianRateProduct(frame, reference),
            ]);
        }
    }
    all
}

#[test]
fn kinematic_quantities_in_lanes_are_those_of_one_state() {
    on_a_large_stack(|| {
        for scene in trees().chain([aligned(36, 11, 0.3)]) {
            // Not a multiple of any number of lanes.
            let states = states(&scene, 13);
            let every_second = scene.links().iter().step_by(2);
            let frames: Vec<_> =
                every_second.map(|link| Frame { body: link.body, placement: link.placement }).collect();
            for what in kinematic_quantities(&frames) {
                let given: Vec<_> = states
                    .iter()
                    .map(|(q, qd, u)| {
                        let qd = if what.reads() > 1 { &qd[..] } else { &[] };
                        let u = if what.reads() > 2 { &u[..] } else { &[] };
                        Arguments { q, qd, u, ..Arguments::default() }
                    })
                    .collect();
                let width = what.width(scene.nv());
                let mut workspace = scene.workspace();
                let mut one = vec![f64::NAN; width * states.len()];
                for (state, out) in given.iter().zip(one.chunks_exact_mut(width)) {
                    scene.kinematic_quantity(&mut workspace, &what, [state.q, state.qd, state.u], out).unwrap();
                }
                for arm in arms() {
                    let mut evaluator = Evaluator::on(arm, &scene);
                    let mut found = vec![f64::NAN; one.len()];
                    scene.evaluate_kinematic_quantity(&mut evaluator, &what, &given, &mut found).unwrap();
                    // For a zero derivative the rounding error of terms of about one remains.
                    let scale = tolerance::size(&one).max(1.0);
                    tolerance::assert_near(
                        &format!("{arm:?}, {what:?}"),
                        &found,
                        &one,
                        tolerance::product(4 * scene.nv(), scale),
                    );
                }
            }
        }
    });
}

/// Models of all states, and models of every third state between states of the scene, which no lanes take together.
#[test]
fn kinematic_quantities_of_models_in_lanes_are_those_of_their_scenes() {
    on_a_large_stack(|| {
        for scene in trees() {
            let (states, mut random) = (states(&scene, 13), Random::new(3));
            let scaled = |of: &[f64]| {
                let factor = random.uniform(0.5, 2.0);
                of.iter().map(|number| factor * number).collect::<Vec<_>>()
            };
            let whole = scene.inertial_parameters();
            let models: Vec<f64> = states.iter().flat_map(|_| whole.clone()).collect();
            let models: Vec<f64> = models.chunks_exact(10).flat_map(scaled).collect();
            let models: Vec<&[f64]> = models.chunks_exact(whole.len()).collect();
            let alone: Vec<_> = models.iter().map(|own| scene.with_inertial_parameters(own).unwrap()).collect();
            for (what, every) in kinematic_quantities(&[]).iter().flat_map(|what| [(what, 1), (what, 3)]) {
                let width = what.width(scene.nv());
                let (mut given, mut expected) = (Vec::new(), vec![f64::NAN; width * states.len()]);
                for (i, ((q, qd, u), out)) in states.iter().zip(expected.chunks_exact_mut(width)).enumerate() {
                    let qd = if what.reads() > 1 { &qd[..] } else { &[] };
                    let u = if what.reads() > 2 { &u[..] } else { &[] };
                    let (inertias, of) = if i % every == 0 { (models[i], &alone[i]) } else { (&[][..], &scene) };
                    of.kinematic_quantity(&mut of.workspace(), what, [q, qd, u], out).unwrap();
                    let model = StateModel { inertias, armature: &[] };
                    given.push(Arguments { q, qd, u, model, ..Arguments::default() });
                }
                for arm in arms() {
                    let mut found = vec![f64::NAN; expected.len()];
                    let mut evaluator = Evaluator::on(arm, &scene);
                    scene.evaluate_kinematic_quantity(&mut evaluator, what, &given, &mut found).unwrap();
                    let bound = tolerance::product(4 * scene.nv(), tolerance::size(&expected).max(1.0));
                    tolerance::assert_near(&format!("{arm:?}, {what:?}, {every}"), &found, &expected, bound);
                }
            }
        }
    });
}

#[test]
fn a_kinematic_quantity_of_a_bad_state_is_refused_by_its_method() {
    on_a_large_stack(|| {
        let scene = trees().nth(2).unwrap();
        let mut states = states(&scene, 9);
        states[5].1[0] = f64::INFINITY;
        let given: Vec<_> = states.iter().map(|(q, qd, _)| Arguments { q, qd, ..Arguments::default() }).collect();
        for arm in arms() {
            let mut out = vec![f64::NAN; 9];
            let mut evaluator = Evaluator::on(arm, &scene);
            let fault = scene
                .evaluate_kinematic_quantity(&mut evaluator, &KinematicQuantity::KineticEnergy, &given, &mut out)
                .unwrap_err();
            assert!(fault.state == 5 && fault.error.to_string().starts_with("qd: found inf"), "{arm:?}: {fault:?}");
        }
    });
}
