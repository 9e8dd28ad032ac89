//! Closed loops: accelerations and forces compared with the KKT system by definition in 31 digits, constraints
//! compared with differences, projections, inverses, simulation, and refused arguments.

use crate::common::lanes::{arms, evaluate, on_a_large_stack};
use crate::common::loops::{biped, exact, four_bar, state, stewart, tangle, welded_four_bar};
use crate::common::{ALL_KINDS, Random, tolerance};
use nalgebra::{DMatrix, DVector};
use phipsi::batch::Evaluator;
use phipsi::filter::Form;
use phipsi::motion::{METHODS, Method, Rollout, Settings, Torque};
use phipsi::report::operations::{Task, count};
use phipsi::scene::{Connection, ConnectionKind, Polynomial, Property};
use phipsi::spatial::RigidShift;
use phipsi::{Algorithm, Arguments, Error, Scene};

const FORMS: [Form; 3] = [Form::Auto, Form::Covariance, Form::SquareRoot];

type State = (Vec<f64>, Vec<f64>, Vec<f64>);

fn bars(kind: ConnectionKind) -> Scene {
    four_bar(kind, [1.0, 2.0, 0.5])
}

fn hinge() -> ConnectionKind {
    ConnectionKind::Axis([0.0, 2.0, 0.0].into())
}

/// qdd, forces, rank and residual.
fn dynamics(scene: &Scene, form: Form, (q, qd, tau): &State) -> Result<(Vec<f64>, Vec<f64>, usize, f64), Error> {
    let (mut workspace, mut scratch) = (scene.workspace().in_form(form), scene.constraint_scratch());
    let (mut qdd, mut forces) = (vec![f64::NAN; scene.nv()], vec![f64::NAN; scene.constraint_rows()]);
    let told = scene.constrained_dynamics(&mut workspace, &mut scratch, q, qd, tau, &[], (&mut qdd, &mut forces))?;
    Ok((qdd, forces, told.rank, told.residual))
}

/// The same by the general recursion, independent of the kernels.
fn recursion(scene: &Scene, form: Form, (q, qd, tau): &State) -> Vec<f64> {
    let algorithm = Algorithm::ConstrainedDynamics(form);
    let (state, mut out) =
        (Arguments { q, qd, u: tau, ..Arguments::default() }, vec![f64::NAN; scene.width(algorithm)]);
    scene.recursion(&mut scene.workspace(), None, algorithm, &state, &mut out).unwrap();
    out
}

fn jacobian(scene: &Scene, q: &[f64]) -> DMatrix<f64> {
    let mut out = vec![f64::NAN; scene.constraint_rows() * scene.nv()];
    scene.constraint_jacobian(&mut scene.workspace(), &mut scene.constraint_scratch(), q, &mut out).unwrap();
    DMatrix::from_row_slice(scene.constraint_rows(), scene.nv(), &out)
}

fn errors(scene: &Scene, q: &[f64]) -> Vec<f64> {
    let mut out = vec![f64::NAN; scene.constraint_rows()];
    scene.constraint_error(q, &mut out).unwrap();
    out
}

fn mass_matrix(scene: &Scene, q: &[f64]) -> DMatrix<f64> {
    let mut out = vec![f64::NAN; scene.nv() * scene.nv()];
    scene.mass_matrix(&mut scene.workspace(), q, &mut out).unwrap();
    DMatrix::from_row_slice(scene.nv(), scene.nv(), &out)
}

fn inverse(scene: &Scene, q: &[f64]) -> DMatrix<f64> {
    let mut out = vec![f64::NAN; scene.nv() * scene.nv()];
    let (mut workspace, mut scratch) = (scene.workspace(), scene.constraint_scratch());
    scene.constrained_mass_matrix_inverse(&mut workspace, &mut scratch, q, &mut out).unwrap();
    DMatrix::from_row_slice(scene.nv(), scene.nv(), &out)
}

fn moved(scene: &Scene, q: &[f64], v: &[f64], share: f64) -> Vec<f64> {
    let (step, mut out): (Vec<f64>, _) = (v.iter().map(|v| v * share).collect(), vec![f64::NAN; scene.nq()]);
    scene.integrate(q, &step, &mut out).unwrap();
    out
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    tolerance::size(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>())
}

