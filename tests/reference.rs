//! The recursions compared with two references, neither of them the same code in the same precision: rigid-body
//! dynamics from the definitions (`common/oracle.rs`, about 31 digits), and the recursions themselves in
//! double-double arithmetic.

use crate::common::oracle::{D, LinkWrench, Oracle, d, ds, solve};
use crate::common::tolerance::{self, assert_close, assert_near, assert_near_double, conditioning, size, to_f64};
use crate::common::{ALL_KINDS, KINDS_WITH_FIXED, Random, Tree, random_state};
use nalgebra::{DMatrix, Matrix3, Vector3, Vector6};
use phipsi::dynamics;
use phipsi::dynamics::InverseScratch;
use phipsi::kinematics::ReferenceFrame;
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, Model, SceneBuilder};
use phipsi::spatial::{RigidShift, Symmetric3};
use phipsi::{Algorithm, Arguments, Form, Scene, Workspace};

/// Joints whose velocities are the derivatives of their coordinates, for which the textbook form of Lagrange's
/// equations holds.
const COORDINATE_KINDS: [JointKind; 5] = [
    JointKind::Revolute,
    JointKind::Prismatic,
    JointKind::Screw { pitch: 0.4 },
    JointKind::Planar,
    JointKind::Universal,
];

fn round(values: &[D]) -> Vec<f64> {
    values.iter().map(|&x| to_f64(x)).collect()
}

fn round_matrix(matrix: &DMatrix<D>) -> Vec<f64> {
    let (rows, columns) = matrix.shape();
    (0..rows * columns).map(|i| to_f64(matrix[(i / columns, i % columns)])).collect()
}

/// Random mixed trees, seeds 0..n: fixed and floating bases, with and without armature, one joint to eight.
fn mixed_trees(n: u64) -> impl Iterator<Item = (u64, SceneBuilder)> {
    (0..n).map(|seed| {
        let bodies = 1 + usize::try_from(seed).unwrap() % 8;
        let kinds = if seed % 2 == 0 { &ALL_KINDS[..] } else { &KINDS_WITH_FIXED[..] };
        let armature = if seed % 3 == 0 { 0.0 } else { 0.3 };
        (seed, Tree { seed, bodies, kinds, branching: 0.5, armature, floating: seed % 5 == 1 }.builder())
    })
}

/// A wrench on two links, including merged ones and the base.
fn link_wrenches(scene: &Scene, random: &mut Random) -> Vec<(String, [f64; 6])> {
    (0..2)
        .map(|_| {
            let link = scene.links()[random.below(scene.links().len())].name.clone();
            (link, std::array::from_fn(|_| random.uniform(-5.0, 5.0)))
        })
        .collect()
}

