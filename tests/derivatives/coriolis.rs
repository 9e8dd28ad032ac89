//! Coriolis matrix, and time derivative of the mass matrix.

use super::support::{State, of_torques, round, trees, widened};
use crate::common::oracle::{D, d};
use crate::common::tolerance::{self, assert_near, size};
use crate::common::{Random, Tree, random_state};
use phipsi::dynamics::derivatives::{DerivativeScratch, coriolis_matrix};
use phipsi::scene::JointKind;
use phipsi::{Scene, Workspace, dynamics};

/// C and dM/dt by the methods of the scene.
fn found(scene: &Scene, q: &[f64], qd: &[f64]) -> [Vec<f64>; 2] {
    let mut out = [(); 2].map(|()| vec![f64::NAN; scene.nv() * scene.nv()]);
    let [coriolis, rate] = &mut out;
    scene.coriolis_matrix(&mut scene.workspace(), q, qd, coriolis).unwrap();
    scene.mass_matrix_derivative(&mut scene.workspace(), q, qd, rate).unwrap();
    out
}

/// Torque of the velocities alone: bias with velocities minus bias without.
#[test]
fn it_gives_the_torque_of_the_rates() {
    for tree in trees(32) {
        let scene = tree.scene();
        let nv = scene.nv();
        let (q, qd, _) = random_state(&scene, &mut Random::new(40 + tree.seed));
        let [coriolis, _] = found(&scene, &q, &qd);
        let bias = |qd: &[f64]| {
            let mut tau = vec![f64::NAN; nv];
            scene.bias_torque(&mut scene.workspace(), &q, qd, &mut tau).unwrap();
            tau
        };
        let (moving, still) = (bias(&qd), bias(&vec![0.0; nv]));
        let expected: Vec<f64> = moving.iter().zip(&still).map(|(a, b)| a - b).collect();
        let product: Vec<f64> =
            coriolis.chunks(nv.max(1)).map(|row| row.iter().zip(&qd).map(|(c, v)| c * v).sum()).collect();
        let scale = size(&moving) + size(&still) + size(&coriolis);
        assert_near("C qd", &product, &expected, tolerance::product(nv.max(1), tolerance::TERMS_OF_TREES * scale));
    }
}

/// M at q (+) h qd in 31 digits, forward and backward.
#[test]
fn with_its_transpose_it_is_the_rate_of_the_mass_matrix() {
    let mut moved = 0.0_f64;
    for tree in trees(32) {
        let scene = tree.scene();
        let (nv, model) = (scene.nv(), widened(&scene));
        let (q, qd, u) = random_state(&scene, &mut Random::new(60 + tree.seed));
        let [coriolis, rate] = found(&scene, &q, &qd);
        let state: State<D> = State { q, qd, u, wrenches: Vec::new() }.cast();
        let mass = |h: f64| {
            let (mut at, v) = (state.q.clone(), state.qd.iter().map(|&v| v * d(h)).collect::<Vec<_>>());
            for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
                body.motion.advance(&state.q[body.q..], &v[stage.first_row..], &mut at[body.q..]);
            }
            let mut out = vec![d(f64::NAN); nv * nv];
            dynamics::mass_matrix(&model, &mut Workspace::new(&model), &at, &mut out);
            out
        };
        let (ahead, back) = (mass(tolerance::STEP), mass(-tolerance::STEP));
        let expected: Vec<D> = ahead.iter().zip(&back).map(|(&a, &b)| (a - b) * d(0.5 / tolerance::STEP)).collect();
        let bound = tolerance::product(nv.max(1), tolerance::TERMS_OF_TREES * (size(&coriolis) + 1.0));
        assert_near("dM/dt", &rate, &round(&expected), bound);
        let both: Vec<f64> = (0..nv * nv).map(|i| coriolis[i] + coriolis[i % nv * nv + i / nv]).collect();
        assert_near("C + C^T", &rate, &both, bound);
        moved = moved.max(size(&rate));
    }
    assert!(moved > 0.1);
}

/// Christoffel symbols: for one-axis joints, half of the derivatives of the torques with respect to the velocities.
#[test]
fn of_one_axis_joints_it_is_half_of_dtau_dqd() {
    const KINDS: [JointKind; 3] = [JointKind::Revolute, JointKind::Prismatic, JointKind::Screw { pitch: 0.3 }];
    for seed in 0..12 {
        let tree = Tree { seed, bodies: 7, kinds: &KINDS, branching: 0.4, armature: 0.2, floating: false };
        let scene = tree.scene();
        let (q, qd, _) = random_state(&scene, &mut Random::new(80 + seed));
        let [coriolis, _] = found(&scene, &q, &qd);
        let u = vec![0.7; scene.nv()];
        let [_, by_qd, _] = of_torques(scene.model(), &State { q, qd, u, wrenches: Vec::new() });
        let half: Vec<f64> = by_qd.iter().map(|x| 0.5 * x).collect();
        assert_near("2 C", &coriolis, &half, tolerance::product(scene.nv(), size(&half)));
        assert!(size(&half) > 1e-3);
    }
}

/// The recursion and the compiled kernel.
#[test]
fn either_way_to_it_gives_the_same() {
    for tree in trees(16) {
        let scene = tree.scene();
        let (q, qd, _) = random_state(&scene, &mut Random::new(90 + tree.seed));
        let [coriolis, _] = found(&scene, &q, &qd);
        let mut expected = vec![f64::NAN; coriolis.len()];
        let scratch = &mut DerivativeScratch::new(scene.model());
        coriolis_matrix(scene.model(), &mut scene.workspace(), scratch, &q, &qd, &mut expected);
        assert_near("C", &coriolis, &expected, tolerance::product(scene.nv().max(1), size(&expected) + 1.0));
    }
}
