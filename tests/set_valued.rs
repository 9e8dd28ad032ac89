//! Exact Coulomb friction and joint stops: arms in static equilibrium, closed forms of sliding and bouncing, and
//! equal results alone, in batches, on threads and with every instruction set.

use crate::common::{Random, tolerance};
use phipsi::Scene;
use phipsi::batch::INSTRUCTION_SETS;
use phipsi::motion::{Limits, METHODS, Method, Rollout, Settings, Simulator, Torque};
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::spatial::Symmetric3;

/// A body of 2 kg on a vertical prismatic joint.
fn lift(friction: f64, lower: f64, upper: f64) -> Scene {
    let body = Inertial {
        mass: 2.0,
        center: [0.1, 0.0, 0.0].into(),
        central: Symmetric3::new([0.1, 0.0, 0.0, 0.2, 0.0, 0.3]),
    };
    let mut joint = JointDescription::new("lift", JointKind::Prismatic, "base", "body");
    (joint.friction, joint.limits.lower, joint.limits.upper) = (friction, lower, upper);
    SceneBuilder::new()
        .link(LinkDescription { name: "base".into(), inertial: None })
        .link(LinkDescription { name: "body".into(), inertial: Some(body) })
        .joint(joint)
        .build()
        .unwrap()
}

const G: f64 = 9.81;

fn run(scene: &Scene, settings: Settings, (q, v): (f64, f64), steps: usize) -> Rollout<&Scene> {
    let mut rollout = Rollout::new(scene, settings, &[q], &[v]).unwrap();
    rollout.advance(steps, &Torque::Zero, None).unwrap();
    rollout
}

#[test]
fn what_friction_can_hold_does_not_move_at_all() {
    let chain = phipsi::scenes::chain(7).unwrap();
    let q = [0.4, -0.3, 0.2, 0.5, -0.6, 0.1, 0.3];
    let mut gravity = [0.0; 7];
    chain.bias_torque(&mut chain.workspace(), &q, &[0.0; 7], &mut gravity).unwrap();
    for &(name, method) in METHODS {
        let mut settings = Settings::new(&chain, 1e-3).with_method(method);
        settings.properties.friction = gravity.iter().map(|g| 1.01 * g.abs() + 1e-9).collect();
        let mut rollout = Rollout::new(&chain, settings, &q, &[0.0; 7]).unwrap();
        rollout.advance(1000, &Torque::Zero, None).unwrap();
        assert_eq!(rollout.state(0), (&q[..], &[0.0; 7][..]), "{name}");
        assert_eq!(rollout.totals(0).events.to_bits(), 0.0_f64.to_bits(), "{name}: modes that hold need no events");
    }
}

#[test]
fn what_friction_cannot_hold_moves() {
    let scene = lift(0.99 * 2.0 * G, f64::NEG_INFINITY, f64::INFINITY);
    let rollout = run(&scene, Settings::new(&scene, 1e-3), (0.0, 0.0), 1000);
    let exact = -0.5 * 0.01 * G;
    // The first step is the event, of first order.
    assert!((rollout.state(0).0[0] - exact).abs() <= 0.01 * G * 1e-3, "{}", rollout.state(0).0[0]);
    assert!((rollout.state(0).1[0] + 0.01 * G).abs() <= tolerance::product(1000, 1.0));
}

#[test]
fn sliding_friction_stops_a_body_where_it_should() {
    // Upward against gravity and friction, instantaneously at rest, and kept there by friction.
    let (friction, v) = (1.2 * 2.0 * G, 3.0);
    let scene = lift(friction, f64::NEG_INFINITY, f64::INFINITY);
    let rollout = run(&scene, Settings::new(&scene, 1e-3), (0.0, v), 1000);
    let exact = 0.5 * v * v / (2.2 * G);
    let (q, v) = rollout.state(0);
    // The last step of the slide is too short or too long by a fraction of a step: h^2 a/2.
    assert!((q[0] - exact).abs() <= 1e-6 * 2.2 * G && v[0].to_bits() == 0.0_f64.to_bits(), "{q:?} {v:?}");
    let totals = rollout.totals(0);
    assert!((totals.friction + friction * exact).abs() <= 1e-3 * friction * exact, "{totals:?}");
}

