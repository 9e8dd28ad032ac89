//! The types of the crate as a Rust program meets them: errors, names, settings.

use phipsi::batch::{Broadcast, Fault, INSTRUCTION_SETS, InstructionSet};
use phipsi::estimation::{Observer, ObserverSettings, Quantity, Sensor};
use phipsi::filter::FORMS;
use phipsi::function_table::FUNCTIONS;
use phipsi::inverse_kinematics::{Goal, Options, Solver, Task};
use phipsi::kinematics::{ACCELERATION_KINDS, AccelerationKind, REFERENCE_FRAMES, ReferenceFrame};
use phipsi::motion::{Gains, METHODS, Method, Settings, Simulator, StepFault, Torque};
use phipsi::nalgebra::Vector3;
use phipsi::scene::{Contact, Property};
use phipsi::{Algorithm, Arguments, Error, Form, Scene, interrupt, scenes};
use std::fmt::Display;
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A chain whose joints have no inertia about their axes.
fn without_inertia() -> Scene {
    let mut builder = phipsi::SceneBuilder::new();
    for name in ["base", "rod"] {
        builder = builder.link(phipsi::scene::LinkDescription { name: name.into(), inertial: None });
    }
    let hinge = phipsi::scene::JointDescription::new("hinge", phipsi::scene::JointKind::Revolute, "base", "rod");
    builder.joint(hinge).build().unwrap()
}

#[test]
fn faults_are_errors_and_become_errors_of_the_crate() {
    fn of_batch() -> Result<(), Box<dyn std::error::Error>> {
        let scene = scenes::chain(2)?;
        let (fine, bad) = ([0.1; 2], [0.1, f64::NAN]);
        let state = |q| Arguments { q, qd: &[0.0; 2], u: &[0.0; 2], ..Arguments::default() };
        let mut out = [f64::NAN; 4];
        scene.evaluate(&mut scene.evaluator(), Algorithm::InverseDynamics, &[state(&fine), state(&bad)], &mut out)?;
        Ok(())
    }
    fn of_step() -> Result<(), Error> {
        let scene = scenes::chain(2)?;
        let stiff = Settings::new(&scene, 1e-2)
            .with_method(Method::SemiImplicitEuler)
            .with_gains(Gains::new([1e9; 2], [0.0; 2], [1.0; 2]));
        Simulator::new(&scene, stiff, &[0.0; 2], &[0.0; 2])?.step(&Torque::Zero, 1000)?;
        Ok(())
    }
    let error = of_batch().unwrap_err();
    let fault = error.downcast_ref::<Fault>().expect("a fault");
    assert_eq!(fault.state, 1);
    assert!(error.to_string().starts_with("state 1: q: found NaN at index 1"), "{error}");
    let error = of_step().unwrap_err();
    assert!(error.to_string().contains("Method::Auto"), "{error}");
}

#[test]
fn a_fault_of_a_step_names_step_state_and_joint() {
    let scene = scenes::chain(2).unwrap();
    let gains = Gains::new([1e9; 2], [0.0; 2], [1.0; 2]);
    let stiff = Settings::new(&scene, 1e-2).with_method(Method::SemiImplicitEuler).with_gains(gains);
    let mut simulator = Simulator::new(&scene, stiff, &[0.0; 2], &[0.0; 2]).unwrap();
    let fault: StepFault = simulator.step(&Torque::Zero, 1000).unwrap_err();
    let error: &dyn std::error::Error = &fault;
    let expected = format!("step {}, state 0, joint {:?}: {}", fault.step, fault.joint, fault.error);
    assert_eq!(error.to_string(), expected);
    // `?` loses nothing of it.
    assert_eq!(Error::from(fault.clone()).to_string(), expected);
    let Error::Step { step, state, joint, error } = Error::from(fault.clone()) else { panic!("{fault}") };
    assert_eq!((step, state, joint, *error), (fault.step, fault.state, fault.joint, fault.error));
}

