//! Faults and refused arguments of simulations, and simulators compared with rollouts.

use super::momentum::floating;
use super::{State, on_a_large_stack, settings};
use crate::common::{ALL_KINDS, Random, Tree, random_state};
use phipsi::batch::{Broadcast, INSTRUCTION_SETS, InstructionSet};
use phipsi::filter::Form;
use phipsi::motion::{METHODS, Method, Records, Rollout, Settings, Simulator, StepFault, Torque};
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::spatial::Symmetric3;
use phipsi::{Error, Scene};

#[test]
fn a_lost_pivot_is_told_with_step_state_and_joint() {
    // The inertia at the elbow is zero: a point mass on its axis.
    let point = Inertial { mass: 1.0, center: [0.0; 3].into(), central: Symmetric3::zero() };
    let arm = Inertial {
        mass: 1.0,
        center: [0.5, 0.0, 0.0].into(),
        central: Symmetric3::new([0.1, 0.0, 0.0, 0.1, 0.0, 0.1]),
    };
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
    for (name, inertial) in [("upper", arm), ("lower", point)] {
        builder = builder.link(LinkDescription { name: name.into(), inertial: Some(inertial) });
    }
    let scene = builder
        .joint(JointDescription::new("shoulder", JointKind::Revolute, "base", "upper"))
        .joint(JointDescription::new("elbow", JointKind::Revolute, "upper", "lower"))
        .build()
        .unwrap();
    for &(name, method) in METHODS {
        let mut settings = Settings::new(&scene, 1e-3).with_method(method);
        let fault = Rollout::new(&scene, settings.clone(), &[0.0; 6], &[0.0; 6])
            .unwrap()
            .advance(5, &Torque::Zero, None)
            .expect_err("no inertia");
        assert_eq!((fault.step, fault.state, fault.joint.as_str()), (0, 0, "elbow"));
        assert!(matches!(fault.error, Error::SingularJoint { .. }));
        // Armature is a remedy, and so is damping if it is implicit.
        settings.properties.damping[1] = 0.1;
        let outcome =
            Rollout::new(&scene, settings.clone(), &[0.0; 2], &[0.0; 2]).unwrap().advance(5, &Torque::Zero, None);
        assert_eq!(outcome.is_ok(), method.is_implicit(), "{name}: {outcome:?}");
        settings.properties.armature[1] = 0.1;
        let outcome = Rollout::new(&scene, settings, &[0.0; 2], &[0.0; 2]).unwrap().advance(5, &Torque::Zero, None);
        assert!(outcome.is_ok());
    }
}

#[test]
fn the_earliest_step_and_the_lowest_state_are_told_and_rows_before_are_kept() {
    let scene = phipsi::scenes::chain(2).unwrap();
    let mut settings = Settings::new(&scene, 1e-2).with_method(Method::SemiImplicitEuler);
    settings.properties.stiffness = vec![1e5; 2];
    let mut q = vec![0.0; 40];
    // The further from rest the earlier.
    (q[2 * 3], q[2 * 17]) = (1e-2, 1.0);
    let mut rollout = Rollout::new(&scene, settings, &q, &[0.0; 40]).unwrap();
    let (mut out_q, mut out_v) = (vec![f64::NAN; 20 * 101 * 2], vec![f64::NAN; 20 * 101 * 2]);
    let mut records = Records::new(&mut out_q, &mut out_v);
    let StepFault { step, state, joint, error, .. } =
        rollout.advance(100, &Torque::Zero, Some(&mut records)).expect_err("an explicit step of a stiff spring");
    assert_eq!(state, 17);
    assert!(joint.starts_with('j') && error.to_string().contains(&joint), "{error}");
    assert!(step > 2 && rollout.steps() == step);
    for state in 0..20 {
        assert!(out_q[state * 202..][..2 * (step + 1)].iter().all(|x| x.is_finite()));
    }
}

