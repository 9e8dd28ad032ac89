//! The random model: its samples satisfy (1.1) to (1.6), and M is their covariance (5.1).

use crate::common::{ALL_KINDS, Random, Tree, random_scene, random_state, tolerance};
use phipsi::operators::{Kind, Operator};
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::spatial::Symmetric3;
use phipsi::stochastic::{Method, Points, RandomModel};
use phipsi::{Error, Scene, scenes};

fn monte_carlo(samples: usize, seed: u64, confidence: f64) -> Method {
    Method::MonteCarlo { samples, seed, confidence }
}

fn mass_matrix(scene: &Scene, q: &[f64]) -> Vec<f64> {
    let mut m = vec![f64::NAN; scene.nv() * scene.nv()];
    scene.mass_matrix(&mut scene.workspace(), q, &mut m).unwrap();
    m
}

/// Trees with all types of joints, every other one with armature, every third floating.
fn cases() -> impl Iterator<Item = (Scene, Vec<f64>, Vec<f64>)> {
    (0..6).map(|seed| {
        let armature = if seed % 2 == 0 { 0.0 } else { 0.3 };
        let floating = seed % 3 == 0;
        let scene = Tree { seed, bodies: 5, kinds: &ALL_KINDS, branching: 0.5, armature, floating }.scene();
        let (q, qd, _) = random_state(&scene, &mut Random::new(seed));
        (scene, q, qd)
    })
}

/// Relative error in the Frobenius norm.
fn error(found: &[f64], exact: &[f64]) -> f64 {
    let square = |x: &mut dyn Iterator<Item = f64>| x.map(|x| x * x).sum::<f64>();
    (square(&mut found.iter().zip(exact).map(|(a, b)| a - b)) / square(&mut exact.iter().copied())).sqrt()
}

#[test]
fn states_and_torques_follow_from_the_forces() {
    for (scene, q, qd) in cases() {
        let model = scene.random_model(&q, Some(&qd), 1.5).unwrap();
        let factor = scene.factor(&mut scene.workspace(), &q).unwrap();
        let (nv, wide) = (scene.nv(), 6 * scene.nv());
        let samples = model.sample(&Points::random(4), 0..70).unwrap();
        assert_eq!((samples.process.len(), samples.force.len(), samples.torque.len()), (70 * wide, 70 * wide, 70 * nv));
        for i in 0..70 {
            let (w, x) = (&samples.process[i * wide..][..wide], &samples.force[i * wide..][..wide]);
            let (mut phi_w, mut h_x) = (vec![f64::NAN; wide], vec![f64::NAN; nv]);
            factor.operator(Kind::Phi).apply(w, &mut phi_w);
            tolerance::assert_near("X = phi W", x, &phi_w, tolerance::product(wide, tolerance::size(&phi_w)));
            factor.operator(Kind::H).apply(x, &mut h_x);
            let without: Vec<usize> = (0..nv).filter(|&row| scene.model().system.noise[row] == 0.0).collect();
            let pick = |of: &[f64]| -> Vec<f64> { without.iter().map(|&row| of[row]).collect() };
            assert_eq!(pick(&h_x), pick(&samples.torque[i * nv..][..nv]));
            for row in (0..nv).filter(|row| !without.contains(row)) {
                assert_ne!(h_x[row].to_bits(), samples.torque[i * nv + row].to_bits(), "the armature has noise");
            }
        }
    }
}

