//! Identities between the algorithms, on random mixed trees.
#![allow(clippy::cast_possible_truncation)] // small seeds

mod common;

use common::tolerance::{assert_near, inverse, product, size};
use common::{ALL_KINDS, Random, random_scene, random_state};
use nalgebra::DMatrix;
use phipsi::dynamics;

#[test]
fn forward_dynamics_undoes_inverse_dynamics() {
    for seed in 0..60 {
        let scene = random_scene(seed, 1 + (seed as usize % 9), &ALL_KINDS, 0.4, if seed % 2 == 0 { 0.0 } else { 0.1 });
        let mut random = Random::new(1000 + seed);
        let (q, qd, tau) = random_state(&scene, &mut random);
        let (nv, mut w) = (scene.nv(), scene.workspace());
        let wrenches: Vec<_> =
            scene.model().bodies.iter().map(|_| nalgebra::Vector6::from_fn(|_, _| random.uniform(-3.0, 3.0))).collect();
        let mut m = vec![f64::NAN; nv * nv];
        scene.mass_matrix(&mut w, &q, &mut m).unwrap();
        let m = DMatrix::from_row_slice(nv, nv, &m);
        let s = m.clone().svd(false, false).singular_values;
        let cond = s[0] / s[nv - 1];
        let (mut qdd, mut back) = (vec![f64::NAN; nv], vec![f64::NAN; nv]);
        scene.forward_dynamics(&mut w, &q, &qd, &tau, &wrenches, &mut qdd).unwrap();
        scene.inverse_dynamics(&mut w, &q, &qd, &qdd, &wrenches, &mut back).unwrap();
        assert_near("tau", &back, &tau, inverse(cond, size(&tau).max(30.0)));

        // M qdd + bias = tau, and M^-1 M = 1.
        let mut w2 = scene.workspace();
        dynamics::bias_torque(scene.model(), &mut w2, &q, &qd, &wrenches, &mut back);
        let total = &m * nalgebra::DVector::from_vec(qdd.clone()) + nalgebra::DVector::from_vec(back.clone());
        assert_near("M qdd + bias", total.as_slice(), &tau, inverse(cond, size(&tau).max(30.0)));
        let mut minv = vec![f64::NAN; nv * nv];
        scene.mass_matrix_inverse(&mut w, &mut scene.inverse_scratch(), &q, &mut minv).unwrap();
        let one = DMatrix::from_row_slice(nv, nv, &minv) * &m;
        assert_near("M^-1 M", one.as_slice(), DMatrix::identity(nv, nv).as_slice(), inverse(cond, 1.0));

        // det.
        let det = m.determinant().ln();
        dynamics::factorise(scene.model(), &mut w, &q, |_, _| {});
        assert!((dynamics::log_det_mass_matrix(&w) - det).abs() <= product(nv, 30.0));

        // kinetic energy = qd M qd / 2.
        let v = nalgebra::DVector::from_vec(qd.clone());
        let kinetic = 0.5 * (v.transpose() * &m * &v)[(0, 0)];
        let energy = scene.energy(&mut w, &q, &qd).unwrap();
        assert!((energy.kinetic - kinetic).abs() <= product(nv, kinetic));
    }
}
