//! Adaptive steps compared with closed forms and with small fixed steps; refused arguments.

use crate::common::{Random, Tree, random_state, tolerance};
use phipsi::motion::{Adaptive, Gains, Method, Rollout, Settings, Solver, Torque};
use phipsi::motion::{Failure, Solution};
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::spatial::Symmetric3;
use phipsi::{Error, Scene};

const SOLVERS: [Solver; 4] = [Solver::Tsit45, Solver::Bdf, Solver::TrBdf2, Solver::Esdirk34];

fn no_torque(_t: f64, _q: &[f64], _qd: &[f64], _torque: &mut [f64]) {}

/// A body of 2 kg on a hinge along y, its center of mass half a meter below, inertia about the hinge 0.62 kg m^2.
fn pendulum(kind: JointKind) -> Scene {
    let rod = Inertial {
        mass: 2.0,
        center: [0.0, 0.0, -0.5].into(),
        central: Symmetric3::new([0.12, 0.0, 0.0, 0.12, 0.0, 0.01]),
    };
    let mut joint = JointDescription::new("hinge", kind, "base", "rod");
    joint.axis = nalgebra::Vector3::y();
    SceneBuilder::new()
        .gravity([0.0, 0.0, -9.81])
        .link(LinkDescription { name: "base".into(), inertial: None })
        .link(LinkDescription { name: "rod".into(), inertial: Some(rod) })
        .joint(joint)
        .build()
        .unwrap()
}

/// The period of a pendulum from rest at `angle`: 2 pi sqrt(I/(m g d))/agm(1, cos(angle/2)).
fn period(angle: f64) -> f64 {
    let (mut a, mut b) = (1.0_f64, (angle / 2.0).cos());
    for _ in 0..8 {
        (a, b) = (0.5 * (a + b), (a * b).sqrt());
    }
    std::f64::consts::TAU * (0.62_f64 / (2.0 * 9.81 * 0.5)).sqrt() / a
}

#[test]
fn a_pendulum_is_back_after_its_period() {
    let scene = pendulum(JointKind::Continuous);
    let time = period(2.0);
    for solver in SOLVERS {
        let errors = [1e-5, 1e-8].map(|tol| {
            let law = Adaptive::new(&scene).with_solver(solver).with_rtol(tol).with_atol(tol);
            let path = law.solve(&[2.0], &[0.0], &[0.0, time / 2.0, time], &no_torque).unwrap();
            assert_eq!((path.t.len(), path.centers), (3, 1));
            let half = (path.q[1] + 2.0).abs().max(path.qd[1].abs());
            (half.max((path.q[2] - 2.0).abs()).max(path.qd[2].abs()), path.steps, path.evaluations)
        });
        println!("{solver:?}: {errors:?}");
        for ((error, steps, _), tol) in errors.into_iter().zip([1e-5, 1e-8]) {
            assert!(error <= tolerance::adaptive(steps, tol), "{solver:?} at {tol:e}: {error:e}");
        }
        assert!(errors[1].1 > errors[0].1);
    }
}

#[test]
fn a_spring_swings_as_a_cosine_and_a_damped_one_as_its_closed_form() {
    // Without gravity along the prismatic joint: x'' = -k x - d x', 2 kg.
    let scene = pendulum(JointKind::Prismatic);
    for (damping, solver) in [(0.0, Solver::Tsit45), (3.0, Solver::Bdf)] {
        let mut law = Adaptive::new(&scene).with_solver(solver);
        (law.properties.stiffness, law.properties.damping) = (vec![80.0], vec![damping]);
        let times: Vec<f64> = (0..20).map(|i| 0.13 * f64::from(i)).collect();
        let path = law.solve(&[0.3], &[0.0], &times, &no_torque).unwrap();
        let decay = damping / 4.0;
        let fast = (40.0 - decay * decay).sqrt();
        for (t, x) in times.iter().zip(&path.q) {
            let expected = 0.3 * (-decay * t).exp() * ((fast * t).cos() + decay / fast * (fast * t).sin());
            assert!(
                (x - expected).abs() <= tolerance::adaptive(path.steps, 1e-9),
                "{solver:?} at {t}: {x} beside {expected}"
            );
        }
    }
}