#[test]
fn mean_and_covariance_of_the_forces_are_bias_and_inertia() {
    // (1.3): the mean is checked through phi and H, where it is the bias torque; the covariance body by body.
    for (scene, q, qd) in cases() {
        let (nv, wide, variance) = (scene.nv(), 6 * scene.nv(), 2.5);
        let count = 4096;
        let model = scene.random_model(&q, Some(&qd), variance).unwrap();
        let samples = model.sample(&Points::random(11), 0..count).unwrap();
        let n = tolerance::count(usize::try_from(count).unwrap());
        let mut bias = vec![f64::NAN; nv];
        scene.bias_torque(&mut scene.workspace(), &q, &qd, &mut bias).unwrap();
        let m = mass_matrix(&scene, &q);
        for row in 0..nv {
            let mean: f64 = samples.torque.iter().skip(row).step_by(nv).sum::<f64>() / n;
            let standard_error = (variance * m[row * nv + row] / n).sqrt();
            assert!((mean - bias[row]).abs() <= tolerance::SIGMAS * standard_error, "row {row}: {mean} {}", bias[row]);
        }
        let q_matrix = scene.composite(&q).unwrap().matrix(Kind::Q).unwrap();
        let means: Vec<f64> =
            (0..wide).map(|i| samples.process.iter().skip(i).step_by(wide).sum::<f64>() / n).collect();
        for i in 0..wide {
            for j in 0..wide {
                let product = |row: &[f64]| (row[i] - means[i]) * (row[j] - means[j]);
                let found = samples.process.chunks_exact(wide).map(product).sum::<f64>() / n;
                let exact = variance * q_matrix[(i, j)];
                let spread = variance * variance * q_matrix[(i, i)] * q_matrix[(j, j)] + exact * exact;
                assert!((found - exact).abs() <= tolerance::SIGMAS * (spread / n).sqrt(), "{i} {j}: {found} {exact}");
            }
        }
    }
}

#[test]
fn a_sample_is_the_same_whatever_is_drawn_with_it() {
    let (scene, q, _) = cases().last().unwrap();
    let model = scene.random_model(&q, None, 1.0).unwrap();
    let (nv, points) = (scene.nv(), Points::random(9));
    let all = model.sample_torque(&points, 0..300).unwrap();
    assert!(all.iter().all(|x| x.is_finite()));
    for range in [0..1, 63..65, 64..128, 17..290, 299..300] {
        let (start, end) = (usize::try_from(range.start).unwrap(), usize::try_from(range.end).unwrap());
        assert_eq!(model.sample_torque(&points, range.clone()).unwrap(), all[start * nv..end * nv]);
        assert_eq!(model.sample(&points, range).unwrap().torque, all[start * nv..end * nv]);
    }
    assert!(model.sample_torque(&points, 5..5).unwrap().is_empty());
    assert_ne!(model.sample_torque(&Points::random(10), 0..300).unwrap(), all);
}

#[test]
fn sigma_points_are_exact() {
    for (scene, q, _) in cases() {
        let estimate = scene.random_model(&q, None, 3.0).unwrap().mass_matrix(Method::SigmaPoints).unwrap();
        let m = mass_matrix(&scene, &q);
        let bound = tolerance::product(6 * scene.nv(), tolerance::size(&m));
        tolerance::assert_near("M from sigma points (5.1)", &estimate.mass_matrix, &m, bound);
        assert!(estimate.spread.is_none());
    }
}

#[test]
fn monte_carlo_is_right_within_its_standard_error() {
    for (seed, (scene, q, _)) in cases().enumerate() {
        let model = scene.random_model(&q, None, 3.0).unwrap();
        let estimate = model.mass_matrix(monte_carlo(50_000, seed as u64, 0.95)).unwrap();
        let spread = estimate.spread.unwrap();
        for (at, exact) in mass_matrix(&scene, &q).into_iter().enumerate() {
            let off = (estimate.mass_matrix[at] - exact).abs();
            assert!(off <= tolerance::SIGMAS * spread.standard_error[at], "{at}: {off}");
            assert!(spread.low[at] <= estimate.mass_matrix[at] && estimate.mass_matrix[at] <= spread.high[at]);
        }
    }
}

