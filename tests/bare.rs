//! The crate without default features: `cargo test --no-default-features --test bare`.
//!
//! It has no kernels for the square-root form and for kinematic quantities, so that every state of these is computed by
//! the fallback.
#![cfg(not(any(feature = "derivatives", feature = "lanes")))]
#![allow(clippy::disallowed_methods)] // references decompose matrices that are finite and square

#[allow(dead_code)] // most of it is for tests of features
mod common;
mod double_double;
mod live_terms;
mod operational;
mod scene_errors;

use common::loops::{exact, four_bar, state};
use common::tolerance::{self, assert_near, size, to_f64};
use common::{ALL_KINDS, Random, Tree, random_state};
use phipsi::kinematics::ReferenceFrame;
use phipsi::scalar::{DoubleDouble, Real};
use phipsi::scene::ConnectionKind;
use phipsi::{Algorithm, Arguments, Form, KinematicQuantity, Scene, Workspace, dynamics, scenes};

/// A chain, a tip of a million times the mass of the arm, and trees with every kind of joint, fixed and floating.
fn scenes_and_states() -> Vec<(Scene, [Vec<f64>; 3])> {
    let tree =
        |seed, floating| Tree { seed, bodies: 9, kinds: &ALL_KINDS, branching: 0.4, armature: 0.1, floating }.scene();
    let heavy = scenes::extreme("heavy-tip", Some(1e6), None, 0).unwrap().scene;
    let all = [scenes::chain(7).unwrap(), heavy, tree(1, false), tree(2, true)];
    all.into_iter()
        .map(|scene| {
            let (q, qd, u) = random_state(&scene, &mut Random::new(3));
            (scene, [q, qd, u])
        })
        .collect()
}

/// Joint accelerations in double-double arithmetic.
fn exact_accelerations(scene: &Scene, [q, qd, tau]: &[Vec<f64>; 3]) -> Vec<f64> {
    let model = scene.model().cast::<DoubleDouble>();
    let mut workspace = Workspace::new(&model).in_form(Form::Covariance);
    let wide = |x: &[f64]| -> Vec<DoubleDouble> { x.iter().map(|&x| DoubleDouble::from_f64(x)).collect() };
    let mut qdd = wide(&vec![f64::NAN; scene.nv()]);
    dynamics::forward_dynamics(&model, &mut workspace, &wide(q), &wide(qd), &wide(tau), &[], &mut qdd);
    qdd.into_iter().map(to_f64).collect()
}

#[test]
fn every_form_has_full_precision() {
    for (which, (scene, state)) in scenes_and_states().iter().enumerate() {
        let expected = exact_accelerations(scene, state);
        let [q, qd, tau] = state;
        for form in [Form::Auto, Form::SquareRoot] {
            let mut workspace = scene.workspace().in_form(form);
            let mut qdd = vec![f64::NAN; scene.nv()];
            scene.forward_dynamics(&mut workspace, q, qd, tau, &[], &mut qdd).unwrap();
            let bound = tolerance::ALL_DIGITS * size(&expected);
            assert_near(&format!("scene {which}, {form:?}"), &qdd, &expected, bound);
        }
    }
}