/// Every form compared with the definition, relative to the largest acceleration and the largest torque, within 64
/// eps and the square roots of the condition numbers of M and of the scaled G.
fn compare(what: &str, scene: &Scene, state: &State, rank: usize) {
    let (q, qd, tau) = state;
    let exact = exact(scene, q, qd, tau);
    assert_eq!(exact.rank, rank, "{what}: rank of the definition");
    let (nv, m) = (scene.nv(), scene.constraint_rows());
    let general = |form| {
        let all = recursion(scene, form, state);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        (all[..nv].to_vec(), all[nv..nv + m].to_vec(), all[nv + m] as usize, all[nv + m + 1])
    };
    let ways = FORMS.iter().flat_map(|&form| [(form, dynamics(scene, form, state).unwrap()), (form, general(form))]);
    for (form, (qdd, forces, found, residual)) in ways {
        assert_eq!(found, rank, "{what} {form:?}: rank");
        let torque = jacobian(scene, q).tr_mul(&DVector::from_vec(forces));
        let error = distance(&qdd, &exact.qdd) / tolerance::size(&exact.qdd);
        let of_torque = distance(torque.as_slice(), &exact.torque) / tolerance::size(&exact.torque);
        let of_mass = tolerance::conditioning(scene.nv(), mass_matrix(scene, q).as_slice()).number;
        let bound = 64.0 * f64::EPSILON * of_mass.max(exact.condition);
        println!(
            "{what} {form:?}: qdd {error:.1e}, J^T f {of_torque:.1e}, residual {residual:.1e}, bound {bound:.1e}, M {of_mass:.1e}, G {:.1e}",
            exact.condition
        );
        assert!(error <= bound && of_torque <= bound, "{what} {form:?}: {error:e} and {of_torque:e}, bound {bound:e}");
    }
}