/// Fraction of intervals that contain the exact entry, over many seeds; few samples, for which the intervals are
/// difficult.
fn coverage(model: &RandomModel, exact: &[f64], samples: usize, seeds: u64, confidence: f64) -> Vec<f64> {
    let mut held = vec![0_u32; exact.len()];
    for seed in 0..seeds {
        let spread = model.mass_matrix(monte_carlo(samples, seed, confidence)).unwrap().spread.unwrap();
        for (at, m) in exact.iter().enumerate() {
            held[at] += u32::from(spread.low[at] <= *m && *m <= spread.high[at]);
        }
    }
    let all = tolerance::count(usize::try_from(seeds).unwrap());
    held.into_iter().map(|count| f64::from(count) / all).collect()
}

#[test]
fn intervals_hold_as_often_as_they_say() {
    let scene = random_scene(3, 4, &[JointKind::Revolute, JointKind::Prismatic], 0.3, 0.1);
    let (q, ..) = random_state(&scene, &mut Random::new(3));
    let model = scene.random_model(&q, None, 1.0).unwrap();
    let exact = mass_matrix(&scene, &q);
    let seeds = 2000;
    for (samples, confidence) in [(12, 0.95), (64, 0.68), (192, 0.9)] {
        let deviation: f64 = (confidence * (1.0 - confidence) / 2000.0_f64).sqrt();
        for (at, found) in coverage(&model, &exact, samples, seeds, confidence).into_iter().enumerate() {
            // Off the diagonal the interval is approximate: half a percent at a dozen samples.
            let bound = 4.5 * deviation + if samples < 50 { 0.005 } else { 0.0 };
            assert!((found - confidence).abs() <= bound, "{samples} samples, entry {at}: {found} for {confidence}");
        }
    }
}

/// Least-squares slope of log error against log samples; the error is the root mean square over seeds.
fn slope(exact: &[f64], sizes: &[usize], seeds: u64, estimate: impl Fn(usize, u64) -> Vec<f64>) -> f64 {
    let point = |&size: &usize| {
        // Samples of one seed have a common beginning: each size has separate seeds.
        let first = 1000 * size as u64;
        let squares: f64 = (first..first + seeds).map(|seed| error(&estimate(size, seed), exact).powi(2)).sum();
        (tolerance::count(size).ln(), 0.5 * (squares / tolerance::count(usize::try_from(seeds).unwrap())).ln())
    };
    let points: Vec<(f64, f64)> = sizes.iter().map(point).collect();
    let n = tolerance::count(points.len());
    let (x, y) = points.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + x / n, b + y / n));
    let (top, bottom) = points.iter().fold((0.0, 0.0), |(t, b), p| (t + (p.0 - x) * (p.1 - y), b + (p.0 - x).powi(2)));
    top / bottom
}

#[test]
fn errors_fall_with_the_slopes_that_theory_gives() {
    let scene = scenes::chain(4).unwrap();
    let q = [0.3, -0.8, 1.1, 0.4];
    let (model, exact) = (scene.random_model(&q, None, 1.0).unwrap(), mass_matrix(&scene, &q));
    let sizes: Vec<usize> = (8..=14).step_by(2).map(|power| 1 << power).collect();
    let plain = slope(&exact, &sizes, 64, |n, seed| model.mass_matrix(monte_carlo(n, seed, 0.9)).unwrap().mass_matrix);
    assert!((plain + 0.5).abs() <= 0.06, "Monte Carlo: {plain}");
    let sobol = slope(&exact, &sizes, 16, |n, seed| model.sobol_estimate(n, seed, 0).unwrap());
    assert!(sobol <= -0.8, "Sobol: {sobol}");
}