/// A floating tree with all types of rotations, with springs, damping, friction and a control law.
fn tumbling() -> (Scene, Settings, (Vec<f64>, Vec<f64>)) {
    let kinds = [JointKind::Spherical, JointKind::Revolute, JointKind::Floating, JointKind::Prismatic];
    let tree = Tree { seed: 5, bodies: 5, kinds: &kinds, branching: 0.4, armature: 0.3, floating: true };
    let scene = tree.scene();
    let mut random = Random::new(4);
    let (q, v, _) = random_state(&scene, &mut random);
    let nv = scene.nv();
    let mut settings = Settings::new(&scene, 1.0);
    let mut positive = |size: f64| -> Vec<f64> { random.array(nv, size).iter().map(|x| x.abs()).collect() };
    let p = &mut settings.properties;
    (p.damping, p.stiffness, p.friction) = (positive(0.3), positive(2.0), positive(0.2));
    (p.rest, p.friction_speed) = (q.clone(), 0.5);
    // The tree makes several turns.
    for acting in [&mut p.damping, &mut p.stiffness, &mut p.friction] {
        acting[..6].fill(0.0);
    }
    let [mut proportional, mut derivative] = [positive(1.0), positive(0.3)];
    proportional[..6].fill(0.0);
    derivative[..6].fill(0.0);
    settings.gains = Some(Gains::new(proportional, derivative, q.clone()).with_target_rate(positive(0.5)));
    (scene, settings, (q, v))
}

/// The largest difference of two states, positions on the manifold.
fn distance(scene: &Scene, a: (&[f64], &[f64]), b: (&[f64], &[f64])) -> f64 {
    let mut s = vec![f64::NAN; scene.nv()];
    scene.difference(a.0, b.0, &mut s).unwrap();
    let rates = a.1.iter().zip(b.1).map(|(a, b)| a - b);
    s.iter().copied().chain(rates).map(f64::abs).fold(0.0, |m, x| if x <= m { m } else { x })
}

#[test]
fn a_tumbling_tree_goes_as_by_small_fixed_steps_however_often_it_is_recentered() {
    let (scene, settings, (q, mut v)) = tumbling();
    // It rotates by several radians.
    v[3..6].copy_from_slice(&[14.0, -9.0, 12.0]);
    let settings = settings.with_dt(1.25e-4).with_method(Method::RungeKutta4);
    let mut rollout = Rollout::new(&scene, settings.clone(), &q, &v).unwrap();
    let mut exact = Vec::new();
    for _ in 0..4 {
        rollout.advance(1600, &Torque::Zero, None).unwrap();
        exact.push((rollout.state(0).0.to_vec(), rollout.state(0).1.to_vec()));
    }
    let times = [0.0, 0.2, 0.4, 0.6, 0.8];
    for (solver, tol) in [(Solver::Tsit45, 1e-8), (Solver::Bdf, 1e-8), (Solver::TrBdf2, 1e-5), (Solver::Esdirk34, 1e-6)]
    {
        let law = Adaptive::new(&scene)
            .with_solver(solver)
            .with_rtol(tol)
            .with_atol(tol)
            .with_properties(settings.properties.clone())
            .with_gains(settings.gains.clone());
        let path = law.solve(&q, &v, &times, &no_torque).unwrap();
        let mut worst = 0.0_f64;
        for (row, (q1, v1)) in exact.iter().enumerate() {
            let (nq, nv) = (scene.nq(), scene.nv());
            let found = (&path.q[(row + 1) * nq..(row + 2) * nq], &path.qd[(row + 1) * nv..(row + 2) * nv]);
            let off = distance(&scene, found, (q1, v1));
            worst = if off <= worst { worst } else { off };
            for joint in scene.joints() {
                let q = &found.0[joint.q.clone()];
                if q.len() >= 4 {
                    let norm: f64 = q[q.len() - 4..].iter().map(|x| x * x).sum();
                    assert!((norm - 1.0).abs() <= tolerance::product(4, 1.0), "{solver:?}");
                }
            }
        }
        println!("{solver:?}: {worst:.1e}, {} steps, {} rates, {} centers", path.steps, path.evaluations, path.centers);
        assert!(worst <= tolerance::adaptive(path.steps, tol), "{solver:?}: {worst:e}");
        assert!(path.centers > 2, "{solver:?}: {} centers", path.centers);
    }
}

