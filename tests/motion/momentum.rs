//! Momentum and energy of simulated trees, and corrections that keep momentum.

use super::{State, after, distance, on_a_large_stack, reference, settings};
use crate::common::{ALL_KINDS, Random, Tree, random_state, tolerance};
use phipsi::batch::{Broadcast, INSTRUCTION_SETS, InstructionSet};
use phipsi::filter::Form;
use phipsi::motion::{METHODS, Rollout, Settings, Torque};
use phipsi::scene::{JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::{Scene, dynamics};

fn momentum(scene: &Scene, q: &[f64], v: &[f64]) -> nalgebra::Vector6<f64> {
    scene.momentum(&mut scene.workspace(), q, v).unwrap()
}

/// The linear momentum of a body on prismatic joints is linear in the velocities without rotations: every method
/// conserves it.
#[test]
fn momentum_of_what_only_slides_is_kept_to_rounding() {
    let mut builder =
        Tree { seed: 4, bodies: 5, kinds: &[JointKind::Prismatic], branching: 0.5, armature: 0.0, floating: false }
            .builder();
    builder = builder.gravity([0.0; 3]);
    // Three rails instead of a base: without rotations.
    let mut rails = SceneBuilder::new().gravity([0.0; 3]);
    for name in ["world", "x", "y"] {
        rails = rails.link(LinkDescription { name: name.into(), inertial: None });
    }
    for link in builder.links() {
        let mut link = link.clone();
        if link.name == "base" {
            link.inertial = builder.links()[1].inertial;
        }
        rails = rails.link(link);
    }
    for (k, (name, parent, child)) in
        [("rail x", "world", "x"), ("rail y", "x", "y"), ("rail z", "y", "base")].into_iter().enumerate()
    {
        let mut joint = JointDescription::new(name, JointKind::Prismatic, parent, child);
        joint.axis = nalgebra::Vector3::ith(k, 1.0);
        rails = rails.joint(joint);
    }
    for joint in builder.joints() {
        rails = rails.joint(joint.clone());
    }
    let scene = rails.build().unwrap();
    let mut random = Random::new(9);
    let (q, v, u) = random_state(&scene, &mut random);
    let u: Vec<f64> = u.iter().enumerate().map(|(i, u)| if i < 3 { 0.0 } else { *u }).collect();
    let start = momentum(&scene, &q, &v);
    let settings = Settings::new(&scene, 1.0);
    for &(name, method) in METHODS {
        let settings = settings.clone().with_method(method);
        let (q, v) = after(&scene, &settings, (&q, &v, &u), 1.0, 200);
        let end = momentum(&scene, &q, &v);
        let off = (0..3).map(|i| (end[3 + i] - start[3 + i]).abs()).fold(0.0, f64::max);
        let size = v.iter().fold(1.0_f64, |m, x| m.max(x.abs()));
        assert!(off <= tolerance::inverse(1e2, size), "{name}: {off:e}");
    }
}

/// A floating tree with revolute joints, without gravity.
fn turning_tree() -> Scene {
    let kinds = &[JointKind::Revolute, JointKind::Spherical];
    let tree = Tree { seed: 6, bodies: 4, kinds, branching: 0.4, armature: 0.0, floating: true };
    tree.builder().gravity([0.0; 3]).build().unwrap()
}

/// With rotations, momentum is not linear in the velocities: its drift decreases with the order of the method.
#[test]
fn drift_of_momentum_and_energy_falls_with_the_order() {
    let scene = turning_tree();
    let mut random = Random::new(2);
    let (q, v, _) = random_state(&scene, &mut random);
    let u = vec![0.0; scene.nv()];
    let start = momentum(&scene, &q, &v);
    let energy = |q: &[f64], v: &[f64]| scene.energy(&mut scene.workspace(), q, v).unwrap().kinetic;
    for &(name, method) in METHODS {
        let settings = Settings::new(&scene, 1.0).with_method(method);
        let steps = if method.order() >= 3 { 20 } else { 200 };
        let drift = [steps, 2 * steps].map(|steps| {
            let (q1, v1) = after(&scene, &settings, (&q, &v, &u), 0.4, steps);
            [(momentum(&scene, &q1, &v1) - start).amax(), (energy(&q1, &v1) - energy(&q, &v)).abs()]
        });
        println!(
            "{name}: momentum {:.1e} {:.1e}, energy {:.1e} {:.1e}",
            drift[0][0], drift[1][0], drift[0][1], drift[1][1]
        );
        let least = 0.8 * f64::from(method.order());
        for (coarse, fine) in drift[0].into_iter().zip(drift[1]) {
            assert!((coarse / fine).log2() >= least, "{name}: {drift:?}");
        }
    }
}

/// A tree of six bodies on a free joint; all forces act at its joints, none at the free joint.
pub(super) fn floating(kinds: &[JointKind], gravity: [f64; 3]) -> (Scene, Settings, State) {
    let tree = Tree { seed: 6, bodies: 5, kinds, branching: 0.4, armature: 0.3, floating: true };
    let scene = tree.builder().gravity(gravity).build().unwrap();
    let mut random = Random::new(2);
    let (q, v, mut u) = random_state(&scene, &mut random);
    let mut settings = settings(&scene, &q, &mut random);
    let gains = settings.gains.as_mut().unwrap();
    let p = &mut settings.properties;
    for acting in
        [&mut p.damping, &mut p.stiffness, &mut p.friction, &mut gains.proportional, &mut gains.derivative, &mut u]
    {
        acting[..6].fill(0.0);
    }
    settings.conserve_momentum = true;
    (scene, settings, (q, v, u))
}

/// Mass times center of mass, by the potential energy with gravity of 1 m/s^2 along each axis; and the mass.
fn moment_of_mass(scene: &Scene, q: &[f64]) -> (nalgebra::Vector3<f64>, f64) {
    let mut model = scene.model().clone();
    let mut workspace = phipsi::Workspace::new(&model);
    let still = vec![0.0; scene.nv()];
    let moment = nalgebra::Vector3::from_fn(|i, _| {
        model.gravity = -nalgebra::Vector3::ith(i, 1.0);
        dynamics::energy(&model, &mut workspace, q, &still).potential
    });
    let links = scene.source().links().iter();
    (moment, links.filter_map(|link| link.inertial.as_ref()).map(|inertial| inertial.mass).sum())
}

/// Effect of gravity alone on the momentum about the origin and on the center of mass: (momentum, mass times center
/// of mass) after `t`.
fn thrown(scene: &Scene, (q, v): (&[f64], &[f64]), t: f64) -> (nalgebra::Vector6<f64>, nalgebra::Vector3<f64>) {
    let (g, start) = (scene.model().gravity, momentum(scene, q, v));
    let (moment, mass) = moment_of_mass(scene, q);
    let (turning, pushed) = (start.fixed_rows::<3>(0).into_owned(), start.fixed_rows::<3>(3).into_owned());
    let turning = turning + moment.cross(&g) * t + pushed.cross(&g) * (t * t / 2.0);
    let after = pushed + g * (mass * t);
    let moment = moment + pushed * t + g * (mass * t * t / 2.0);
    (nalgebra::Vector6::from_iterator(turning.iter().chain(&after).copied()), moment)
}

/// Distance of a state from [`thrown`], in units of the rounding error of its momentum and moment.
fn off_course(scene: &Scene, start: (&[f64], &[f64]), (q, v): (&[f64], &[f64]), t: f64) -> f64 {
    let (expected, expected_moment) = thrown(scene, start, t);
    let (moment, mass) = moment_of_mass(scene, q);
    // Links extend about a meter further than the first one.
    let reach = 1.0 + q[..3].iter().fold(0.0_f64, |m, x| m.max(x.abs())) + tolerance::count(scene.joints().len());
    let speed = reach * v.iter().fold(1.0_f64, |m, x| m.max(x.abs()));
    let turning = (momentum(scene, q, v) - expected).amax() / tolerance::product(1, mass * reach * speed);
    turning.max((moment - expected_moment).amax() / tolerance::product(1, mass * reach))
}

#[test]
fn momentum_of_floating_trees_is_kept_to_rounding_where_asked() {
    let turning = [JointKind::Revolute, JointKind::Spherical];
    for (kinds, weightless) in [(&turning[..], true), (&ALL_KINDS[..7], false)] {
        let gravity = if weightless { [0.0; 3] } else { [0.3, -0.5, -9.6] };
        let (scene, mut settings, (q, v, u)) = floating(kinds, gravity);
        settings.dt = 1e-3;
        let (every, steps) = (100, 1200);
        for &(name, method) in METHODS {
            settings.method = method;
            let worst = |conserve_momentum: bool| {
                let settings = settings.clone().with_conserve_momentum(conserve_momentum);
                let mut rollout = Rollout::new(&scene, settings, &q, &v).unwrap();
                let torque = Torque::constant(&u);
                let mut worst = 0.0_f64;
                for n in 1..=steps / every {
                    rollout.advance(every, &torque, None).unwrap();
                    let time = 1e-3 * tolerance::count(n * every);
                    let off = off_course(&scene, (&q, &v), rollout.state(0), time);
                    worst = if off <= worst { worst } else { off };
                }
                assert_eq!(rollout.correction(0).is_some(), conserve_momentum);
                worst
            };
            let kept = worst(true);
            println!("{name}, gravity {gravity:?}: {kept:.2e} of the bound");
            assert!(kept <= 1.0, "{name}: {kept}");
            if weightless {
                // It is not conserved without the correction.
                let left = worst(false);
                println!("{name}, not asked: {left:.1e}");
                // A method of order 5 nearly conserves it.
                assert!(
                    left >= if method.order() < 5 { 1e3 * kept.max(1.0) } else { 2.0 * kept },
                    "{name}: {left:e} beside {kept:e}"
                );
            }
        }
    }
}

#[test]
fn keeping_momentum_leaves_every_method_its_order() {
    let (scene, mut settings, (q, v, u)) =
        floating(&[JointKind::Spherical, JointKind::Revolute, JointKind::Planar], [0.3, -0.5, -9.6]);
    let (state, time) = ((&q[..], &v[..], &u[..]), 0.1);
    let exact = reference(&scene, &settings, state, time, 400);
    for &(name, method) in METHODS {
        settings.method = method;
        let steps = [0, 128, 64, 32, 24, 16][method.order() as usize];
        let found = [steps, 2 * steps].map(|steps| {
            let settings = settings.clone().with_dt(time / tolerance::count(steps));
            let mut rollout = Rollout::new(&scene, settings, &q, &v).unwrap();
            let torque = Torque::constant(&u);
            rollout.advance(steps, &torque, None).unwrap();
            let (q, v) = rollout.state(0);
            let correction = rollout.correction(0).unwrap();
            [distance(&scene, &(q.to_vec(), v.to_vec()), &exact), correction.velocity, correction.position]
        });
        let [error, velocity, position] = [0, 1, 2].map(|i| (found[0][i] / found[1][i]).log2());
        println!("{name}: {found:?}, orders {error:.3}, {velocity:.3}, {position:.3}");
        let order = f64::from(method.order());
        if method.order() == 5 {
            // Near the rounding error, errors decrease faster.
            assert!(error - order >= -tolerance::ORDER, "{name}: {error}, {found:?}");
            continue;
        }
        assert!((error - order).abs() <= tolerance::ORDER, "{name}: {error}, {found:?}");
        // A correction has the magnitude of the error of one step.
        for correction in [velocity, position] {
            assert!((correction - order - 1.0).abs() <= tolerance::ORDER_OF_A_STEP, "{name}: {correction}, {found:?}");
        }
    }
}

#[test]
fn keeping_momentum_does_not_spoil_the_energy() {
    let scene = turning_tree();
    let mut random = Random::new(2);
    // For several states, because the drift of one may be small by chance.
    let states: Vec<_> = (0..6).map(|_| random_state(&scene, &mut random)).collect();
    let u = vec![0.0; scene.nv()];
    let energy = |q: &[f64], v: &[f64]| scene.energy(&mut scene.workspace(), q, v).unwrap().kinetic;
    for &(name, method) in METHODS {
        let steps = if method.order() >= 3 { 40 } else { 200 };
        let drift = [true, false].map(|conserve_momentum| {
            let settings = Settings::new(&scene, 1.0).with_method(method).with_conserve_momentum(conserve_momentum);
            let drifts = states.iter().map(|(q, v, _)| {
                let (q1, v1) = after(&scene, &settings, (q, v, &u), 0.4, steps);
                let off = (momentum(&scene, &q1, &v1) - momentum(&scene, q, v)).amax();
                println!(
                    "{name}, asked {conserve_momentum}: momentum {off:.1e} of {:.1}",
                    momentum(&scene, q, v).amax()
                );
                (energy(&q1, &v1) - energy(q, v)).abs()
            });
            drifts.sum::<f64>() / tolerance::count(states.len())
        });
        println!("{name}: energy {:.1e}, not asked {:.1e}", drift[0], drift[1]);
        assert!(drift[0] <= tolerance::ENERGY_KEEPING_MOMENTUM * drift[1], "{name}: {drift:?}");
    }
}

#[test]
fn kept_momentum_is_the_same_in_lanes_and_however_a_run_is_cut() {
    on_a_large_stack(|| {
        let (scene, mut settings, (_, _, u)) = floating(&ALL_KINDS, [0.3, -0.5, -9.6]);
        settings.dt = 1e-3;
        let mut random = Random::new(8);
        let states: Vec<_> = (0..11).map(|_| random_state(&scene, &mut random)).collect();
        let q: Vec<f64> = states.iter().flat_map(|state| state.0.clone()).collect();
        let v: Vec<f64> = states.iter().flat_map(|state| state.1.clone()).collect();
        let torque = Torque::Constant(Broadcast::new("tau", &u, scene.nv(), &[], &[11]).unwrap());
        for form in [Form::Auto, Form::Covariance] {
            for &(name, method) in METHODS {
                (settings.method, settings.form) = (method, form);
                let run = |arm: InstructionSet, cuts: &[usize]| {
                    let settings = settings.clone().with_arm(arm);
                    let mut rollout = Rollout::new(&scene, settings, &q, &v).unwrap();
                    for &cut in cuts {
                        rollout.advance(cut, &torque, None).unwrap();
                    }
                    (0..11)
                        .map(|i| {
                            let (q, v) = rollout.state(i);
                            ((q.to_vec(), v.to_vec()), rollout.correction(i).unwrap())
                        })
                        .collect::<Vec<_>>()
                };
                let mut found = Vec::new();
                for arm in INSTRUCTION_SETS.iter().map(|&(_, arm)| arm).filter(|arm| arm.available()) {
                    found.push(run(arm, &[3]));
                    assert_eq!(found[found.len() - 1], run(arm, &[1, 2]), "{name}");
                }
                for other in &found[1..] {
                    for (a, b) in found[0].iter().zip(other) {
                        let size = a.0.1.iter().fold(1.0_f64, |m, x| m.max(x.abs()));
                        let off = distance(&scene, &a.0, &b.0);
                        let corrected = (a.1.velocity - b.1.velocity).abs().max((a.1.position - b.1.position).abs());
                        assert!(off.max(corrected) <= tolerance::inverse(1e3, size), "{name}: {off:e}, {corrected:e}");
                    }
                }
            }
        }
    });
}

#[test]
fn trees_side_by_side_keep_their_own_momentum() {
    let mut random = Random::new(12);
    let mut builder =
        SceneBuilder::new().gravity([0.1, 0.2, -9.8]).link(LinkDescription { name: "base".into(), inertial: None });
    for tree in ["a", "b"] {
        let (body, arm) = (format!("{tree} body"), format!("{tree} arm"));
        for name in [&body, &arm] {
            let inertial = Some(crate::common::random_inertial(&mut random));
            builder = builder.link(LinkDescription { name: name.clone(), inertial });
        }
        let mut free = JointDescription::new(format!("{tree} free"), JointKind::Floating, "base", &body);
        // The frame of the free joint differs from that of the base.
        free.origin.rotation = random.rotation();
        free.origin.lever = random.vector();
        let mut hinge = JointDescription::new(format!("{tree} hinge"), JointKind::Revolute, &body, &arm);
        hinge.origin.lever = random.vector();
        builder = builder.joint(free).joint(hinge);
    }
    let scene = builder.build().unwrap();
    let (q, v, _) = random_state(&scene, &mut random);
    let settings = Settings::new(&scene, 1e-3).with_conserve_momentum(true);
    let mut rollout = Rollout::new(&scene, settings, &q, &v).unwrap();
    rollout.advance(1000, &Torque::Zero, None).unwrap();
    let (q1, v1) = rollout.state(0);
    // Each tree independently: the other one without mass.
    for first in ["a", "b"] {
        let mut model = scene.model().clone();
        for (k, body) in model.bodies.iter_mut().enumerate() {
            if !scene.joint_of_body(k).unwrap().name.starts_with(first) {
                body.inertia = phipsi::spatial::BodyInertia::zero();
            }
        }
        let mut workspace = phipsi::Workspace::new(&model);
        let [start, end] = [(&q[..], &v[..]), (q1, v1)].map(|(q, v)| dynamics::momentum(&model, &mut workspace, q, v));
        let g = scene.model().gravity;
        let mut mass_of = |q: &[f64]| {
            nalgebra::Vector3::from_fn(|i, _| {
                model.gravity = -nalgebra::Vector3::ith(i, 1.0);
                dynamics::energy(&model, &mut workspace, q, &vec![0.0; scene.nv()]).potential
            })
        };
        let (moment, moment_end) = (mass_of(&q), mass_of(q1));
        let mass: f64 = (0..4)
            .filter(|&k| scene.joint_of_body(k).unwrap().name.starts_with(first))
            .map(|k| scene.model().bodies[k].inertia.mass)
            .sum();
        let pushed = start.fixed_rows::<3>(3).into_owned();
        let turned = start.fixed_rows::<3>(0) + moment.cross(&g) + pushed.cross(&g) * 0.5;
        let bound = tolerance::product(4, 1e2 * mass * tolerance::size(v1));
        assert!((end.fixed_rows::<3>(0) - turned).amax() <= bound, "{first}");
        assert!((end.fixed_rows::<3>(3) - (pushed + g * mass)).amax() <= bound, "{first}");
        assert!((moment_end - (moment + pushed + g * (mass / 2.0))).amax() <= bound, "{first}");
    }
}

#[test]
fn momentum_that_cannot_be_kept_is_refused_by_name() {
    let (scene, good, (q, v, u)) = floating(&[JointKind::Revolute], [0.0; 3]);
    let refused = |change: &dyn Fn(&mut Settings), words: &[&str]| {
        let mut settings = good.clone();
        change(&mut settings);
        let error = Rollout::new(&scene, settings, &q, &v).expect_err("refused").to_string();
        for word in words.iter().chain(&["conserve_momentum", "root_joint"]) {
            assert!(error.contains(word), "{error}");
        }
    };
    refused(&|s| s.properties.armature[3] = 0.5, &["armature 0.5"]);
    refused(&|s| s.properties.damping[0] = 0.5, &["damping 0.5"]);
    refused(&|s| s.properties.stiffness[5] = 2.0, &["stiffness 2"]);
    refused(&|s| s.properties.friction[1] = 0.5, &["friction 0.5"]);
    refused(&|s| s.gains.as_mut().unwrap().proportional[2] = 7.0, &["gains.proportional 7"]);
    refused(&|s| s.gains.as_mut().unwrap().derivative[4] = 7.0, &["gains.derivative 7"]);

    let mut rollout = Rollout::new(&scene, good.clone(), &[&q[..], &q].concat(), &[&v[..], &v].concat()).unwrap();
    let mut pushed = [&u[..], &u].concat();
    pushed[scene.nv() + 2] = 0.25;
    let torque = Torque::Constant(Broadcast::new("tau", &pushed, scene.nv(), &[2], &[2]).unwrap());
    let fault = rollout.advance(1, &torque, None).expect_err("refused");
    assert!(fault.state == 1 && fault.step == 0, "{fault:?}");
    let text = fault.error.to_string();
    assert!(["tau", "0.25", "root_joint", "conserve_momentum"].iter().all(|word| text.contains(word)), "{text}");

    let fixed = phipsi::scenes::chain(2).unwrap();
    let settings = Settings::new(&fixed, 1e-3).with_conserve_momentum(true);
    let error = Rollout::new(&fixed, settings, &[0.0; 2], &[0.0; 2]).expect_err("refused").to_string();
    assert!(error.contains("conserve_momentum") && error.contains("\"j0\""), "{error}");
    let still = fixed.lock(&["j0", "j1"], &[0.0; 2]).unwrap();
    let settings = Settings::new(&still, 1e-3).with_conserve_momentum(true);
    let error = Rollout::new(&still, settings, &[], &[]).expect_err("refused").to_string();
    assert!(error.contains("conserve_momentum"), "{error}");
}

#[test]
fn a_tree_at_rest_is_not_corrected() {
    let (scene, _, (q, _, _)) = floating(&[JointKind::Revolute, JointKind::Spherical], [0.0; 3]);
    let settings = Settings::new(&scene, 1e-3).with_conserve_momentum(true);
    let mut rollout = Rollout::new(&scene, settings, &q, &vec![0.0; scene.nv()]).unwrap();
    rollout.advance(10, &Torque::Zero, None).unwrap();
    let correction = rollout.correction(0).unwrap();
    assert!(correction.velocity == 0.0 && correction.position <= tolerance::product(6, 10.0), "{correction:?}");
}