/// A solver, a simulator and an observer that own their scene, as fields of a program do.
struct Program {
    solver: Solver<Arc<Scene>>,
    simulator: Simulator<Arc<Scene>>,
    observer: Observer<Arc<Scene>>,
}

#[test]
fn programs_own_solver_simulator_and_observer_and_clone_them() {
    let scene = Arc::new(scenes::chain(3).unwrap());
    let (q, qd, tau) = ([0.3, 0.2, 0.1], [0.0; 3], [0.5, 0.2, 0.1]);
    let sensors = vec![Sensor::new("encoder", Quantity::Encoder(None), 1e-4)];
    let noise = ObserverSettings::new(&scene, 1e-3, sensors).with_torque_noise([0.01; 3]).with_initial([1e-3; 6]);
    let mut program = Program {
        solver: Solver::new(Arc::clone(&scene), &Options::default()).unwrap(),
        simulator: Simulator::new(Arc::clone(&scene), Settings::new(&scene, 1e-3), &q, &qd).unwrap(),
        observer: Observer::new(Arc::clone(&scene), &noise, &q, &qd).unwrap(),
    };
    let frame = scene.frame(&"link2".into()).unwrap();
    let task = Task::new(Goal::Pose { frame, target: scene.placement(&q, frame).unwrap() });
    let mut solver = program.solver.clone();
    for solver in [&mut program.solver, &mut solver] {
        let mut found = [f64::NAN; 3];
        assert!(solver.solve(&mut scene.workspace(), &[task], &[0.0; 3], None, &mut found).unwrap().reached);
    }

    // Clones continue independently, with the same bits.
    let (simulator, observer) = (&mut program.simulator, &mut program.observer);
    simulator.step(&Torque::constant(&tau), 10).unwrap();
    observer.step(&tau, &q).unwrap();
    let (mut other, mut twin) = (simulator.clone(), observer.clone());
    let before = simulator.state(0).0.to_vec();
    other.step(&Torque::from(&tau[..]), 10).unwrap();
    twin.step(&tau, &q).unwrap();
    assert_eq!(simulator.state(0).0, before);
    assert_ne!(other.state(0).0, before);
    simulator.step(&Torque::Constant(Broadcast::new("tau", &tau, 3, &[], &[]).unwrap()), 10).unwrap();
    observer.step(&tau, &q).unwrap();
    assert_eq!((simulator.state(0), simulator.steps()), (other.state(0), other.steps()));
    assert_eq!(observer.estimate(0).unwrap().q(), twin.estimate(0).unwrap().q());
    assert!(simulator.step(&Torque::constant(&tau[..2]), 1).unwrap_err().error.to_string().starts_with("torque: "));
}

#[test]
fn a_stop_function_captures() {
    let (limit, scene) = (Arc::new(AtomicUsize::new(0)), scenes::chain(2).unwrap());
    let mut simulator = Simulator::new(&scene, Settings::new(&scene, 1e-4), &[0.1; 2], &[0.0; 2]).unwrap();
    let own = Arc::clone(&limit);
    let stop = move || own.fetch_add(1, Ordering::Relaxed) == 1;
    let fault = interrupt::during(stop, || simulator.step(&Torque::Zero, usize::MAX >> 1)).unwrap_err();
    assert_eq!((Error::from(fault), limit.load(Ordering::Relaxed)), (Error::Interrupted, 2));
}

