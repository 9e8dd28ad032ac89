//! States in lanes of f32: the results of plain f64 up to the precision of f32; twice the number of lanes; and f64 if
//! the error estimate exceeds the tolerance.

#[cfg(feature = "lanes")]
use crate::common::Random;
use crate::common::lanes::{
    ALGORITHMS, State, aligned, arguments, arms, evaluate, forces, on_a_large_stack, plainly, states, trees,
};
use crate::common::tolerance::{self, Conditioning, assert_near, conditioning};
use phipsi::batch::Evaluator;
use phipsi::batch::InstructionSet;
use phipsi::filter::Form;
#[cfg(feature = "lanes")]
use phipsi::scalar::{Instructions, Lanes, Real};
use phipsi::scene::{JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::spatial::SpatialVector;
use phipsi::{Algorithm, Arguments, Derivatives, Products};
use phipsi::{Error, Scene};

#[allow(clippy::cast_possible_truncation)] // compared exactly
fn rounded(x: &[f64]) -> Vec<f32> {
    x.iter().map(|&x| x as f32).collect()
}

fn widened(x: &[f32]) -> Vec<f64> {
    x.iter().map(|&x| f64::from(x)).collect()
}

/// States in f32, and the same values in f64.
fn both(scene: &Scene, count: u64) -> (Vec<State<f32>>, Vec<State>) {
    let single: Vec<_> = states(scene, count).iter().map(|(q, qd, u)| (rounded(q), rounded(qd), rounded(u))).collect();
    let double = single.iter().map(|(q, qd, u)| (widened(q), widened(qd), widened(u))).collect();
    (single, double)
}

/// Condition number of M in one state.
fn condition(scene: &Scene, q: &[f64]) -> Conditioning {
    let mut m = vec![f64::NAN; scene.nv() * scene.nv()];
    scene.mass_matrix(&mut scene.workspace(), q, &mut m).unwrap();
    conditioning(scene.nv(), &m)
}

/// Largest difference of f32 from the plain results: rounding in the recursion, and of the scene.
fn allowed(scene: &Scene, algorithm: Algorithm, (q, qd, u): &State, plain: &[f64]) -> f64 {
    let size = tolerance::size(plain);
    tolerance::single(match algorithm {
        Algorithm::ForwardDynamics(_) => {
            let mut bias = vec![f64::NAN; scene.nv()];
            scene.bias_torque(&mut scene.workspace(), q, qd, &mut bias).unwrap();
            let forces = tolerance::size(&bias).max(tolerance::size(u));
            tolerance::solution(&condition(scene, q), size, forces)
        }
        Algorithm::MassMatrixInverse(_)
        | Algorithm::Derivatives(Derivatives::ForwardDynamics(_))
        | Algorithm::Products(
            Products::ForwardTangent(_)
            | Products::ForwardTangents(_)
            | Products::ForwardGradient(_)
            | Products::ForwardGradients(_),
        ) => tolerance::inverse(condition(scene, q).number, size),
        _ => tolerance::product(scene.nv(), size),
    })
}

#[test]
fn every_arm_gives_what_plain_numbers_give() {
    on_a_large_stack(|| {
        for scene in trees().chain([aligned(36, 11, 0.3)]) {
            // Not a multiple of any number of lanes.
            let (single, double) = both(&scene, 21);
            let forces = forces(&scene, single.len());
            for arm in arms() {
                let mut evaluator = Evaluator::<f32>::on(arm, &scene);
                assert_eq!(evaluator.instruction_set(), arm);
                for algorithm in ALGORITHMS {
                    let all: Vec<_> = single.iter().zip(&forces).map(|(s, w)| arguments(algorithm, s, w)).collect();
                    let found = evaluate(&scene, &mut evaluator, algorithm, &all);
                    for ((state, w), found) in double.iter().zip(&forces).zip(found.chunks(scene.width(algorithm))) {
                        let plain = plainly(&scene, algorithm, &arguments(algorithm, state, w));
                        let bound = allowed(&scene, algorithm, state, &plain);
                        assert_near(&format!("{arm:?} {algorithm:?}"), &widened(found), &plain, bound);
                    }
                }
            }
        }
    });
}

#[test]
fn twice_the_lanes_of_f64_where_it_is_compiled() {
    let scene = trees().next().unwrap();
    for arm in arms() {
        let (double, single) = (Evaluator::<f64>::on(arm, &scene).lanes(), Evaluator::<f32>::on(arm, &scene).lanes());
        let has_lanes = arm != InstructionSet::Baseline && cfg!(feature = "float32");
        assert_eq!(single, if has_lanes { 2 * double } else { 1 }, "{arm:?}");
    }
}

/// The bits of a state depend only on the state: alone, in any lane, with any other states, in an incomplete chunk.
#[test]
fn neighbours_change_no_bit() {
    on_a_large_stack(|| {
        for scene in trees().skip(2) {
            let (states, _) = both(&scene, 35);
            for arm in arms() {
                let mut evaluator = Evaluator::<f32>::on(arm, &scene);
                for algorithm in ALGORITHMS {
                    let all: Vec<_> = states.iter().map(|s| arguments(algorithm, s, &[])).collect();
                    let width = scene.width(algorithm);
                    let together = evaluate(&scene, &mut evaluator, algorithm, &all);
                    let mut backwards = all.clone();
                    backwards.reverse();
                    let reversed = evaluate(&scene, &mut evaluator, algorithm, &backwards);
                    for (i, (state, here)) in all.iter().zip(together.chunks(width)).enumerate() {
                        // A zero may differ in its sign, because lanes that are idle at a body add zeros there.
                        let bits = |x: &[f32]| x.iter().map(|x| (x + 0.0).to_bits()).collect::<Vec<_>>();
                        let there = all.len() - 1 - i;
                        let there = &reversed[there * width..(there + 1) * width];
                        assert_eq!(bits(here), bits(there), "{arm:?} {algorithm:?}: state {i}");
                        let alone = evaluate(&scene, &mut evaluator, algorithm, std::slice::from_ref(state));
                        assert_eq!(bits(here), bits(&alone), "{arm:?} {algorithm:?}: state {i} alone");
                    }
                }
            }
        }
    });
}

/// Algorithms without f32 kernels, and states with a loss of precision, have the results of f64, rounded once.
#[test]
fn states_in_doubt_are_done_in_f64() {
    on_a_large_stack(|| {
        let heavy = phipsi::scenes::extreme("heavy-tip", Some(1e9), None, 0).unwrap().scene;
        let forward = Algorithm::ForwardDynamics;
        let inverse = Algorithm::MassMatrixInverse;
        let ordinary = trees().nth(1).unwrap();
        for (scene, algorithm) in [
            (&heavy, forward(Form::Auto)),
            (&heavy, inverse(Form::Auto)),
            (&ordinary, forward(Form::SquareRoot)),
            (&ordinary, inverse(Form::SquareRoot)),
        ] {
            let (single, double) = both(scene, 5);
            let all: Vec<_> = single.iter().map(|s| arguments(algorithm, s, &[])).collect();
            for arm in arms() {
                let found = evaluate(scene, &mut Evaluator::<f32>::on(arm, scene), algorithm, &all);
                for (state, found) in double.iter().zip(found.chunks(scene.width(algorithm))) {
                    let plain = plainly(scene, algorithm, &arguments(algorithm, state, &[]));
                    assert_eq!(found, rounded(&plain), "{arm:?} {algorithm:?}");
                }
            }
        }
    });
}

#[test]
fn a_bad_state_is_named() {
    on_a_large_stack(|| {
        let scene = trees().nth(2).unwrap();
        let refused = |arm, algorithm, states: &[State<f32>], forces: &[Vec<SpatialVector<f64>>]| {
            let mut evaluator = Evaluator::<f32>::on(arm, &scene);
            let all: Vec<_> = states.iter().zip(forces).map(|(s, w)| arguments(algorithm, s, w)).collect();
            let mut out = vec![0.0; scene.width(algorithm) * all.len()];
            scene.evaluate(&mut evaluator, algorithm, &all, &mut out).unwrap_err()
        };
        let forces = forces(&scene, 21);
        for arm in arms() {
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                for (argument, name) in ["q", "qd", "tau"].into_iter().enumerate() {
                    let (mut states, _) = both(&scene, 21);
                    let state = &mut states[13];
                    [&mut state.0, &mut state.1, &mut state.2].into_iter().nth(argument).unwrap()[0] = bad;
                    let fault = refused(arm, Algorithm::ForwardDynamics(Form::Auto), &states, &forces);
                    assert_eq!(fault.state, 13);
                    assert!(
                        matches!(fault.error, Error::NotFinite { ref argument, .. } if argument == name),
                        "{fault:?}"
                    );
                }
            }
            let (mut states, _) = both(&scene, 3);
            for x in &mut states[1].0[3..7] {
                *x *= 1.01;
            }
            let fault = refused(arm, Algorithm::MassMatrix, &states, &forces);
            assert!(fault.state == 1 && fault.error.to_string().contains("quaternion"), "{fault:?}");
            let mut bad = forces.clone();
            bad[2][0][0] = f64::NAN;
            let fault = refused(arm, Algorithm::InverseDynamics, &both(&scene, 4).0, &bad);
            assert!(fault.state == 2 && fault.error.to_string().contains("wrench"), "{fault:?}");
        }
    });
}