#[test]
fn a_body_rebounds_from_its_stop_by_the_coefficient() {
    let scene = lift(0.0, 0.0, 5.0);
    for restitution in [0.0, 0.5, 0.9] {
        let settings = Settings::new(&scene, 1e-3).with_restitution(restitution);
        let mut rollout = run(&scene, settings, (0.5, 0.0), 3000);
        let impacts = rollout.take_impacts();
        let speed = (2.0 * G * 0.5_f64).sqrt();
        let first = impacts.first().expect("an impact");
        assert!((first.speed - speed).abs() <= 1e-3 * G && !first.upper && (first.time - speed / G).abs() <= 2e-3);
        let impulse = 2.0 * (1.0 + restitution) * first.speed;
        // Gravity acts during the step too.
        assert!((first.impulse - impulse).abs() <= 2.0 * G * 1e-3 * 1.001, "{first:?} {impulse}");
        if restitution == 0.0 {
            assert_eq!(rollout.state(0), (&[0.0][..], &[0.0][..]));
            assert_eq!(impacts.len(), 1);
        } else {
            let second = &impacts[1];
            assert!((second.speed - restitution * first.speed).abs() <= 2e-3 * G, "{second:?}");
            assert!(rollout.state(0).0[0] >= 0.0);
        }
        let totals = rollout.totals(0);
        assert!(totals.stops < 0.0, "{totals:?}");
    }
}

#[test]
fn limits_can_be_reported_only_and_starts_outside_return() {
    let scene = lift(0.0, 0.0, 5.0);
    let free = run(&scene, Settings::new(&scene, 1e-3).with_limits(Limits::Report), (0.5, 0.0), 500);
    assert!(free.state(0).0[0] < -0.5);
    let mut rollout = Rollout::new(&scene, Settings::new(&scene, 1e-3), &[-0.4], &[0.0]).unwrap();
    let (mut fastest, mut before) = (0.0_f64, 0.0);
    for _ in 0..1000 {
        rollout.advance(1, &Torque::Zero, None).unwrap();
        let v = rollout.state(0).1[0];
        assert!(v - before <= 1e-3 * 0.4 / (0.05 * 0.05) * 1.001, "a jump from {before} to {v}");
        (fastest, before) = (fastest.max(v), v);
    }
    assert_eq!(rollout.state(0), (&[0.0][..], &[0.0][..]));
    assert!(fastest < 8.0);
}

/// Chains with friction and stops from random states: every path through the code.
fn rubbing(states: usize) -> (Scene, Settings, Vec<f64>, Vec<f64>) {
    let mut random = Random::new(11);
    let chain = phipsi::scenes::chain(5).unwrap();
    let mut joints: Vec<JointDescription> = chain.source().joints().to_vec();
    for (k, joint) in joints.iter_mut().enumerate() {
        (joint.limits.lower, joint.limits.upper) = (-0.6, 0.7);
        (joint.friction, joint.damping) = (if k % 2 == 0 { 0.4 } else { 0.0 }, if k == 1 { 0.2 } else { 0.0 });
    }
    let mut builder = SceneBuilder::new();
    for link in chain.source().links() {
        builder = builder.link(link.clone());
    }
    for joint in joints {
        builder = builder.joint(joint);
    }
    let scene = builder.build().unwrap();
    let settings = Settings::new(&scene, 1e-3).with_restitution(0.3);
    (scene, settings, random.array(5 * states, 0.6), random.array(5 * states, 3.0))
}

#[test]
fn alone_and_in_batches_and_in_pieces_the_bits_are_the_same() {
    let states = 37;
    let (scene, settings, q, v) = rubbing(states);
    let mut all = Rollout::new(&scene, settings.clone(), &q, &v).unwrap();
    all.advance(400, &Torque::Zero, None).unwrap();
    let impacts = all.take_impacts();
    assert!(impacts.len() > states / 2, "{} impacts", impacts.len());
    for state in [0, 5, 36] {
        let (q, v) = (&q[5 * state..][..5], &v[5 * state..][..5]);
        let mut one = Simulator::new(&scene, settings.clone(), q, v).unwrap();
        for piece in [1, 7, 192, 200] {
            one.step(&Torque::constant(&[0.0; 5]), piece).unwrap();
        }
        // One state uses a separate scalar type: nearly equal results, and the same modes.
        let (a, b) = (one.state(0), all.state(state));
        for (a, b) in a.0.iter().chain(a.1).zip(b.0.iter().chain(b.1)) {
            assert!((a - b).abs() <= 1e-7 * (1.0 + b.abs()), "{a} {b}");
        }
        let own: Vec<_> = impacts.iter().filter(|impact| impact.state == state).collect();
        let found = one.take_impacts();
        assert_eq!(found.len(), own.len());
        for (a, b) in found.iter().zip(own) {
            assert_eq!((a.row, a.upper), (b.row, b.upper));
            assert!((a.time - b.time).abs() <= 1e-9, "{a:?} {b:?}");
        }
    }
    let mut pieces = Rollout::new(&scene, settings, &q, &v).unwrap();
    for steps in [1, 7, 192, 200] {
        pieces.advance(steps, &Torque::Zero, None).unwrap();
    }
    for state in 0..states {
        assert_eq!(pieces.state(state), all.state(state));
        assert_eq!(pieces.totals(state), all.totals(state));
    }
    assert_eq!(pieces.take_impacts(), impacts);
}

