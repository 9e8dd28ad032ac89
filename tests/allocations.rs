//! No sweep allocates once its workspace exists, and none reads values of a previous call.

use crate::common::loops::{self, four_bar};
use crate::common::{KINDS_WITH_FIXED, Random, Tree, random_state};
use nalgebra::{Vector3, Vector6};
use phipsi::batch::Broadcast;
use phipsi::dynamics::InverseScratch;
use phipsi::dynamics::OperationalScratch;
use phipsi::dynamics::{Estimate, EstimateCovariance, EstimateScratch, Measurements};
use phipsi::inverse_kinematics::{Goal, Options, RateOptions, Solver, Task};
use phipsi::kinematics::{AccelerationKind, ReferenceFrame};
use phipsi::motion::{Gains, METHODS, Method, Settings, Simulator, Torque};
use phipsi::scene::{ConnectionKind, Inertial, JointDescription, JointKind, LinkDescription};
use phipsi::spatial::{RigidShift, Symmetric3};
use phipsi::{Arguments, Form, Scene, Workspace};

/// Additional memory of some algorithms, and error estimates.
struct Scratch {
    inverse: InverseScratch<f64>,
    operational: OperationalScratch<f64>,
    estimation: EstimateScratch<f64>,
    estimate: Estimate<f64>,
    covariance: EstimateCovariance<f64>,
}

impl Scratch {
    fn new(scene: &Scene) -> Self {
        Self {
            inverse: scene.inverse_scratch(),
            operational: scene.operational_scratch(),
            estimation: scene.estimate_scratch(),
            estimate: Estimate::new(scene.model()),
            covariance: EstimateCovariance::new(scene.model()),
        }
    }
}

/// One state of a scene, and memory for every result.
struct State {
    q: Vec<f64>,
    qd: Vec<f64>,
    tau: Vec<f64>,
    wrenches: Vec<Vector6<f64>>,
    noise: Vec<f64>,
    vector: Vec<f64>,
    matrix: Vec<f64>,
}

impl State {
    fn new(scene: &Scene, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let (q, qd, tau) = random_state(scene, &mut random);
        let nv = scene.nv();
        let wrenches =
            scene.model().bodies.iter().map(|_| Vector6::from_fn(|_, _| random.uniform(-3.0, 3.0))).collect();
        Self {
            q,
            qd,
            tau,
            wrenches,
            noise: vec![f64::NAN; nv],
            vector: vec![f64::NAN; nv],
            matrix: vec![f64::NAN; nv * nv],
        }
    }
}

const LINK: &str = "link5";
const WORLD: ReferenceFrame = ReferenceFrame::World;

type Algorithm = fn(&Scene, &mut Workspace<f64>, &mut Scratch, &mut State);

