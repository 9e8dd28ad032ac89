//! Linearized system.

use super::support::{State, of_accelerations_by_method, trees};
use crate::common::tolerance::{self, assert_near, size};
use phipsi::scene::Property;
use phipsi::{Form, Scene};

/// A and B, row by row.
fn linearized(scene: &Scene, state: &State<f64>) -> (Vec<f64>, Vec<f64>) {
    let nv = scene.nv();
    let (mut a, mut b) = (vec![f64::NAN; 4 * nv * nv], vec![f64::NAN; 2 * nv * nv]);
    let State { q, qd, u, wrenches } = state;
    scene.linearize(&mut scene.workspace(), q, qd, u, wrenches, (&mut a, &mut b)).unwrap();
    (a, b)
}

#[test]
#[allow(clippy::float_cmp)] // the same values in other entries
fn its_lower_half_is_the_derivatives_and_its_upper_right_the_identity() {
    for tree in trees(16) {
        let scene = tree.scene();
        let nv = scene.nv();
        let state = State::random(&scene, 100 + tree.seed);
        let (a, b) = linearized(&scene, &state);
        let [by_q, by_qd, inverse] = of_accelerations_by_method(&scene, Form::Auto, &state).unwrap();
        for (row, column) in (0..nv).flat_map(|row| (0..nv).map(move |column| (row, column))) {
            let at = row * nv + column;
            assert_eq!(a[2 * nv * (nv + row) + column], by_q[at]);
            assert_eq!(a[2 * nv * (nv + row) + nv + column], by_qd[at]);
            assert_eq!(a[2 * nv * row + nv + column], f64::from(u8::from(row == column)));
            assert_eq!((b[at], b[nv * nv + at]), (0.0, inverse[at]));
        }
    }
}

#[test]
fn springs_and_damping_of_the_joints_are_part_of_it_and_no_call_allocates() {
    let (stiffness, damping) = ([2.0, 0.0, 5.0], [0.3, 0.4, 0.0]);
    let properties = [(Property::Stiffness, stiffness), (Property::Damping, damping)];
    let changes = properties
        .iter()
        .flat_map(|(of, values)| ["j0", "j1", "j2"].into_iter().zip(values).map(|(j, x)| (j, *of, *x)));
    let scene = phipsi::scenes::chain(3).unwrap().with_properties(changes).unwrap();
    let state = State::random(&scene, 7);
    let (a, b) = linearized(&scene, &state);
    // The springs are at rest at zero.
    let u = (0..3).map(|i| state.u[i] - stiffness[i] * state.q[i] - damping[i] * state.qd[i]).collect();
    let bare = State { u, ..state.clone() };
    let [by_q, by_qd, inverse] = of_accelerations_by_method(&scene, Form::Auto, &bare).unwrap();
    for (row, column) in (0..3).flat_map(|row| (0..3).map(move |column| (row, column))) {
        let at = 3 * row + column;
        let expected = [by_q[at] - inverse[at] * stiffness[column], by_qd[at] - inverse[at] * damping[column]];
        let found = [a[6 * (3 + row) + column], a[6 * (3 + row) + 3 + column]];
        assert_near("system", &found, &expected, 1e-13);
        assert!(b[9 + at].to_bits() == inverse[at].to_bits());
    }
    let (mut workspace, mut a, mut b) = (scene.workspace(), [f64::NAN; 36], [f64::NAN; 18]);
    let State { q, qd, u, wrenches } = &state;
    let mut call = || scene.linearize(&mut workspace, q, qd, u, wrenches, (&mut a, &mut b)).unwrap();
    call();
    assert_eq!(allocation_counter::measure(call).count_total, 0);
}

/// Two neighboring motions: the growth of their difference, compared with A.
#[test]
fn its_upper_left_is_how_fast_neighbours_part() {
    const STEP: f64 = 1e-4;
    let mut turning = 0.0_f64;
    for tree in trees(16) {
        let scene = tree.scene();
        let nv = scene.nv();
        let state = State::random(&scene, 800 + tree.seed);
        let (a, _) = linearized(&scene, &state);
        let along = |q: &[f64], v: &[f64]| {
            let mut out = vec![f64::NAN; scene.nq()];
            scene.integrate(q, v, &mut out).unwrap();
            out
        };
        let scaled = |v: &[f64], h: f64| v.iter().map(|v| v * h).collect::<Vec<_>>();
        for column in 0..nv {
            let unit: Vec<f64> = (0..nv).map(|i| if i == column { STEP } else { 0.0 }).collect();
            let apart = |e: f64, h: f64| {
                let (here, beside) = (&state.q, along(&state.q, &scaled(&unit, e)));
                let rates = scaled(&state.qd, STEP * h);
                let mut between = vec![f64::NAN; nv];
                scene.difference(&along(here, &rates), &along(&beside, &rates), &mut between).unwrap();
                between
            };
            let [pp, pm, mp, mm] = [apart(1.0, 1.0), apart(1.0, -1.0), apart(-1.0, 1.0), apart(-1.0, -1.0)];
            let found: Vec<f64> = (0..nv).map(|row| a[2 * nv * row + column]).collect();
            let expected: Vec<f64> = (0..nv).map(|i| (pp[i] - pm[i] - mp[i] + mm[i]) / (4.0 * STEP * STEP)).collect();
            turning = turning.max(size(&found));
            assert_near("parting", &found, &expected, tolerance::MIXED_DIFFERENCE);
        }
    }
    assert!(turning > 0.1);
}