#[test]
fn dynamics_match_first_principles() {
    for (seed, source) in mixed_trees(40) {
        let scene = source.clone().build().unwrap();
        let oracle = Oracle::new(&source);
        let (nv, n) = (scene.nv(), scene.links().len());
        assert_eq!((oracle.nq, oracle.nv()), (scene.nq(), nv));
        let mut random = Random::new(2000 + seed);
        let (q, qd, tau) = random_state(&scene, &mut random);
        let wrenches = link_wrenches(&scene, &mut random);
        let named: Vec<LinkWrench<'_>> = wrenches.iter().map(|(name, wrench)| (name.as_str(), *wrench)).collect();
        let on_bodies = scene.body_wrenches(named.iter().map(|&(name, w)| (name, Vector6::from(w)))).unwrap();
        let mut workspace = scene.workspace();
        let instant = oracle.at(&ds(&q), &ds(&qd));

        let exact_mass = instant.mass_matrix();
        let exact_rows = round_matrix(&exact_mass);
        let mut mass = vec![f64::NAN; nv * nv];
        scene.mass_matrix(&mut workspace, &q, &mut mass).unwrap();
        assert_near("mass matrix", &mass, &exact_rows, tolerance::product(n, size(&exact_rows)));

        let (exact_bias, _) = instant.bias(&[]);
        let (loaded_bias, terms) = instant.bias(&named);
        let mut torque = vec![f64::NAN; nv];
        scene.bias_torque(&mut workspace, &q, &qd, &mut torque).unwrap();
        assert_near("bias torque", &torque, &round(&exact_bias), tolerance::product(n, terms));

        // Inverse dynamics at a separate acceleration.
        let qdd = random.array(nv, 3.0);
        let exact: Vec<D> =
            (0..nv).map(|i| (0..nv).fold(loaded_bias[i], |sum, j| sum + exact_mass[(i, j)] * d(qdd[j]))).collect();
        scene.inverse_dynamics(&mut workspace, &q, &qd, &qdd, &on_bodies, &mut torque).unwrap();
        let terms_moving = terms + size(&exact_rows) * qdd.iter().map(|x| x.abs()).sum::<f64>();
        assert_near("inverse dynamics", &torque, &round(&exact), tolerance::product(n, terms_moving));

        // Forward dynamics, and the inverse of M.
        let conditioning = conditioning(nv, &exact_rows);
        let right: Vec<D> = tau.iter().zip(&loaded_bias).map(|(&t, &b)| d(t) - b).collect();
        let exact = round(&solve(&exact_mass, &right));
        let mut found = vec![f64::NAN; nv];
        scene.forward_dynamics(&mut workspace, &q, &qd, &tau, &on_bodies, &mut found).unwrap();
        let bound = tolerance::solution(&conditioning, size(&exact), terms.max(size(&tau)));
        assert_near("forward dynamics", &found, &exact, bound);

        let mut inverse = vec![f64::NAN; nv * nv];
        scene.mass_matrix_inverse(&mut workspace, &mut scene.inverse_scratch(), &q, &mut inverse).unwrap();
        let bound = tolerance::inverse(conditioning.number, conditioning.inverse_norm);
        for j in 0..nv {
            let unit: Vec<D> = (0..nv).map(|i| d(if i == j { 1.0 } else { 0.0 })).collect();
            let exact = round(&solve(&exact_mass, &unit));
            assert_near("inverse mass matrix", &inverse[j * nv..(j + 1) * nv], &exact, bound);
        }
    }
}

#[test]
fn energy_momentum_and_kinematics_match_first_principles() {
    for (seed, source) in mixed_trees(40) {
        let scene = source.clone().build().unwrap();
        let oracle = Oracle::new(&source);
        let (nv, n) = (scene.nv(), scene.links().len());
        let (q, qd, _) = random_state(&scene, &mut Random::new(3000 + seed));
        let instant = oracle.at(&ds(&q), &ds(&qd));
        let mut workspace = scene.workspace();

        let (kinetic, potential) = instant.energy();
        let energy = scene.energy(&mut workspace, &q, &qd).unwrap();
        assert_close("kinetic energy", energy.kinetic, to_f64(kinetic), tolerance::product(n, to_f64(kinetic)));
        // Weight of all links, at the extent of the tree (and of its prismatic joints).
        let reach = tolerance::count(n) * (1.0 + size(&q));
        let weight = 10.0 * 2.0 * tolerance::count(n);
        assert_close("potential energy", energy.potential, to_f64(potential), tolerance::product(1, weight * reach));

        let exact = round(&instant.momentum());
        let momentum = scene.momentum(&mut workspace, &q, &qd).unwrap();
        let scale = size(&exact).max((2.0 * to_f64(kinetic) * 2.0 * tolerance::count(n)).sqrt() * reach);
        assert_near("momentum", momentum.as_slice(), &exact, tolerance::product(n, scale));

        let placements = scene.placements(&q).unwrap();
        for (link, found) in scene.links().iter().zip(&placements) {
            let exact = instant.placement(&link.name);
            let (rotation, lever) = (exact.rotation.map(to_f64), exact.lever.map(to_f64));
            assert_near("rotation", found.rotation.as_slice(), rotation.as_slice(), tolerance::product(n, 1.0));
            assert_near("position", found.lever.as_slice(), lever.as_slice(), tolerance::product(n, reach));
            let mut jacobian = vec![f64::NAN; 6 * nv];
            scene.jacobian(&q, &link.name, ReferenceFrame::Local, &mut jacobian).unwrap();
            let exact = round_matrix(&instant.jacobian(&link.name));
            assert_near("jacobian", &jacobian, &exact, tolerance::product(n, size(&exact)));
        }
    }
}