#[test]
fn sobol_is_unbiased_and_its_interval_holds() {
    let scene = scenes::chain(3).unwrap();
    let q = [0.3, -0.8, 1.1];
    let (model, exact) = (scene.random_model(&q, None, 1.0).unwrap(), mass_matrix(&scene, &q));
    let (mut held, mut all) = (0.0, 0.0);
    for seed in 0..300 {
        let method = Method::Sobol { samples: 1024, seed, replicates: 8, confidence: 0.9 };
        let spread = model.mass_matrix(method).unwrap().spread.unwrap();
        for (at, m) in exact.iter().enumerate() {
            held += f64::from(u8::from(spread.low[at] <= *m && *m <= spread.high[at]));
            all += 1.0;
        }
    }
    assert!((held / all - 0.9_f64).abs() <= 0.04, "{}", held / all);
}

#[test]
fn bodies_of_less_than_six_dimensions_draw_fewer_numbers() {
    let point = Inertial { mass: 2.0, centre: [0.0, 0.0, 1.0].into(), central: Symmetric3::zero() };
    let builder = SceneBuilder::new()
        .link(LinkDescription { name: "base".into(), inertial: None })
        .link(LinkDescription { name: "bob".into(), inertial: Some(point) });
    let mut swing = JointDescription::new("swing", JointKind::Revolute, "base", "bob");
    swing.axis = [1.0, 0.0, 0.0].into();
    let scene = builder.joint(swing).build().unwrap();
    let model = scene.random_model(&[0.0], None, 1.0).unwrap();
    assert_eq!(model.dimension(), 3);
    let estimate = model.mass_matrix(Method::SigmaPoints).unwrap();
    assert!((estimate.mass_matrix[0] - 2.0).abs() <= tolerance::product(6, 2.0));
    assert_eq!(estimate.samples, 6);
}

#[test]
fn an_indefinite_inertia_names_its_link() {
    let wrong =
        Inertial { mass: 1.0, centre: [0.0; 3].into(), central: Symmetric3::new([-0.1, 0.0, 0.0, 1.0, 0.0, 1.0]) };
    let builder = SceneBuilder::new()
        .link(LinkDescription { name: "base".into(), inertial: None })
        .link(LinkDescription { name: "odd".into(), inertial: Some(wrong) });
    let scene = builder.joint(JointDescription::new("hinge", JointKind::Revolute, "base", "odd")).build().unwrap();
    let error = scene.random_model(&[0.0], None, 1.0).expect_err("no covariance");
    assert!(matches!(error, Error::Argument { .. }) && error.to_string().contains("\"odd\""), "{error}");
}

#[test]
fn bad_arguments_are_named() {
    let scene = scenes::chain(3).unwrap();
    let model = scene.random_model(&[0.1; 3], None, 1.0).unwrap();
    let named = |result: Result<phipsi::stochastic::MassEstimate, Error>, name: &str| {
        let Err(Error::Argument { argument, .. }) = result else { panic!("{name} was accepted") };
        assert_eq!(argument, name);
    };
    named(model.mass_matrix(monte_carlo(0, 1, 0.95)), "samples");
    named(model.mass_matrix(monte_carlo(10, 1, 1.5)), "confidence");
    let sobol = |samples, replicates| Method::Sobol { samples, seed: 1, replicates, confidence: 0.95 };
    named(model.mass_matrix(sobol(1000, 8)), "samples");
    named(model.mass_matrix(sobol(0, 8)), "samples");
    named(model.mass_matrix(sobol(1024, 1)), "replicates");
    named(model.mass_matrix(sobol(1024, 0)), "replicates");
    for variance in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let error = scene.random_model(&[0.1; 3], None, variance).expect_err("no variance");
        assert!(error.to_string().starts_with("acceleration_variance"), "{error}");
    }
    assert!(matches!(scene.random_model(&[0.1; 2], None, 1.0), Err(Error::Shape { .. })));
    assert!(matches!(scene.random_model(&[0.1; 3], Some(&[f64::NAN; 3]), 1.0), Err(Error::NotFinite { .. })));
    let long = scenes::chain(170).unwrap().random_model(&[0.1; 170], None, 1.0).unwrap();
    named(long.sobol_estimate(64, 1, 0).map(|_| unreachable!()), "method");
}
