//! Operation counts: by hand for one body, linear on chains, bitwise equality with f64, and the counts in doc
//! comments.

use crate::common::{ALL_KINDS, Random, random_scene, random_state};
use nalgebra::Vector6;
use phipsi::batch::Evaluator;
use phipsi::batch::InstructionSet;
use phipsi::dynamics::InverseScratch;
use phipsi::dynamics::{self, Estimate, EstimateCovariance, EstimateScratch, Measurements};
use phipsi::filter::{Form, HingeMap, riccati, smoothed};
use phipsi::report::operations::{Count, Task, count, count_recursion, tasks};
use phipsi::scalar::{Operations, Real, Traced};
use phipsi::scene::{JointKind, Model};
use phipsi::{Algorithm, Arguments};
use phipsi::{Scene, Workspace, scenes};

/// A state of a chain without zero entries.
fn counted(scene: &Scene, task: Task) -> Count {
    let (q, qd, u) = random_state(scene, &mut Random::new(5));
    count_recursion(scene, task, &Arguments { q: &q, qd: &qd, u: &u, wrenches: &[], ..Arguments::default() })
}

fn of_chain(bodies: usize, task: Task) -> Operations {
    counted(&scenes::chain(bodies).unwrap(), task).operations
}

/// The same on a chain with so much armature that no form loses precision, and none needs a second estimate.
fn of_calm_chain(bodies: usize, task: Task) -> Operations {
    counted(&random_scene(3, bodies, &[JointKind::Revolute], 0.0, 100.0), task).operations
}

/// Cost of one additional joint of a long chain.
fn a_joint(work: impl Fn(usize) -> Operations) -> u64 {
    work(21).flops() - work(20).flops()
}

#[test]
fn one_body_by_hand() {
    // R Rz: three rows of two products with a sum and two without.
    let placed = Operations { multiplications: 6, fused: 6, sines: 1, ..Operations::NONE };
    // The acceleration across a lever: three cross products of six. Three rotations of 3 + 6. The joint's own velocity:
    // 2 and a sum. Squares and products of w, and three sums of three. The force: 6 products without a sum, 27 with, 3
    // sums, and 3 differences of moments of inertia.
    let bias = Operations {
        additions: 1 + 9 + 3 + 3,
        multiplications: placed.multiplications + 3 * 3 + 6 + 6,
        fused: placed.fused + 3 * 6 + 3 * 6 + 2 + 27,
        ..placed
    };
    assert_eq!(of_chain(1, Task::Algorithm(Algorithm::BiasTorque)), bias);
    // Six sums for the acceleration of the joint, and a multiply-add for the armature.
    let inverse = Operations { additions: bias.additions + 6 + 1, multiplications: bias.multiplications + 1, ..bias };
    assert_eq!(of_chain(1, Task::Algorithm(Algorithm::InverseDynamics)), inverse);
    // The sum over no children and the body's ten parameters, and the armature's sum.
    let mass = Operations { additions: 10 + 1, ..placed };
    assert_eq!(of_chain(1, Task::Algorithm(Algorithm::MassMatrix)), mass);
    assert_eq!(mass.flops(), 11 + 6 + 2 * 6 + Operations::OF_SINES);
}

#[test]
fn nothing_is_counted_twice_or_outside() {
    let two = Traced::from_f64(2.0);
    let (inner, outer) = Traced::counted(|| {
        let _ = two * two;
        Traced::counted(|| (two + two).sqrt().recip().mul_add(two, -two) / two).1
    });
    let expected = Operations { additions: 1, fused: 1, divisions: 2, roots: 1, ..Operations::NONE };
    assert_eq!(inner, expected);
    assert_eq!(outer, Operations { multiplications: 1, ..Operations::NONE });
    assert_eq!(Traced::counted(|| ()).1, Operations::NONE);
}

#[test]
fn linear_on_chains() {
    for (name, task) in tasks() {
        let order = match task {
            Task::Algorithm(Algorithm::MassMatrix | Algorithm::MassMatrixInverse(_)) => 2,
            _ => 1,
        };
        let mut differences: Vec<Vec<i128>> =
            (4..10).map(|n| of_calm_chain(n, task).named().map(|(_, count)| i128::from(count)).to_vec()).collect();
        for _ in 0..=order {
            differences =
                differences.windows(2).map(|w| w[1].iter().zip(&w[0]).map(|(b, a)| b - a).collect()).collect();
        }
        assert!(differences.iter().flatten().all(|&d| d == 0), "{name}: {differences:?}");
        let [few, many] = [4, 9].map(|n| of_calm_chain(n, task).flops());
        assert!(few > 0 && many > few, "{name}");
    }
}

