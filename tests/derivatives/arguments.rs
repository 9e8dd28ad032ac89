//! One valid call of each checked method, and one broken argument a test; no call allocates.

use crate::common::{Random, random_state};
use crate::support::{State, trees};
use phipsi::dynamics::derivatives::{DerivativeScratch, ForwardDerivatives, InverseDerivatives};
use phipsi::{Error, Form, Scene, Workspace};

/// A scene with one state and room for everything.
struct Case {
    scene: Scene,
    workspace: Workspace<f64>,
    scratch: DerivativeScratch<f64>,
    state: State<f64>,
    out: [Vec<f64>; 3],
}

impl Case {
    fn new() -> Self {
        let scene = trees(8).last().unwrap().scene();
        let state = State::random(&scene, 1);
        let n = scene.nv() * scene.nv();
        Self {
            workspace: scene.workspace(),
            scratch: scene.derivative_scratch(),
            state,
            out: [(); 3].map(|()| vec![f64::NAN; n]),
            scene,
        }
    }

    fn inverse(&mut self) -> Result<(), Error> {
        let State { q, qd, u, wrenches } = &self.state;
        let [dtau_dq, dtau_dqd, mass_matrix] = &mut self.out;
        let mut out = InverseDerivatives { dtau_dq, dtau_dqd, mass_matrix };
        self.scene.inverse_dynamics_derivatives(&mut self.workspace, &mut self.scratch, q, qd, u, wrenches, &mut out)
    }

    fn forward(&mut self) -> Result<(), Error> {
        let State { q, qd, u, wrenches } = &self.state;
        let [dqdd_dq, dqdd_dqd, mass_matrix_inverse] = &mut self.out;
        let mut out = ForwardDerivatives { dqdd_dq, dqdd_dqd, mass_matrix_inverse };
        self.scene.forward_dynamics_derivatives(&mut self.workspace, &mut self.scratch, q, qd, u, wrenches, &mut out)
    }

    /// The messages of both with one thing broken.
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
    assert!(case.out.iter().flatten().all(|x| x.is_finite()));
    case.out.iter_mut().for_each(|out| out.fill(f64::NAN));
    case.forward().unwrap();
    assert!(case.out.iter().flatten().all(|x| x.is_finite()));
}

#[test]
fn no_call_allocates() {
    for form in [Form::Auto, Form::Covariance, Form::SquareRoot] {
        let mut case = Case::new();
        case.workspace.form = form;
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
    let [inverse, forward] = Case::refused(|case| assert!(case.out[1].pop().is_some()));
    assert!(inverse.starts_with("dtau_dqd: found shape") && forward.starts_with("dqdd_dqd: found shape"));
}

#[test]
fn scratch_of_another_scene() {
    let other = trees(2).last().unwrap().scene();
    for message in Case::refused(|case| case.scratch = other.derivative_scratch()) {
        assert!(message.starts_with("scratch: found"), "{message}");
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
    let (mut workspace, mut scratch) = (scene.workspace(), scene.derivative_scratch());
    let mut out = InverseDerivatives { dtau_dq: &mut [], dtau_dqd: &mut [], mass_matrix: &mut [] };
    scene.inverse_dynamics_derivatives(&mut workspace, &mut scratch, &[], &[], &[], &[], &mut out).unwrap();
    let mut out = ForwardDerivatives { dqdd_dq: &mut [], dqdd_dqd: &mut [], mass_matrix_inverse: &mut [] };
    scene.forward_dynamics_derivatives(&mut workspace, &mut scratch, &[], &[], &[], &[], &mut out).unwrap();
    scene.linearize(&mut workspace, &mut scratch, &[], &[], &[], &[], (&mut [], &mut [])).unwrap();
}
