//! The forms of the recursion: all have the same results, the square-root form also if the others lose all precision.

use crate::common::{ALL_KINDS, Random, Tree, oracle, random_scene, random_state, tolerance};
use phipsi::filter::{FORMS, Form};
#[cfg(feature = "dense")]
use phipsi::operators::{Factor, KINDS, Operator};
use phipsi::scalar::{DoubleDouble, Real};
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::spatial::Symmetric3;
use phipsi::{Error, Scene, Workspace, dynamics};

fn cases() -> impl Iterator<Item = (Scene, u64)> {
    (0..12).map(|seed| {
        let armature = if seed % 2 == 0 { 0.0 } else { 0.3 };
        let floating = seed % 3 == 0;
        (Tree { seed, bodies: 6, kinds: &ALL_KINDS, branching: 0.5, armature, floating }.scene(), seed)
    })
}

fn wide(values: &[f64]) -> Vec<DoubleDouble> {
    values.iter().map(|&x| DoubleDouble::from_f64(x)).collect()
}

/// Accelerations in double-double arithmetic, in a given form.
fn reference(scene: &Scene, form: Form, q: &[f64], qd: &[f64], tau: &[f64]) -> Vec<f64> {
    let model = scene.model().cast::<DoubleDouble>();
    let mut qdd = wide(&vec![f64::NAN; scene.nv()]);
    let mut workspace = Workspace::new(&model).in_form(form);
    dynamics::forward_dynamics(&model, &mut workspace, &wide(q), &wide(qd), &wide(tau), &[], &mut qdd);
    qdd.iter().map(|&x| tolerance::to_f64(x)).collect()
}

#[test]
fn forms_give_the_same_accelerations_as_newton_and_euler() {
    for (scene, seed) in cases() {
        let (q, qd, tau) = random_state(&scene, &mut Random::new(seed));
        let nv = scene.nv();
        let mut m = vec![f64::NAN; nv * nv];
        scene.mass_matrix(&mut scene.workspace(), &q, &mut m).unwrap();
        let conditioning = tolerance::conditioning(nv, &m);
        let exactly = oracle::Oracle::new(scene.source());
        let instant = exactly.at(&oracle::ds(&q), &oracle::ds(&qd));
        let (bias, _) = instant.bias(&[]);
        let centered: Vec<_> = tau.iter().zip(bias).map(|(&tau, bias)| oracle::d(tau) - bias).collect();
        let exact = oracle::solve(&instant.mass_matrix(), &centered);
        let exact: Vec<f64> = exact.into_iter().map(tolerance::to_f64).collect();
        for &(name, form) in FORMS {
            let mut qdd = vec![f64::NAN; nv];
            let mut workspace = scene.workspace().in_form(form);
            scene.forward_dynamics(&mut workspace, &q, &qd, &tau, &[], &mut qdd).unwrap();
            let bound = tolerance::inverse(conditioning.number, tolerance::size(&exact));
            tolerance::assert_near(name, &qdd, &exact, bound);
        }
    }
}

