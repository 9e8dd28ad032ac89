//! Inverse dynamics.

use super::support::{
    KINDS, NAMES, State, Three, differences, of_torques, of_torques_by_method, round, torque, trees, widened,
};
use crate::common::oracle::{Oracle, d, ds};
use crate::common::tolerance::{self, assert_near, assert_near_double, size};
use crate::common::{Random, Tree, random_state};
use phipsi::Scene;
use phipsi::scene::JointKind;
use phipsi::scene::Model;

const ONE_AXIS: [JointKind; 5] = [
    JointKind::Revolute,
    JointKind::Prismatic,
    JointKind::Screw { pitch: -0.3 },
    JointKind::Planar,
    JointKind::Universal,
];

/// Magnitude of the terms of the sums.
fn scale(model: &Model<f64>, found: &Three<f64>, state: &State<f64>) -> f64 {
    let tau = round(&torque(&model.cast(), &state.cast()));
    found.iter().map(|matrix| size(matrix)).sum::<f64>() + size(&tau) + size(&state.u)
}

/// Analytic derivatives in double-double arithmetic compared with differences, and those in f64 compared with them.
#[track_caller]
fn assert_right(scene: &Scene, state: &State<f64>) -> Three<f64> {
    let (model, n) = (scene.model(), scene.links().len());
    let (wide, wide_state) = (widened(scene), state.cast());
    let exact = of_torques(&wide, &wide_state);
    let expected = differences(&wide, &wide_state, torque);
    let (found, by_method) = (of_torques(model, state), of_torques_by_method(scene, state));
    let scale = scale(model, &found, state);
    for (i, name) in NAMES.iter().enumerate() {
        assert_near(name, &by_method[i], &round(&exact[i]), tolerance::product(n, scale));
        assert_near_double(name, &exact[i], &expected[i], tolerance::difference(n, scale));
        assert_near(name, &found[i], &round(&exact[i]), tolerance::product(n, scale));
    }
    found
}

#[test]
fn all_joints_as_central_differences() {
    for tree in trees(48) {
        let scene = tree.scene();
        assert_right(&scene, &State::random(&scene, 100 + tree.seed));
    }
}

/// For a single joint S x* F would be wrong in its own rows, and the velocity of its parent differs from its own.
#[test]
fn each_kind_alone_and_on_a_turning_parent() {
    for kind in KINDS {
        for bodies in [1, 2, 3] {
            for floating in [false, true] {
                let kinds = [kind];
                let tree = Tree { seed: 7, bodies, kinds: &kinds, branching: 0.0, armature: 0.0, floating };
                let scene = tree.scene();
                assert_right(&scene, &State::random(&scene, 5));
            }
        }
    }
}

#[test]
fn as_differences_of_first_principles() {
    for tree in trees(16) {
        let (source, scene) = (tree.builder(), tree.scene());
        let oracle = Oracle::new(&source);
        let (nv, n) = (scene.nv(), scene.links().len());
        let mut random = Random::new(900 + tree.seed);
        let (q, qd, qdd) = random_state(&scene, &mut random);
        let name = scene.links()[random.below(n)].name.clone();
        let wrench: [f64; 6] = std::array::from_fn(|_| random.uniform(-5.0, 5.0));
        let named = [(name.as_str(), wrench)];
        let wrenches = scene.body_wrenches(named.map(|(name, wrench)| (name, wrench.into()))).unwrap();
        let torque = |q: &[_], qd: &[_]| {
            let instant = oracle.at(q, qd);
            let (bias, mass) = (instant.bias(&named).0, instant.mass_matrix());
            (0..nv).map(|i| (0..nv).fold(bias[i], |sum, j| sum + mass[(i, j)] * d(qdd[j]))).collect::<Vec<_>>()
        };
        let (q0, v0) = (ds(&q), ds(&qd));
        let found = of_torques(scene.model(), &State { q, qd: qd.clone(), u: qdd.clone(), wrenches });
        let scale = found.iter().map(|matrix| size(matrix)).sum::<f64>() + oracle.at(&q0, &v0).bias(&named).1;
        for column in 0..nv {
            let unit: Vec<_> = (0..nv).map(|j| d(if j == column { 1.0 } else { 0.0 })).collect();
            let rate = |h: f64| v0.iter().zip(&unit).map(|(&v, &e)| v + e * d(h)).collect::<Vec<_>>();
            let by_q = [tolerance::STEP, -tolerance::STEP].map(|h| torque(&oracle.moved(&q0, &unit, d(h)), &v0));
            let by_qd = [tolerance::STEP, -tolerance::STEP].map(|h| torque(&q0, &rate(h)));
            for (found, [ahead, back]) in found.iter().zip([by_q, by_qd]) {
                let found: Vec<f64> = (0..nv).map(|row| found[row * nv + column]).collect();
                let expected: Vec<_> =
                    ahead.iter().zip(&back).map(|(&a, &b)| (a - b) * d(0.5 / tolerance::STEP)).collect();
                assert_near("first principles", &found, &round(&expected), tolerance::product(n, scale));
            }
        }
    }
}