#[test]
fn given_torques_are_asked_at_every_stage() {
    // No gravity along the prismatic joint: 2 x'' = 6 t, x = t^3/2; and a function of the state, 2 x'' = -8 x.
    let scene = pendulum(JointKind::Prismatic);
    let law = Adaptive::new(&scene);
    let path = law.solve(&[0.0], &[0.0], &[0.0, 1.0], &|t, _q, _v, torque| torque[0] = 6.0 * t).unwrap();
    assert!((path.q[1] - 0.5).abs() <= tolerance::adaptive(path.steps, 1e-9));
    let path = law.solve(&[1.0], &[0.0], &[0.0, 1.0], &|_t, q, _v, torque| torque[0] = -8.0 * q[0]).unwrap();
    assert!((path.q[1] - 2.0_f64.cos()).abs() <= tolerance::adaptive(path.steps, 1e-9));
}

#[test]
fn springs_of_a_billion_are_followed_in_few_steps_by_the_implicit_solvers() {
    let scene = crate::common::swinging(3);
    let slow = scene.lock(&["j1", "j2"], &[0.0; 3]).unwrap();
    let tight = Adaptive::new(&slow).with_rtol(1e-11).with_atol(1e-11);
    let exact = tight.solve(&[0.3], &[0.5], &[0.0, 0.2], &no_torque).unwrap();
    for (solver, damping) in [(Solver::Bdf, 1e6), (Solver::TrBdf2, 0.0), (Solver::Esdirk34, 0.0)] {
        let mut law = Adaptive::new(&scene).with_solver(solver).with_rtol(1e-6).with_atol(1e-6).with_most_steps(5000);
        law.properties.stiffness = vec![0.0, 1e9, 1e9];
        law.properties.damping = vec![0.0, damping, damping];
        let path = law.solve(&[0.3, 0.0, 0.0], &[0.5, 0.0, 0.0], &[0.0, 0.2], &no_torque).unwrap();
        let off = (path.q[3] - exact.q[1]).abs().max((path.qd[3] - exact.qd[1]).abs());
        println!("{solver:?}: {off:.1e}, {} steps, {} rates", path.steps, path.evaluations);
        assert!(off <= tolerance::adaptive(path.steps, 1e-6), "{solver:?}: {off:e}");
    }
    // The explicit method would need steps of microseconds.
    let mut law = Adaptive::new(&scene).with_most_steps(500);
    law.properties.stiffness = vec![0.0, 1e9, 1e9];
    let failure = law.solve(&[0.3, 0.0, 0.0], &[0.5, 0.0, 0.0], &[0.0, 0.2], &no_torque).expect_err("stiff");
    assert!(failure.to_string().contains("most_steps: found 500"), "{failure}");
    assert_eq!((failure.solution.t.len(), failure.solution.steps), (1, 500));
    assert!(failure.time > 0.0 && failure.time < 0.2);
}