#[cfg(feature = "dense")]
#[test]
fn factors_and_inverses_of_every_form_match_the_definitions() {
    for (scene, seed) in cases().take(6) {
        let mut random = Random::new(seed);
        let (q, ..) = random_state(&scene, &mut random);
        let nv = scene.nv();
        let dense = scene.composite(&q).unwrap();
        let inverse = dense.matrix(phipsi::operators::Kind::MassInverse).unwrap();
        let mut m = vec![f64::NAN; nv * nv];
        scene.mass_matrix(&mut scene.workspace(), &q, &mut m).unwrap();
        let cond = tolerance::conditioning(nv, &m).number;
        for &(name, form) in FORMS {
            let mut workspace = scene.workspace().in_form(form);
            let mut out = vec![f64::NAN; nv * nv];
            scene.mass_matrix_inverse(&mut workspace, &mut scene.inverse_scratch(), &q, &mut out).unwrap();
            let expected: Vec<f64> = (0..nv * nv).map(|at| inverse[(at / nv, at % nv)]).collect();
            tolerance::assert_near(name, &out, &expected, tolerance::inverse(cond, tolerance::size(&expected)));

            let factor: Factor<f64> = scene.factor(&mut workspace, &q).unwrap();
            for &(operator_name, kind) in KINDS {
                let (operator, matrix) = (factor.operator(kind), dense.matrix(kind).unwrap());
                let (rows, columns) = operator.shape();
                let x = random.array(columns, 1.0);
                let mut y = vec![f64::NAN; rows];
                operator.apply(&x, &mut y);
                let product: Vec<f64> = (0..rows).map(|i| (0..columns).map(|j| matrix[(i, j)] * x[j]).sum()).collect();
                let bound = tolerance::inverse(cond, tolerance::size(&product));
                tolerance::assert_near(&format!("{operator_name}, {name}"), &y, &product, bound);
            }
            let links = [scene.links().last().unwrap().name.as_str()];
            let mut omega = vec![f64::NAN; 36];
            let mut covariance = omega.clone();
            let scratch = &mut scene.operational_scratch();
            scene.operational_inverse_inertia(&mut workspace, scratch, &q, &links, &mut omega).unwrap();
            scene.operational_inverse_inertia(&mut scene.workspace(), scratch, &q, &links, &mut covariance).unwrap();
            tolerance::assert_near(name, &omega, &covariance, tolerance::inverse(cond, tolerance::size(&covariance)));
        }
    }
}

/// A chain whose last link has a given mass.
fn heavy_tip(mass: f64) -> Scene {
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "link0".into(), inertial: None });
    for k in 0..8 {
        let m = if k == 7 { mass } else { 1.0 };
        let inertial = Inertial {
            mass: m,
            center: [0.25, 0.05, 0.0].into(),
            central: Symmetric3::new([0.005 * m, 0.0, 0.0, 0.02 * m, 0.0, 0.0225 * m]),
        };
        let (parent, child) = (format!("link{k}"), format!("link{}", k + 1));
        let mut joint = JointDescription::new(format!("joint{k}"), JointKind::Revolute, parent, child.clone());
        joint.axis = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.3]][k % 3].into();
        joint.origin.lever = [if k == 0 { 0.0 } else { 0.5 }, 0.0, 0.0].into();
        builder = builder.link(LinkDescription { name: child, inertial: Some(inertial) }).joint(joint);
    }
    builder.build().unwrap()
}

/// Largest error relative to the largest acceleration.
fn error(scene: &Scene, form: Form, state: &(Vec<f64>, Vec<f64>, Vec<f64>)) -> f64 {
    let (q, qd, tau) = state;
    let mut qdd = vec![f64::NAN; scene.nv()];
    dynamics::forward_dynamics(scene.model(), &mut scene.workspace().in_form(form), q, qd, tau, &[], &mut qdd);
    let exact = reference(scene, Form::SquareRoot, q, qd, tau);
    let off: Vec<f64> = qdd.iter().zip(&exact).map(|(a, b)| a - b).collect();
    tolerance::size(&off) / tolerance::size(&exact)
}

#[test]
fn a_heavy_tip_costs_the_square_root_form_no_digit() {
    for mass in [1.0, 1e3, 1e6, 1e9, 1e12, 1e15] {
        let scene = heavy_tip(mass);
        let state = random_state(&scene, &mut Random::new(5));
        assert!(error(&scene, Form::SquareRoot, &state) <= tolerance::ALL_DIGITS, "tip of {mass}");
    }
    let scene = heavy_tip(1e12);
    let state = random_state(&scene, &mut Random::new(5));
    assert!(error(&scene, Form::Covariance, &state) > 1e-9, "the case is an easy one");
}