/// The derivative with respect to qdd is M, bitwise equal to M computed alone, except for the sign of a zero.
#[test]
#[allow(clippy::float_cmp)] // equality is asserted
fn the_third_is_the_mass_matrix_and_symmetric() {
    for tree in trees(16) {
        let scene = tree.scene();
        let state = State::random(&scene, 200 + tree.seed);
        let [_, _, mass] = of_torques(scene.model(), &state);
        let mut expected = vec![f64::NAN; scene.nv() * scene.nv()];
        scene.mass_matrix(&mut scene.workspace(), &state.q, &mut expected).unwrap();
        assert_near("M", &mass, &expected, tolerance::product(scene.nv(), size(&expected)));
        for i in 0..scene.nv() {
            for j in 0..scene.nv() {
                assert_eq!(mass[i * scene.nv() + j], mass[j * scene.nv() + i]);
            }
        }
    }
}

#[test]
#[allow(clippy::float_cmp)] // equality is asserted
fn armature_is_in_the_mass_matrix_alone() {
    for tree in trees(16).filter(|tree| tree.armature > 0.0) {
        let (geared, plain) = (tree.scene(), Tree { armature: 0.0, ..tree }.scene());
        let state = State::random(&geared, 300 + tree.seed);
        let [[dq, dqd, mass], [dq_plain, dqd_plain, mass_plain]] =
            [&geared, &plain].map(|scene| of_torques(scene.model(), &state));
        assert_eq!((dq, dqd), (dq_plain, dqd_plain));
        let nv = geared.nv();
        for i in 0..nv * nv {
            let armature = if i % (nv + 1) == 0 { geared.model().system.noise[i / (nv + 1)] } else { 0.0 };
            assert_eq!(mass[i], mass_plain[i] + armature);
        }
        assert!(nv == 0 || size(&geared.model().system.noise) > 0.0);
    }
}

/// Effect of one change of the state on dtau/dq and dtau/dqd.
fn change(scene: &Scene, state: &State<f64>, make: impl Fn(&mut State<f64>)) -> [f64; 2] {
    let mut other = state.clone();
    make(&mut other);
    let [a, b] = [state, &other].map(|state| of_torques(scene.model(), state));
    [0, 1].map(|i| size(&a[i].iter().zip(&b[i]).map(|(a, b)| a - b).collect::<Vec<_>>()))
}

#[test]
fn no_term_is_zero() {
    for tree in trees(24).filter(|tree| tree.bodies > 3) {
        let scene = tree.scene();
        let state = State::random(&scene, 400 + tree.seed);
        let [by_q, _] = change(&scene, &state, |state| state.u.fill(0.0));
        assert!(by_q > 1e-2, "accelerations");
        let [by_q, by_qd] = change(&scene, &state, |state| state.qd.fill(0.0));
        assert!(by_q > 1e-2 && by_qd > 1e-2, "rates");
        let [by_q, _] = change(&scene, &state, |state| state.wrenches.clear());
        assert!(by_q > 1e-2, "wrenches");
        let weightless = scene.source().clone().gravity([0.0; 3]).build().unwrap();
        let [heavy, light] = [&scene, &weightless].map(|scene| of_torques(scene.model(), &state));
        let off: Vec<f64> = heavy[0].iter().zip(&light[0]).map(|(a, b)| a - b).collect();
        assert!(size(&off) > 1e-2, "gravity");
    }
}

