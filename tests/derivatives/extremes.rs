//! Form `auto` in cases with cancellation: the extreme scenes by name, and random ones, ordinary and extreme, in
//! typical states.
//!
//! `PHIPSI_SHOW_RATIOS=1 PHIPSI_DERIVATIVE_SCENES=2200 cargo test --test all derivatives::extremes --
//! --nocapture` prints a table of the families: median, 90th percentile and largest error of dqdd/dq, dqdd/dqd
//! and M^-1.

use super::support::{NAMES, State, Three, of_accelerations, of_accelerations_by_method, round};
use crate::auto::families::{Case, FAMILIES, STATES, case};
use crate::common::tolerance::{self, size};
use phipsi::scenes::{extreme, names};
use phipsi::{Form, Scene};

/// The derivatives in double-double arithmetic, square-root form; none if a pivot is singular even there.
fn reference(scene: &Scene, state: &State<f64>) -> Option<Three<f64>> {
    let exact = of_accelerations(&scene.model().cast(), Form::SquareRoot, &state.cast()).ok()?;
    let exact = exact.map(|matrix| round(&matrix));
    exact.iter().flatten().all(|x| x.is_finite()).then_some(exact)
}

/// Largest error relative to the largest entry, of each; if a result consists of rounding errors of double-double
/// arithmetic, relative to that of M^-1.
fn errors(found: &Three<f64>, exact: &Three<f64>) -> [f64; 3] {
    let inverse = size(&exact[2]);
    [0, 1, 2].map(|i| {
        let off: Vec<f64> = found[i].iter().zip(&exact[i]).map(|(a, b)| a - b).collect();
        let size_of = size(&exact[i]);
        let scale = if size_of <= tolerance::NOTHING * inverse { inverse } else { size_of };
        if size(&off) == 0.0 { 0.0 } else { size(&off) / scale }
    })
}

fn shows() -> bool {
    std::env::var_os("PHIPSI_SHOW_RATIOS").is_some()
}

#[test]
fn extreme_scenes_keep_their_digits() {
    for name in names() {
        let usual = extreme(name, None, None, 0).unwrap();
        for &value in usual.values {
            if (name == "zero-inertia" && value == 0.0) || (name == "long-chain" && value > 40.0) {
                continue;
            }
            let case = extreme(name, Some(value), None, 1).unwrap();
            let state = State { q: case.q, qd: case.qd, u: case.tau, wrenches: Vec::new() };
            let exact = reference(&case.scene, &state).unwrap();
            let found = of_accelerations_by_method(&case.scene, Form::Auto, &state).unwrap();
            for (what, error) in NAMES.iter().zip(errors(&found, &exact)) {
                if shows() {
                    eprintln!("{name} {value:e} {what}: {error:.1e}");
                }
                assert!(error <= tolerance::EXTREME_DERIVATIVES, "{name} at {value:e}, {what}: {error:e}");
            }
        }
    }
}

/// Errors of `auto` in one state, if there is a reference.
fn errors_at(case: &Case) -> Option<[f64; 3]> {
    let Case { q, qd, tau, wrenches, .. } = case.clone();
    let state = State { q, qd, u: tau, wrenches };
    let exact = reference(&case.scene, &state)?;
    let found = of_accelerations_by_method(&case.scene, Form::Auto, &state).ok()?;
    Some(errors(&found, &exact))
}

/// Up to the documented tolerance, which applies to an estimate: hence the margin.
#[test]
fn random_scenes_keep_what_is_promised() {
    let scenes = std::env::var("PHIPSI_DERIVATIVE_SCENES").map_or(66, |n| n.parse().unwrap());
    let mut table = vec![[const { Vec::new() }; 3]; FAMILIES.len()];
    for number in 0..scenes {
        let Some(found) = errors_at(&case(number)) else { continue };
        for ((all, error), what) in table[number % FAMILIES.len()].iter_mut().zip(found).zip(NAMES) {
            all.push(error);
            assert!(error <= tolerance::CANCELLED_DERIVATIVES || scenes > 66, "scene {number}, {what}: {error:e}");
        }
    }
    for (family, errors) in FAMILIES.iter().zip(&mut table) {
        let told = errors.each_mut().map(|all| {
            all.sort_by(f64::total_cmp);
            format!("{:.0e} {:.0e} {:.0e}", all[all.len() / 2], all[all.len() * 9 / 10], all[all.len() - 1])
        });
        if shows() {
            eprintln!("{family:28} {:3} {}", errors[0].len(), told.join(" | "));
        }
    }
}

/// Static equilibrium and free fall: accelerations cancel, their derivatives do not.
#[test]
fn the_states_that_robots_are_in() {
    for (number, family) in FAMILIES.iter().enumerate() {
        for base in [Some(case(number)), case(number).on_a_free_base(1)].into_iter().flatten() {
            for state in STATES {
                let Some(found) = base.in_state(state).as_ref().and_then(errors_at) else { continue };
                for (what, error) in NAMES.iter().zip(found) {
                    assert!(error <= tolerance::CANCELLED_DERIVATIVES, "{family}, {state}, {what}: {error:e}");
                }
            }
        }
    }
}