/// Every algorithm that takes a workspace, by name; results are written to the vector or matrix of the state.
const ALGORITHMS: [(&str, Algorithm); 24] = [
    ("forward_dynamics", |scene, w, _, s| {
        scene.forward_dynamics(w, &s.q, &s.qd, &s.tau, &[], &mut s.vector).unwrap();
    }),
    ("forward_dynamics with wrenches", |scene, w, _, s| {
        scene.forward_dynamics(w, &s.q, &s.qd, &s.tau, &s.wrenches, &mut s.vector).unwrap();
    }),
    ("inverse_dynamics", |scene, w, _, s| {
        scene.inverse_dynamics(w, &s.q, &s.qd, &s.tau, &s.wrenches, &mut s.vector).unwrap();
    }),
    ("bias_torque", |scene, w, _, s| scene.bias_torque(w, &s.q, &s.qd, &mut s.vector).unwrap()),
    ("mass_matrix", |scene, w, _, s| scene.mass_matrix(w, &s.q, &mut s.matrix).unwrap()),
    ("mass_matrix_inverse", |scene, w, scratch, s| {
        scene.mass_matrix_inverse(w, &mut scratch.inverse, &s.q, &mut s.matrix).unwrap();
    }),
    ("operational_inverse_inertia", |scene, w, scratch, s| {
        let links = ["link5"];
        let out = &mut s.matrix[..36];
        scene.operational_inverse_inertia(w, &mut scratch.operational, &s.q, &links, out).unwrap();
    }),
    ("estimate", |scene, w, scratch, s| {
        // Every third joint has no sensor, the others have a noisy one.
        for (i, noise) in s.noise.iter_mut().enumerate() {
            *noise = if i % 3 == 0 { f64::INFINITY } else { 0.25 };
        }
        let prior_acceleration = Some(&s.qd[..]);
        let measurements =
            Measurements { torque: &s.tau, noise: &s.noise, prior_acceleration, acceleration_variance: 2.0 };
        let Scratch { estimation, estimate, covariance, .. } = scratch;
        let (q, qd, wrenches) = (&s.q, &s.qd, &s.wrenches);
        scene.estimate(w, estimation, q, qd, &measurements, wrenches, estimate, Some(&mut *covariance)).unwrap();
        s.vector.copy_from_slice(&estimate.torque);
        s.matrix[..covariance.torque.len()].copy_from_slice(&covariance.torque);
    }),
    ("energy", |scene, w, _, s| {
        let energy = scene.energy(w, &s.q, &s.qd).unwrap();
        s.vector[0] = energy.kinetic;
        s.vector[1] = energy.potential;
    }),
    ("momentum", |scene, w, _, s| {
        let momentum = scene.momentum(w, &s.q, &s.qd).unwrap();
        s.vector[..6].copy_from_slice(momentum.as_slice());
    }),
    ("gravity_torque", |scene, w, _, s| scene.gravity_torque(w, &s.q, &mut s.vector).unwrap()),
    ("kinetic_energy", |scene, w, _, s| s.vector[0] = scene.kinetic_energy(w, &s.q, &s.qd).unwrap()),
    ("placement", |scene, _, _, s| {
        s.matrix[..3].copy_from_slice(scene.placement(&s.q, LINK).unwrap().lever.as_slice());
    }),
    ("placements_of", |scene, w, _, s| {
        let mut found = [RigidShift::filled(f64::NAN); 3];
        scene.placements_of(w, &s.q, &[LINK, "base", "link2"], &mut found).unwrap();
        for (found, out) in found.iter().zip(s.matrix.chunks_exact_mut(3)) {
            out.copy_from_slice(found.lever.as_slice());
        }
    }),
    ("velocity", |scene, _, _, s| {
        s.vector[..6].copy_from_slice(scene.velocity(&s.q, &s.qd, LINK, WORLD).unwrap().as_slice());
    }),
    ("acceleration", |scene, _, _, s| {
        let found = scene.acceleration(&s.q, &s.qd, &s.tau, LINK, WORLD, AccelerationKind::Classical).unwrap();
        s.vector[..6].copy_from_slice(found.as_slice());
    }),
    ("jacobian", |scene, _, _, s| {
        let room = 6 * scene.nv();
        scene.jacobian(&s.q, LINK, WORLD, &mut s.matrix[..room]).unwrap();
    }),
    ("jacobian_rate", |scene, _, _, s| {
        let room = 6 * scene.nv();
        scene.jacobian_rate(&s.q, &s.qd, LINK, WORLD, &mut s.matrix[..room]).unwrap();
    }),
    ("jacobian_rate_product", |scene, _, _, s| {
        s.vector[..6].copy_from_slice(scene.jacobian_rate_product(&s.q, &s.qd, LINK, WORLD).unwrap().as_slice());
    }),
    ("center_of_mass", |scene, w, _, s| {
        s.vector[..3].copy_from_slice(scene.center_of_mass(w, &s.q).unwrap().as_slice());
        let velocity = scene.center_of_mass_velocity(w, &s.q, &s.qd).unwrap();
        s.vector[3..6].copy_from_slice(velocity.as_slice());
        let acceleration = scene.center_of_mass_acceleration(w, &s.q, &s.qd, &s.tau).unwrap();
        s.matrix[..3].copy_from_slice(acceleration.as_slice());
    }),
    ("center_of_mass_jacobian", |scene, w, _, s| {
        let room = 3 * scene.nv();
        scene.center_of_mass_jacobian(w, &s.q, &mut s.matrix[..room]).unwrap();
    }),
    ("centroidal_momentum_matrix", |scene, w, _, s| {
        let room = 6 * scene.nv();
        scene.centroidal_momentum_matrix(w, &s.q, &mut s.matrix[..room]).unwrap();
    }),
    ("centroidal_momentum_matrix_rate", |scene, w, _, s| {
        let room = 6 * scene.nv();
        scene.centroidal_momentum_matrix_rate(w, &s.q, &s.qd, &mut s.matrix[..room]).unwrap();
    }),
    ("integrate", |scene, _, _, s| {
        scene.integrate(&s.q, &s.qd, &mut s.matrix[..scene.nq()]).unwrap();
    }),
];

