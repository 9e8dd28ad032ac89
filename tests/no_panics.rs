//! No public call of a scene panics: arguments that are too short, too long or of another scene, and invalid indices,
//! are errors.

use crate::common::loops::four_bar;
use nalgebra::{Matrix3, Vector3};
use phipsi::batch::{Broadcast, Evaluator};
use phipsi::dynamics::derivatives::HessianScratch;
use phipsi::dynamics::{
    ConstraintScratch, Estimate, EstimateCovariance, EstimateScratch, InverseScratch, Measurements, OperationalScratch,
};
use phipsi::inverse_kinematics::{Goal, Options, RateOptions, Task};
use phipsi::kinematics::{AccelerationKind, Frame, ReferenceFrame};
use phipsi::motion::{RecordedRows, Records, Rollout, Settings, Simulator, Torque};
use phipsi::operators::{Factor, Kind, Operator};
use phipsi::scene::{ConnectionKind, Contact, JointKind, Mimic, MimicJoints, Property};
use phipsi::spatial::RigidShift;
use phipsi::{
    Accuracy, Algorithm, Arguments, Derivatives, Error, Form, KinematicQuantity, Products, Scene, Workspace, scenes,
};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Scratch memory for all calls of a scene.
struct Kit {
    workspace: Workspace<f64>,
    inverse: InverseScratch<f64>,
    rows: ConstraintScratch,
    operational: OperationalScratch<f64>,
    hessian: HessianScratch,
    scratch: EstimateScratch<f64>,
    estimate: (Estimate<f64>, EstimateCovariance<f64>),
    evaluator: Evaluator,
    factor: Option<Factor<f64>>,
}

impl Kit {
    fn of(scene: &Scene) -> Self {
        Self {
            workspace: scene.workspace(),
            inverse: scene.inverse_scratch(),
            rows: scene.constraint_scratch(),
            operational: scene.operational_scratch(),
            hessian: scene.hessian_scratch(),
            scratch: scene.estimate_scratch(),
            estimate: (Estimate::new(scene.model()), EstimateCovariance::new(scene.model())),
            evaluator: scene.evaluator(),
            factor: scene.factor(&mut scene.workspace(), &scene.neutral()).ok(),
        }
    }
}

/// The arguments of one state, and the excess length of results.
#[derive(Clone)]
struct Given {
    arrays: [Vec<f64>; 4],
    longer: isize,
}

impl Given {
    fn of(scene: &Scene) -> Self {
        let rates = vec![0.0; scene.nv()];
        Self { arrays: [scene.neutral(), rates.clone(), rates.clone(), rates], longer: 0 }
    }

    fn out(&self, width: usize) -> Vec<f64> {
        vec![f64::NAN; width.checked_add_signed(self.longer).unwrap_or(1)]
    }
}

type Run = Box<dyn Fn(&Scene, &mut Kit, &Given) -> Result<(), Error>>;

/// A call: its name, the number of its arguments, whether its result has a length, and whether it has scratch memory
/// of the scene.
struct Call {
    name: String,
    reads: usize,
    has_result: bool,
    has_scratch: bool,
    run: Run,
}

const FORM: Form = Form::Auto;

fn algorithms() -> Vec<(Algorithm, usize)> {
    vec![
        (Algorithm::ForwardDynamics(FORM), 3),
        (Algorithm::ForwardDynamics(Form::SquareRoot), 3),
        (Algorithm::ConstrainedDynamics(FORM), 3),
        (Algorithm::InverseDynamics, 3),
        (Algorithm::BiasTorque, 2),
        (Algorithm::MassMatrix, 1),
        (Algorithm::MassMatrixInverse(FORM), 1),
        (Algorithm::Derivatives(Derivatives::InverseDynamics), 3),
        (Algorithm::Derivatives(Derivatives::ForwardDynamics(FORM)), 3),
        (Algorithm::Derivatives(Derivatives::CoriolisMatrix), 2),
        (Algorithm::Derivatives(Derivatives::MassMatrix), 2),
        (Algorithm::Products(Products::tangent(None)), 4),
        (Algorithm::Products(Products::gradient(None).with_constants()), 4),
        (Algorithm::Products(Products::gradient(Some(FORM))), 4),
        (Algorithm::Products(Products::gradient(Some(FORM)).with_constants()), 4),
    ]
}