/// Mechanisms, and the displacement of their random states.
fn mechanisms() -> [(&'static str, Scene, f64); 5] {
    [
        ("point", bars(ConnectionKind::Point), 0.7),
        ("axis", bars(hinge()), 0.7),
        ("platform", stewart(), 0.1),
        ("welds", biped(0), 0.2),
        ("four points a foot", biped(4), 0.2),
    ]
}

#[test]
fn states_in_lanes_are_as_the_recursion_has_them_and_as_alone() {
    on_a_large_stack(|| {
        let tangled = [("tangle", tangle(3, &ALL_KINDS), 0.1)];
        for (what, scene, size) in mechanisms().into_iter().chain(tangled) {
            let states: Vec<State> = (0..11).map(|seed| state(&scene, seed, size)).collect();
            for form in [Form::Auto, Form::Covariance] {
                let algorithm = Algorithm::ConstrainedDynamics(form);
                let arguments: Vec<_> =
                    states.iter().map(|(q, qd, tau)| Arguments { q, qd, u: tau, ..Arguments::default() }).collect();
                let width = scene.width(algorithm);
                for arm in arms() {
                    let mut evaluator = Evaluator::on(arm, &scene);
                    let all = evaluate(&scene, &mut evaluator, algorithm, &arguments);
                    let accelerations = evaluate(&scene, &mut evaluator, Algorithm::ForwardDynamics(form), &arguments);
                    for (i, state) in states.iter().enumerate() {
                        let own = &all[i * width..(i + 1) * width];
                        let alone = evaluate(&scene, &mut evaluator, algorithm, &arguments[i..=i]);
                        let again = evaluate(&scene, &mut evaluator, algorithm, &[arguments[i]; 3]);
                        assert_eq!(own, &again[width..2 * width], "{what} {arm:?} {i}: other neighbours");
                        let general = recursion(&scene, form, state);
                        let (nv, told) = (scene.nv(), width - 2);
                        assert_eq!(own[told].to_bits(), general[told].to_bits(), "{what} {arm:?} {i}: rank");
                        assert_eq!(&own[..nv], &accelerations[i * nv..(i + 1) * nv]);
                        let of_mass = tolerance::conditioning(nv, mass_matrix(&scene, &state.0).as_slice()).number;
                        let bound = 1024.0 * f64::EPSILON * of_mass * tolerance::size(&general[..nv]);
                        for found in [own, &alone] {
                            let error = distance(&found[..nv], &general[..nv]);
                            assert!(error <= bound, "{what} {arm:?} {form:?} {i}: {error:e}, bound {bound:e}");
                        }
                    }
                }
            }
        }
    });
}

#[test]
fn the_kernels_have_what_is_regular_and_leave_the_rest() {
    let doubt = |scene: &Scene, state: &State| {
        let (q, qd, tau) = state;
        let algorithm = Algorithm::ConstrainedDynamics(Form::Covariance);
        let arguments = [Arguments { q, qd, u: tau, ..Arguments::default() }];
        Evaluator::new(scene).run(algorithm, &arguments, &mut vec![f64::NAN; scene.width(algorithm)]) & 1
    };
    for seed in 0..3 {
        // Two of the five constraints of the hinge act on a movable direction: the others are omitted.
        let scenes = [(bars(hinge()), 0.7), (bars(ConnectionKind::Point), 0.7), (biped(0), 0.2), (stewart(), 0.1)];
        for (scene, size) in scenes {
            assert_eq!(doubt(&scene, &state(&scene, seed, size)), 0);
        }
        let redundant = biped(4);
        assert_eq!(doubt(&redundant, &state(&redundant, seed, 0.2)), 1, "24 rows of rank 12");
    }
}

/// In a locked mechanism the constraints consist of rounding errors and do not contradict each other.
#[test]
fn robots_at_rest_are_held_by_their_connections() {
    for (what, scene, size) in mechanisms() {
        let weightless = scene.source().clone().gravity([0.0; 3]).build().unwrap();
        for seed in 0..4 {
            let (q, _, tau) = state(&scene, seed, size);
            let still = vec![0.0; scene.nv()];
            let mut holding = vec![f64::NAN; scene.nv()];
            scene.bias_torque(&mut scene.workspace(), &q, &still, &mut holding).unwrap();
            for (name, scene, torque) in [
                ("limp", &scene, &still),
                ("held by all joints", &scene, &holding),
                ("pushed", &scene, &tau),
                ("weightless", &weightless, &still),
            ] {
                for form in FORMS {
                    let state = (q.clone(), still.clone(), torque.clone());
                    let (qdd, .., residual) = dynamics(scene, form, &state).unwrap();
                    let general = recursion(scene, form, &state);
                    let scale = tolerance::size(&qdd).max(9.81);
                    assert!(residual <= 1e-11 * scale, "{what} {name} {form:?}: {residual:e}");
                    let cond = tolerance::conditioning(scene.nv(), mass_matrix(scene, &q).as_slice()).number;
                    let error = distance(&qdd, &general[..scene.nv()]);
                    assert!(error <= 1024.0 * f64::EPSILON * cond * scale, "{what} {name} {form:?}: {error:e}");
                }
            }
        }
    }
}

#[test]
fn what_connections_take_is_counted() {
    let scene = biped(0);
    let (q, qd, tau) = state(&scene, 1, 0.2);
    let state = Arguments { q: &q, qd: &qd, u: &tau, ..Arguments::default() };
    let through = count(&scene, Task::Algorithm(Algorithm::ConstrainedDynamics(Form::Covariance)), &state);
    let tree = scene.without_constraints().unwrap();
    let alone = count(&tree, Task::Algorithm(Algorithm::ForwardDynamics(Form::Covariance)), &state);
    let (through_flops, alone_flops) = (through.operations.flops(), alone.operations.flops());
    assert!(alone_flops < through_flops && through_flops < 6 * alone_flops, "{through_flops} beside {alone_flops}");
    let general = recursion(&scene, Form::Covariance, &(q.clone(), qd.clone(), tau.clone()));
    let nv = scene.nv();
    let error = distance(&through.results[..nv], &general[..nv]);
    assert!(error <= 1e-11 * tolerance::size(&general[..nv]), "{error:e}");
}

#[test]
fn a_linkage_moves_as_defined_however_it_is_closed() {
    for seed in 0..3 {
        let scene = bars(ConnectionKind::Point);
        compare("point", &scene, &state(&scene, seed, 0.7), 2);
        let scene = bars(hinge());
        compare("axis", &scene, &state(&scene, seed, 0.7), 2);
        let scene = welded_four_bar();
        let mut q = vec![0.3, 1.0, 1.2, 0.8];
        let mut qd = Random::new(seed).array(4, 1.0);
        scene.project(&mut scene.workspace(), &mut scene.constraint_scratch(), &mut q, Some(&mut qd)).unwrap();
        compare("weld", &scene, &(q, qd, vec![1.0, -2.0, 0.5, 0.3]), 3);
    }
}

#[test]
fn a_platform_on_six_legs_moves_as_defined() {
    for seed in 0..3 {
        let scene = stewart();
        compare("platform", &scene, &state(&scene, seed, 0.1), 15);
    }
}

#[test]
fn a_biped_on_both_feet_moves_as_defined_with_rows_that_depend_on_each_other_too() {
    for seed in 0..2 {
        let scene = biped(0);
        compare("welds", &scene, &state(&scene, seed, 0.2), 12);
        let scene = biped(4);
        compare("four points a foot", &scene, &state(&scene, seed, 0.2), 12);
    }
}

#[test]
fn no_digits_are_lost_at_mass_ratios_of_1e8() {
    for masses in [[1.0, 1e8, 1.0], [1e8, 1.0, 1.0], [1.0, 1.0, 1e8], [1e8, 1.0, 1e8], [1.0, 1e8, 1e8]] {
        let scene = four_bar(ConnectionKind::Point, masses);
        for seed in 1..12 {
            let state = state(&scene, seed, 0.7);
            let exact = exact(&scene, &state.0, &state.1, &state.2);
            for form in [Form::Auto, Form::SquareRoot] {
                let (qdd, ..) = dynamics(&scene, form, &state).unwrap();
                let error = distance(&qdd, &exact.qdd) / tolerance::size(&exact.qdd);
                assert!(error <= 4e-14, "{masses:?} {form:?}, seed {seed}: {error:e}");
            }
        }
    }
}

#[test]
fn tangles_of_all_connections_move_as_defined() {
    for seed in 0..6 {
        let scene = tangle(seed, &ALL_KINDS);
        let (q, qd, tau) = state(&scene, seed, 0.05);
        let exact = exact(&scene, &q, &qd, &tau);
        let found = dynamics(&scene, Form::Auto, &(q.clone(), qd.clone(), tau.clone())).unwrap();
        assert_eq!(found.2, exact.rank, "tangle {seed}");
        let conditioning = tolerance::conditioning(scene.nv(), mass_matrix(&scene, &q).as_slice());
        let error = distance(&found.0, &exact.qdd) / tolerance::size(&exact.qdd);
        let bound = 64.0 * f64::EPSILON * conditioning.number.sqrt() * exact.condition.sqrt();
        println!("tangle {seed}: {error:.1e}, bound {bound:.1e}");
        assert!(error <= bound, "tangle {seed}: {error:e}, bound {bound:e}");
    }
}

#[test]
fn rows_are_the_derivatives_of_the_errors_off_the_connections_too() {
    for seed in 0..6 {
        let scene = tangle(seed, &ALL_KINDS);
        let mut random = Random::new(seed);
        let q = moved(&scene, &scene.neutral(), &random.array(scene.nv(), 0.8), 1.0);
        let v = random.array(scene.nv(), 1.0);
        let along = |t: f64| errors(&scene, &moved(&scene, &q, &v, t));
        let h = 1e-4;
        let (two, one, none) = ((along(2.0 * h), along(-2.0 * h)), (along(h), along(-h)), along(0.0));
        let rates = jacobian(&scene, &q) * DVector::from_column_slice(&v);
        let mut bias = vec![f64::NAN; scene.constraint_rows()];
        scene.constraint_bias(&mut scene.workspace(), &mut scene.constraint_scratch(), &q, &v, &mut bias).unwrap();
        for i in 0..scene.constraint_rows() {
            let first = (8.0 * (one.0[i] - one.1[i]) - (two.0[i] - two.1[i])) / (12.0 * h);
            let second = (16.0 * (one.0[i] + one.1[i]) - (two.0[i] + two.1[i]) - 30.0 * none[i]) / (12.0 * h * h);
            assert!((first - rates[i]).abs() <= 1e-9, "row {i} of tangle {seed}: {first} and {}", rates[i]);
            assert!((second - bias[i]).abs() <= 1e-5 * (1.0 + second.abs()), "row {i}: {second} and {}", bias[i]);
        }
    }
}

#[test]
fn projections_meet_the_connections_by_moves_of_least_kinetic_energy() {
    for seed in 0..4 {
        let scene = tangle(seed, &ALL_KINDS);
        let mut random = Random::new(seed);
        let mut q = moved(&scene, &scene.neutral(), &random.array(scene.nv(), 0.1), 1.0);
        let (before, mut allowed) = (random.array(scene.nv(), 1.0), random.array(scene.nv(), 1.0));
        let mut qd = before.clone();
        let (mut workspace, mut scratch) = (scene.workspace(), scene.constraint_scratch());
        let told = scene.project(&mut workspace, &mut scratch, &mut q, Some(&mut qd)).unwrap();
        assert!(tolerance::size(&errors(&scene, &q)) <= 1e-13 && told.error <= 1e-13, "{told:?}");
        let rates = jacobian(&scene, &q) * DVector::from_column_slice(&qd);
        assert!(rates.amax() <= 1e-13, "{:e}", rates.amax());
        // The change is M-orthogonal to every velocity that satisfies the connections.
        let again = scene.project(&mut workspace, &mut scratch, &mut q, Some(&mut allowed)).unwrap();
        assert_eq!(again.rank, told.rank);
        let change = DVector::from_iterator(qd.len(), qd.iter().zip(&before).map(|(a, b)| a - b));
        let work = (mass_matrix(&scene, &q) * change).dot(&DVector::from_vec(allowed));
        assert!(work.abs() <= 1e-11, "{work:e}");
    }
}

#[test]
fn a_linkage_that_is_stretched_out_has_a_lower_rank() {
    // A flat parallelogram: its crank and its rocker can rotate independently.
    let open = bars(ConnectionKind::Point).without_constraints().unwrap();
    let mut pin = Connection::new("pin", ConnectionKind::Point, "coupler", Some("rocker"));
    pin.frame.lever = [0.0, 0.0, 0.3].into();
    pin.other_frame = Some(RigidShift { lever: [0.0, 0.0, 0.2].into(), ..RigidShift::identity() });
    let scene = open.source().clone().connect(pin).build().unwrap();
    let half = std::f64::consts::FRAC_PI_2;
    let (mut workspace, mut scratch) = (scene.workspace(), scene.constraint_scratch());
    let mut flat = vec![half, 0.0, half];
    assert!(tolerance::size(&errors(&scene, &flat)) < 1e-12);
    assert_eq!(scene.project(&mut workspace, &mut scratch, &mut flat, None).unwrap().rank, 1);
    let mut open = vec![0.4, half - 0.4, 0.4];
    assert_eq!(scene.project(&mut workspace, &mut scratch, &mut open, None).unwrap().rank, 2);
}

#[test]
fn what_cannot_be_reached_is_named() {
    let scene = bars(ConnectionKind::Distance(Some(5.0)));
    let mut q = vec![0.3, 0.2, 0.1];
    let found = scene.project(&mut scene.workspace(), &mut scene.constraint_scratch(), &mut q, None).unwrap_err();
    let Error::Constraint { violation, .. } = &found else { panic!("{found}") };
    assert_eq!(violation.connections, ["pin"]);
    assert!(violation.residual > 3.0 && found.to_string().contains("m or rad"), "{found}");
}

/// A chain whose tip is welded to two different poses.
fn torn() -> Scene {
    let weld = |name: &str, x: f64| {
        let mut weld = Connection::new(name, ConnectionKind::Point, "link2", None);
        weld.frame.lever = [x, 0.0, 0.0].into();
        weld
    };
    let tree = phipsi::scenes::chain(3).unwrap().source().clone();
    tree.connect(weld("one", 0.0)).connect(weld("other", 0.3)).build().unwrap()
}

#[test]
fn connections_that_contradict_each_other_are_named() {
    // Both points of a rotating link cannot be at rest.
    let scene = torn();
    let state = (vec![0.3, 0.4, 0.5], vec![1.0, -2.0, 3.0], vec![0.0; 3]);
    let found = dynamics(&scene, Form::Auto, &state).unwrap_err();
    let Error::Constraint { violation, .. } = &found else { panic!("{found}") };
    assert_eq!(violation.connections, ["one", "other"]);
    assert!(found.to_string().contains("Scene::project"), "{found}");
    let (q, qd, tau) = &state;
    let mut qdd = [f64::NAN; 3];
    assert_eq!(scene.forward_dynamics(&mut scene.workspace(), q, qd, tau, &[], &mut qdd).unwrap_err(), found);
}

#[test]
fn forward_dynamics_goes_through_the_connections_and_what_knows_trees_only_says_so() {
    let scene = bars(ConnectionKind::Point);
    let state = state(&scene, 2, 0.7);
    let (q, qd, tau) = &state;
    let (through, ..) = dynamics(&scene, Form::Auto, &state).unwrap();
    let (mut qdd, mut tree) = ([f64::NAN; 3], [f64::NAN; 3]);
    let mut workspace = scene.workspace();
    scene.forward_dynamics(&mut workspace, q, qd, tau, &[], &mut qdd).unwrap();
    assert_eq!(qdd[..], through[..]);
    let open = scene.without_constraints().unwrap();
    open.forward_dynamics(&mut open.workspace(), q, qd, tau, &[], &mut tree).unwrap();
    assert!(distance(&tree, &qdd) > 0.1 && open.constraint_rows() == 0);
    scene.inverse_dynamics(&mut workspace, q, qd, tau, &[], &mut [0.0; 3]).unwrap();
}

#[test]
fn torques_of_inverse_dynamics_give_the_accelerations() {
    for seed in 0..4 {
        let scene = tangle(seed, &ALL_KINDS);
        let state = state(&scene, seed, 0.05);
        let (q, qd, tau) = &state;
        let (qdd, ..) = dynamics(&scene, Form::Auto, &state).unwrap();
        let (mut workspace, mut scratch) = (scene.workspace(), scene.constraint_scratch());
        let (mut back, mut forces) = (vec![f64::NAN; scene.nv()], vec![f64::NAN; scene.constraint_rows()]);
        let at = (&mut workspace, &mut scratch);
        let told =
            scene.constrained_inverse_dynamics(at.0, at.1, q, qd, &qdd, &[], &[], (&mut back, &mut forces)).unwrap();
        assert!(told.residual <= 1e-9, "{told:?}");
        let (again, ..) = dynamics(&scene, Form::Auto, &(q.clone(), qd.clone(), back.clone())).unwrap();
        assert!(distance(&again, &qdd) <= 1e-10 * tolerance::size(&qdd), "seed {seed}");
        // Of all solutions, these have zero connection forces.
        let m = mass_matrix(&scene, q).cholesky().unwrap();
        let loads = jacobian(&scene, q) * m.solve(&DVector::from_column_slice(&back));
        assert!(loads.amax() <= 1e-10 * tolerance::size(&qdd), "{:e}", loads.amax());
        let more = m.solve(&DVector::from_column_slice(tau)).dot(&DVector::from_column_slice(tau));
        assert!(
            m.solve(&DVector::from_column_slice(&back)).dot(&DVector::from_column_slice(&back)) <= more * 1.000_001
        );
    }
}

#[test]
fn one_motor_drives_a_linkage_and_none_does_not() {
    let scene = bars(hinge());
    let state = state(&scene, 3, 0.7);
    let (q, qd, _) = &state;
    let (qdd, ..) = dynamics(&scene, Form::Auto, &(q.clone(), qd.clone(), vec![7.0, 0.0, 0.0])).unwrap();
    let (mut workspace, mut scratch) = (scene.workspace(), scene.constraint_scratch());
    let (mut tau, mut forces) = ([f64::NAN; 3], vec![f64::NAN; 5]);
    let motors = [true, false, false];
    let (w, s) = (&mut workspace, &mut scratch);
    scene.constrained_inverse_dynamics(w, s, q, qd, &qdd, &[], &motors, (&mut tau, &mut forces)).unwrap();
    assert!(distance(&tau, &[7.0, 0.0, 0.0]) <= 1e-12, "{tau:?}");
    let none = [false; 3];
    let found = scene.constrained_inverse_dynamics(w, s, q, qd, &qdd, &[], &none, (&mut tau, &mut forces)).unwrap_err();
    assert!(found.to_string().contains("not actuated"), "{found}");
}

#[test]
fn the_inverse_mass_matrix_through_connections_is_as_defined() {
    for seed in 0..4 {
        let scene = tangle(seed, &ALL_KINDS);
        let (q, ..) = state(&scene, seed, 0.05);
        let (m, j, found) = (mass_matrix(&scene, &q), jacobian(&scene, &q), inverse(&scene, &q));
        let free = m.clone().cholesky().unwrap().inverse();
        let g = &j * &free * j.transpose();
        let expected = &free - &free * j.transpose() * g.pseudo_inverse(1e-9).unwrap() * &j * &free;
        let size = free.amax();
        assert!((&found - &expected).amax() <= 1e-9 * size, "{:e}", (&found - expected).amax() / size);
        assert!((&j * &found).amax() <= 1e-12 * size && (&found * &m * &found - &found).amax() <= 1e-12 * size);
    }
}

#[test]
fn motion_stays_on_the_connections_and_keeps_its_energy() {
    let scene = bars(hinge());
    let (q, mut qd, _) = state(&scene, 4, 0.7);
    for v in &mut qd {
        *v *= 2.0;
    }
    let energy = |q: &[f64], qd: &[f64]| {
        let energy = scene.energy(&mut scene.workspace(), q, qd).unwrap();
        energy.kinetic + energy.potential
    };
    let begun = energy(&q, &qd);
    for (method, bound) in [(Method::RungeKutta4, 1e-6), (Method::SemiImplicitEuler, 0.5)] {
        let mut settings = Settings::new(&scene, 1e-3);
        settings.method = method;
        let mut rollout = Rollout::new(&scene, settings, &q, &qd).unwrap();
        rollout.advance(1_000, &Torque::Zero, None).map_err(|fault| fault.error).unwrap();
        let (end, rates) = rollout.state(0);
        assert!(tolerance::size(&errors(&scene, end)) <= 1e-14, "{method:?}");
        assert!((jacobian(&scene, end) * DVector::from_column_slice(rates)).amax() <= 1e-13);
        assert!(
            distance(end, &q) > 0.1 && (energy(end, rates) - begun).abs() <= bound,
            "{method:?}: {:e}",
            energy(end, rates) - begun
        );
    }
}

/// On every instruction set, with and without implicit terms, steps in the kernels are those of the checked step, which
/// compliance selects; and a state of a batch has the same bits as alone.
#[test]
fn steps_in_the_kernels_are_those_of_the_checked_step() {
    on_a_large_stack(|| {
        for (what, scene, size) in mechanisms() {
            let states: Vec<State> = (0..5).map(|seed| state(&scene, seed, size)).collect();
            let q: Vec<f64> = states.iter().flat_map(|s| s.0.clone()).collect();
            let qd: Vec<f64> = states.iter().flat_map(|s| s.1.clone()).collect();
            let cases = [(Method::RungeKutta4, 0.0), (Method::Rosenbrock2, 0.3), (Method::SemiImplicitEuler, 0.0)];
            for (method, damping) in cases {
                let mut settings = Settings::new(&scene, 1e-3).with_method(method);
                settings.properties.damping.fill(damping);
                let run = |settings: &Settings, q: &[f64], qd: &[f64]| {
                    let mut rollout = Rollout::new(&scene, settings.clone(), q, qd).unwrap();
                    for _ in 0..2 {
                        rollout.advance(5, &Torque::Zero, None).map_err(|fault| fault.error).unwrap();
                    }
                    rollout
                };
                let mut checked = settings.clone();
                checked.compliance = vec![1e-300; scene.constraint_rows()];
                let checked = run(&checked, &q, &qd);
                for arm in arms() {
                    let settings = settings.clone().with_arm(arm);
                    let all = run(&settings, &q, &qd);
                    for (i, own) in states.iter().enumerate() {
                        let case = format!("{what}, {method}, {arm}, state {i}");
                        let ((q, qd), (expected_q, expected_qd)) = (all.state(i), checked.state(i));
                        assert!(
                            distance(q, expected_q) <= tolerance::SAME_STEPS,
                            "{case}: {}",
                            distance(q, expected_q)
                        );
                        assert!(
                            distance(qd, expected_qd) <= tolerance::SAME_STEPS * tolerance::size(qd).max(1.0),
                            "{case}"
                        );
                        assert_eq!(run(&settings, &own.0, &own.1).state(0), (q, qd), "{case}: alone");
                    }
                }
            }
        }
    });
}

#[test]
fn steps_have_their_order_through_connections() {
    let scene = bars(ConnectionKind::Point);
    let (q, qd, _) = state(&scene, 4, 0.7);
    let end = |method: Method, steps: u32| {
        let mut settings = Settings::new(&scene, 0.2 / f64::from(steps));
        settings.method = method;
        settings.properties.damping = vec![0.3; 3];
        let mut rollout = Rollout::new(&scene, settings, &q, &qd).unwrap();
        rollout.advance(steps as usize, &Torque::Zero, None).map_err(|fault| fault.error).unwrap();
        rollout.state(0).0.to_vec()
    };
    let fine = end(Method::RungeKutta4, 800);
    for &(name, method) in METHODS {
        let (coarse, twice) = (distance(&end(method, 40), &fine), distance(&end(method, 80), &fine));
        let order = (coarse / twice).log2();
        println!("{name}: {coarse:.1e}, {twice:.1e}, order {order:.2}");
        assert!(order > f64::from(method.order()) - 0.3, "{name}: {order}");
    }
}

#[test]
fn a_start_off_the_connections_is_refused() {
    let scene = bars(ConnectionKind::Point);
    let (mut q, mut qd, _) = state(&scene, 4, 0.7);
    let settings = Settings::new(&scene, 1e-3);
    qd[0] += 1e-3;
    let found = Rollout::new(&scene, settings.clone(), &q, &qd).unwrap_err().to_string();
    assert!(found.contains("\"pin\"") && found.contains("Scene::project") && found.contains("qd"), "{found}");
    q[1] += 1e-3;
    let found = Rollout::new(&scene, settings, &q, &qd).unwrap_err().to_string();
    assert!(found.contains("\"pin\"") && found.contains("Scene::project"), "{found}");
}

#[test]
fn states_of_a_batch_go_on_as_they_do_alone() {
    let scene = bars(hinge());
    let (states, settings) =
        ([state(&scene, 1, 0.7), state(&scene, 2, 0.7), state(&scene, 3, 0.5)], Settings::new(&scene, 1e-2));
    let (q, qd): (Vec<f64>, Vec<f64>) =
        (states.iter().flat_map(|s| s.0.clone()).collect(), states.iter().flat_map(|s| s.1.clone()).collect());
    let mut all = Rollout::new(&scene, settings.clone(), &q, &qd).unwrap();
    all.advance(20, &Torque::Zero, None).map_err(|fault| fault.error).unwrap();
    for (i, state) in states.iter().enumerate() {
        let mut one = Rollout::new(&scene, settings.clone(), &state.0, &state.1).unwrap();
        one.advance(20, &Torque::Zero, None).map_err(|fault| fault.error).unwrap();
        assert_eq!(one.state(0), all.state(i));
    }
}

#[test]
fn changed_scenes_keep_their_connections() {
    let scene = bars(hinge());
    let (q, qd, tau) = state(&scene, 5, 0.7);
    let rebuilt = scene.source().clone().build().unwrap();
    assert_eq!(scene.connections(), rebuilt.connections());
    let state = (q.clone(), qd.clone(), tau.clone());
    assert_eq!(dynamics(&scene, Form::Auto, &state).unwrap(), dynamics(&rebuilt, Form::Auto, &state).unwrap());
    let heavier = scene.with_properties([("crank", Property::Armature, 0.5)]).unwrap();
    assert_eq!(errors(&scene, &q), errors(&heavier, &q));

    // Two of three joints: the connection locks the rest. The end of the coupler stays on the rocker.
    let locked = scene.lock(&["crank"], &q).unwrap();
    assert!(tolerance::size(&errors(&locked, &q[1..])) <= 1e-15 && locked.connections().len() == 1);
    // All of them: the connection is between merged links.
    assert!(scene.lock(&["crank", "coupler", "rocker"], &q).unwrap().connections().is_empty());
    let torn = scene.lock(&["crank", "coupler", "rocker"], &[0.1, 0.2, 0.3]).unwrap_err().to_string();
    assert!(torn.contains("connection \"pin\""), "{torn}");
}

#[test]
fn couplings_of_locked_joints_go_on_with_what_these_are_held_at() {
    let kind = ConnectionKind::Joint(Polynomial::linear(2.0, 0.1));
    let names: Vec<String> =
        phipsi::scenes::chain(3).unwrap().joints().iter().map(|joint| joint.name.clone()).collect();
    let gear = Connection::new("gear", kind, &names[0], Some(&names[2]));
    let scene = phipsi::scenes::chain(3).unwrap().source().clone().connect(gear).build().unwrap();
    let q = [0.5, -0.3, 0.2];
    assert!(tolerance::size(&errors(&scene, &q)) <= 1e-16);
    for held in [0, 2] {
        let locked = scene.lock(&[&names[held]], &q).unwrap();
        let rest: Vec<f64> = (0..3).filter(|&i| i != held).map(|i| q[i]).collect();
        assert!(tolerance::size(&errors(&locked, &rest)) <= 1e-15, "{held}");
    }
    assert!(scene.lock(&[&names[0], &names[2]], &q).unwrap().connections().is_empty());
}

/// Error message for this connection.
fn refused(change: impl FnOnce(&mut Connection)) -> String {
    let mut connection = Connection::new("pin", ConnectionKind::Point, "coupler", Some("rocker"));
    change(&mut connection);
    let builder = bars(ConnectionKind::Point).without_constraints().unwrap().source().clone();
    match builder.connect(connection).build() {
        Err(error @ Error::Scene { .. }) => error.to_string(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_name_used_twice_is_refused() {
    let builder = bars(ConnectionKind::Point).source().clone();
    let again = builder.connections()[0].clone();
    assert!(builder.connect(again).build().unwrap_err().to_string().contains("duplicate name"));
}

#[test]
fn unknown_links_are_refused() {
    assert!(refused(|c| c.link = "crankk".into()).contains("\"crankk\""));
    assert!(refused(|c| c.other = Some("none".into())).contains("\"none\""));
}

#[test]
fn a_link_connected_with_itself_is_refused() {
    assert!(refused(|c| c.other = Some("coupler".into())).contains("itself"));
}

#[test]
fn links_that_are_rigidly_attached_are_refused() {
    assert!(refused(|c| (c.link, c.other) = ("ground".into(), None)).contains("rigidly attached"));
}

#[test]
fn lengths_that_are_none_are_refused() {
    for length in [-1.0, 0.0, f64::NAN, f64::INFINITY] {
        assert!(refused(|c| c.kind = ConnectionKind::Distance(Some(length))).contains("length"), "{length}");
    }
    assert!(refused(|c| c.kind = ConnectionKind::Distance(None)).contains("coincide"));
}

#[test]
fn an_axis_without_direction_is_refused() {
    for axis in [[0.0; 3], [f64::NAN, 0.0, 1.0]] {
        assert!(refused(|c| c.kind = ConnectionKind::Axis(axis.into())).contains("axis"));
    }
}

#[test]
fn frames_that_are_none_are_refused() {
    assert!(refused(|c| c.frame.rotation *= 1.1).contains("first frame"));
    assert!(refused(|c| c.frame.rotation *= -1.0).contains("first frame"));
    assert!(refused(|c| c.frame.lever[0] = f64::NAN).contains("not finite"));
    let skewed = RigidShift { rotation: RigidShift::identity().rotation * 2.0, ..RigidShift::identity() };
    assert!(refused(|c| c.other_frame = Some(skewed)).contains("second frame"));
}

#[test]
fn couplings_that_are_none_are_refused() {
    let gear = |multiplier: f64| ConnectionKind::Joint(Polynomial::linear(multiplier, 0.0));
    assert!(refused(|c| (c.kind, c.link) = (gear(1.0), "nobody".into())).contains("\"nobody\""));
    assert!(refused(|c| (c.kind, c.other) = (gear(1.0), Some("coupler".into()))).contains("itself"));
    assert!(refused(|c| c.kind = gear(f64::NAN)).contains("multiplier"));
}

#[test]
fn broken_arguments_are_refused() {
    let scene = bars(ConnectionKind::Point);
    let (mut workspace, mut scratch) = (scene.workspace(), scene.constraint_scratch());
    let mut call = |q: &[f64], qd: &[f64], tau: &[f64], lengths: [usize; 2]| {
        let (mut qdd, mut forces) = (vec![0.0; lengths[0]], vec![0.0; lengths[1]]);
        scene.constrained_dynamics(&mut workspace, &mut scratch, q, qd, tau, &[], (&mut qdd, &mut forces))
    };
    let z = [0.0; 3];
    assert!(call(&z[..2], &z, &z, [3, 3]).unwrap_err().to_string().starts_with("q:"));
    assert!(call(&z, &z[..2], &z, [3, 3]).unwrap_err().to_string().starts_with("qd:"));
    assert!(call(&z, &z, &[f64::NAN; 3], [3, 3]).unwrap_err().to_string().starts_with("tau:"));
    assert!(call(&z, &z, &z, [2, 3]).unwrap_err().to_string().starts_with("qdd:"));
    assert!(call(&z, &z, &z, [3, 2]).unwrap_err().to_string().starts_with("forces:"));
    let other = biped(0);
    let (q, mut out) = (scene.neutral(), vec![0.0; 9]);
    let mut of_other = other.constraint_scratch();
    assert!(scene.constraint_jacobian(&mut scene.workspace(), &mut of_other, &q, &mut out).is_err());
}

#[test]
fn a_scene_without_constraints_has_no_rows() {
    let scene = phipsi::scenes::chain(3).unwrap();
    let state = (vec![0.1, 0.2, 0.3], vec![0.3; 3], vec![1.0; 3]);
    let (qdd, forces, rank, residual) = dynamics(&scene, Form::Auto, &state).unwrap();
    let mut expected = [f64::NAN; 3];
    let (q, qd, tau) = &state;
    scene.forward_dynamics(&mut scene.workspace(), q, qd, tau, &[], &mut expected).unwrap();
    assert!(forces.is_empty() && rank == 0 && residual == 0.0 && distance(&qdd, &expected) <= 1e-12);
    let m = mass_matrix(&scene, q);
    assert!((inverse(&scene, q) * m - DMatrix::identity(3, 3)).amax() <= 1e-10);
    let (mut workspace, mut scratch) = (scene.workspace(), scene.constraint_scratch());
    let mut moved = q.clone();
    assert_eq!(scene.project(&mut workspace, &mut scratch, &mut moved, None).unwrap().rank, 0);
    let (mut out, at) = ([f64::NAN; 3], (&mut workspace, &mut scratch));
    let motors = [true, false, true];
    let found = scene.constrained_inverse_dynamics(at.0, at.1, q, qd, &qdd, &[], &motors, (&mut out, &mut []));
    assert!(found.unwrap_err().to_string().contains("not actuated"));
}