/// Velocities of 1e20 give torques of about 1e40: finite in f64, but not in f32.
#[test]
fn results_that_f32_cannot_hold_are_refused() {
    on_a_large_stack(|| {
        let scene = trees().nth(1).unwrap();
        let (mut states, _) = both(&scene, 6);
        states[4].1.fill(1e20);
        let algorithm = Algorithm::BiasTorque;
        let all: Vec<_> = states.iter().map(|s| arguments(algorithm, s, &[])).collect();
        let mut out = vec![0.0; scene.nv() * all.len()];
        for arm in arms() {
            let mut evaluator = Evaluator::<f32>::on(arm, &scene);
            let fault = scene.evaluate(&mut evaluator, algorithm, &all, &mut out).unwrap_err();
            let message = Error::from(fault).to_string();
            assert!(message.contains("in state 4") && message.contains("float32 cannot hold"), "{message}");
        }
        // An armature beyond the range of f32, on the diagonal of M and nowhere else.
        let mut joint = JointDescription::new("j", JointKind::Spherical, "base", "tip");
        joint.armature = 1e39;
        let base = LinkDescription { name: "base".into(), inertial: None };
        let scene =
            SceneBuilder::new().link(base).link(LinkDescription { name: "tip".into(), inertial: None }).joint(joint);
        let geared = scene.build().unwrap();
        let one = [Arguments { q: &[0.0_f32, 0.0, 0.6, 0.8], qd: &[], u: &[], wrenches: &[], ..Arguments::default() }];
        for arm in arms() {
            let mut evaluator = Evaluator::<f32>::on(arm, &geared);
            let fault = geared.evaluate(&mut evaluator, Algorithm::MassMatrix, &one, &mut [0.0; 9]).unwrap_err();
            assert!(Error::from(fault).to_string().contains("float32 cannot hold"));
        }
        // Forces beyond the range of f32, and accelerations within it: f64 is used.
        let heavy = phipsi::scenes::extreme("heavy-tip", Some(1e9), None, 0).unwrap().scene;
        let (single, double) = both(&heavy, 1);
        let mut forces = vec![SpatialVector::zeros(); heavy.model().bodies.len()];
        forces[0][0] = 1e39;
        let algorithm = Algorithm::ForwardDynamics(Form::Covariance);
        let plain = plainly(&heavy, algorithm, &arguments(algorithm, &double[0], &forces));
        for arm in arms() {
            let one = [arguments(algorithm, &single[0], &forces)];
            let found = evaluate(&heavy, &mut Evaluator::<f32>::on(arm, &heavy), algorithm, &one);
            assert_eq!(found, rounded(&plain));
        }
    });
}

