//! Operations counted: by hand for one body, linear on chains, the bits of f64, and the counts that the doc comments give.

use crate::common::{ALL_KINDS, Random, random_scene, random_state};
use nalgebra::Vector6;
use phipsi::batch::Evaluator;
use phipsi::batch::InstructionSet;
use phipsi::dynamics::InverseScratch;
use phipsi::dynamics::{self, Estimate, EstimateCovariance, EstimateScratch, Measurements};
use phipsi::filter::Scale;
use phipsi::filter::riccati::{self, Measured};
use phipsi::filter::rounding::{self, Reach, Swept, Weighed};
use phipsi::filter::square_root::{self, Mean, Roots};
use phipsi::filter::{Form, HingeMap, innovations, smoothed, smoother};
use phipsi::kinematics::placements_base_to_tip;
use phipsi::report::operations::{Count, Task, count, count_recursion, tasks};
use phipsi::scalar::{Operations, Real, Traced};
use phipsi::scene::{JointKind, Model};
use phipsi::spatial::RigidShift;
use phipsi::{Algorithm, Arguments};
use phipsi::{Scene, Workspace, scenes};

/// A state of a chain, no number of it zero.
fn counted(scene: &Scene, task: Task) -> Count {
    let (q, qd, u) = random_state(scene, &mut Random::new(5));
    count_recursion(scene, task, &Arguments { q: &q, qd: &qd, u: &u, wrenches: &[], ..Arguments::default() })
}

fn of_chain(bodies: usize, task: Task) -> Operations {
    counted(&scenes::chain(bodies).unwrap(), task).operations
}

/// The same on a chain with so much armature that no form loses digits, and none looks twice.
fn of_calm_chain(bodies: usize, task: Task) -> Operations {
    counted(&random_scene(3, bodies, &[JointKind::Revolute], 0.0, 100.0), task).operations
}

/// What one more joint adds to a long chain.
fn a_joint(work: impl Fn(usize) -> Operations) -> u64 {
    work(21).flops() - work(20).flops()
}