/// tau = d/dt (M qd) - d/dq (qd M qd / 2) + dU/dq, from M and U alone: verifies the torque of the oracle too.
#[test]
fn bias_torque_satisfies_lagranges_equations() {
    for seed in 0..16 {
        // Orthonormal rotations: otherwise M and the torque would differ by their rounding error.
        let source = exact_tree(seed, &COORDINATE_KINDS);
        let scene = source.clone().build().unwrap();
        let oracle = Oracle::new(&source);
        let (nv, n) = (scene.nv(), scene.links().len());
        let (q, qd, _) = random_state(&scene, &mut Random::new(4000 + seed));
        let (q0, v) = (ds(&q), ds(&qd));
        let (ahead, back) = (d(tolerance::STEP), d(-tolerance::STEP));
        let half_step = d(0.5 / tolerance::STEP);
        let mass_rate = (oracle.at_rest(&oracle.moved(&q0, &v, ahead)).mass_matrix()
            - oracle.at_rest(&oracle.moved(&q0, &v, back)).mass_matrix())
            * half_step;
        let exact: Vec<D> = (0..nv)
            .map(|i| {
                let unit: Vec<D> = (0..nv).map(|j| d(if i == j { 1.0 } else { 0.0 })).collect();
                let (kinetic, potential) = oracle.at(&oracle.moved(&q0, &unit, ahead), &v).energy();
                let (kinetic_back, potential_back) = oracle.at(&oracle.moved(&q0, &unit, back), &v).energy();
                let lagrangian = (kinetic - potential) - (kinetic_back - potential_back);
                (0..nv).fold(-lagrangian * half_step, |sum, j| sum + mass_rate[(i, j)] * v[j])
            })
            .collect();
        let instant = oracle.at(&q0, &v);
        let (bias, terms) = instant.bias(&[]);
        let (kinetic, potential) = instant.energy();
        let scale = terms + to_f64(kinetic) + to_f64(potential).abs();
        assert_near_double("Lagrange, oracle", &bias, &exact, tolerance::difference(n, scale));
        let mut found = vec![f64::NAN; nv];
        scene.bias_torque(&mut scene.workspace(), &q, &qd, &mut found).unwrap();
        assert_near("Lagrange", &found, &round(&exact), tolerance::product(n, terms));
    }
}

#[test]
fn gravity_torque_is_the_gradient_of_the_potential() {
    for (seed, source) in mixed_trees(20) {
        let scene = source.clone().build().unwrap();
        let oracle = Oracle::new(&source);
        let (nv, n) = (scene.nv(), scene.links().len());
        let (q, ..) = random_state(&scene, &mut Random::new(5000 + seed));
        let q0 = ds(&q);
        let potential = |q: &[D]| oracle.at_rest(q).energy().1;
        let exact: Vec<D> = (0..nv)
            .map(|i| {
                let unit: Vec<D> = (0..nv).map(|j| d(if i == j { 1.0 } else { 0.0 })).collect();
                let difference = potential(&oracle.moved(&q0, &unit, d(tolerance::STEP)))
                    - potential(&oracle.moved(&q0, &unit, d(-tolerance::STEP)));
                difference * d(0.5 / tolerance::STEP)
            })
            .collect();
        let (_, terms) = oracle.at_rest(&q0).bias(&[]);
        let mut found = vec![f64::NAN; nv];
        scene.gravity_torque(&mut scene.workspace(), &q, &mut found).unwrap();
        assert_near("gradient of the potential", &found, &round(&exact), tolerance::product(n, terms));
    }
}

