//! Planar scenes in 3-vectors: what is one and what is not, and the results against dense algebra of about 31 digits.

mod common;

use common::oracle::{Oracle, ds, solve};
use common::tolerance::{self, assert_near, conditioning, size};
use common::{Random, random_inertial, random_state};
use nalgebra::{Matrix3, Rotation3, Vector3};
use phipsi::batch::arms::ARMS;
use phipsi::batch::evaluator::Evaluator;
use phipsi::filter::Form;
use phipsi::planar::PlanarModel;
use phipsi::planar::model::TOLERANCE;
use phipsi::report::operations::{Task, count, count_in_six_vectors};
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, Omissions, SceneBuilder};
use phipsi::spatial::{SpatialVector, Symmetric3};
use phipsi::{Algorithm, Arguments};
use phipsi::{Error, Scene};

const ALGORITHMS: [Algorithm; 5] = [
    Algorithm::ForwardDynamics(Form::Covariance),
    Algorithm::InverseDynamics,
    Algorithm::BiasTorque,
    Algorithm::MassMatrix,
    Algorithm::MassMatrixInverse(Form::Covariance),
];

/// Whether all joints of a scene move in one plane.
fn is_planar(scene: &Scene) -> bool {
    PlanarModel::of(scene.model()).is_some()
}

/// The rotation that a URDF's roll, pitch and yaw give, rounding included.
fn of_rpy(angles: [f64; 3]) -> Matrix3<f64> {
    *Rotation3::from_euler_angles(angles[0], angles[1], angles[2]).matrix()
}

/// A random tree in the plane across `normal`: turns about it or against it, slides across it, planar joints, welds; frames turned by
/// quarters and by any angles.
fn tree(seed: u64, bodies: usize, normal: Vector3<f64>) -> SceneBuilder {
    let mut random = Random::new(seed);
    let mut builder =
        SceneBuilder::new().gravity([0.3, -0.5, -9.6]).link(LinkDescription { name: "base".into(), inertial: None });
    // The normal as each link's frame sees it.
    let mut normals = vec![("base".to_owned(), normal.normalize())];
    for k in 0..bodies {
        let (parent, above) = normals[if random.below(3) == 0 { random.below(k + 1) } else { k }].clone();
        let kinds =
            [JointKind::Revolute, JointKind::Continuous, JointKind::Prismatic, JointKind::Planar, JointKind::Fixed];
        let kind = kinds[random.below(if k + 1 < bodies { 5 } else { 4 })];
        let name = format!("link{k}");
        let mut joint = JointDescription::new(format!("joint{k}"), kind, parent, name.clone());
        let quarters = random.array(3, 2.9).iter().map(|x| x.round() * std::f64::consts::FRAC_PI_2).collect::<Vec<_>>();
        joint.origin.rotation =
            if random.below(2) == 0 { of_rpy([quarters[0], quarters[1], quarters[2]]) } else { random.rotation() };
        joint.origin.lever = random.vector() * 0.5;
        let here = joint.origin.rotation.tr_mul(&above);
        joint.axis = match kind {
            JointKind::Prismatic => here.cross(&random.vector()),
            _ if random.below(2) == 0 => -here * 2.0,
            _ => here,
        };
        joint.armature = if seed.is_multiple_of(2) { 0.1 * random.uniform(0.0, 1.0) } else { 0.0 };
        let inertial = Some(random_inertial(&mut random));
        builder = builder.link(LinkDescription { name: name.clone(), inertial }).joint(joint);
        normals.push((name, here));
    }
    builder
}

/// Along coordinates, and across them.
fn normals() -> [Vector3<f64>; 3] {
    [Vector3::z(), Vector3::y(), Vector3::new(0.3, -0.5, 0.7)]
}

/// A planar tree that has joints at all.
fn trees() -> impl Iterator<Item = (u64, SceneBuilder)> {
    (0..30).map(|seed| {
        let bodies = 1 + usize::try_from(seed % 9).unwrap();
        (seed, tree(seed, bodies, normals()[usize::try_from(seed % 3).unwrap()]))
    })
}

fn run(scene: &Scene, algorithm: Algorithm, state: &Arguments<'_>) -> Result<Vec<f64>, Error> {
    let mut workspace = scene.workspace().in_form(Form::Covariance);
    let mut out = vec![f64::NAN; scene.width(algorithm)];
    let &Arguments { q, qd, u, wrenches } = state;
    match algorithm {
        Algorithm::ForwardDynamics(_) => scene.forward_dynamics(&mut workspace, q, qd, u, wrenches, &mut out),
        Algorithm::InverseDynamics => scene.inverse_dynamics(&mut workspace, q, qd, u, wrenches, &mut out),
        Algorithm::BiasTorque => scene.bias_torque(&mut workspace, q, qd, &mut out),
        Algorithm::MassMatrix => scene.mass_matrix(&mut workspace, q, &mut out),
        Algorithm::MassMatrixInverse(_) => {
            scene.mass_matrix_inverse(&mut workspace, &mut scene.inverse_scratch(), q, &mut out)
        }
    }?;
    Ok(out)
}