/// A rotation of the frame of a joint does not affect its own rows: the derivative of its torque with respect to its
/// rotation is not larger than the terms of M and F.
#[test]
fn at_rest_the_weight_of_one_axis_joints_has_a_symmetric_derivative() {
    for seed in 0..12 {
        let tree = Tree { seed, bodies: 6, kinds: &ONE_AXIS, branching: 0.4, armature: 0.2, floating: false };
        let scene = tree.scene();
        let nv = scene.nv();
        let mut state = State::random(&scene, 500 + seed);
        state.qd.fill(0.0);
        state.u.fill(0.0);
        state.wrenches.clear();
        let [by_q, by_qd, _] = of_torques(scene.model(), &state);
        let transposed: Vec<f64> = (0..nv * nv).map(|i| by_q[i % nv * nv + i / nv]).collect();
        assert_near("Hessian of the potential", &by_q, &transposed, tolerance::product(nv, size(&by_q)));
        assert!(size(&by_q) > 1e-2 && size(&by_qd) == 0.0);
    }
}

/// At rest, in static equilibrium, passive: typical initial and final states of trajectories.
#[test]
fn at_rest_and_falling() {
    for tree in trees(24) {
        let scene = tree.scene();
        let mut state = State::random(&scene, 600 + tree.seed);
        state.qd.fill(0.0);
        state.u.fill(0.0);
        state.wrenches.clear();
        assert_right(&scene, &state);
        let mut qdd = vec![f64::NAN; scene.nv()];
        let State { q, qd, u, .. } = &state;
        scene.forward_dynamics(&mut scene.workspace(), q, qd, u, &[], &mut qdd).unwrap();
        assert_right(&scene, &State { u: qdd, ..state });
    }
}

/// Along a path between branches, and nowhere else.
#[test]
#[allow(clippy::float_cmp)] // zeros are exact
fn branches_do_not_see_each_other() {
    let tree = Tree { seed: 3, bodies: 9, kinds: &KINDS, branching: 1.0, armature: 0.0, floating: false };
    let scene = tree.scene();
    let (nv, stages) = (scene.nv(), &scene.model().system.stages);
    let found = of_torques(scene.model(), &State::random(&scene, 1));
    let body_of = |row: usize| stages.partition_point(|stage| stage.first_row <= row) - 1;
    let is_inboard = |a: usize, mut b: usize| loop {
        if a == b {
            return true;
        }
        match stages[b].parent {
            Some(parent) => b = parent,
            None => return false,
        }
    };
    let mut between = 0;
    for i in 0..nv * nv {
        let (row, column) = (body_of(i / nv), body_of(i % nv));
        if !is_inboard(row, column) && !is_inboard(column, row) {
            between += 1;
            assert!(found.iter().all(|matrix| matrix[i] == 0.0));
        }
    }
    assert!(between > 0);
}

/// A robot that floats far from the origin of the base has full precision, because everything is in body frames.
#[test]
fn far_from_the_origin_no_digit_is_lost() {
    let tree =
        Tree { seed: 11, bodies: 7, kinds: &[JointKind::Revolute], branching: 0.3, armature: 0.0, floating: true };
    let scene = tree.scene();
    let near = State::random(&scene, 2);
    let mut far = near.clone();
    far.q[..3].copy_from_slice(&[1e6, -2e6, 1.5e6]);
    let [found, expected] = [&far, &near].map(|state| of_torques(scene.model(), state));
    for (found, expected) in found.iter().zip(&expected) {
        assert_near("1000 km away", found, expected, tolerance::product(1, size(expected)));
    }
}