/// All arguments of an algorithm, including those that it ignores.
fn arguments(algorithm: Algorithm, given: &Given) -> Arguments<'_> {
    let [q, qd, u, seed] = &given.arrays;
    let seed = match algorithm {
        Algorithm::Products(which) if which.entry().seeds().len() == 3 => [&seed[..]; 3],
        Algorithm::Products(_) => [&seed[..], &[], &[]],
        _ => [&[][..]; 3],
    };
    Arguments { q, qd, u, wrenches: &[], seed, ..Arguments::default() }
}

fn kinematic_quantities(frame: &Frame<f64>) -> Vec<KinematicQuantity<'_>> {
    let local = ReferenceFrame::Local;
    vec![
        KinematicQuantity::Placement(frame),
        KinematicQuantity::Velocity(frame, local),
        KinematicQuantity::Acceleration(frame, local, AccelerationKind::Spatial),
        KinematicQuantity::Jacobian(frame, local),
        KinematicQuantity::JacobianRate(frame, local),
        KinematicQuantity::JacobianRateProduct(frame, local),
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
    ]
}

/// A frame on a body, or on the base.
fn frame_on(body: Option<usize>) -> Frame<f64> {
    Frame { body, placement: RigidShift { rotation: Matrix3::identity(), lever: Vector3::zeros() } }
}

