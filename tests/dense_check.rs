//! The sweeps compared with composite matrices and faer's LDLT, on random mixed trees and on chains.
#![allow(clippy::cast_precision_loss)] // small counts

use crate::common::{ALL_KINDS, Random, random_scene, random_state, tolerance};
use phipsi::operators::{Factor, KINDS, Operator};
use phipsi::report::residuals::residuals;
use phipsi::{Scene, scenes};

fn condition_number(scene: &Scene, q: &[f64]) -> f64 {
    let nv = scene.nv();
    let mut m = vec![f64::NAN; nv * nv];
    scene.mass_matrix(&mut scene.workspace(), q, &mut m).unwrap();
    let s = nalgebra::DMatrix::from_row_slice(nv, nv, &m).svd(false, false).singular_values;
    s[0] / s[nv - 1]
}

fn check(scene: &Scene, seed: u64) {
    let (q, qd, tau) = random_state(scene, &mut Random::new(seed));
    let cond = condition_number(scene, &q);
    for residual in residuals(scene, &q, &qd, &tau).unwrap() {
        let bound =
            if residual.through_inverse { tolerance::inverse(cond, 1.0) } else { tolerance::product(scene.nv(), 1.0) };
        assert!(residual.value <= bound, "{}: {:e}, bound {bound:e}", residual.name, residual.value);
    }
}

#[test]
fn residuals_of_mixed_trees_are_rounding() {
    for seed in 0..16 {
        let armature = if seed % 3 == 0 { 0.0 } else { 0.2 };
        check(&random_scene(seed, 1 + usize::try_from(seed).unwrap() % 5, &ALL_KINDS, 0.5, armature), seed);
    }
}

#[test]
fn residuals_of_chains_are_rounding() {
    for n in [1, 2, 7, 16] {
        check(&scenes::chain(n).unwrap(), n as u64);
    }
}

#[test]
fn every_operator_and_its_transpose_match_the_definition() {
    for seed in 0..6 {
        let scene = random_scene(seed, 5, &ALL_KINDS, 0.5, if seed % 2 == 0 { 0.0 } else { 0.3 });
        let mut random = Random::new(seed);
        let (q, ..) = random_state(&scene, &mut random);
        let cond = condition_number(&scene, &q);
        let (factor, _) = Factor::new(scene.model(), &mut scene.workspace(), &q);
        let dense = scene.composite(&q).unwrap();
        for &(name, kind) in KINDS {
            let operator = factor.operator(kind);
            let matrix = dense.matrix(kind).unwrap();
            let (rows, columns) = operator.shape();
            assert_eq!((matrix.nrows(), matrix.ncols()), (rows, columns), "{name}");
            let (x, t) = (random.array(columns, 1.0), random.array(rows, 1.0));
            let (mut y, mut s) = (vec![f64::NAN; rows], vec![f64::NAN; columns]);
            operator.apply(&x, &mut y);
            operator.apply_transpose(&t, &mut s);
            let product: Vec<f64> = (0..rows).map(|i| (0..columns).map(|j| matrix[(i, j)] * x[j]).sum()).collect();
            let transposed: Vec<f64> = (0..columns).map(|j| (0..rows).map(|i| matrix[(i, j)] * t[i]).sum()).collect();
            let scale = tolerance::size(&product).max(tolerance::size(&transposed));
            tolerance::assert_near(name, &y, &product, tolerance::inverse(cond, scale));
            tolerance::assert_near(&format!("{name}^T"), &s, &transposed, tolerance::inverse(cond, scale));
            // Adjoint: t . (A x) = x . (A^T t), and not trivially.
            let left: f64 = t.iter().zip(&y).map(|(a, b)| a * b).sum();
            let right: f64 = x.iter().zip(&s).map(|(a, b)| a * b).sum();
            assert!((left - right).abs() <= tolerance::inverse(cond, scale * tolerance::count(rows)), "{name}");
            if scene.nv() > 1 {
                assert!(scale > 0.0, "{name} is zero");
            }
        }
    }
}