#[test]
fn one_body_by_hand() {
    // R Rz: three rows of two products with a sum and two without. phi^T v: a lever (6 with a sum), two rotations (3 + 6 each).
    // M v: 6 products without a sum, 18 with; v x* (M v) beside it: 6 + 33 (see BodyInertia::bias_force).
    let placed = Operations { multiplications: 6, fused: 6, sines: 1, ..Operations::NONE };
    let bias = Operations {
        // Velocity and acceleration: two sums of six.
        additions: 12,
        multiplications: placed.multiplications + 2 * 6 + 4 + 12,
        fused: placed.fused + 2 * 18 + 45,
        ..placed
    };
    assert_eq!(of_chain(1, Task::Algorithm(Algorithm::BiasTorque)), bias);
    // Six sums for the joint's acceleration, and the armature's product and sum.
    let inverse = Operations { additions: bias.additions + 6 + 1, multiplications: bias.multiplications + 1, ..bias };
    assert_eq!(of_chain(1, Task::Algorithm(Algorithm::InverseDynamics)), inverse);
    // H^T is written by a sum, M H^T is a product, the armature a sum.
    let mass =
        Operations { additions: 2, multiplications: placed.multiplications + 6, fused: placed.fused + 18, ..placed };
    assert_eq!(of_chain(1, Task::Algorithm(Algorithm::MassMatrix)), mass);
    assert_eq!(mass.flops(), 2 + 12 + 2 * 24 + Operations::OF_SINES);
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

/// The same functions on f64.
fn plainly(scene: &Scene, task: Task, state: &Arguments<'_>) -> Vec<f64> {
    let model = scene.model();
    let mut workspace = Workspace::new(model);
    let &Arguments { q, qd, u, wrenches, .. } = state;
    let mut out = match task {
        Task::Algorithm(algorithm) => vec![f64::NAN; scene.width(algorithm)],
        Task::Factor(_) => Vec::new(),
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
        Task::Algorithm(Algorithm::Derivatives(_) | Algorithm::Products(_) | Algorithm::ConstrainedDynamics(_)) => {
            unreachable!("not among the tasks")
        }
        Task::Factor(form) => {
            workspace.form = form;
            out.extend(scene.factor(&mut workspace, q).unwrap().pivots());
        }
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
            // Numbers of their own, products and sums apart, as they are counted.
            let mut evaluator = Evaluator::on(InstructionSet::Baseline, &scene);
            for algorithm in algorithms {
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

/// The square-root form's sweep with a mean, its first look, and its judge, on a chain.
fn root_sweep(bodies: usize) -> [Operations; 3] {
    let scene = scenes::chain(bodies).unwrap();
    let model: Model<Traced> = scene.model().cast();
    let (system, nv) = (&model.system, model.nv());
    let [q, tau, w] =
        [1, 2, 3].map(|seed| Random::new(seed).array(nv, 2.0).into_iter().map(Traced::from_f64).collect::<Vec<_>>());
    let zeros = || vec![Vector6::from_element(Traced::from_f64(0.0)); bodies];
    let mut shift = vec![RigidShift::identity(); bodies];
    placements_base_to_tip(&model, &q, &mut shift);
    let mut root: Vec<_> = model.inertia_roots.iter().map(|root| root.as_ref().unwrap().to_root()).collect();
    let mut scale: Vec<_> = model.bodies.iter().map(|body| Scale::of_noise(&body.inertia_terms)).collect();
    let mut measured = vec![Measured::filled(Traced::from_f64(f64::NAN)); nv];
    let (mut coordinates, mut added, mut estimates) =
        (vec![[Traced::from_f64(0.5); 6]; bodies], zeros(), vec![Traced::from_f64(0.0); nv]);
    let (monitor, swept) = Traced::counted(|| {
        let (shift, measurement) = (&shift, &tau);
        let mut roots = Roots { shift, root: &mut root, scale: &mut scale, measured: &mut measured };
        let innovations = &mut estimates;
        let mut mean = Mean { coordinates: &mut coordinates, added: &mut added, measurement, innovations };
        square_root::sweep(system, &mut roots, Some(&mut mean), |_, _| {})
    });
    let (mut co_state, mut second, mut state, mut innovations) = (zeros(), zeros(), zeros(), tau.clone());
    smoother::sweep(system, &shift, &measured, &mut co_state, &mut estimates);
    let (_, looked) = Traced::counted(|| Reach::new(&monitor, system, &shift, &co_state, &estimates));
    innovations::sweep(system, &shift, &measured, &w, &mut state, &mut innovations);
    let mut others = innovations.clone();
    smoother::sweep(system, &shift, &measured, &mut second, &mut others);
    let swept_all = Swept {
        shift: &shift,
        root: &root,
        coordinates: &coordinates,
        added: &added,
        measured: &measured,
        measurement: &tau,
        estimates: &estimates,
        co_state: &co_state,
    };
    let weighed = Weighed { state: &state, innovations: &innovations, estimates: &others, co_state: &second };
    let (rounding, judged) = Traced::counted(|| rounding::judge(system, &swept_all, &weighed));
    assert!(rounding.relative_error(0).is_finite());
    [swept, looked, judged]
}

/// One measurement, and what the covariances of a block cost beside those of Lambda.
fn of_one_block() -> [u64; 2] {
    let scene = scenes::chain(1).unwrap();
    let model: Model<Traced> = scene.model().cast();
    let mut p = model.bodies[0].inertia.to_symmetric();
    let (measured, update) =
        Traced::counted(|| riccati::measurement_update(&mut p, &HingeMap::Axis(2), Traced::from_f64(0.0)));
    let (_, block) = Traced::counted(|| (smoothed::remaining(&p, &p), smoothed::information(&measured, &p)));
    [update.flops(), block.flops()]
}

/// Floating-point operations that the doc comments name, of a one-axis joint without armature, and what is counted: within a
/// twentieth, for they say "about".
#[test]
fn as_documented() {
    let a_joint_of = |task| a_joint(|n| of_chain(n, task));
    let forward = |form| Task::Algorithm(Algorithm::ForwardDynamics(form));
    let calm = |task| a_joint(|n| of_calm_chain(n, task));
    let [update, block] = of_one_block();
    let root = |which: usize| a_joint(|n| root_sweep(n)[which]);
    let [more_in_joseph, more_in_auto] =
        [Form::Joseph, Form::Auto].map(|form| calm(forward(form)) - calm(forward(Form::Covariance)));
    let documented: [(&str, u64, u64); 14] = [
        ("dynamics::forward_dynamics, covariance", 810, a_joint_of(forward(Form::Covariance))),
        ("dynamics::inverse_dynamics", 330, a_joint_of(Task::Algorithm(Algorithm::InverseDynamics))),
        ("dynamics::estimate", 1150, a_joint(|n| estimates(n)[0])),
        ("dynamics::estimate_covariance", 2700, a_joint(|n| estimates(n)[1])),
        ("Scene::factor, covariance", 490, a_joint_of(Task::Factor(Form::Covariance))),
        ("Scene::factor, auto beside it", 490, calm(Task::Factor(Form::Auto)) - calm(Task::Factor(Form::Covariance))),
        ("riccati::measurement_update", 56, update),
        ("riccati::update, Joseph", 170, update + more_in_joseph),
        ("filter::cancellation", 370, more_in_auto),
        ("filter::square_root", 1020, root(0)),
        ("filter::square_root, divisions", 31, root_sweep(21)[0].divisions - root_sweep(20)[0].divisions),
        ("rounding::Reach::new", 18, root(1)),
        ("rounding::judge", 420, root(2)),
        ("filter::smoothed", 700, block),
    ];
    let wrong: Vec<_> =
        documented.iter().filter(|(_, about, counted)| about.abs_diff(*counted) * 20 > *about).collect();
    assert!(wrong.is_empty(), "(what, documented, counted): {wrong:?}");
}