/// The same functions with f64.
fn plainly(scene: &Scene, task: Task, state: &Arguments<'_>) -> Vec<f64> {
    let model = scene.model();
    let mut workspace = Workspace::new(model);
    let &Arguments { q, qd, u, wrenches, .. } = state;
    let mut out = match task {
        Task::Algorithm(algorithm) => vec![f64::NAN; scene.width(algorithm)],
        _ => Vec::new(),
    };
    match task {
        Task::Algorithm(Algorithm::ForwardDynamics(form)) => {
            workspace.form = form;
            dynamics::forward_dynamics(model, &mut workspace, q, qd, u, wrenches, &mut out);
        }
        Task::Algorithm(Algorithm::InverseDynamics) => {
            dynamics::inverse_dynamics(model, &mut workspace, q, qd, u, wrenches, &mut out);
        }
        Task::Algorithm(Algorithm::BiasTorque) => {
            dynamics::bias_torque(model, &mut workspace, q, qd, wrenches, &mut out);
        }
        Task::Algorithm(Algorithm::MassMatrix) => dynamics::mass_matrix(model, &mut workspace, q, &mut out),
        Task::Algorithm(Algorithm::MassMatrixInverse(form)) => {
            workspace.form = form;
            dynamics::mass_matrix_inverse(model, &mut workspace, &mut InverseScratch::new(model), q, &mut out);
        }
        Task::Factor(form) => {
            workspace.form = form;
            out.extend(scene.factor(&mut workspace, q).unwrap().pivots());
        }
        other => unreachable!("{other:?}: not among the tasks"),
    }
    assert_eq!(workspace.tally.refined, 0, "double-double arithmetic is f64's alone");
    out
}

#[test]
fn the_bits_of_f64() {
    for seed in 0..6 {
        let scene = random_scene(seed, 9, &ALL_KINDS, 0.4, 0.1);
        let mut random = Random::new(seed);
        let (q, qd, u) = random_state(&scene, &mut random);
        let wrenches: Vec<_> =
            scene.model().bodies.iter().map(|_| Vector6::from_fn(|_, _| random.uniform(-1.0, 1.0))).collect();
        let state = Arguments { q: &q, qd: &qd, u: &u, wrenches: &wrenches, ..Arguments::default() };
        for (name, task) in tasks() {
            let found = count_recursion(&scene, task, &state).results;
            let expected = plainly(&scene, task, &state);
            assert!(!expected.is_empty() && expected.iter().all(|x| x.is_finite()), "{name}, scene {seed}");
            let bits = |values: &[f64]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&found), bits(&expected), "{name}, scene {seed}: {found:?} {expected:?}");
        }
    }
}

#[test]
fn what_is_counted_is_what_is_evaluated() {
    let algorithms = [
        Algorithm::ForwardDynamics(Form::Auto),
        Algorithm::ForwardDynamics(Form::Covariance),
        Algorithm::ForwardDynamics(Form::SquareRoot),
        Algorithm::InverseDynamics,
        Algorithm::BiasTorque,
        Algorithm::MassMatrix,
        Algorithm::MassMatrixInverse(Form::Auto),
        Algorithm::MassMatrixInverse(Form::Covariance),
    ];
    for seed in 0..6 {
        for kinds in [&ALL_KINDS[..], &[JointKind::Revolute]] {
            let scene = random_scene(seed, 9, kinds, 0.4, 0.1);
            let (q, qd, u) = random_state(&scene, &mut Random::new(seed));
            // Separate counts of multiplications and additions.
            let mut evaluator = Evaluator::on(InstructionSet::Baseline, &scene);
            // Without the feature lanes the recursion computes the square-root form, with other rounding errors.
            let has_kernels =
                |&of: &Algorithm| cfg!(feature = "lanes") || of != Algorithm::ForwardDynamics(Form::SquareRoot);
            for algorithm in algorithms.into_iter().filter(has_kernels) {
                let state =
                    Arguments { q: &q, qd: &qd, u: &u, wrenches: &[], ..Arguments::default() }.read_by(algorithm);
                let mut expected = vec![f64::NAN; scene.width(algorithm)];
                scene.evaluate(&mut evaluator, algorithm, &[state], &mut expected).unwrap();
                let found = count(&scene, Task::Algorithm(algorithm), &state);
                let bits = |values: &[f64]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
                assert_eq!(bits(&found.results), bits(&expected), "{algorithm:?}, scene {seed}");
                assert!(found.operations.flops() > 0);
            }
        }
    }
}

