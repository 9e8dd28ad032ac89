//! Simulation: the order of every method compared with an independent integration in coordinates, stiff joints,
//! momentum, energy, lanes, and refused arguments.

use crate::common::{ALL_KINDS, Random, Tree, random_state, tolerance};
use phipsi::batch::Broadcast;
use phipsi::batch::{INSTRUCTION_SETS, InstructionSet};
use phipsi::dynamics;
use phipsi::filter::Form;
use phipsi::kinematics::coordinate_rates;
use phipsi::motion::{Gains, METHODS, Method, Properties, Records, Rollout, Settings, Simulator, StepFault, Torque};
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::spatial::Symmetric3;
use phipsi::{Error, Scene};

/// Joints whose motion is smooth over the duration of the tests.
fn tree(kinds: &[JointKind], floating: bool) -> Scene {
    Tree { seed: 5, bodies: 5, kinds, branching: 0.4, armature: 0.3, floating }.scene()
}

/// All joint properties with moderate values, rest and target near `q`.
fn settings(scene: &Scene, q: &[f64], random: &mut Random) -> Settings {
    let mut settings = Settings::new(scene, 1.0);
    let nv = scene.nv();
    let mut near = |size: f64| {
        let mut out = vec![0.0; scene.nq()];
        scene.integrate(q, &random.array(nv, size), &mut out).unwrap();
        out
    };
    let (rest, target) = (near(0.4), near(0.4));
    let positive = |random: &mut Random, size: f64| random.array(nv, size).iter().map(|x| x.abs() + 0.1).collect();
    let p = &mut settings.properties;
    (p.rest, p.friction_speed) = (rest, 0.5);
    (p.damping, p.stiffness, p.friction) = (positive(random, 0.5), positive(random, 3.0), positive(random, 0.3));
    settings.gains =
        Some(Gains::new(positive(random, 3.0), positive(random, 0.5), target).with_target_rate(random.array(nv, 0.3)));
    settings
}

/// Torque of the joints and the control law, from the definitions: distances by [`Scene::difference`], except for the
/// linear part of a free joint, which is a distance in space in the child frame.
fn own_torque(scene: &Scene, settings: &Settings, q: &[f64], v: &[f64]) -> Vec<f64> {
    let p = &settings.properties;
    let away = |from: &[f64]| {
        let mut s = vec![f64::NAN; scene.nv()];
        scene.difference(from, q, &mut s).unwrap();
        for joint in scene.joints().iter().filter(|joint| joint.kind == JointKind::Floating) {
            let at = joint.q.start;
            let turn = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(
                q[at + 6],
                q[at + 3],
                q[at + 4],
                q[at + 5],
            ));
            let moved = nalgebra::Vector3::from_fn(|i, _| q[at + i] - from[at + i]);
            s[joint.v.start..joint.v.start + 3].copy_from_slice(turn.inverse_transform_vector(&moved).as_slice());
        }
        s
    };
    let (s, mut torque) = (away(&p.rest), vec![0.0; scene.nv()]);
    for i in 0..scene.nv() {
        let friction = p.friction[i] * v[i] / (v[i] * v[i] + p.friction_speed * p.friction_speed).sqrt();
        torque[i] = -p.damping[i] * v[i] - p.stiffness[i] * s[i] - friction;
    }
    if let Some(gains) = &settings.gains {
        let s = away(&gains.target);
        for i in 0..scene.nv() {
            torque[i] += gains.derivative[i] * (gains.target_rate[i] - v[i]) - gains.proportional[i] * s[i];
        }
    }
    torque
}