#[test]
fn what_cannot_be_used_is_refused_by_name() {
    let scene = phipsi::scenes::chain(2).unwrap();
    let good = Settings::new(&scene, 1e-3);
    let refused = |change: &dyn Fn(&mut Settings), words: &[&str]| {
        let mut settings = good.clone();
        change(&mut settings);
        let error = Rollout::new(&scene, settings, &[0.0; 2], &[0.0; 2]).expect_err("refused").to_string();
        for word in words {
            assert!(error.contains(word), "{error}");
        }
    };
    for dt in [0.0, -1e-3, f64::NAN, f64::INFINITY] {
        refused(&|s| s.dt = dt, &["dt", &format!("{dt}"), "positive"]);
    }
    refused(&|s| s.form = Form::SquareRoot, &["form", "square-root"]);
    refused(&|s| s.properties.damping = vec![0.0; 3], &["damping", "(3,)", "(2,)"]);
    refused(&|s| s.properties.stiffness[1] = -1.0, &["stiffness", "-1", "j1"]);
    refused(&|s| s.properties.friction[0] = f64::NAN, &["friction", "NaN"]);
    refused(&|s| s.properties.friction_speed = -1e-3, &["friction_speed"]);
    refused(&|s| s.properties.rest = vec![0.0; 1], &["rest"]);
    let bad = Rollout::new(&scene, good.clone(), &[0.0, f64::NAN], &[0.0; 2]).expect_err("refused");
    assert!(bad.to_string().contains("q: found NaN"), "{bad}");
    let mut rollout = Rollout::new(&scene, good, &[0.0; 2], &[0.0; 2]).unwrap();
    let torque = Torque::constant(&[0.0; 3]);
    assert!(matches!(rollout.advance(1, &torque, None).expect_err("refused").error, Error::Shape { .. }));
    let (mut q, mut qd) = (vec![0.0; 4], vec![0.0; 4]);
    let mut records = Records::new(&mut q, &mut qd);
    assert!(matches!(
        rollout.advance(2, &Torque::Zero, Some(&mut records)).expect_err("refused").error,
        Error::Shape { .. }
    ));
    assert!(Method::named("euler").expect_err("refused").to_string().contains("\"rk4\""));
    let _ = InstructionSet::of_process();
}

/// Eleven states in sequence, and a torque for each.
fn eleven(scene: &Scene, seed: u64) -> State {
    let mut random = Random::new(seed);
    let states: Vec<_> = (0..11).map(|_| random_state(scene, &mut random)).collect();
    let all = |of: fn(&State) -> &[f64]| states.iter().flat_map(|state| of(state).to_vec()).collect();
    (all(|state| &state.0), all(|state| &state.1), all(|state| &state.2))
}

/// The bits of a state.
fn bits((q, v): (&[f64], &[f64])) -> Vec<u64> {
    q.iter().chain(v).map(|x| x.to_bits()).collect()
}

#[test]
fn a_simulator_has_the_bits_of_a_rollout_step_by_step() {
    on_a_large_stack(|| {
        let scene =
            Tree { seed: 3, bodies: 4, kinds: &ALL_KINDS, branching: 0.4, armature: 0.2, floating: true }.scene();
        let (q, v, u) = eleven(&scene, 3);
        let (nq, nv) = (scene.nq(), scene.nv());
        let mut settings = settings(&scene, &q[..nq], &mut Random::new(4));
        settings.dt = 1e-3;
        let each = Torque::Constant(Broadcast::new("tau", &u, nv, &[11], &[11]).unwrap());
        let one = Torque::constant(&u[..nv]);
        for form in [Form::Auto, Form::Covariance] {
            for &(name, method) in METHODS {
                (settings.method, settings.form) = (method, form);
                for arm in INSTRUCTION_SETS.iter().map(|&(_, arm)| arm).filter(|arm| arm.available()) {
                    settings.arm = arm;
                    let mut rollout = Rollout::new(&scene, settings.clone(), &q, &v).unwrap();
                    rollout.advance(3, &each, None).unwrap();
                    let mut together = Simulator::new(&scene, settings.clone(), &q, &v).unwrap();
                    let mut alone = Simulator::new(&scene, settings.clone(), &q[..nq], &v[..nv]).unwrap();
                    for steps in [1, 0, 2] {
                        together.step(&each, steps).unwrap();
                        alone.step(&one, steps).unwrap();
                    }
                    for i in 0..11 {
                        assert_eq!(bits(together.state(i)), bits(rollout.state(i)), "{name}, state {i}");
                        assert_eq!((together.time(i), together.steps()), (3.0 * 1e-3, 3));
                    }
                    assert_eq!(bits(alone.state(0)), bits(rollout.state(0)), "{name}, alone");
                    assert_eq!(together.settings(), settings);
                }
            }
        }
    });
}