/// Estimation from noisy torques of every joint, and the covariances after it, on a chain.
fn estimates(bodies: usize) -> [Operations; 2] {
    let scene = scenes::chain(bodies).unwrap();
    let model: Model<Traced> = scene.model().cast();
    let (q, qd, u) = random_state(&scene, &mut Random::new(5));
    let [q, qd, u] = [q, qd, u].map(|values| values.into_iter().map(Traced::from_f64).collect::<Vec<_>>());
    let noise = vec![Traced::from_f64(0.1); model.nv()];
    let measurements = Measurements {
        torque: &u,
        noise: &noise,
        prior_acceleration: None,
        acceleration_variance: Traced::from_f64(2.0),
    };
    let (mut workspace, mut scratch) = (Workspace::new(&model), EstimateScratch::new(&model));
    let (mut means, mut covariances) = (Estimate::new(&model), EstimateCovariance::new(&model));
    let (_, first) = Traced::counted(|| {
        dynamics::estimate(&model, &mut workspace, &mut scratch, &q, &qd, &measurements, &[], &mut means)
    });
    let (_, second) = Traced::counted(|| {
        dynamics::estimate_covariance(&model, &mut workspace, &mut scratch, &measurements, &mut covariances)
    });
    assert!(covariances.torque.iter().all(|x| x.lane(0) > 0.0));
    [first, second]
}

/// Forward dynamics in square-root form on a chain, without and with the error estimate.
fn by_roots(bodies: usize) -> [Operations; 2] {
    let scene = scenes::chain(bodies).unwrap();
    let model: Model<Traced> = scene.model().cast();
    let (q, qd, u) = random_state(&scene, &mut Random::new(5));
    let [q, qd, u] = [q, qd, u].map(|values| values.into_iter().map(Traced::from_f64).collect::<Vec<_>>());
    [false, true].map(|estimates_error| {
        let mut workspace = Workspace::new(&model).in_form(Form::SquareRoot);
        workspace.estimates_error = estimates_error;
        let mut qdd = vec![Traced::from_f64(f64::NAN); model.nv()];
        let ((), counted) = Traced::counted(|| {
            dynamics::forward_dynamics(&model, &mut workspace, &q, &qd, &u, &[], &mut qdd);
        });
        assert!(workspace.accuracy.error > 0.0 || !estimates_error);
        counted
    })
}

/// One measurement, and the cost of the covariances of a block in addition to those of Lambda.
fn of_one_block() -> [u64; 2] {
    let scene = scenes::chain(1).unwrap();
    let model: Model<Traced> = scene.model().cast();
    let mut p = model.bodies[0].inertia.to_symmetric();
    let (measured, update) =
        Traced::counted(|| riccati::measurement_update(&mut p, &HingeMap::Axis(2), Traced::from_f64(0.0)));
    let (_, block) = Traced::counted(|| (smoothed::remaining(&p, &p), smoothed::information(&measured, &p)));
    [update.flops(), block.flops()]
}

/// Floating-point operations in the doc comments, for a one-axis joint without armature, compared with the
/// counts: within a twentieth, because they are approximate.
#[test]
fn as_documented() {
    let a_joint_of = |task| a_joint(|n| of_chain(n, task));
    let forward = |form| Task::Algorithm(Algorithm::ForwardDynamics(form));
    let calm = |task| a_joint(|n| of_calm_chain(n, task));
    let [update, block] = of_one_block();
    let root = |n| of_chain(n, Task::Factor(Form::SquareRoot));
    let more_in_auto = calm(forward(Form::Auto)) - calm(forward(Form::Covariance));
    let documented: [(&str, u64, u64); 12] = [
        ("dynamics::forward_dynamics, covariance", 770, a_joint_of(forward(Form::Covariance))),
        ("dynamics::inverse_dynamics", 290, a_joint_of(Task::Algorithm(Algorithm::InverseDynamics))),
        ("dynamics::estimate", 1150, a_joint(|n| estimates(n)[0])),
        ("dynamics::estimate_covariance", 2700, a_joint(|n| estimates(n)[1])),
        ("Scene::factor, covariance", 490, a_joint_of(Task::Factor(Form::Covariance))),
        ("Scene::factor, auto beside it", 490, calm(Task::Factor(Form::Auto)) - calm(Task::Factor(Form::Covariance))),
        ("riccati::measurement_update", 56, update),
        ("filter::cancellation", 370, more_in_auto),
        ("filter::square_root", 1100, a_joint(root)),
        ("filter::square_root, divisions", 31, root(21).divisions - root(20).divisions),
        ("rounding::Rounding", 530, a_joint(|n| by_roots(n)[1]) - a_joint(|n| by_roots(n)[0])),
        ("filter::smoothed", 700, block),
    ];
    let wrong: Vec<_> =
        documented.iter().filter(|(_, about, counted)| about.abs_diff(*counted) * 20 > *about).collect();
    assert!(wrong.is_empty(), "(what, documented, counted): {wrong:?}");
}