#[test]
fn what_cannot_be_used_is_refused_by_name() {
    let scene = phipsi::scenes::chain(2).unwrap();
    let refused = |change: &dyn Fn(&mut Adaptive<'_>), times: &[f64], words: &[&str]| {
        let mut law = Adaptive::new(&scene);
        change(&mut law);
        let failure = law.solve(&[0.1; 2], &[0.0; 2], times, &no_torque).expect_err("refused");
        for word in words {
            assert!(failure.to_string().contains(word), "{failure}");
        }
        assert_eq!(*failure.solution, Solution::default());
    };
    let good = [0.0, 1.0];
    for bad in [0.0, -1e-3, f64::NAN, f64::INFINITY] {
        refused(&|law| law.rtol = bad, &good, &["rtol", &format!("{bad}"), "positive"]);
        refused(&|law| law.atol = bad, &good, &["atol", &format!("{bad}"), "positive"]);
    }
    refused(&|_| {}, &[], &["times"]);
    refused(&|_| {}, &[0.0, 1.0, 1.0], &["times: found 1 after 1"]);
    refused(&|_| {}, &[1.0, 0.5], &["times: found 0.5 after 1"]);
    refused(&|_| {}, &[0.0, f64::NAN], &["times"]);
    refused(&|law| law.properties.damping = vec![0.0; 3], &good, &["damping", "(3,)", "(2,)"]);
    refused(&|law| law.properties.stiffness[1] = -1.0, &good, &["stiffness", "-1", "j1"]);
    let law = Adaptive::new(&scene);
    let refused = |q: &[f64], v: &[f64], word: &str| {
        let failure = law.solve(q, v, &good, &no_torque).expect_err("refused");
        assert!(failure.to_string().contains(word), "{failure}");
    };
    refused(&[0.0; 3], &[0.0; 2], "q: found shape (3,)");
    refused(&[0.0; 2], &[0.0; 1], "qd: found shape (1,)");
    refused(&[0.0, f64::NAN], &[0.0; 2], "q: found NaN");
}

#[test]
fn a_torque_that_is_not_finite_ends_the_solution_with_the_rows_before() {
    let scene = phipsi::scenes::chain(2).unwrap();
    for solver in SOLVERS {
        let law = Adaptive::new(&scene).with_solver(solver).with_rtol(1e-5).with_atol(1e-5);
        let broken =
            |t: f64, _q: &[f64], _v: &[f64], torque: &mut [f64]| torque[1] = if t > 0.25 { f64::NAN } else { 0.1 };
        let Failure { solution, time, error, .. } =
            law.solve(&[0.1; 2], &[0.0; 2], &[0.0, 0.1, 0.2, 0.5], &broken).expect_err("not finite");
        assert!(matches!(*error, Error::Argument { .. }), "{solver:?}: {error}");
        let text = error.to_string();
        assert!(["torque", "NaN", "j1"].iter().all(|word| text.contains(word)), "{solver:?}: {text}");
        assert_eq!(solution.t, [0.0, 0.1, 0.2], "{solver:?}");
        assert!(solution.q.iter().chain(&solution.qd).all(|x| x.is_finite()) && (0.2..=0.25).contains(&time), "{time}");
        // From the initial state.
        let at_once = |_t: f64, _q: &[f64], _v: &[f64], torque: &mut [f64]| torque[0] = f64::INFINITY;
        let failure = law.solve(&[0.1; 2], &[0.0; 2], &[0.0, 0.1], &at_once).expect_err("not finite");
        assert!(failure.to_string().contains("torque: found inf for joint \"j0\""), "{failure}");
    }
}

#[test]
fn a_joint_without_inertia_is_named() {
    let point = Inertial { mass: 1.0, center: [0.0; 3].into(), central: Symmetric3::zero() };
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
    builder = builder.link(LinkDescription { name: "tip".into(), inertial: Some(point) });
    let scene = builder.joint(JointDescription::new("elbow", JointKind::Revolute, "base", "tip")).build().unwrap();
    for solver in SOLVERS {
        let law = Adaptive::new(&scene).with_solver(solver);
        let failure = law.solve(&[0.0], &[0.0], &[0.0, 1.0], &no_torque).expect_err("no inertia");
        assert!(matches!(&*failure.error, Error::SingularJoint { joint, .. } if joint == "elbow"), "{failure}");
    }
}

#[test]
fn one_time_is_the_start_and_what_cannot_move_stays() {
    let scene = phipsi::scenes::chain(2).unwrap();
    let path = Adaptive::new(&scene).solve(&[0.1; 2], &[0.2; 2], &[3.0], &no_torque).unwrap();
    assert_eq!((path.t, path.q, path.qd, path.steps), (vec![3.0], vec![0.1; 2], vec![0.2; 2], 0));
    let still = scene.lock(&["j0", "j1"], &[0.0; 2]).unwrap();
    let path = Adaptive::new(&still).solve(&[], &[], &[0.0, 1.0, 2.0], &no_torque).unwrap();
    assert_eq!((path.t.len(), path.steps), (3, 0));
}