#[test]
fn every_instruction_set_has_the_same_modes() {
    let states = 16;
    let (scene, settings, q, v) = rubbing(states);
    let of = |arm| {
        let mut rollout = Rollout::new(&scene, settings.clone().with_arm(arm), &q, &v).unwrap();
        rollout.advance(300, &Torque::Zero, None).unwrap();
        rollout
    };
    let first = of(INSTRUCTION_SETS[0].1);
    for &(_, arm) in INSTRUCTION_SETS {
        let other = of(arm);
        for state in 0..states {
            let (a, b) = (first.state(state), other.state(state));
            let pairs = a.0.iter().chain(a.1).zip(b.0.iter().chain(b.1));
            pairs.for_each(|(a, b)| assert!((a - b).abs() <= 1e-7 * (1.0 + b.abs()), "{arm:?}: {a} {b}"));
            let at_rest = |v: &[f64]| v.iter().map(|v| v.to_bits() == 0.0_f64.to_bits()).collect::<Vec<_>>();
            assert_eq!(at_rest(a.1), at_rest(b.1), "{arm:?}");
        }
    }
}

#[test]
fn energy_does_not_grow_and_its_works_add_up() {
    let states = 32;
    let (scene, settings, q, v) = rubbing(states);
    let energy = |q: &[f64], v: &[f64]| {
        let energy = scene.energy(&mut scene.workspace(), q, v).unwrap();
        energy.kinetic + energy.potential
    };
    let mut rollout = Rollout::new(&scene, settings, &q, &v).unwrap();
    let start: Vec<f64> = (0..states).map(|i| energy(&q[5 * i..][..5], &v[5 * i..][..5])).collect();
    rollout.advance(1000, &Torque::Zero, None).unwrap();
    for (state, start) in start.into_iter().enumerate() {
        let ((q, v), totals) = (rollout.state(state), rollout.totals(state));
        let change = energy(q, v) - start;
        let works = totals.damping + totals.friction + totals.stops;
        assert!(totals.damping < 0.0 && totals.friction < 0.0 && totals.stops <= 0.0, "{totals:?}");
        assert_eq!(totals.torque.to_bits(), 0.0_f64.to_bits());
        assert!((change - works).abs() <= 0.01 * works.abs(), "state {state}: {change} {works}");
    }
}

#[test]
fn fast_motion_is_divided_and_keeps_its_energy() {
    let chain = crate::common::swinging(3);
    let weightless = chain.source().clone().gravity([0.0; 3]).build().unwrap();
    let (q, v) = ([0.3, 0.8, -0.5], [100.0, -150.0, 200.0]);
    let energy = |q: &[f64], v: &[f64]| weightless.energy(&mut weightless.workspace(), q, v).unwrap().kinetic;
    let mut rollout = Rollout::new(&weightless, Settings::new(&weightless, 1e-3), &q, &v).unwrap();
    rollout.advance(1000, &Torque::Zero, None).unwrap();
    let (found, start) = (energy(rollout.state(0).0, rollout.state(0).1), energy(&q, &v));
    assert!(rollout.totals(0).most_substeps >= 2.0, "{:?}", rollout.totals(0));
    assert!((found - start).abs() <= 1e-3 * start, "{found} {start}");
    assert_eq!(rollout.chosen_method(), Method::RungeKutta4);
}

#[test]
fn error_control_meets_its_bound_through_events() {
    let (scene, settings, q, v) = rubbing(1);
    let of = |accuracy| {
        let settings = settings.clone().with_accuracy(Some(accuracy)).with_dt(0.01);
        let mut rollout = Rollout::new(&scene, settings, &q, &v).unwrap();
        rollout.advance(40, &Torque::Zero, None).unwrap();
        rollout.state(0).0.to_vec()
    };
    let exact = of(1e-11);
    let mut before = f64::INFINITY;
    for accuracy in [1e-4, 1e-6, 1e-8] {
        let error = of(accuracy).iter().zip(&exact).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
        assert!(error <= 100.0 * accuracy + 1e-7 && error <= before, "{accuracy}: {error}");
        before = error;
    }
}

#[test]
fn settings_that_make_no_sense_are_named() {
    let scene = lift(0.0, 0.0, 1.0);
    let refused = |settings: Settings, name: &str| {
        let text = Rollout::new(&scene, settings, &[0.5], &[0.0]).expect_err("refused").to_string();
        assert!(text.contains(name), "{text}");
    };
    let usual = Settings::new(&scene, 1e-3);
    refused(usual.clone().with_restitution(1.5), "restitution");
    refused(usual.clone().with_restitution(f64::NAN), "restitution");
    refused(usual.clone().with_accuracy(Some(0.0)), "accuracy");
    refused(usual.with_accuracy(Some(1e-6)).with_method(Method::RungeKutta4), "accuracy");
}