#[allow(clippy::too_many_lines)] // a list
fn calls() -> Vec<Call> {
    let mut all: Vec<Call> = Vec::new();
    let mut add = |name: &str, (reads, has_result, has_scratch): (usize, bool, bool), run: Run| {
        all.push(Call { name: name.to_owned(), reads, has_result, has_scratch, run });
    };
    for (algorithm, reads) in algorithms() {
        let name = format!("{algorithm:?}");
        add(
            &format!("recursion {name}"),
            (reads, true, true),
            Box::new(move |scene, kit, given| {
                let mut out = given.out(scene.width(algorithm));
                scene.recursion(
                    &mut kit.workspace,
                    Some(&mut kit.inverse),
                    algorithm,
                    &arguments(algorithm, given),
                    &mut out,
                )
            }),
        );
        for states in [1, 5] {
            add(
                &format!("evaluate {states} {name}"),
                (reads, true, true),
                Box::new(move |scene, kit, given| {
                    let mut out = given.out(states * scene.width(algorithm));
                    let states = vec![arguments(algorithm, given); states];
                    Ok(scene.evaluate(&mut kit.evaluator, algorithm, &states, &mut out)?)
                }),
            );
        }
    }
    add(
        "evaluate_with_accuracy",
        (3, true, true),
        Box::new(|scene, kit, given| {
            let state = arguments(Algorithm::InverseDynamics, given);
            let (mut out, mut accuracy) = (given.out(2 * scene.nv()), [Accuracy::unknown(FORM); 2]);
            Ok(scene.evaluate_with_accuracy(&mut kit.evaluator, FORM, &[state; 2], &mut out, &mut accuracy)?)
        }),
    );
    for body in [None, Some(0), Some(99)] {
        let frame = frame_on(body);
        for which in 0..kinematic_quantities(&frame).len() {
            let (what, name) =
                (kinematic_quantities(&frame)[which], format!("{:?}", kinematic_quantities(&frame)[which]));
            let reads = what.reads();
            add(
                &format!("kinematic_quantity {name}"),
                (reads, true, false),
                Box::new(move |scene, kit, given| {
                    let what = kinematic_quantities(&frame)[which];
                    let [q, qd, qdd, _] = &given.arrays;
                    scene.kinematic_quantity(
                        &mut kit.workspace,
                        &what,
                        [q, qd, qdd],
                        &mut given.out(what.width(scene.nv())),
                    )
                }),
            );
            add(
                &format!("evaluate_kinematic_quantity {name}"),
                (reads, true, true),
                Box::new(move |scene, kit, given| {
                    let what = kinematic_quantities(&frame)[which];
                    let [q, qd, qdd, _] = &given.arrays;
                    // Ignored arrays are empty, or have the length of others.
                    let read = |at: usize, x| if at < what.reads() || given.longer == 0 { x } else { &[][..] };
                    let state = Arguments { q, qd: read(1, qd), u: read(2, qdd), ..Arguments::default() };
                    let mut out = given.out(3 * what.width(scene.nv()));
                    Ok(scene.evaluate_kinematic_quantity(&mut kit.evaluator, &what, &[state; 3], &mut out)?)
                }),
            );
        }
    }
    macro_rules! method {
        ($name:expr, $traits:expr, |$scene:ident, $kit:ident, $given:ident, $q:ident, $qd:ident, $u:ident, $seed:ident| $body:expr) => {
            add(
                $name,
                $traits,
                Box::new(|$scene: &Scene, $kit: &mut Kit, $given: &Given| {
                    let [$q, $qd, $u, $seed] = &$given.arrays;
                    let _ = (&$kit, &$q, &$qd, &$u, &$seed);
                    $body
                }),
            );
        };
    }
    method!("forward_dynamics", (3, true, true), |s, k, g, q, qd, u, _x| {
        s.forward_dynamics(&mut k.workspace, q, qd, u, &[], &mut g.out(s.nv()))
    });
    method!("gravity_torque", (1, true, true), |s, k, g, q, _qd, _u, _x| {
        s.gravity_torque(&mut k.workspace, q, &mut g.out(s.nv()))
    });
    method!("mass_matrix_inverse", (1, true, true), |s, k, g, q, _qd, _u, _x| {
        s.mass_matrix_inverse(&mut k.workspace, &mut k.inverse, q, &mut g.out(s.nv() * s.nv()))
    });
    method!("mass_matrix_inverse, own workspace", (1, true, true), |s, k, g, q, _qd, _u, _x| {
        s.mass_matrix_inverse(&mut s.workspace(), &mut k.inverse, q, &mut g.out(s.nv() * s.nv()))
    });
    method!("linearize", (3, true, true), |s, k, g, q, qd, u, _x| {
        let (mut a, mut b) = (g.out(4 * s.nv() * s.nv()), g.out(2 * s.nv() * s.nv()));
        s.linearize(&mut k.workspace, q, qd, u, &[], (&mut a, &mut b))
    });
    method!("inverse_dynamics_hvp", (4, true, true), |s, k, g, q, qd, u, x| {
        let state = Arguments { q, qd, u, wrenches: &[], seed: [x, &[], &[]], ..Arguments::default() };
        s.inverse_dynamics_hvp(&mut k.hessian, &state, [x, x, x], &mut g.out(3 * s.nv()))
    });
    method!("forward_dynamics_hvp", (4, true, true), |s, k, g, q, qd, u, x| {
        let state = Arguments { q, qd, u, wrenches: &[], seed: [x, &[], &[]], ..Arguments::default() };
        s.forward_dynamics_hvp(&mut s.workspace(), &mut k.hessian, &state, [x, x, x], &mut g.out(3 * s.nv()))
    });
    method!("energy", (2, false, true), |s, k, _g, q, qd, _u, _x| s.energy(&mut k.workspace, q, qd).map(drop));
    method!("kinetic_energy", (2, false, true), |s, k, _g, q, qd, _u, _x| {
        s.kinetic_energy(&mut k.workspace, q, qd).map(drop)
    });
    method!("momentum", (2, false, true), |s, k, _g, q, qd, _u, _x| s.momentum(&mut k.workspace, q, qd).map(drop));
    method!("placements", (1, false, false), |s, _k, _g, q, _qd, _u, _x| s.placements(q).map(drop));
    method!("placements_of", (1, true, true), |s, k, g, q, _qd, _u, _x| {
        let mut out = vec![RigidShift::identity(); 1_usize.saturating_add_signed(g.longer)];
        s.placements_of(&mut k.workspace, q, &[s.links()[0].name.as_str()], &mut out)
    });
    method!("constraint_error", (1, true, false), |s, _k, g, q, _qd, _u, _x| {
        s.constraint_error(q, &mut g.out(s.constraint_rows()))
    });
    method!("constraint_jacobian", (1, true, true), |s, k, g, q, _qd, _u, _x| {
        let mut out = g.out(s.constraint_rows() * s.nv());
        s.constraint_jacobian(&mut s.workspace(), &mut k.rows, q, &mut out)
    });
    method!("constraint_bias", (2, true, true), |s, k, g, q, qd, _u, _x| {
        s.constraint_bias(&mut s.workspace(), &mut k.rows, q, qd, &mut g.out(s.constraint_rows()))
    });
    method!("constrained_dynamics", (3, true, true), |s, k, g, q, qd, u, _x| {
        let (mut qdd, mut forces) = (g.out(s.nv()), g.out(s.constraint_rows()));
        s.constrained_dynamics(&mut s.workspace(), &mut k.rows, q, qd, u, &[], (&mut qdd, &mut forces)).map(drop)
    });
    method!("constrained_inverse_dynamics", (3, true, true), |s, k, g, q, qd, u, _x| {
        let (mut tau, mut forces) = (g.out(s.nv()), g.out(s.constraint_rows()));
        let out = (&mut tau[..], &mut forces[..]);
        s.constrained_inverse_dynamics(&mut s.workspace(), &mut k.rows, q, qd, u, &[], &[], out).map(drop)
    });
    method!("constrained_mass_matrix_inverse", (1, true, true), |s, k, g, q, _qd, _u, _x| {
        s.constrained_mass_matrix_inverse(&mut s.workspace(), &mut k.rows, q, &mut g.out(s.nv() * s.nv()))
    });
    method!("project", (2, false, true), |s, k, _g, q, qd, _u, _x| {
        let (mut q, mut qd) = (q.clone(), qd.clone());
        s.project(&mut s.workspace(), &mut k.rows, &mut q, Some(&mut qd)).map(drop)
    });
    method!("contact_gaps", (1, true, false), |s, _k, g, q, _qd, _u, _x| {
        s.contact_gaps(q, &mut g.out(s.contacts().len()))
    });
    method!("contact_velocities", (2, true, false), |s, _k, g, q, qd, _u, _x| {
        s.contact_velocities(q, qd, &mut g.out(3 * s.contacts().len()))
    });
    method!("estimate", (3, false, true), |s, k, _g, q, qd, u, _x| {
        let noise = vec![0.1; s.nv()];
        let said = Measurements { torque: u, noise: &noise, prior_acceleration: None, acceleration_variance: 100.0 };
        let Kit { scratch, estimate: (mean, covariance), .. } = k;
        s.estimate(&mut s.workspace(), scratch, q, qd, &said, &[], mean, Some(covariance))
    });
    method!("operational_inertia", (1, true, true), |s, k, g, q, _qd, _u, _x| {
        let link = [s.links().last().map_or("", |link| link.name.as_str())];
        let directions = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0];
        s.operational_inertia(&mut s.workspace(), &mut k.operational, q, &link, Some(&directions), &mut g.out(1))
    });
    method!("operational_inverse_inertia", (1, true, true), |s, k, g, q, _qd, _u, _x| {
        let link = [s.links().last().map_or("", |link| link.name.as_str())];
        s.operational_inverse_inertia(&mut s.workspace(), &mut k.operational, q, &link, &mut g.out(36))
    });
    method!("factor", (1, false, true), |s, k, _g, q, _qd, _u, _x| s.factor(&mut k.workspace, q).map(drop));
    method!("update_factor", (1, false, true), |s, k, _g, q, _qd, _u, _x| match &mut k.factor {
        Some(factor) => s.update_factor(&mut s.workspace(), factor, q).map(drop),
        None => s.factor(&mut k.workspace, q).map(drop),
    });
    method!("integrate", (2, true, false), |s, _k, g, q, qd, _u, _x| s.integrate(q, qd, &mut g.out(s.nq())));
    method!("difference", (1, true, false), |s, _k, g, q, _qd, _u, _x| s.difference(q, q, &mut g.out(s.nv())));
    method!("lock", (1, false, false), |s, _k, _g, q, _qd, _u, _x| s.lock(&[], q).map(drop));
    method!("inverse_kinematics", (1, true, true), |s, k, g, q, _qd, _u, _x| {
        let task = Task::new(Goal::Position { frame: frame_on(Some(0)), target: Vector3::new(0.1, 0.0, 0.1) });
        let mut solver = s.inverse_kinematics(&Options::default().with_starts(2).with_iterations(5))?;
        solver.solve(&mut k.workspace, &[task], q, None, &mut g.out(s.nq())).map(drop)
    });
    method!("inverse_kinematics_rates", (1, true, true), |s, k, g, q, _qd, _u, _x| {
        let task = Task::new(Goal::Position { frame: frame_on(Some(0)), target: Vector3::new(0.1, 0.0, 0.1) });
        let options = RateOptions::new(0.01).with_gain(0.1).with_damping(1e-3).with_limits(false);
        let mut solver = s.inverse_kinematics(&Options::default())?;
        solver.rates(&mut k.workspace, &[task], q, &options, &mut g.out(s.nv()))
    });
    all
}

