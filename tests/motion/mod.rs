//! Simulation: the order of every method compared with an independent integration in coordinates, stiff joints,
//! friction and lanes.

use crate::common::{ALL_KINDS, Random, Tree, random_state, tolerance};
use phipsi::batch::{Broadcast, INSTRUCTION_SETS};
use phipsi::filter::Form;
use phipsi::kinematics::coordinate_rates;
use phipsi::motion::{Gains, METHODS, Method, Properties, Records, Rollout, Settings, Torque};
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::spatial::Symmetric3;
use phipsi::{Scene, dynamics};

mod momentum;
mod simulator;

/// q, qd and torque.
type State = (Vec<f64>, Vec<f64>, Vec<f64>);

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
    let torque = Torque::constant(u);
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
        for &(name, method) in METHODS {
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
    for &(_, method) in METHODS {
        settings.method = method;
        let run = |cuts: &[usize]| {
            let mut rollout = Rollout::new(&scene, settings.clone(), &q, &v).unwrap();
            let (mut out_q, mut out_v) = (vec![f64::NAN; 19 * rows * nq], vec![f64::NAN; 19 * rows * nv]);
            for &cut in cuts {
                let mut records = Records::new(&mut out_q, &mut out_v).with_every(every);
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
            let torque = Torque::constant(u);
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
                for &(name, method) in METHODS {
                    (settings.method, settings.form) = (method, form);
                    let mut found = Vec::new();
                    for arm in INSTRUCTION_SETS.iter().map(|&(_, arm)| arm).filter(|arm| arm.available()) {
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