/// All results of the recursions in one state, in double-double arithmetic.
struct InDouble {
    mass: Vec<D>,
    inverse: Vec<D>,
    bias: Vec<D>,
    torque: Vec<D>,
    acceleration: Vec<D>,
}

impl InDouble {
    fn new(model: &Model<D>, q: &[f64], qd: &[f64], tau: &[f64]) -> Self {
        let nv = model.nv();
        let (q, qd, tau) = (ds(q), ds(qd), ds(tau));
        let mut workspace = Workspace::new(model);
        let nan = |n: usize| vec![d(f64::NAN); n];
        let mut all =
            Self { mass: nan(nv * nv), inverse: nan(nv * nv), bias: nan(nv), torque: nan(nv), acceleration: nan(nv) };
        dynamics::mass_matrix(model, &mut workspace, &q, &mut all.mass);
        let mut scratch = InverseScratch::new(model);
        assert!(dynamics::mass_matrix_inverse(model, &mut workspace, &mut scratch, &q, &mut all.inverse).clear(0));
        dynamics::bias_torque(model, &mut workspace, &q, &qd, &[], &mut all.bias);
        dynamics::inverse_dynamics(model, &mut workspace, &q, &qd, &tau, &[], &mut all.torque);
        let monitor = dynamics::forward_dynamics(model, &mut workspace, &q, &qd, &tau, &[], &mut all.acceleration);
        assert!(monitor.clear(0));
        all
    }
}

#[test]
fn recursions_match_themselves_in_double_double() {
    for (seed, source) in mixed_trees(40) {
        let scene = source.clone().build().unwrap();
        let (nv, n) = (scene.nv(), scene.links().len());
        let (q, qd, tau) = random_state(&scene, &mut Random::new(6000 + seed));
        let exact = InDouble::new(&scene.model().cast(), &q, &qd, &tau);
        let mut workspace = scene.workspace();
        let (mut matrix, mut vector) = (vec![f64::NAN; nv * nv], vec![f64::NAN; nv]);
        let exact_mass = round(&exact.mass);
        let (_, terms) = Oracle::new(&source).at(&ds(&q), &ds(&qd)).bias(&[]);
        let conditioning = conditioning(nv, &exact_mass);

        let configuration = Arguments { q: &q, ..Arguments::default() };
        let state = Arguments { q: &q, qd: &qd, u: &tau, wrenches: &[], ..Arguments::default() };
        let mut recursion = |algorithm, state: &Arguments<'_>, out: &mut Vec<f64>| {
            scene.recursion(&mut workspace, None, algorithm, state, out).unwrap();
        };
        recursion(Algorithm::MassMatrix, &configuration, &mut matrix);
        assert_near("M in double-double", &matrix, &exact_mass, tolerance::product(n, size(&exact_mass)));
        recursion(Algorithm::MassMatrixInverse(Form::Auto), &configuration, &mut matrix);
        let bound = tolerance::inverse(conditioning.number, conditioning.inverse_norm);
        assert_near("M^-1 in double-double", &matrix, &round(&exact.inverse), bound);
        recursion(Algorithm::BiasTorque, &Arguments { u: &[], ..state }, &mut vector);
        assert_near("bias in double-double", &vector, &round(&exact.bias), tolerance::product(n, terms));
        // The torque is used as the acceleration here.
        recursion(Algorithm::InverseDynamics, &state, &mut vector);
        let moving = terms + size(&exact_mass) * tau.iter().map(|x| x.abs()).sum::<f64>();
        assert_near("ID in double-double", &vector, &round(&exact.torque), tolerance::product(n, moving));
        recursion(Algorithm::ForwardDynamics(Form::Auto), &state, &mut vector);
        let acceleration = round(&exact.acceleration);
        let bound = tolerance::solution(&conditioning, size(&acceleration), terms.max(size(&tau)));
        assert_near("FD in double-double", &vector, &acceleration, bound);
    }
}