/// Scenes of each kind: trees, one with a loop, one with coupled joints, one with a floating base, one with a
/// contact.
fn each_kind() -> Vec<(&'static str, Scene)> {
    let floating = scenes::chain(3).unwrap().source().clone().floating_base(true).build().unwrap();
    let touching = scenes::chain(3).unwrap().source().clone().contact(Contact::new("tip", "link2")).build().unwrap();
    vec![
        ("tree", scenes::chain(3).unwrap()),
        ("loop", four_bar(ConnectionKind::Point, [1.0; 3])),
        ("mimic", mimic(3)),
        ("floating", floating),
        ("contact", touching),
    ]
}

/// A chain whose second joint follows the third.
fn mimic(bodies: usize) -> Scene {
    let plain = scenes::chain(bodies).unwrap();
    let mut builder = phipsi::SceneBuilder::new();
    for link in plain.source().links() {
        builder = builder.link(link.clone());
    }
    let names: Vec<String> = plain.source().joints().iter().map(|joint| joint.name.clone()).collect();
    for (at, joint) in plain.source().joints().iter().enumerate() {
        let mut joint = joint.clone();
        joint.mimic = (at == 1).then(|| Mimic::of(names[2].clone()));
        builder = builder.joint(joint);
    }
    builder.mimic_joints(MimicJoints::Coupled).build().unwrap()
}