#[test]
fn a_state_that_is_reset_goes_on_as_in_a_simulator_of_its_own() {
    on_a_large_stack(|| {
        let (scene, mut settings, (_, _, u)) = floating(&ALL_KINDS, [0.3, -0.5, -9.6]);
        settings.dt = 1e-3;
        let (q, v, _) = eleven(&scene, 9);
        let (nq, nv) = (scene.nq(), scene.nv());
        let (own_q, own_v) = (|i: usize| &q[i * nq..(i + 1) * nq], |i: usize| &v[i * nv..(i + 1) * nv]);
        let torque = Torque::constant(&u);
        let mut simulator = Simulator::new(&scene, settings.clone(), &q, &v).unwrap();
        simulator.step(&torque, 3).unwrap();
        // States 2 and 7 where 0 and 1 began.
        let (from_q, from_v) = (
            Broadcast::new("q", &q[..2 * nq], nq, &[2], &[2]).unwrap(),
            Broadcast::new("qd", &v[..2 * nv], nv, &[2], &[2]).unwrap(),
        );
        simulator.reset(&[2, 7], &from_q, &from_v).unwrap();
        assert_eq!((simulator.time(2), simulator.time(3)), (0.0, 3.0 * 1e-3));
        assert_eq!(bits(simulator.state(7)), bits((own_q(1), own_v(1))));
        simulator.step(&torque, 2).unwrap();
        for (state, from, steps) in [(2, 0, 2), (7, 1, 2), (3, 3, 5)] {
            let mut alone = Simulator::new(&scene, settings.clone(), own_q(from), own_v(from)).unwrap();
            alone.step(&torque, steps).unwrap();
            assert_eq!(bits(simulator.state(state)), bits(alone.state(0)), "state {state}");
            assert_eq!(simulator.time(state).to_bits(), alone.time(0).to_bits());
        }
    });
}

#[test]
fn after_a_fault_a_simulator_is_at_the_last_step_that_all_states_finished() {
    let scene = phipsi::scenes::chain(2).unwrap();
    let mut settings = Settings::new(&scene, 1e-2).with_method(Method::SemiImplicitEuler);
    settings.properties.stiffness = vec![1e5; 2];
    let mut q = vec![0.0; 40];
    q[2 * 17] = 1.0;
    let mut simulator = Simulator::new(&scene, settings.clone(), &q, &[0.0; 40]).unwrap();
    let fault = simulator.step(&Torque::Zero, 100).expect_err("an explicit step of a stiff spring");
    assert_eq!((fault.state, fault.step), (17, simulator.steps()));
    assert!(fault.step > 2);
    let mut rollout = Rollout::new(&scene, settings, &q, &[0.0; 40]).unwrap();
    rollout.advance(fault.step, &Torque::Zero, None).unwrap();
    for state in 0..20 {
        assert_eq!(bits(simulator.state(state)), bits(rollout.state(state)));
    }
    // Once more, and then without it.
    assert_eq!(simulator.step(&Torque::Zero, 1).expect_err("again"), fault);
    assert_eq!(bits(simulator.state(0)), bits(rollout.state(0)));
    let zero = Broadcast::new("q", &[0.0; 2], 2, &[], &[]).unwrap();
    simulator.reset(&[17], &zero, &zero).unwrap();
    simulator.step(&Torque::Zero, 1).unwrap();
    assert_eq!(simulator.steps(), fault.step + 1);
}

#[test]
fn what_a_simulator_refuses_leaves_it_as_it_was() {
    let scene = phipsi::scenes::chain(2).unwrap();
    let q = [0.1, 0.2, 0.3, 0.4];
    let mut simulator = Simulator::new(&scene, Settings::new(&scene, 1e-3), &q, &[0.0; 4]).unwrap();
    simulator.step(&Torque::Zero, 1).unwrap();
    let before = [bits(simulator.state(0)), bits(simulator.state(1))];
    let three = Torque::constant(&[0.0; 3]);
    assert!(matches!(simulator.step(&three, 1).expect_err("refused").error, Error::Shape { .. }));
    let numbers = [0.5, 0.6, 0.7, f64::NAN];
    let bad = Broadcast::new("q", &numbers, 2, &[2], &[2]).unwrap();
    let good = Broadcast::new("qd", &[0.0; 2], 2, &[], &[2]).unwrap();
    let fault = simulator.reset(&[0, 1], &bad, &good).expect_err("refused");
    assert_eq!(fault.state, 1);
    assert!(fault.error.to_string().contains("q: found NaN"), "{}", fault.error);
    let fault = simulator.reset(&[1, 0], &good, &bad).expect_err("refused");
    assert!(fault.state == 0 && fault.error.to_string().contains("qd: found NaN"), "{}", fault.error);
    let fault = simulator.reset(&[0, 2], &good, &good).expect_err("refused");
    assert!(fault.error.to_string().contains("states: found 2"), "{}", fault.error);
    assert_eq!(before, [bits(simulator.state(0)), bits(simulator.state(1))]);
    assert_eq!((simulator.time(0), simulator.steps()), (1e-3, 1));
}