/// Mixed trees with floating bases, so that all types of joints and results occur.
fn scenes() -> impl Iterator<Item = Scene> {
    (0..8).map(|seed| {
        let tree = Tree { seed, bodies: 6, kinds: &KINDS_WITH_FIXED, branching: 0.5, armature: 0.2, floating: true };
        tree.scene()
    })
}

#[test]
fn the_counter_counts() {
    let seen = allocation_counter::measure(|| drop(std::hint::black_box(vec![1.0_f64; 16])));
    assert_eq!(seen.count_total, 1);
}

#[test]
fn algorithms_allocate_nothing() {
    for scene in scenes() {
        let (mut workspace, mut scratch) = (scene.workspace(), Scratch::new(&scene));
        let mut state = State::new(&scene, 1);
        for (name, algorithm) in ALGORITHMS {
            // The first call too: nothing is allocated later.
            let seen = allocation_counter::measure(|| algorithm(&scene, &mut workspace, &mut scratch, &mut state));
            assert_eq!(seen.count_total, 0, "{name}: {seen:?}");
        }
    }
}

/// Products with Jacobians allocate their scratch memory in the first call.
#[test]
fn products_allocate_nothing_after_the_first() {
    for scene in scenes() {
        let (mut workspace, mut state) = (scene.workspace(), State::new(&scene, 1));
        let (mut hessian, mut all) = (scene.hessian_scratch(), vec![0.0; 3 * scene.nv()]);
        let mut whole =
            vec![0.0; scene.width(phipsi::Algorithm::Products(phipsi::Products::gradient(None).with_constants()))];
        let third =
            vec![
                0.1;
                scene.seed_width(phipsi::Algorithm::Products(phipsi::Products::tangent(None).with_constants()), 2)
            ];
        let mut call = |w: &mut Workspace<f64>, s: &mut State| {
            let (q, qd, u, wrenches) = (&s.q, &s.qd, &s.tau, &s.wrenches);
            let direction = [&qd[..], u, qd];
            scene.inverse_dynamics_jvp(w, q, qd, u, wrenches, direction, &mut s.vector).unwrap();
            scene.inverse_dynamics_vjp(w, q, qd, u, wrenches, u, &mut all).unwrap();
            for form in [Form::Auto, Form::Covariance] {
                w.form = form;
                scene.forward_dynamics_jvp(w, q, qd, u, wrenches, direction, &mut s.vector).unwrap();
                scene.forward_dynamics_vjp(w, q, qd, u, wrenches, u, &mut all).unwrap();
            }
            let given = Arguments { q, qd, u, wrenches, seed: [u, &[], &[]], ..Arguments::default() };
            scene.forward_dynamics_gradients(w, q, qd, u, wrenches, u, &mut whole).unwrap();
            let along = Arguments { seed: [u, qd, &third], ..given };
            scene.inverse_dynamics_along(w, &along, &mut s.vector).unwrap();
            scene.forward_dynamics_along(w, &along, &mut s.vector).unwrap();
            scene.forward_dynamics_hvp(w, &mut hessian, &given, direction, &mut all).unwrap();
        };
        call(&mut workspace, &mut state);
        let seen = allocation_counter::measure(|| call(&mut workspace, &mut state));
        assert_eq!(seen.count_total, 0, "{seen:?}");
    }
}

/// The first call allocates scratch in the workspace.
#[test]
fn derivatives_allocate_nothing_after_the_first_call() {
    for scene in scenes() {
        let (mut workspace, state) = (scene.workspace(), State::new(&scene, 1));
        let mut out = vec![f64::NAN; 3 * scene.nv() * scene.nv()];
        let mut call = || {
            let (q, qd, u, wrenches) = (&state.q, &state.qd, &state.tau, &state.wrenches);
            scene.inverse_dynamics_derivatives(&mut workspace, q, qd, u, wrenches, &mut out).unwrap();
            scene.forward_dynamics_derivatives(&mut workspace, q, qd, u, wrenches, &mut out).unwrap();
        };
        call();
        let seen = allocation_counter::measure(&mut call);
        assert_eq!(seen.count_total, 0, "{seen:?}");
    }
}