/// Runs a call; a panic fails the test.
fn run(what: &str, call: &Call, scene: &Scene, kit: &mut Kit, given: &Given) -> Result<(), Error> {
    let caught = catch_unwind(AssertUnwindSafe(|| (call.run)(scene, kit, given)));
    caught.unwrap_or_else(|_| panic!("{} panics: {what}", call.name))
}

#[test]
fn short_long_and_foreign_arguments_are_errors() {
    crate::common::lanes::on_a_large_stack(|| {
        let calls = calls();
        for (kind, scene) in each_kind() {
            let valid = Given::of(&scene);
            // The same links with another mass, and one of another size: with equal or different lengths.
            let heavier = scene.with_properties([(scene.joints()[0].name.as_str(), Property::Armature, 0.7)]).unwrap();
            let longer = scenes::chain(5).unwrap();
            let mut others: Vec<Kit> = [&heavier, &longer, scene.tree()].into_iter().map(Kit::of).collect();
            let foreign = if scene.coupling().is_some() { 3 } else { 2 };
            for call in &calls {
                let kit = &mut Kit::of(&scene);
                let works = run(kind, call, &scene, kit, &valid).is_ok();
                for (at, array) in valid.arrays.iter().enumerate() {
                    for length in [0, array.len() - 1, array.len() + 1] {
                        let mut broken = valid.clone();
                        broken.arrays[at].resize(length, 0.0);
                        let what = format!("{kind}, argument {at} with {length} of {} numbers", array.len());
                        let outcome = run(&what, call, &scene, kit, &broken);
                        assert!(outcome.is_err() || at >= call.reads, "{} accepts {what}", call.name);
                    }
                }
                for longer in [-1, 1] {
                    let outcome =
                        run(&format!("{kind}, result {longer}"), call, &scene, kit, &Given { longer, ..valid.clone() });
                    assert!(
                        outcome.is_err() || !call.has_result,
                        "{} accepts a result {longer} longer, {kind}",
                        call.name
                    );
                }
                for (at, other) in others[..foreign].iter_mut().enumerate() {
                    let outcome = run(&format!("{kind}, foreign scratch {at}"), call, &scene, other, &valid);
                    // The scratch memory of the tree is that of a scene with coupled joints, except for the
                    // evaluator.
                    let own = at == 2 && !call.name.starts_with("evaluate");
                    let refused =
                        matches!(outcome, Err(Error::Argument { ref found, .. }) if found.contains("another scene"));
                    let fits = !call.has_scratch || own || !works;
                    assert!(refused || fits, "{} of {kind} with foreign scratch {at}: {outcome:?}", call.name);
                }
            }
        }
    });
}