#[test]
fn messages_suggest_rust() {
    let chain = scenes::chain(2).unwrap();
    let gains = Gains::new([-1.0; 2], [0.0; 2], [0.0; 2]);
    let settings = Settings::new(&chain, 1e-3).with_gains(gains);
    let error = Simulator::new(&chain, settings, &[0.0; 2], &[0.0; 2]).unwrap_err().to_string();
    assert!(error.starts_with("gains.proportional"), "{error}");
    let scene = without_inertia();
    let error = scene.forward_dynamics(&mut scene.workspace(), &[0.1], &[0.0], &[1.0], &[], &mut [0.0]).unwrap_err();
    assert!(error.to_string().ends_with(r#"scene.with_properties([("hinge", Property::Armature, 1e-3)])"#), "{error}");
    // The suggestion works.
    let scene = scene.with_properties([("hinge", Property::Armature, 1e-3)]).unwrap();
    let mut qdd = [f64::NAN];
    scene.forward_dynamics(&mut scene.workspace(), &[0.1], &[0.0], &[1.0], &[], &mut qdd).unwrap();
    assert!((qdd[0] - 1000.0).abs() <= 1e-9);
}

/// Names that are printed are parsed, and an unknown one is refused with the known ones.
fn round_trip<T: FromStr<Err = Error> + Display + PartialEq + std::fmt::Debug + Copy>(known: &[(&str, T)]) {
    for &(name, value) in known {
        assert_eq!(value.to_string(), name);
        assert_eq!(name.parse::<T>(), Ok(value));
    }
    let refused = "?".parse::<T>().unwrap_err().to_string();
    assert!(known.iter().all(|(name, _)| refused.contains(&format!("{name:?}"))), "{refused}");
}

#[test]
fn names_are_parsed() {
    round_trip::<Form>(FORMS);
    round_trip::<Method>(METHODS);
    round_trip::<ReferenceFrame>(REFERENCE_FRAMES);
    round_trip::<AccelerationKind>(ACCELERATION_KINDS);
    round_trip::<InstructionSet>(INSTRUCTION_SETS);
    assert_eq!("semi-implicit".parse(), Ok(Method::SemiImplicitEuler));
    assert_eq!("contact".parse(), Ok(Method::Contact));
    // Every function with u or a form is an algorithm, unless it has a margin.
    let mut algorithms = 0;
    for entry in FUNCTIONS {
        if let Ok(algorithm) = entry.name.parse::<Algorithm>() {
            assert_eq!(algorithm.to_string(), entry.name);
            assert!(algorithm.form().is_none_or(|form| form == Form::Auto));
            algorithms += 1;
        }
    }
    assert_eq!(algorithms, 14);
    assert!("placement".parse::<Algorithm>().unwrap_err().to_string().contains("\"inverse_dynamics\""));
}

#[test]
fn setters_set_their_own_field() {
    let plain = Contact::new("tip", "link2");
    let contact =
        plain.clone().with_point([0.0, 0.0, 0.3]).with_radius(0.1).with_normal(Vector3::x()).with_friction(0.5);
    assert_eq!(contact.point, Vector3::new(0.0, 0.0, 0.3));
    assert_eq!((contact.radius, contact.normal, contact.friction), (0.1, Vector3::x(), 0.5));
    assert_eq!((contact.name.as_str(), contact.offset, contact.restitution), ("tip", 0.0, 0.0));
    let scene = scenes::chain(2).unwrap();
    let settings = Settings::new(&scene, 1e-3).with_tolerance(1e-6).with_compliance([1.0]);
    assert_eq!((settings.dt, settings.tolerance, settings.compliance), (1e-3, Some(1e-6), vec![1.0]));
}

#[test]
fn views_of_derivatives_are_the_matrices_of_the_slice() {
    let scene = scenes::chain(4).unwrap();
    let out: Vec<f64> = (0..48_u8).map(f64::from).collect();
    let views = scene.derivative_matrices(&out).unwrap();
    for (k, view) in [views.by_q, views.by_qd, views.by_u].into_iter().enumerate() {
        for i in 0..4 {
            for j in 0..4 {
                assert_eq!(view[(i, j)].to_bits(), out[16 * k + 4 * i + j].to_bits());
            }
        }
    }
    assert!(scene.derivative_matrices(&out[1..]).unwrap_err().to_string().starts_with("out: found shape (47,)"));
}