/// Every kind of task, in the base frame and relative to another link.
fn tasks(scene: &Scene, q: &[f64]) -> Vec<Task> {
    let (frame, other) = (scene.frame(&LINK.into()).unwrap(), scene.frame(&"link2".into()).unwrap());
    let target = scene.placement(q, frame).unwrap();
    let (axis, lever) = (Vector3::z(), target.lever);
    let goals = [
        Goal::Pose { frame, target },
        Goal::Position { frame, target: lever },
        Goal::Orientation { frame, target: target.rotation },
        Goal::Direction { frame, axis, target: target.rotation * axis },
        Goal::LookAt { frame, axis, target: lever + target.rotation * axis },
        Goal::CenterOfMass(scene.center_of_mass(&mut scene.workspace(), q).unwrap()),
    ];
    let relative = Task::new(Goal::Position { frame, target: Vector3::new(0.1, 0.2, 0.3) }).with_relative_to(other);
    goals.into_iter().map(Task::new).chain([relative]).collect()
}

/// With limits, with a posture, and as steps of a control loop with velocity limits of the joints and of the caller.
#[test]
fn inverse_kinematics_allocates_nothing_after_the_first_call() {
    let closed = four_bar(ConnectionKind::Point, [1.0, 2.0, 0.5]);
    let of_loop = loops::state(&closed, 1, 0.5).0;
    let trees = scenes().take(3).map(|scene| {
        let q = State::new(&scene, 5).q;
        (tasks(&scene, &q), q, scene)
    });
    let link = closed.frame(&closed.joints()[0].child.as_str().into()).unwrap();
    let point = Goal::Position { frame: link, target: Vector3::new(0.3, 0.2, 0.1) };
    for (tasks, start, scene) in trees.chain([(vec![Task::new(point)], of_loop, closed)]) {
        let mut workspace = scene.workspace();
        let (mut q, mut qd) = (vec![f64::NAN; scene.nq()], vec![f64::NAN; scene.nv()]);
        let (velocity, mut covariance) = (vec![1.0; scene.nv()], vec![f64::NAN; scene.nv() * scene.nv()]);
        for posture in [None, Some(1.0)] {
            let options = Options::default().with_starts(3).with_iterations(10).with_posture(posture);
            let mut solver = Solver::new(&scene, &options).unwrap();
            let is_tree = scene.constraint_rows() == 0;
            let mut call = || {
                let room = is_tree.then_some(&mut covariance[..]);
                solver.solve(&mut workspace, &tasks, &start, room, &mut q).unwrap();
                let rates = RateOptions::new(0.01);
                solver.rates(&mut workspace, &tasks, &start, &rates, &mut qd).unwrap();
                let limited = rates.with_velocity(&velocity[..]);
                solver.rates(&mut workspace, &tasks, &start, &limited, &mut qd).unwrap();
            };
            call();
            let seen = allocation_counter::measure(&mut call);
            assert_eq!(seen.count_total, 0, "{posture:?}, {} rows: {seen:?}", scene.constraint_rows());
        }
    }
}

/// After any other call with another state, bitwise equal to results with a workspace filled with NaN.
#[test]
fn algorithms_use_nothing_stale() {
    let bits = |state: &State| -> Vec<u64> { state.vector.iter().chain(&state.matrix).map(|x| x.to_bits()).collect() };
    for scene in scenes().take(3) {
        for (name, algorithm) in ALGORITHMS {
            let mut fresh = State::new(&scene, 2);
            algorithm(&scene, &mut scene.workspace(), &mut Scratch::new(&scene), &mut fresh);
            for (earlier_name, earlier) in ALGORITHMS {
                let (mut workspace, mut scratch) = (scene.workspace(), Scratch::new(&scene));
                earlier(&scene, &mut workspace, &mut scratch, &mut State::new(&scene, 3));
                let mut again = State::new(&scene, 2);
                algorithm(&scene, &mut workspace, &mut scratch, &mut again);
                assert_eq!(bits(&fresh), bits(&again), "{name} after {earlier_name}");
            }
        }
    }
}

/// The previous content of an output array has no effect, and every entry is written.
#[test]
fn algorithms_write_all_of_their_results() {
    for scene in scenes().take(3) {
        for (name, algorithm) in &ALGORITHMS[..6] {
            let (mut nan, mut full) = (State::new(&scene, 4), State::new(&scene, 4));
            full.vector.fill(1e9);
            full.matrix.fill(1e9);
            for state in [&mut nan, &mut full] {
                algorithm(&scene, &mut scene.workspace(), &mut Scratch::new(&scene), state);
            }
            let (results, others) =
                if name.starts_with("mass") { (nan.matrix, full.matrix) } else { (nan.vector, full.vector) };
            assert!(results.iter().all(|x| x.is_finite()), "{name}");
            assert_eq!(results, others, "{name}");
        }
    }
}