#[test]
fn calls_with_numbers_that_overflow_return() {
    crate::common::lanes::on_a_large_stack(|| {
        let calls = calls();
        let mut kinds = each_kind();
        kinds.extend(
            [ConnectionKind::Axis(Vector3::y()), ConnectionKind::Weld, ConnectionKind::Distance(Some(0.3))]
                .map(|kind| ("loop of another kind", four_bar(kind, [1.0; 3]))),
        );
        for (kind, scene) in kinds {
            let kit = &mut Kit::of(&scene);
            for call in &calls {
                for size in [1e100, 1e155, 1e300, f64::MAX] {
                    for at in 0..call.reads {
                        let mut given = Given::of(&scene);
                        // The positions of a free joint come before its quaternion.
                        given.arrays[at].iter_mut().take(3).for_each(|x| *x = size);
                        let _ = run(&format!("{kind}, argument {at} of {size:e}"), call, &scene, kit, &given);
                    }
                }
            }
        }
    });
}

#[test]
fn indices_and_sizes_that_are_not_there_are_errors() {
    let scene = scenes::chain(2).unwrap();
    let huge = [1 << 40, 1 << 40];
    assert!(Broadcast::new("x", &[0.0; 2], 2, &[], &huge).is_ok());
    assert!(Broadcast::new("x", &[0.0; 2], 2, &huge, &huge).is_err());
    assert!(Broadcast::new("x", &[0.0; 2], usize::MAX, &[3], &[3]).is_err());

    let settings = Settings::new(&scene, 1e-3);
    let mut simulator = Simulator::new(&scene, settings.clone(), &[0.0; 4], &[0.0; 4]).unwrap();
    let one = Broadcast::new("q", &[0.0; 2], 2, &[], &[]).unwrap();
    let two = Broadcast::new("q", &[0.0; 4], 2, &[2], &[2]).unwrap();
    assert!(simulator.reset(&[0, 1], &two, &one).is_ok());
    assert!(simulator.reset(&[0, 1, 0], &two, &one).is_err());
    assert!(simulator.reset(&[2], &one, &one).is_err());
    for wrong in
        [Broadcast::new("tau", &[], 2, &[0], &[0]).unwrap(), Broadcast::new("tau", &[0.0; 3], 3, &[], &[]).unwrap()]
    {
        assert!(simulator.step(&Torque::Constant(wrong), 1).is_err());
    }
    assert!(simulator.step(&Torque::Zero, 1).is_ok());
    assert!(simulator.step(&Torque::Zero, usize::MAX).is_err());
    for panics in [|of: &Simulator<&Scene>| of.time(9), |of: &Simulator<&Scene>| of.state(9).0[0]] {
        // As documented, with a message.
        let caught = catch_unwind(AssertUnwindSafe(|| panics(&simulator))).unwrap_err();
        let words = caught.downcast_ref::<String>().map_or("", String::as_str);
        assert!(words.contains('9'), "{words}");
    }

    let mut rollout = Rollout::new(&scene, settings, &[0.0; 4], &[0.0; 4]).unwrap();
    let (mut few_q, mut few_qd) = ([0.0; 3], [0.0; 4]);
    let mut few = Records::new(&mut few_q, &mut few_qd);
    assert!(rollout.advance(1, &Torque::Zero, Some(&mut few)).is_err());
    let rows = RecordedRows { q: &[0.0; 4], qd: &[], every: 1, by_q: &[], by_qd: &[] };
    for steps in [0, 1, usize::MAX] {
        assert!(rollout.gradients(&Torque::Zero, steps, &rows, true).is_err());
    }

    let factor = scene.factor(&mut scene.workspace(), &[0.3; 2]).unwrap();
    for (x, y) in [(1, 2), (2, 1), (0, 0), (3, 3)] {
        let caught = catch_unwind(|| factor.operator(Kind::K).apply(&vec![0.0; x], &mut vec![0.0; y])).unwrap_err();
        let words = caught.downcast_ref::<String>().map_or("", String::as_str);
        assert!(words.contains("(2, 2)"), "{words}");
    }
    assert!(scene.placement(&[0.0; 2], frame_on(Some(99))).is_err());
    assert!(scene.placement(&[0.0; 2], "nobody").is_err());
    assert!(scene.lock(&["nobody"], &[0.0; 2]).is_err());
    assert!(scene.body_wrenches([("nobody", nalgebra::Vector6::zeros())]).is_err());
}