#[test]
fn wrong_lengths_are_refused() {
    let scene = trees().nth(1).unwrap();
    let mut evaluator = scene.evaluator_f32();
    let (states, _) = both(&scene, 2);
    let algorithm = Algorithm::InverseDynamics;
    let all: Vec<_> = states.iter().map(|s| arguments(algorithm, s, &[])).collect();
    let mut out = vec![0.0_f32; 2 * scene.nv()];
    let mut refused = |all: &[Arguments<'_, f32>], out: &mut [f32]| {
        let outcome = scene.evaluate(&mut evaluator, algorithm, all, out);
        outcome.is_err_and(|fault| matches!(fault.error, Error::Shape { .. }))
    };
    assert!(refused(&all, &mut out[1..]));
    for field in 0..3 {
        let mut short = all.clone();
        let state = &mut short[1];
        let numbers = [&mut state.q, &mut state.qd, &mut state.u].into_iter().nth(field).unwrap();
        *numbers = &numbers[1..];
        assert!(refused(&short, &mut out));
    }
}

/// Compared with f64, which is exact here: for 60,000 angles and near multiples of pi/2.
#[cfg(feature = "lanes")]
fn sine_and_cosine_of<S: Instructions>() {
    if S::token().is_none() {
        return;
    }
    let ulp = |x: f64| {
        #[allow(clippy::cast_possible_truncation)]
        let x = (x.abs() as f32).max(f32::MIN_POSITIVE);
        f64::from(f32::from_bits(x.to_bits() + 1)) - f64::from(x)
    };
    let mut random = Random::new(5);
    let mut angles: Vec<f64> = [1.0, 10.0, 1e2, 1e3, 1e4, 1e5, 1e-3, 1e-9, 1e-30, 1e7, 1e30, 3e38]
        .iter()
        .flat_map(|&size| (0..5_000).map(|_| random.uniform(-size, size)).collect::<Vec<_>>())
        .collect();
    angles.extend((0..60_000).map(|k| f64::from(k) * std::f64::consts::FRAC_PI_2));
    angles.extend([0.0, -0.0, 1e5, -1e5, 233.293_98, 42_913.41]);
    for chunk in rounded(&angles).chunks(Lanes::<S, f32>::LANES) {
        let mut angle = Lanes::<S, f32>::filled(0.0);
        angle.lanes_mut()[..chunk.len()].copy_from_slice(chunk);
        let (sines, cosines) = angle.sin_cos();
        for (i, &x) in chunk.iter().enumerate() {
            let (s, c) = f64::from(x).sin_cos();
            for (found, exact) in [(sines.lane(i), s), (cosines.lane(i), c)] {
                assert!((found - exact).abs() <= tolerance::SINGLE_ULPS * ulp(exact), "{x}: {found} beside {exact}");
            }
        }
    }
    let mut odd = Lanes::<S, f32>::filled(0.5);
    odd.lanes_mut()[..3].copy_from_slice(&[-0.0, f32::NAN, f32::INFINITY]);
    let (sine, cosine) = odd.sin_cos();
    assert_eq!((sine.lane(0).to_bits(), cosine.lane(0).to_bits()), ((-0.0_f64).to_bits(), 1.0_f64.to_bits()));
    for bad in [sine.lane(1), cosine.lane(1), sine.lane(2), cosine.lane(2)] {
        assert!(bad.is_nan());
    }
    let half = Lanes::<S, f32>::filled(0.5).sin_cos();
    assert_eq!((sine.lane(3), cosine.lane(3)), (half.0.lane(0), half.1.lane(0)), "a NaN changes no other lane");
}

#[cfg(feature = "lanes")]
#[test]
fn sine_and_cosine_are_good_to_a_unit_in_the_last_place() {
    #[cfg(target_arch = "x86_64")]
    {
        sine_and_cosine_of::<pulp::x86::V3>();
        sine_and_cosine_of::<pulp::x86::V4>();
    }
    #[cfg(target_arch = "aarch64")]
    sine_and_cosine_of::<pulp::aarch64::Neon>();
}