#[test]
fn both_forms_agree_in_double_double_where_f64_loses_all() {
    // The reference itself: two independent recursions agree up to the rounding error of double-double arithmetic.
    let scene = heavy_tip(1e6);
    let (q, qd, tau) = random_state(&scene, &mut Random::new(6));
    let one = reference(&scene, Form::SquareRoot, &q, &qd, &tau);
    let other = reference(&scene, Form::Covariance, &q, &qd, &tau);
    // The square root of an inertia is rounded to f64: the two results belong to bodies that differ by some eps.
    tolerance::assert_near("qdd", &one, &other, tolerance::ALL_DIGITS * tolerance::size(&one));
}

#[test]
fn logarithmic_masses_over_24_decades() {
    for seed in 0..6 {
        let mut random = Random::new(seed);
        let mut builder = random_scene(seed, 30, &ALL_KINDS, 0.2, 0.0).source().clone();
        let links: Vec<LinkDescription> = builder.links().to_vec();
        let joints: Vec<JointDescription> = builder.joints().to_vec();
        builder = SceneBuilder::new();
        for mut link in links {
            let factor = 10_f64.powf(random.uniform(-12.0, 12.0));
            if let Some(inertial) = &mut link.inertial {
                inertial.mass *= factor;
                inertial.central = Symmetric3::new(inertial.central.entries.map(|entry| entry * factor));
            }
            builder = builder.link(link);
        }
        builder = joints.into_iter().fold(builder, SceneBuilder::joint);
        let scene = builder.build().unwrap();
        let state = random_state(&scene, &mut random);
        let found = error(&scene, Form::SquareRoot, &state);
        assert!(found <= tolerance::ALL_DIGITS, "seed {seed}: {found:e}");
    }
}

#[test]
fn a_massless_link_between_two_joints_is_legal_and_at_the_tip_it_is_not() {
    let rod = Inertial {
        mass: 1.0,
        center: [0.0, 0.4, 0.0].into(),
        central: Symmetric3::new([0.05, 0.0, 0.0, 0.0, 0.0, 0.05]),
    };
    let build = |middle: Option<Inertial>, tip: Option<Inertial>| {
        let joint = |name: &str, axis: [f64; 3], parent: &str, child: &str| {
            let mut joint = JointDescription::new(name, JointKind::Revolute, parent, child);
            joint.axis = axis.into();
            joint
        };
        SceneBuilder::new()
            .link(LinkDescription { name: "base".into(), inertial: None })
            .link(LinkDescription { name: "middle".into(), inertial: middle })
            .link(LinkDescription { name: "tip".into(), inertial: tip })
            .joint(joint("one", [1.0, 0.0, 0.0], "base", "middle"))
            .joint(joint("two", [0.0, 0.0, 1.0], "middle", "tip"))
            .build()
            .unwrap()
    };
    let mut qdd = [f64::NAN; 2];
    let legal = build(None, Some(rod));
    for &(name, form) in FORMS {
        let mut workspace = legal.workspace().in_form(form);
        legal.forward_dynamics(&mut workspace, &[0.3, 0.4], &[0.1; 2], &[1.0; 2], &[], &mut qdd).expect(name);
    }
    let singular = build(Some(rod), None);
    for &(name, form) in FORMS {
        let mut workspace = singular.workspace().in_form(form);
        let outcome = singular.forward_dynamics(&mut workspace, &[0.3, 0.4], &[0.1; 2], &[1.0; 2], &[], &mut qdd);
        assert!(matches!(outcome, Err(Error::SingularJoint { joint, .. }) if joint == "two"), "{name}");
    }
    // A rod rotated about its own axis: zero inertia in a frame where no entry is exactly zero.
    let mut turned = build(
        Some(rod),
        Some(Inertial {
            central: Symmetric3::new([0.0, 0.0, 0.0, 0.05, 0.0, 0.05]),
            center: [0.4, 0.0, 0.0].into(),
            ..rod
        }),
    );
    let mut joints: Vec<JointDescription> = turned.source().joints().to_vec();
    joints[1].axis = [1.0, 0.0, 0.0].into();
    joints[1].origin.rotation = *nalgebra::Rotation3::new(nalgebra::Vector3::new(0.4, -1.1, 0.7)).matrix();
    let builder = turned.source().links().iter().cloned().fold(SceneBuilder::new(), SceneBuilder::link);
    turned = joints.into_iter().fold(builder, SceneBuilder::joint).build().unwrap();
    for &(name, form) in FORMS {
        let mut workspace = turned.workspace().in_form(form);
        let outcome = turned.forward_dynamics(&mut workspace, &[0.3, 0.4], &[0.1; 2], &[1.0; 2], &[], &mut qdd);
        assert!(matches!(outcome, Err(Error::SingularJoint { joint, .. }) if joint == "two"), "{name}");
    }
}