#[test]
fn the_plan_of_joints_that_follow_each_other_is_that_of_the_tree() {
    let scene = mimic(3);
    assert_eq!(scene.plan(), scene.tree().plan());
    assert!(scene.plan().bodies == 3 && scene.joints().iter().all(|joint| joint.kind == JointKind::Revolute));
}

#[cfg(feature = "stochastic")]
#[test]
fn random_numbers_that_are_too_few_are_errors() {
    use phipsi::stochastic::{Method, Points};
    let model = scenes::chain(2).unwrap().random_model(&[0.1; 2], None, 1.0).unwrap();
    let points = |dimension| Points::sobol(dimension, 1, 0).unwrap();
    assert!(model.sample_torque(&points(model.dimension()), 0..3).unwrap().iter().all(|x| x.is_finite()));
    assert!(model.sample_torque(&points(model.dimension() - 1), 0..3).is_err());
    let far = model.sample_torque(&Points::random(1), u64::MAX - 70..u64::MAX).unwrap();
    assert!(far.len() == 140 && far.iter().all(|x| x.is_finite()));
    for (samples, replicates) in [(usize::MAX, 2), (8, 0), (0, 2)] {
        assert!(model.mass_matrix(Method::Sobol { samples, seed: 1, replicates, confidence: 0.9 }).is_err());
    }
}