/// The same motion in coordinates, quaternions as four values: the classical method of order 4 with very small steps.
fn reference(
    scene: &Scene,
    settings: &Settings,
    (q, v, u): (&[f64], &[f64], &[f64]),
    time: f64,
    steps: usize,
) -> (Vec<f64>, Vec<f64>) {
    let mut model = scene.model().clone();
    model.system.noise.clone_from(&settings.properties.armature);
    let mut workspace = phipsi::Workspace::new(&model);
    let (nq, nv) = (scene.nq(), scene.nv());
    let mut rate = |y: &[f64]| {
        let (q, v) = y.split_at(nq);
        let mut unit = q.to_vec();
        scene.integrate(q, &vec![0.0; nv], &mut unit).unwrap();
        let torque: Vec<f64> = own_torque(scene, settings, &unit, v).iter().zip(u).map(|(a, b)| a + b).collect();
        let mut out = vec![f64::NAN; nq + nv];
        let (dq, dv) = out.split_at_mut(nq);
        coordinate_rates(&model, q, v, dq);
        dynamics::forward_dynamics(&model, &mut workspace, q, v, &torque, &[], dv);
        out
    };
    let h = time / tolerance::count(steps);
    let mut y = [q, v].concat();
    let plus = |y: &[f64], h: f64, k: &[f64]| -> Vec<f64> { y.iter().zip(k).map(|(y, k)| y + h * k).collect() };
    for _ in 0..steps {
        let k1 = rate(&y);
        let k2 = rate(&plus(&y, h / 2.0, &k1));
        let k3 = rate(&plus(&y, h / 2.0, &k2));
        let k4 = rate(&plus(&y, h, &k3));
        for i in 0..y.len() {
            y[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
        }
    }
    let v = y.split_off(nq);
    let mut unit = y.clone();
    scene.integrate(&y, &vec![0.0; nv], &mut unit).unwrap();
    (unit, v)
}

/// One state after `time`.
fn after(
    scene: &Scene,
    settings: &Settings,
    (q, v, u): (&[f64], &[f64], &[f64]),
    time: f64,
    steps: usize,
) -> (Vec<f64>, Vec<f64>) {
    let settings = settings.clone().with_dt(time / tolerance::count(steps));
    let mut rollout = Rollout::new(scene, settings, q, v).unwrap();
    let torque = Torque::Constant(Broadcast::new("tau", u, scene.nv(), &[], &[]).unwrap());
    rollout.advance(steps, &torque, None).unwrap();
    let (q, v) = rollout.state(0);
    (q.to_vec(), v.to_vec())
}

/// Largest difference, positions on the manifold.
fn distance(scene: &Scene, a: &(Vec<f64>, Vec<f64>), b: &(Vec<f64>, Vec<f64>)) -> f64 {
    let mut s = vec![f64::NAN; scene.nv()];
    scene.difference(&a.0, &b.0, &mut s).unwrap();
    let rates = a.1.iter().zip(&b.1).map(|(a, b)| a - b);
    // NaN propagates.
    s.iter().copied().chain(rates).map(f64::abs).fold(0.0, |m, x| if x <= m { m } else { x })
}

#[test]
fn every_method_has_its_order() {
    let cases = [
        (tree(&[JointKind::Revolute, JointKind::Prismatic, JointKind::Screw { pitch: 0.2 }], false), 0.2),
        (tree(&[JointKind::Spherical, JointKind::Revolute, JointKind::Planar], true), 0.1),
        (tree(&[JointKind::Floating, JointKind::Spherical], false), 0.1),
    ];
    for (k, (scene, time)) in cases.iter().enumerate() {
        let mut random = Random::new(7);
        let (q, v, u) = random_state(scene, &mut random);
        let mut settings = settings(scene, &q, &mut random);
        let state = (&q[..], &v[..], &u[..]);
        let exact = reference(scene, &settings, state, *time, 400);
        for (name, method) in METHODS {
            settings.method = method;
            let steps = [0, 128, 64, 32, 24, 16][method.order() as usize];
            let errors =
                [steps, 2 * steps].map(|steps| distance(scene, &after(scene, &settings, state, *time, steps), &exact));
            let order = (errors[0] / errors[1]).log2();
            println!("case {k}, {name}: errors {errors:?}, order {order:.3}");
            // Near the rounding error, errors of order 5 decrease faster.
            let faster = if method.order() == 5 { 1.0 } else { tolerance::ORDER };
            let above = order - f64::from(method.order());
            assert!((-tolerance::ORDER..=faster).contains(&above), "{name}: {order}, {errors:?}");
        }
    }
}

#[test]
fn rows_are_recorded_and_calls_may_be_cut_anywhere() {
    let scene = tree(&ALL_KINDS, true);
    let mut random = Random::new(3);
    let states: Vec<_> = (0..19).map(|_| random_state(&scene, &mut random)).collect();
    let q: Vec<f64> = states.iter().flat_map(|state| state.0.clone()).collect();
    let v: Vec<f64> = states.iter().flat_map(|state| state.1.clone()).collect();
    let (nq, nv, rows, every) = (scene.nq(), scene.nv(), 4, 3);
    let torques = random.array(19 * 10 * nv, 2.0);
    let torque = Broadcast::new("tau", &torques, 10 * nv, &[19], &[19]).unwrap();
    let mut settings = settings(&scene, &q[..nq], &mut random);
    settings.dt = 1e-3;
    for (_, method) in METHODS {
        settings.method = method;
        let run = |cuts: &[usize]| {
            let mut rollout = Rollout::new(&scene, settings.clone(), &q, &v).unwrap();
            let (mut out_q, mut out_v) = (vec![f64::NAN; 19 * rows * nq], vec![f64::NAN; 19 * rows * nv]);
            for &cut in cuts {
                let mut records = Records { q: &mut out_q, qd: &mut out_v, contacts: &mut [], every };
                let torque = Torque::Steps { torque: torque.clone(), first: 0 };
                rollout.advance(cut, &torque, Some(&mut records)).unwrap();
            }
            (out_q, out_v)
        };
        let whole = run(&[10]);
        assert!(whole.0.iter().chain(&whole.1).all(|x| x.is_finite()));
        assert_eq!(whole.0[..nq], q[..nq]);
        assert_eq!(whole, run(&[1, 2, 4, 3]));
        // One state alone, step by step.
        let mut alone = Rollout::new(&scene, settings.clone(), &q[11 * nq..12 * nq], &v[11 * nv..12 * nv]).unwrap();
        for n in 0..9 {
            let u = &torques[(11 * 10 + n) * nv..][..nv];
            let torque = Torque::Constant(Broadcast::new("tau", u, nv, &[], &[]).unwrap());
            alone.advance(1, &torque, None).unwrap();
        }
        assert_eq!(alone.state(0).0, &whole.0[(11 * rows + 3) * nq..][..nq]);
        assert_eq!(alone.state(0).1, &whole.1[(11 * rows + 3) * nv..][..nv]);
    }
}

/// Without optimization the lane kernels need more stack than a thread has by default.
fn on_a_large_stack(work: impl FnOnce() + Send + 'static) {
    std::thread::Builder::new().stack_size(256 << 20).spawn(work).unwrap().join().unwrap();
}

#[test]
fn lanes_move_as_one_state_does() {
    on_a_large_stack(|| {
        for (seed, floating) in [(1, false), (2, true)] {
            let scene = Tree { seed, bodies: 4, kinds: &ALL_KINDS, branching: 0.4, armature: 0.2, floating }.scene();
            let mut random = Random::new(seed);
            let states: Vec<_> = (0..11).map(|_| random_state(&scene, &mut random)).collect();
            let q: Vec<f64> = states.iter().flat_map(|state| state.0.clone()).collect();
            let v: Vec<f64> = states.iter().flat_map(|state| state.1.clone()).collect();
            let mut settings = settings(&scene, &states[0].0, &mut random);
            settings.dt = 1e-3;
            for form in [Form::Auto, Form::Covariance] {
                for (name, method) in METHODS {
                    (settings.method, settings.form) = (method, form);
                    let mut found = Vec::new();
                    for arm in INSTRUCTION_SETS.into_iter().map(|(_, arm)| arm).filter(|arm| arm.available()) {
                        settings.arm = arm;
                        // Few enough steps that no other thread, with a smaller stack, is used.
                        let mut rollout = Rollout::new(&scene, settings.clone(), &q, &v).unwrap();
                        rollout.advance(2, &Torque::Zero, None).unwrap();
                        let all: Vec<_> = (0..11).map(|i| rollout.state(i)).collect();
                        found.push(all.iter().map(|(q, v)| (q.to_vec(), v.to_vec())).collect::<Vec<_>>());
                    }
                    for other in &found[1..] {
                        for (a, b) in found[0].iter().zip(other) {
                            let size = a.1.iter().fold(1.0_f64, |m, x| m.max(x.abs()));
                            let off = distance(&scene, a, b);
                            assert!(off <= tolerance::inverse(1e3, size), "{name}: {off:e}");
                        }
                    }
                }
            }
        }
    });
}

/// A pendulum of three rods with springs at all joints except the first; gravity and motion load the springs.
fn sprung(stiffness: f64) -> (Scene, Settings) {
    let scene = crate::common::swinging(3);
    let mut settings = Settings::new(&scene, 1e-3);
    settings.properties.stiffness = vec![0.0, stiffness, stiffness];
    (scene, settings)
}

/// With the springs of [`sprung`] at rest, the rods are one body: the scene with these joints locked.
fn rigid(scene: &Scene) -> Scene {
    scene.lock(&["j1", "j2"], &[0.0; 3]).unwrap()
}

#[test]
fn springs_of_a_billion_are_stable_and_followed_on_the_slow_manifold() {
    let (scene, mut settings) = sprung(1e9);
    let (q, v, u) = ([0.3, 0.0, 0.0], [0.5, 0.0, 0.0], [0.4, 0.0, 0.0]);
    let slow = rigid(&scene);
    let exact = reference(&slow, &Settings::new(&slow, 1.0), (&q[..1], &v[..1], &u[..1]), 0.2, 2000);
    // The deflection of the springs moves the rods by as much as the error of the third order.
    let fine = settings.clone().with_method(Method::Rosenbrock3);
    let elastic = after(&scene, &fine, (&q, &v, &u), 0.2, 3200).0[0];
    assert!((elastic - exact.0[0]).abs() <= tolerance::SLOW_ORDER_3, "{elastic}");
    for method in [Method::ImplicitEuler, Method::Rosenbrock2, Method::Rosenbrock3] {
        settings.method = method;
        let swung = |steps: usize| {
            let (q, v) = after(&scene, &settings, (&q, &v, &u), 0.2, steps);
            let bent = q[1].abs().max(q[2].abs());
            // They deflect only under their load.
            assert!((tolerance::BENT_LEAST..=tolerance::BENT).contains(&bent), "{method:?}: {bent:e}");
            (q[0], v[0])
        };
        let found = [200, 400].map(swung);
        let errors = found.map(|(q, v)| (q - exact.0[0]).abs().max((v - exact.1[0]).abs()));
        let [coarse, half] = found.map(|(q, _)| (q - elastic).abs());
        let order = (coarse / half).log2();
        println!("{method:?}: {errors:?}, beside the sprung rods {coarse:.1e} {half:.1e}, order {order:.3}");
        // No order reduction here: the fast modes are damped.
        assert!((order - f64::from(method.order())).abs() <= tolerance::ORDER, "{method:?}: {order}, {errors:?}");
        assert!(errors[0] <= tolerance::SLOW, "{method:?}: {errors:?}");
        if method == Method::Rosenbrock3 {
            assert!(errors[0] <= tolerance::SLOW_ORDER_3, "{errors:?}");
        }
    }
    for method in [Method::SemiImplicitEuler, Method::RungeKutta4] {
        settings.method = method;
        let mut rollout = Rollout::new(&scene, settings.clone(), &q, &v).unwrap();
        let fault = rollout.advance(200, &Torque::Zero, None).expect_err("an explicit step of a stiff spring");
        assert!(fault.joint.starts_with('j') && fault.error.to_string().contains("diverged"), "{fault:?}");
    }
}

#[test]
fn stiff_gains_hold_a_target_that_explicit_steps_lose() {
    let scene = phipsi::scenes::chain(5).unwrap();
    let mut settings = Settings::new(&scene, 1e-2);
    settings.method = Method::ImplicitEuler;
    let target = vec![0.4, -0.3, 0.2, 0.5, -0.6];
    settings.gains = Some(Gains::new([1e8; 5], [1e6; 5], target.clone()));
    let mut rollout = Rollout::new(&scene, settings, &[0.0; 5], &[0.0; 5]).unwrap();
    rollout.advance(1000, &Torque::Zero, None).unwrap();
    for (q, target) in rollout.state(0).0.iter().zip(&target) {
        assert!((q - target).abs() <= tolerance::BENT, "{q} beside {target}");
    }
}

#[test]
fn friction_stops_a_joint_and_does_not_turn_it_round() {
    let rod = Inertial { mass: 1.0, center: [0.0; 3].into(), central: Symmetric3::new([0.1, 0.0, 0.0, 0.1, 0.0, 0.1]) };
    let mut joint = JointDescription::new("wheel", JointKind::Continuous, "base", "rod");
    (joint.friction, joint.damping) = (2.0, 0.1);
    let scene = SceneBuilder::new()
        .link(LinkDescription { name: "base".into(), inertial: None })
        .link(LinkDescription { name: "rod".into(), inertial: Some(rod) })
        .joint(joint)
        .build()
        .unwrap();
    assert_eq!(Properties::of(&scene).friction, [2.0]);
    let mut settings = Settings::new(&scene, 0.01);
    settings.method = Method::ImplicitEuler;
    let mut rollout = Rollout::new(&scene, settings, &[0.0], &[3.0]).unwrap();
    let mut before = 3.0;
    for _ in 0..100 {
        rollout.advance(1, &Torque::Zero, None).unwrap();
        let v = rollout.state(0).1[0];
        assert!(v >= 0.0 && v <= before, "{v} after {before}");
        before = v;
    }
    assert!(before <= 1e-6, "{before}");
}

/// Friction as measurement noise varies with the steps: a floating body has none when the scene is built.
#[test]
fn friction_of_a_floating_body_does_not_turn_it_round() {
    let central = Symmetric3::new([0.1, 0.0, 0.0, 0.1, 0.0, 0.1]);
    let inertial = Some(Inertial { mass: 1.0, center: [0.0; 3].into(), central });
    let link = LinkDescription { name: "base".into(), inertial };
    let scene = SceneBuilder::new().gravity([0.0; 3]).floating_base(true).link(link).build().unwrap();
    for form in [Form::Covariance, Form::Auto] {
        let mut settings = Settings::new(&scene, 0.1);
        (settings.method, settings.form) = (Method::ImplicitEuler, form);
        (settings.properties.friction, settings.properties.friction_speed) = (vec![1.0; 6], 0.01);
        let mut rollout = Rollout::new(&scene, settings, &scene.neutral(), &[1e-3; 6]).unwrap();
        rollout.advance(1, &Torque::Zero, None).unwrap();
        for v in rollout.state(0).1 {
            assert!(*v > 0.0 && *v < 1e-3, "{form:?}: {v}");
        }
    }
}

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
    for (name, method) in METHODS {
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
    for (name, method) in METHODS {
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

/// q, qd and torque.
type State = (Vec<f64>, Vec<f64>, Vec<f64>);

/// A tree of six bodies on a free joint; all forces act at its joints, none at the free joint.
fn floating(kinds: &[JointKind], gravity: [f64; 3]) -> (Scene, Settings, State) {
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
        for (name, method) in METHODS {
            settings.method = method;
            let worst = |conserve_momentum: bool| {
                let settings = settings.clone().with_conserve_momentum(conserve_momentum);
                let mut rollout = Rollout::new(&scene, settings, &q, &v).unwrap();
                let torque = Torque::Constant(Broadcast::new("tau", &u, scene.nv(), &[], &[]).unwrap());
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
    for (name, method) in METHODS {
        settings.method = method;
        let steps = [0, 128, 64, 32, 24, 16][method.order() as usize];
        let found = [steps, 2 * steps].map(|steps| {
            let settings = settings.clone().with_dt(time / tolerance::count(steps));
            let mut rollout = Rollout::new(&scene, settings, &q, &v).unwrap();
            let torque = Torque::Constant(Broadcast::new("tau", &u, scene.nv(), &[], &[]).unwrap());
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
    for (name, method) in METHODS {
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
            for (name, method) in METHODS {
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
                for arm in INSTRUCTION_SETS.into_iter().map(|(_, arm)| arm).filter(|arm| arm.available()) {
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
    refused(&|s| s.gains.as_mut().unwrap().proportional[2] = 7.0, &["pd.kp 7"]);
    refused(&|s| s.gains.as_mut().unwrap().derivative[4] = 7.0, &["pd.kd 7"]);

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
    for (name, method) in METHODS {
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
    let mut records = Records { q: &mut out_q, qd: &mut out_v, contacts: &mut [], every: 1 };
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
    let torque = Torque::Constant(Broadcast::new("tau", &[0.0; 3], 3, &[], &[]).unwrap());
    assert!(matches!(rollout.advance(1, &torque, None).expect_err("refused").error, Error::Shape { .. }));
    let (mut q, mut qd) = (vec![0.0; 4], vec![0.0; 4]);
    let mut records = Records { q: &mut q, qd: &mut qd, contacts: &mut [], every: 1 };
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
        let one = Torque::Constant(Broadcast::new("tau", &u[..nv], nv, &[], &[]).unwrap());
        for form in [Form::Auto, Form::Covariance] {
            for (name, method) in METHODS {
                (settings.method, settings.form) = (method, form);
                for arm in INSTRUCTION_SETS.into_iter().map(|(_, arm)| arm).filter(|arm| arm.available()) {
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
        for conserve_momentum in [false, true] {
            let (scene, mut settings, (_, _, u)) = floating(&ALL_KINDS, [0.3, -0.5, -9.6]);
            (settings.dt, settings.conserve_momentum) = (1e-3, conserve_momentum);
            let (q, v, _) = eleven(&scene, 9);
            let (nq, nv) = (scene.nq(), scene.nv());
            let (own_q, own_v) = (|i: usize| &q[i * nq..(i + 1) * nq], |i: usize| &v[i * nv..(i + 1) * nv]);
            let torque = Torque::Constant(Broadcast::new("tau", &u, nv, &[], &[]).unwrap());
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
                assert_eq!(simulator.correction(state), alone.correction(0));
            }
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
    let three = Torque::Constant(Broadcast::new("tau", &[0.0; 3], 3, &[], &[]).unwrap());
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