#[test]
fn inverse_dynamics_and_the_mass_matrix_agree_with_the_accelerations() {
    for (scene, state) in &scenes_and_states() {
        let ([q, qd, tau], nv) = (state, scene.nv());
        let mut workspace = scene.workspace();
        let qdd = exact_accelerations(scene, state);
        let (mut back, mut bias) = (vec![f64::NAN; nv], vec![f64::NAN; nv]);
        let (mut mass, mut inverse) = (vec![f64::NAN; nv * nv], vec![f64::NAN; nv * nv]);
        scene.inverse_dynamics(&mut workspace, q, qd, &qdd, &[], &mut back).unwrap();
        scene.bias_torque(&mut workspace, q, qd, &mut bias).unwrap();
        scene.mass_matrix(&mut workspace, q, &mut mass).unwrap();
        scene.mass_matrix_inverse(&mut workspace, &mut scene.inverse_scratch(), q, &mut inverse).unwrap();
        let times = |matrix: &[f64], x: &[f64]| -> Vec<f64> {
            matrix.chunks_exact(nv).map(|row| row.iter().zip(x).map(|(a, x)| a * x).sum()).collect()
        };
        let forces: Vec<f64> = times(&mass, &qdd).iter().zip(&bias).map(|(force, bias)| force + bias).collect();
        // The largest term of the sums.
        let terms = size(&mass) * size(&qdd) + size(&bias);
        assert_near("inverse dynamics", &back, tau, tolerance::product(nv, terms));
        assert_near("M qdd + bias", &forces, tau, tolerance::product(nv, terms));
        let net: Vec<f64> = tau.iter().zip(&bias).map(|(tau, bias)| tau - bias).collect();
        let bound = tolerance::product(nv, size(&inverse) * (size(&net) + terms));
        assert_near("M^-1 (tau - bias)", &times(&inverse, &net), &qdd, bound);
    }
}

/// A batch is its states one by one.
#[test]
fn batches_are_their_states() {
    let scene = scenes::chain(7).unwrap();
    let all: Vec<_> = (0..5).map(|seed| random_state(&scene, &mut Random::new(seed))).collect();
    let states: Vec<_> = all.iter().map(|(q, qd, u)| Arguments { q, qd, u, ..Arguments::default() }).collect();
    let (mut evaluator, mut workspace) = (scene.evaluator(), scene.workspace());
    let frame = scene.frame(&"link6".into()).unwrap();
    for form in [Form::Auto, Form::Covariance, Form::SquareRoot] {
        let mut out = vec![f64::NAN; 35];
        scene.evaluate(&mut evaluator, Algorithm::ForwardDynamics(form), &states, &mut out).unwrap();
        workspace.form = form;
        for ((q, qd, tau), found) in all.iter().zip(out.chunks_exact(7)) {
            let mut qdd = vec![f64::NAN; 7];
            scene.forward_dynamics(&mut workspace, q, qd, tau, &[], &mut qdd).unwrap();
            assert_eq!(qdd, found, "{form:?}");
        }
    }
    for what in [KinematicQuantity::Jacobian(&frame, ReferenceFrame::World), KinematicQuantity::CenterOfMass] {
        let width = what.width(7);
        let states: Vec<_> = all.iter().map(|(q, ..)| Arguments { q, ..Arguments::default() }).collect();
        let (mut out, mut one) = (vec![f64::NAN; 5 * width], vec![f64::NAN; width]);
        scene.evaluate_kinematic_quantity(&mut evaluator, &what, &states, &mut out).unwrap();
        for ((q, ..), found) in all.iter().zip(out.chunks_exact(width)) {
            scene.kinematic_quantity(&mut workspace, &what, [q, &[], &[]], &mut one).unwrap();
            assert!(one.iter().all(|x| x.is_finite()));
            assert_eq!(one, found);
        }
    }
}

#[test]
fn connections_hold() {
    let scene = four_bar(ConnectionKind::Point, [1.0, 2.0, 0.5]);
    let (q, qd, tau) = state(&scene, 1, 1.0);
    let mut qdd = vec![f64::NAN; scene.nv()];
    scene.forward_dynamics(&mut scene.workspace(), &q, &qd, &tau, &[], &mut qdd).unwrap();
    let expected = exact(&scene, &q, &qd, &tau).qdd;
    assert_near("qdd", &qdd, &expected, 1e2 * tolerance::ALL_DIGITS * size(&expected));
}

#[test]
fn names_of_algorithms_are_those_that_exist() {
    let error = "forward_dynamics_jvp".parse::<Algorithm>().unwrap_err().to_string();
    assert!(error.contains("\"forward_dynamics\"") && !error.contains("_derivatives\""), "{error}");
}