#[test]
fn an_inertia_that_is_not_positive_has_no_root_and_says_so() {
    let odd = Inertial {
        mass: 1.0,
        center: [0.1, 0.0, 0.0].into(),
        central: Symmetric3::new([-0.1, 0.0, 0.0, 1.0, 0.0, 1.0]),
    };
    let scene = SceneBuilder::new()
        .link(LinkDescription { name: "base".into(), inertial: None })
        .link(LinkDescription { name: "odd".into(), inertial: Some(odd) })
        .joint(JointDescription::new("hinge", JointKind::Revolute, "base", "odd"))
        .build()
        .unwrap();
    let mut qdd = [f64::NAN];
    let mut workspace = scene.workspace().in_form(Form::SquareRoot);
    let refused = |outcome: Result<(), Error>| {
        let Err(Error::Argument { argument, .. }) = outcome else { panic!("accepted") };
        assert!(argument.contains("\"odd\""), "{argument}");
    };
    refused(scene.forward_dynamics(&mut workspace, &[0.0], &[0.0], &[1.0], &[], &mut qdd));
    refused(scene.mass_matrix_inverse(&mut workspace, &mut scene.inverse_scratch(), &[0.0], &mut [f64::NAN]));
    refused(scene.factor(&mut workspace, &[0.0]).map(|_| ()));
    scene.forward_dynamics(&mut scene.workspace(), &[0.0], &[0.0], &[1.0], &[], &mut qdd).expect("covariance form");
}

#[test]
fn no_form_allocates() {
    let (scene, seed) = cases().nth(3).unwrap();
    let (q, qd, tau) = random_state(&scene, &mut Random::new(seed));
    let mut qdd = vec![f64::NAN; scene.nv()];
    for &(name, form) in FORMS {
        let mut workspace = scene.workspace().in_form(form);
        let seen = allocation_counter::measure(|| {
            scene.forward_dynamics(&mut workspace, &q, &qd, &tau, &[], &mut qdd).unwrap();
        });
        assert_eq!(seen.count_total, 0, "{name}");
    }
}

#[test]
fn wrenches_and_fast_spin_in_every_form() {
    for (scene, seed) in cases().take(4) {
        let mut random = Random::new(seed);
        let (q, qd, tau) = random_state(&scene, &mut random);
        let qd: Vec<f64> = qd.iter().map(|rate| 1e3 * rate).collect();
        let wrenches: Vec<_> =
            scene.model().bodies.iter().map(|_| nalgebra::Vector6::from_fn(|_, _| random.uniform(-3.0, 3.0))).collect();
        let mut all = Vec::new();
        for &(_, form) in FORMS {
            let mut qdd = vec![f64::NAN; scene.nv()];
            let mut workspace = scene.workspace().in_form(form);
            scene.forward_dynamics(&mut workspace, &q, &qd, &tau, &wrenches, &mut qdd).unwrap();
            all.push(qdd);
        }
        let mut m = vec![f64::NAN; scene.nv() * scene.nv()];
        scene.mass_matrix(&mut scene.workspace(), &q, &mut m).unwrap();
        let bound = tolerance::inverse(tolerance::conditioning(scene.nv(), &m).number, tolerance::size(&all[1]));
        for (found, (name, _)) in all.iter().zip(FORMS) {
            tolerance::assert_near(name, found, &all[1], bound);
        }
    }
}
