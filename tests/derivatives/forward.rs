//! Forward dynamics.

use super::support::{
    NAMES, State, acceleration, differences, of_accelerations, of_accelerations_by_method, of_torques, round, trees,
    widened,
};
use crate::common::oracle::{D, Oracle, ds, solve};
use crate::common::tolerance::{self, assert_near, assert_near_double, conditioning, size};
use crate::common::{Random, Tree, random_inertial};
use nalgebra::DMatrix;
use phipsi::scene::{JointDescription, JointKind, LinkDescription, SceneBuilder};
use phipsi::{Form, Scene, scenes};

const FORMS: [Form; 3] = [Form::Auto, Form::Covariance, Form::SquareRoot];

/// Condition number of M in a state.
fn condition(scene: &Scene, q: &[f64]) -> f64 {
    let mut mass = vec![f64::NAN; scene.nv() * scene.nv()];
    scene.mass_matrix(&mut scene.workspace(), q, &mut mass).unwrap();
    conditioning(scene.nv(), &mass).number
}

#[test]
fn all_joints_as_central_differences() {
    for tree in trees(48) {
        let scene = tree.scene();
        let (model, n) = (scene.model(), scene.links().len());
        let state = State::random(&scene, 100 + tree.seed);
        let wide = widened(&scene);
        let exact = of_accelerations(&wide, Form::Covariance, &state.cast()).unwrap();
        let expected = differences(&wide, &state.cast(), acceleration);
        let cond = condition(&scene, &state.q);
        let qdd = round(&acceleration(&wide, &state.cast()));
        let all = exact.iter().map(|matrix| size(&round(matrix))).sum::<f64>() + size(&qdd);
        for (i, name) in NAMES.iter().enumerate() {
            assert_near_double(name, &exact[i], &expected[i], cond * tolerance::difference(n, all));
        }
        for form in FORMS {
            let found = of_accelerations(model, form, &state).unwrap();
            let by_method = of_accelerations_by_method(&scene, form, &state).unwrap();
            for (i, name) in NAMES.iter().enumerate() {
                assert_near(name, &found[i], &round(&exact[i]), tolerance::inverse(cond, all));
                assert_near(name, &by_method[i], &round(&exact[i]), tolerance::inverse(cond, all));
            }
        }
    }
}

/// -M^-1 dtau/dq at the accelerations, with M from the definitions and elimination.
#[test]
fn as_dense_algebra() {
    for tree in trees(16) {
        let scene = tree.scene();
        let (nv, model) = (scene.nv(), scene.model());
        let state = State::random(&scene, 700 + tree.seed);
        let mass = Oracle::new(&tree.builder()).at_rest(&ds(&state.q)).mass_matrix();
        let cond = condition(&scene, &state.q);
        let wide: State<D> = state.cast();
        let at = State { u: acceleration(&model.cast(), &wide), ..wide };
        let of_torques = of_torques(&model.cast(), &at);
        let found = of_accelerations(model, Form::Auto, &state).unwrap();
        for (found, of_torques) in found.iter().zip(&of_torques).take(2) {
            for column in 0..nv {
                let right: Vec<D> = (0..nv).map(|row| -of_torques[row * nv + column]).collect();
                let expected = round(&solve(&mass, &right));
                let found: Vec<f64> = (0..nv).map(|row| found[row * nv + column]).collect();
                let scale = size(&expected).max(size(&round(&right)));
                assert_near("dense", &found, &expected, tolerance::inverse(cond, scale));
            }
        }
    }
}

/// A body in free fall: its acceleration R* g in the body frame rotates with it, and velocities have the opposite
/// effect.
#[test]
fn a_single_body_by_hand() {
    let tree = Tree { seed: 1, bodies: 0, kinds: &[JointKind::Fixed], branching: 0.0, armature: 0.0, floating: true };
    let scene = tree.scene();
    let mut state = State::random(&scene, 4);
    state.qd.fill(0.0);
    state.u.fill(0.0);
    state.wrenches.clear();
    let [by_q, by_qd, _] = of_accelerations(scene.model(), Form::Auto, &state).unwrap();
    let placed = scene.placements(&state.q).unwrap()[0];
    let falls = placed.rotate_back(&scene.model().gravity);
    for (row, column) in (0..6).flat_map(|row| (0..6).map(move |column| (row, column))) {
        let expected = if row < 3 && column >= 3 {
            // d(exp(-d~) a) = a~ d
            phipsi::spatial::skew(&falls)[(row, column - 3)]
        } else {
            0.0
        };
        tolerance::assert_close("falling", by_q[row * 6 + column], expected, tolerance::product(8, 10.0));
    }
    assert_near("no rates", &by_qd, &[0.0; 36], tolerance::product(8, 10.0));
}

/// Above 300 links, columns are computed by filter and smoother; compared with M in 31 digits and elimination.
#[test]
fn on_both_sides_of_where_columns_are_fewer_operations() {
    for links in [60, 301] {
        let scene = scenes::chain(links).unwrap();
        let (nv, wide) = (scene.nv(), scene.model().cast());
        let state = State::random(&scene, 3);
        let at = State { u: acceleration(&wide, &state.cast()), ..state.cast() };
        let of_torques = of_torques(&wide, &at);
        let mass = DMatrix::from_row_slice(nv, nv, &of_torques[2]);
        let found = of_accelerations_by_method(&scene, Form::Auto, &state).unwrap();
        let cond = condition(&scene, &state.q);
        for which in 0..2 {
            for column in [0, nv / 2, nv - 1] {
                let right: Vec<D> = (0..nv).map(|row| -of_torques[which][row * nv + column]).collect();
                let expected = round(&solve(&mass, &right));
                let found: Vec<f64> = (0..nv).map(|row| found[which][row * nv + column]).collect();
                assert_near("columns", &found, &expected, tolerance::inverse(cond, size(&expected)));
            }
        }
    }
}

/// A joint without inertia about its axis is named.
#[test]
fn a_lost_pivot_is_told() {
    let mut random = Random::new(1);
    let link = |name: &str, inertial| LinkDescription { name: name.into(), inertial };
    let scene = SceneBuilder::new()
        .link(link("base", None))
        .link(link("arm", Some(random_inertial(&mut random))))
        .link(link("nothing", None))
        .joint(JointDescription::new("turn", JointKind::Revolute, "base", "arm"))
        .joint(JointDescription::new("idle", JointKind::Revolute, "arm", "nothing"))
        .build()
        .unwrap();
    let state = State { q: vec![0.1, 0.2], qd: vec![0.3; 2], u: vec![1.0; 2], wrenches: Vec::new() };
    for form in FORMS {
        assert_eq!(of_accelerations(scene.model(), form, &state).unwrap_err().stage, 1);
    }
    assert!(of_torques(scene.model(), &state).iter().flatten().all(|x| x.is_finite()));
}