/// What the algorithms give by dense algebra, in their order, and what each may be off by.
fn expected(scene: &Scene, (q, qd, u): (&[f64], &[f64], &[f64]), wrench: [f64; 6]) -> Vec<(Vec<f64>, f64)> {
    let (n, nv) = (scene.links().len(), scene.nv());
    let oracle = Oracle::new(scene.source());
    let instant = oracle.at(&ds(q), &ds(qd));
    let mass = instant.mass_matrix();
    let wrenches = [(scene.links()[scene.links().len() - 1].name.as_str(), wrench)];
    let (bias, terms) = instant.bias(&wrenches);
    let (bare, _) = instant.bias(&[]);
    let u = ds(u);
    let entries: Vec<f64> = (0..nv * nv).map(|i| tolerance::to_f64(mass[(i / nv, i % nv)])).collect();
    let matrix = conditioning(nv, &entries);
    let torques: Vec<_> =
        (0..nv).map(|i| (0..nv).fold(bias[i], |sum, j| sum + mass[(i, j)] * u[j])).map(tolerance::to_f64).collect();
    let right: Vec<_> = u.iter().zip(&bias).map(|(&u, &b)| u - b).collect();
    let accelerations: Vec<f64> = solve(&mass, &right).into_iter().map(tolerance::to_f64).collect();
    let mut inverse = vec![f64::NAN; nv * nv];
    for j in 0..nv {
        let unit: Vec<f64> = (0..nv).map(|i| if i == j { 1.0 } else { 0.0 }).collect();
        for (i, x) in solve(&mass, &ds(&unit)).into_iter().enumerate() {
            inverse[i * nv + j] = tolerance::to_f64(x);
        }
    }
    let terms = terms + size(&wrench) * 10.0 + size(&entries) * 5.0 * tolerance::count(nv);
    let of_product = tolerance::product(n, terms);
    let of_solution = tolerance::solution(&matrix, size(&accelerations), terms);
    vec![
        (accelerations, of_solution),
        (torques, of_product),
        (bare.into_iter().map(tolerance::to_f64).collect(), of_product),
        (entries.clone(), tolerance::product(n, size(&entries))),
        (inverse, tolerance::inverse(matrix.number, matrix.inverse_norm)),
    ]
}

#[test]
fn planar_trees_are_found_and_right() {
    let mut seen = 0;
    for (seed, builder) in trees() {
        let scene = builder.clone().build().unwrap();
        if scene.nv() == 0 {
            continue;
        }
        seen += 1;
        assert!(is_planar(&scene), "seed {seed}");
        let plain = Omissions::all_but(|of| &mut of.planar);
        let other = builder.omissions(plain).build().unwrap();
        assert!(!is_planar(&other));
        let (q, qd, u) = random_state(&scene, &mut Random::new(seed));
        let wrench = [0.5, -1.0, 2.0, 3.0, -2.0, 1.5];
        let last = scene.links()[scene.links().len() - 1].name.clone();
        let forces = scene.body_wrenches([(last.as_str(), SpatialVector::from(wrench))]).unwrap();
        let state = Arguments { q: &q, qd: &qd, u: &u, wrenches: &forces };
        for (algorithm, (expected, bound)) in ALGORITHMS.into_iter().zip(expected(&scene, (&q, &qd, &u), wrench)) {
            let say = format!("seed {seed}, {algorithm:?}");
            assert_near(&say, &run(&scene, algorithm, &state).unwrap(), &expected, bound);
            let mut out = vec![f64::NAN; scene.width(algorithm)];
            scene.recursion(&mut scene.workspace(), None, algorithm, &state, &mut out).unwrap();
            assert_near(&format!("{say}, the recursion"), &out, &expected, bound);
            assert_near(&say, &run(&other, algorithm, &state).unwrap(), &expected, bound);
        }
    }
    assert!(seen >= 25);
}

/// In debug builds the lanes need more stack than a thread has by default.
fn on_a_large_stack(work: impl FnOnce() + Send + 'static) {
    std::thread::Builder::new().stack_size(256 << 20).spawn(work).unwrap().join().unwrap();
}