/// Steps through connections in the kernels, with and without implicit terms; the first step allocates the scratch
/// memory.
#[test]
fn steps_through_connections_allocate_nothing_after_the_first() {
    let scene = four_bar(ConnectionKind::Point, [1.0, 2.0, 0.5]);
    let (q, qd, _) = loops::state(&scene, 1, 0.5);
    for (damping, method) in [(0.0, Method::RungeKutta4), (0.3, Method::Rosenbrock2)] {
        let mut settings = Settings::new(&scene, 1e-3).with_method(method);
        settings.properties.damping.fill(damping);
        for states in [1, 7] {
            let mut simulator =
                Simulator::new(&scene, settings.clone(), &q.repeat(states), &qd.repeat(states)).unwrap();
            let mut step = || simulator.step(&Torque::Zero, 3).unwrap();
            step();
            let seen = allocation_counter::measure(&mut step);
            assert_eq!(seen.count_total, 0, "{method}, {states} states: {seen:?}");
        }
    }
}

/// Exact dry friction, and joints that rest at stops.
#[test]
fn steps_with_friction_and_at_stops_allocate_nothing() {
    for friction in [0.0, 0.3] {
        let mut builder = phipsi::SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
        for k in 0..3 {
            let (parent, child) = (if k == 0 { "base".into() } else { format!("link{}", k - 1) }, format!("link{k}"));
            let inertial = Inertial {
                mass: 1.0,
                center: Vector3::new(0.3, 0.0, 0.0),
                central: Symmetric3::new([0.1, 0.0, 0.0, 0.1, 0.0, 0.1]),
            };
            builder = builder.link(LinkDescription { name: child.clone(), inertial: Some(inertial) });
            let mut joint = JointDescription::new(format!("joint{k}"), JointKind::Revolute, parent, child);
            joint.axis = Vector3::y();
            (joint.limits.lower, joint.limits.upper) = (-0.05, 0.05);
            joint.friction = friction;
            builder = builder.joint(joint);
        }
        let scene = builder.build().unwrap();
        let mut simulator = Simulator::new(&scene, Settings::new(&scene, 1e-3), &[0.0; 3], &[0.0; 3]).unwrap();
        // Until the joints rest at their stops.
        simulator.step(&Torque::Zero, 1_500).unwrap();
        let seen = allocation_counter::measure(|| simulator.step(&Torque::Zero, 10).unwrap());
        assert!((simulator.state(0).0[0] - 0.05).abs() <= 1e-9, "{:?}", simulator.state(0));
        assert_eq!(seen.count_total, 0, "friction {friction}: {seen:?}");
    }
}

/// One state and seven, with all forces that can act, by every method; the first step allocates the scratch memory.
#[test]
fn a_simulator_allocates_nothing_after_its_first_step() {
    for scene in scenes().take(2) {
        let state = State::new(&scene, 5);
        let (nq, nv) = (scene.nq(), scene.nv());
        for &(name, method) in METHODS {
            let mut settings = Settings::new(&scene, 1e-4).with_method(method);
            let p = &mut settings.properties;
            for acting in [&mut p.damping, &mut p.stiffness, &mut p.friction] {
                acting.fill(0.1);
            }
            settings.gains = Some(Gains::new(vec![1.0; nv], vec![0.1; nv], scene.neutral()));
            for states in [1, 7] {
                let (q, qd) = (state.q.repeat(states), state.qd.repeat(states));
                let mut simulator = Simulator::new(&scene, settings.clone(), &q, &qd).unwrap();
                let batch = [states];
                let mut step = || {
                    let torque = Broadcast::new("tau", &state.tau, nv, &[], &batch).unwrap();
                    simulator.step(&Torque::Constant(torque), 1).unwrap();
                };
                step();
                let seen = allocation_counter::measure(&mut step);
                assert_eq!(seen.count_total, 0, "{name}, {states} states: {seen:?}");
                let (start, zero) = (
                    Broadcast::new("q", &state.q, nq, &[], &batch).unwrap(),
                    Broadcast::new("qd", &state.qd, nv, &[], &batch).unwrap(),
                );
                let seen = allocation_counter::measure(|| simulator.reset(&[0], &start, &zero).unwrap());
                assert_eq!(seen.count_total, 0, "reset: {seen:?}");
            }
        }
    }
}