/// A tree whose constants are exact in f64: quarter turns, coordinate axes, offsets and inertias in 1/64ths.
fn exact_tree(seed: u64, kinds: &[JointKind]) -> SceneBuilder {
    let mut random = Random::new(seed);
    let quarter = |i: usize| {
        let (u, v, w) = (Vector3::ith(i, 1.0), Vector3::ith((i + 1) % 3, 1.0), Vector3::ith((i + 2) % 3, 1.0));
        Matrix3::from_columns(&[w, -v, u])
    };
    let dyadic = |random: &mut Random| (random.uniform(-1.0, 1.0) * 64.0).round() / 64.0;
    let bodies = 2 + usize::try_from(seed).unwrap() % 6;
    let mut builder =
        SceneBuilder::new().gravity([0.25, -0.5, -9.75]).link(LinkDescription { name: "base".into(), inertial: None });
    for k in 0..bodies {
        let parent = if k == 0 { "base".to_owned() } else { format!("link{}", random.below(k)) };
        let kind = kinds[random.below(kinds.len())];
        let mut joint = JointDescription::new(format!("joint{k}"), kind, parent, format!("link{k}"));
        joint.origin =
            RigidShift { rotation: quarter(random.below(3)), lever: Vector3::from_fn(|_, _| dyadic(&mut random)) };
        joint.axis = Vector3::ith(random.below(3), 1.0);
        joint.armature = 0.25;
        let inertial = Inertial {
            mass: 1.5 + dyadic(&mut random),
            centre: Vector3::from_fn(|_, _| dyadic(&mut random)),
            // Diagonal: in double-double arithmetic an inertia is computed from its square root, L W L^T, which is
            // exact in all frames only if it is diagonal.
            central: Symmetric3::new([0.25, 0.0, 0.0, 0.3125, 0.0, 0.375]),
        };
        let link = LinkDescription { name: format!("link{k}"), inertial: Some(inertial) };
        builder = builder.link(link).joint(joint);
    }
    builder
}

/// Without rounding of the input, recursion and definitions agree to about 30 digits: no constant, sign or
/// coefficient is correct only in its leading digits.
#[test]
fn double_double_recursions_match_first_principles_to_thirty_digits() {
    for seed in 0..16 {
        let source = exact_tree(seed, &ALL_KINDS);
        let scene = source.clone().build().unwrap();
        let (nv, n) = (scene.nv(), scene.links().len());
        let (q, qd, tau) = random_state(&scene, &mut Random::new(7000 + seed));
        let found = InDouble::new(&scene.model().cast(), &q, &qd, &tau);
        let instant_of = Oracle::new(&source);
        let instant = instant_of.at(&ds(&q), &ds(&qd));
        let mass = instant.mass_matrix();
        let (bias, terms) = instant.bias(&[]);
        let rounded = round_matrix(&mass);
        let conditioning = conditioning(nv, &rounded);

        assert_near_double("M, 31 digits", &found.mass, mass.as_slice(), tolerance::double_double(n, size(&rounded)));
        assert_near_double("bias, 31 digits", &found.bias, &bias, tolerance::double_double(n, terms));
        let right: Vec<D> = tau.iter().zip(&bias).map(|(&t, &b)| d(t) - b).collect();
        let exact = solve(&mass, &right);
        let bound = f64::EPSILON * tolerance::solution(&conditioning, size(&round(&exact)), terms.max(size(&tau)));
        assert_near_double("FD, 31 digits", &found.acceleration, &exact, bound);
    }
}
