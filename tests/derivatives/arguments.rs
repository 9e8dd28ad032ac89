//! One valid call of each checked method, and one broken argument per test; no call allocates.

use super::support::{State, trees};
use crate::common::{Random, random_state};
use phipsi::{Error, Form, Scene, Workspace};

/// A scene with one state and memory for all results.
struct Case {
    scene: Scene,
    workspace: Workspace<f64>,
    state: State<f64>,
    out: Vec<f64>,
}

impl Case {
    fn new() -> Self {
        let scene = trees(8).last().unwrap().scene();
        let state = State::random(&scene, 1);
        let n = scene.nv() * scene.nv();
        Self { workspace: scene.workspace(), state, out: vec![f64::NAN; 3 * n], scene }
    }

    fn inverse(&mut self) -> Result<(), Error> {
        let State { q, qd, u, wrenches } = &self.state;
        self.scene.inverse_dynamics_derivatives(&mut self.workspace, q, qd, u, wrenches, &mut self.out)
    }

    fn forward(&mut self) -> Result<(), Error> {
        let State { q, qd, u, wrenches } = &self.state;
        self.scene.forward_dynamics_derivatives(&mut self.workspace, q, qd, u, wrenches, &mut self.out)
    }

    /// The messages of both with one broken argument.
    fn refused(break_it: impl Fn(&mut Self)) -> [String; 2] {
        let mut case = Self::new();
        break_it(&mut case);
        [case.inverse().unwrap_err().to_string(), case.forward().unwrap_err().to_string()]
    }
}

#[test]
fn a_valid_call() {
    let mut case = Case::new();
    case.inverse().unwrap();
    assert!(case.out.iter().all(|x| x.is_finite()));
    case.out.fill(f64::NAN);
    case.forward().unwrap();
    assert!(case.out.iter().all(|x| x.is_finite()));
}

#[test]
fn no_call_allocates() {
    for form in [Form::Auto, Form::Covariance] {
        let mut case = Case::new();
        case.workspace.form = form;
        // The first call allocates the scratch memory.
        case.inverse().unwrap();
        case.forward().unwrap();
        let counted = allocation_counter::measure(|| {
            case.inverse().unwrap();
            case.forward().unwrap();
        });
        assert_eq!(counted.count_total, 0, "{form:?}");
    }
}

#[test]
fn nothing_of_an_earlier_state_is_used() {
    let mut used = Case::new();
    used.forward().unwrap();
    let mut fresh = Case::new();
    let (q, qd, u) = random_state(&used.scene, &mut Random::new(77));
    for case in [&mut used, &mut fresh] {
        case.state = State { q: q.clone(), qd: qd.clone(), u: u.clone(), wrenches: Vec::new() };
        case.forward().unwrap();
    }
    assert_eq!(used.out, fresh.out);
}

#[test]
fn a_short_q() {
    for message in Case::refused(|case| assert!(case.state.q.pop().is_some())) {
        assert!(message.starts_with("q: found shape"), "{message}");
    }
}

#[test]
fn rates_that_are_not_finite() {
    for message in Case::refused(|case| case.state.qd[1] = f64::NAN) {
        assert!(message.starts_with("qd: found NaN at index 1"), "{message}");
    }
}

#[test]
fn a_long_third() {
    let [inverse, forward] = Case::refused(|case| case.state.u.push(0.0));
    assert!(inverse.starts_with("qdd: found shape") && forward.starts_with("tau: found shape"));
}

#[test]
fn wrenches_of_another_scene() {
    for message in Case::refused(|case| assert!(case.state.wrenches.pop().is_some())) {
        assert!(message.starts_with("wrenches: found shape"), "{message}");
    }
}

#[test]
fn a_short_result() {
    for message in Case::refused(|case| assert!(case.out.pop().is_some())) {
        assert!(message.starts_with("out: found shape"), "{message}");
    }
}

#[test]
fn a_workspace_of_another_scene() {
    let other = trees(2).last().unwrap().scene();
    for message in Case::refused(|case| case.workspace = other.workspace()) {
        assert!(message.starts_with("workspace: found"), "{message}");
    }
}

#[test]
fn what_overflows() {
    let [inverse, _] = Case::refused(|case| case.state.qd.fill(1e200));
    assert!(inverse.contains("overflow"), "{inverse}");
}

#[test]
fn a_scene_without_degrees_of_freedom() {
    let tree = crate::common::Tree {
        seed: 1,
        bodies: 2,
        kinds: &[phipsi::scene::JointKind::Fixed],
        branching: 0.0,
        armature: 0.0,
        floating: false,
    };
    let scene = tree.scene();
    let workspace = &mut scene.workspace();
    scene.inverse_dynamics_derivatives(workspace, &[], &[], &[], &[], &mut []).unwrap();
    scene.forward_dynamics_derivatives(workspace, &[], &[], &[], &[], &mut []).unwrap();
    scene.coriolis_matrix(workspace, &[], &[], &mut []).unwrap();
    scene.linearize(workspace, &[], &[], &[], &[], (&mut [], &mut [])).unwrap();
}