#[test]
fn every_arm_gives_the_same() {
    on_a_large_stack(|| {
        for (seed, builder) in trees().skip(6).step_by(5) {
            let scene = builder.build().unwrap();
            let states: Vec<_> = (0..9).map(|i| random_state(&scene, &mut Random::new(seed + i))).collect();
            for (_, arm) in ARMS.into_iter().filter(|(_, arm)| arm.available()) {
                let mut evaluator = Evaluator::on(arm, &scene);
                for (which, algorithm) in ALGORITHMS.into_iter().enumerate() {
                    let all: Vec<Arguments<'_>> = states
                        .iter()
                        .map(|(q, qd, u)| match which {
                            0 | 1 => Arguments { q, qd, u, wrenches: &[] },
                            2 => Arguments { q, qd, ..Arguments::default() },
                            _ => Arguments { q, ..Arguments::default() },
                        })
                        .collect();
                    let width = scene.width(algorithm);
                    let mut out = vec![f64::NAN; width * all.len()];
                    scene.evaluate(&mut evaluator, algorithm, &all, &mut out).unwrap();
                    for ((q, qd, u), out) in states.iter().zip(out.chunks(width)) {
                        let (expected, bound) = expected(&scene, (q, qd, u), [0.0; 6]).swap_remove(which);
                        assert_near(&format!("seed {seed}, {arm:?}, {algorithm:?}"), out, &expected, bound);
                    }
                }
            }
        }
    });
}

/// Two turns, the second about an axis that leans by `angle` from the first's.
fn leaning(kind: JointKind, angle: f64) -> Scene {
    let mut random = Random::new(7);
    let mut builder = SceneBuilder::new();
    for name in ["base", "upper", "lower"] {
        builder = builder.link(LinkDescription { name: name.into(), inertial: Some(random_inertial(&mut random)) });
    }
    let first = JointDescription::new("first", JointKind::Revolute, "base", "upper");
    let mut second = JointDescription::new("second", kind, "upper", "lower");
    second.axis = match kind {
        JointKind::Prismatic => Vector3::new(angle.cos(), 0.0, angle.sin()),
        _ => Vector3::new(angle.sin(), 0.0, angle.cos()),
    };
    second.origin.lever = Vector3::new(0.4, 0.1, 0.2);
    builder.joint(first).joint(second).build().unwrap()
}

#[test]
fn an_axis_out_of_the_plane_is_left_there() {
    for kind in [JointKind::Revolute, JointKind::Prismatic] {
        for angle in [0.0, 6e-17, 0.5 * TOLERANCE] {
            assert!(is_planar(&leaning(kind, angle)), "{kind:?} {angle}");
        }
        for angle in [4.0 * TOLERANCE, 1e-12, 1e-9, 0.3] {
            let scene = leaning(kind, angle);
            assert!(!is_planar(&scene), "{kind:?} {angle}");
            assert!(scene.plan().items.iter().all(|item| item.switch != Some("planar")));
        }
    }
    // A rotation that is off by no more than the builder allows is no rotation of the plane.
    let mut source = SceneBuilder::new();
    let mut random = Random::new(3);
    for name in ["base", "upper", "lower"] {
        source = source.link(LinkDescription { name: name.into(), inertial: Some(random_inertial(&mut random)) });
    }
    let mut second = JointDescription::new("second", JointKind::Revolute, "upper", "lower");
    second.origin.rotation[(0, 1)] = 1e-10;
    let first = JointDescription::new("first", JointKind::Revolute, "base", "upper");
    assert!(!is_planar(&source.joint(first).joint(second).build().unwrap()));
}

#[test]
fn what_has_no_plane() {
    let kinds = |kind| is_planar(&leaning(kind, 0.0));
    assert!(kinds(JointKind::Planar) && kinds(JointKind::Continuous));
    assert!(!kinds(JointKind::Screw { pitch: 0.1 }) && !kinds(JointKind::Spherical) && !kinds(JointKind::Floating));
    let planar = leaning(JointKind::Revolute, 0.0);
    assert!(!is_planar(&planar.source().clone().floating_base(true).build().unwrap()));
    let alone = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
    assert!(!is_planar(&alone.build().unwrap()));
    // Bodies that are kept without a row.
    let kept = Omissions { base_links: false, ..Omissions::all() };
    assert!(!is_planar(&planar.source().clone().omissions(kept).build().unwrap()));
    // A joint that leaves the plane, locked.
    let mut source = planar.source().clone().link(LinkDescription { name: "tool".into(), inertial: None });
    let mut wrist = JointDescription::new("wrist", JointKind::Revolute, "lower", "tool");
    wrist.axis = Vector3::x();
    wrist.armature = 0.1;
    source = source.joint(wrist);
    let scene = source.build().unwrap();
    assert!(!is_planar(&scene));
    assert!(is_planar(&scene.lock(&["wrist"], &[0.1, 0.2, 0.3]).unwrap()));
}

#[test]
fn lost_pivots_raise_as_before() {
    // A point mass on the axis of the last joint, with other turns before it.
    let scene = |omissions| {
        let mut random = Random::new(5);
        let mut builder = SceneBuilder::new().omissions(omissions);
        let point = Inertial { mass: 1.3, centre: Vector3::new(0.0, 0.0, 0.5), central: Symmetric3::zero() };
        let inertials = [None, Some(random_inertial(&mut random)), Some(point)];
        for (k, inertial) in inertials.into_iter().enumerate() {
            builder = builder.link(LinkDescription { name: format!("link{k}"), inertial });
        }
        for k in 0..2 {
            let (parent, child) = (format!("link{k}"), format!("link{}", k + 1));
            builder = builder.joint(JointDescription::new(format!("joint{k}"), JointKind::Revolute, parent, child));
        }
        builder.build().unwrap()
    };
    let (planar, general) = (scene(Omissions::all()), scene(Omissions::all_but(|of| &mut of.planar)));
    assert!(is_planar(&planar));
    let state = Arguments { q: &[0.3, 0.4], qd: &[0.0; 2], u: &[1.0; 2], wrenches: &[] };
    for algorithm in [ALGORITHMS[0], ALGORITHMS[4]] {
        let found = run(&planar, algorithm, &state).unwrap_err();
        assert_eq!(found, run(&general, algorithm, &state).unwrap_err());
        assert!(matches!(&found, Error::SingularJoint { joint, .. } if joint == "joint1"), "{found}");
        let state = match algorithm {
            Algorithm::MassMatrixInverse(_) => Arguments { q: state.q, ..Arguments::default() },
            _ => state,
        };
        let mut out = vec![f64::NAN; planar.width(algorithm)];
        let fault = planar.evaluate(&mut planar.evaluator(), algorithm, &[state], &mut out).unwrap_err();
        assert_eq!(fault.error, found);
    }
}

/// What one more turn costs, without armature.
fn a_turn(algorithm: Algorithm, six: bool) -> u64 {
    let of = |bodies: usize| {
        let mut builder = SceneBuilder::new().link(LinkDescription { name: "link0".into(), inertial: None });
        let mut random = Random::new(11);
        for k in 0..bodies {
            let inertial = Some(random_inertial(&mut random));
            let mut joint = JointDescription::new(
                format!("joint{k}"),
                JointKind::Revolute,
                format!("link{k}"),
                format!("link{}", k + 1),
            );
            joint.origin.lever = random.vector();
            builder = builder.link(LinkDescription { name: format!("link{}", k + 1), inertial }).joint(joint);
        }
        let scene = builder.build().unwrap();
        let (q, qd, u) = random_state(&scene, &mut random);
        let state = Arguments { q: &q, qd: &qd, u: &u, wrenches: &[] };
        let task = Task::Algorithm(algorithm);
        if six { count_in_six_vectors(&scene, task, &state) } else { count(&scene, task, &state) }.operations.flops()
    };
    of(12) - of(11)
}

/// Floating-point operations that the doc comments name, within a twentieth.
#[test]
fn as_documented() {
    let documented = [(ALGORITHMS[0], 160), (ALGORITHMS[1], 100)];
    for (algorithm, about) in documented {
        let counted = a_turn(algorithm, false);
        assert!(counted.abs_diff(about) * 20 <= about, "{algorithm:?}: {counted}, documented {about}");
    }
    for algorithm in ALGORITHMS {
        let (three, six) = (a_turn(algorithm, false), a_turn(algorithm, true));
        println!("{algorithm:?}: {three} operations a joint in 3-vectors, {six} in 6-vectors");
        assert!(2 * three < six, "{algorithm:?}: {three} against {six}");
    }
}

#[test]
fn the_plan_says_so() {
    let scene = leaning(JointKind::Revolute, 0.0);
    let plan = scene.plan();
    let item = plan.items.iter().find(|item| item.switch == Some("planar")).unwrap();
    assert_eq!(item.count, 2);
    let state = Arguments { q: &[0.1; 2], qd: &[0.2; 2], u: &[0.3; 2], wrenches: &[] };
    let task = Task::Algorithm(ALGORITHMS[0]);
    let (three, six) = (count(&scene, task, &state), count_in_six_vectors(&scene, task, &state));
    assert_eq!(u64::try_from(item.operations).unwrap(), six.operations.flops() - three.operations.flops());
}
