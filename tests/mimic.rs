//! Coupled joints in Rust: methods for one state, the evaluator, simulation, and refused arguments.

use nalgebra::{DMatrix, DVector, Vector3};
use phipsi::motion::{Method, Rollout, Settings, Torque};
use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, Mimic, MimicJoints};
use phipsi::spatial::Symmetric3;
use phipsi::{Algorithm, Arguments, Error, Form, Scene, SceneBuilder};

/// An arm with two fingers, of which the second follows the first, and a wrist that follows the elbow.
fn arm(mimic_joints: MimicJoints) -> Scene {
    let link = |name: &str, mass: f64| LinkDescription {
        name: name.into(),
        inertial: Some(Inertial {
            mass,
            center: Vector3::new(0.05, 0.02, 0.2),
            central: Symmetric3::new([0.02, 0.001, 0.0, 0.03, 0.002, 0.015]),
        }),
    };
    let joint = |name: &str, kind: JointKind, parent: &str, child: &str, axis: [f64; 3]| {
        let mut joint = JointDescription::new(name, kind, parent, child);
        (joint.axis, joint.armature) = (axis.into(), 0.05);
        joint.origin.lever = Vector3::new(0.1, -0.05, 0.3);
        joint
    };
    let mut wrist = joint("wrist", JointKind::Revolute, "upper", "hand", [1.0, 0.2, 0.0]);
    wrist.mimic = Some(Mimic::of("shoulder").with_multiplier(-0.5).with_offset(0.2));
    let mut right = joint("right", JointKind::Prismatic, "hand", "right_tip", [-1.0, 0.1, 0.0]);
    right.mimic = Some(Mimic::of("left"));
    SceneBuilder::new()
        .link(LinkDescription { name: "base".into(), inertial: None })
        .link(link("upper", 2.0))
        .link(link("hand", 1.0))
        .link(link("left_tip", 0.2))
        .link(link("right_tip", 0.3))
        .joint(joint("shoulder", JointKind::Revolute, "base", "upper", [0.0, 1.0, 0.3]))
        .joint(wrist)
        .joint(joint("left", JointKind::Prismatic, "hand", "left_tip", [1.0, 0.0, 0.0]))
        .joint(right)
        .mimic_joints(mimic_joints)
        .build()
        .expect("a scene")
}

/// G by hand: shoulder, wrist, left, right from shoulder, left.
fn reduction() -> (DMatrix<f64>, DVector<f64>) {
    let g = DMatrix::from_row_slice(4, 2, &[1.0, 0.0, -0.5, 0.0, 0.0, 1.0, 0.0, 1.0]);
    (g, DVector::from_row_slice(&[0.0, 0.2, 0.0, 0.0]))
}

const Q: [f64; 2] = [0.4, 0.03];
const QD: [f64; 2] = [0.7, -0.2];
const TAU: [f64; 2] = [3.0, 1.0];

fn assert_near(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(1.0_f64, |scale, x| scale.max(x.abs()));
    for (x, y) in found.iter().zip(expected) {
        assert!((x - y).abs() <= 1e-12 * scale, "{found:?} is not {expected:?}");
    }
}

/// M and the bias of the tree in the expanded state, reduced; and the accelerations by dense algebra.
fn dense() -> (DMatrix<f64>, DVector<f64>, DVector<f64>) {
    let free = arm(MimicJoints::Free);
    let (g, o) = reduction();
    let (q, qd) = (&g * DVector::from_row_slice(&Q) + o, &g * DVector::from_row_slice(&QD));
    let mut workspace = free.workspace();
    let (mut m, mut bias) = (vec![f64::NAN; 16], vec![f64::NAN; 4]);
    free.mass_matrix(&mut workspace, q.as_slice(), &mut m).expect("M");
    free.bias_torque(&mut workspace, q.as_slice(), qd.as_slice(), &mut bias).expect("bias");
    let m = g.transpose() * DMatrix::from_row_slice(4, 4, &m) * &g;
    let bias = g.transpose() * DVector::from_vec(bias);
    let qdd = m.clone().cholesky().expect("positive").solve(&(DVector::from_row_slice(&TAU) - &bias));
    (m, bias, qdd)
}

#[test]
fn methods_of_one_state() {
    let scene = arm(MimicJoints::Coupled);
    assert_eq!((scene.nq(), scene.nv(), scene.tree().nv()), (2, 2, 4));
    assert_eq!(scene.joints().iter().map(|joint| joint.name.as_str()).collect::<Vec<_>>(), ["shoulder", "left"]);
    let (m, bias, qdd) = dense();
    let mut workspace = scene.workspace();
    let mut out = [f64::NAN; 4];
    scene.mass_matrix(&mut workspace, &Q, &mut out).expect("M");
    assert_near(&out, m.transpose().as_slice());
    scene.mass_matrix_inverse(&mut workspace, &mut scene.inverse_scratch(), &Q, &mut out).expect("M^-1");
    assert_near(&out, m.try_inverse().expect("positive").as_slice());
    let mut two = [f64::NAN; 2];
    scene.bias_torque(&mut workspace, &Q, &QD, &mut two).expect("bias");
    assert_near(&two, bias.as_slice());
    for form in [Form::Auto, Form::Covariance, Form::SquareRoot] {
        workspace.form = form;
        scene.forward_dynamics(&mut workspace, &Q, &QD, &TAU, &[], &mut two).expect("accelerations");
        assert_near(&two, qdd.as_slice());
    }
    let again = two;
    scene.inverse_dynamics(&mut workspace, &Q, &QD, &again, &[], &mut two).expect("torques");
    assert_near(&two, &TAU);
}

#[test]
fn many_states_at_once() {
    let scene = arm(MimicJoints::Coupled);
    let (_, _, qdd) = dense();
    let states = [Arguments { q: &Q, qd: &QD, u: &TAU, ..Arguments::default() }; 19];
    let mut out = [f64::NAN; 38];
    let mut evaluator = scene.evaluator();
    scene.evaluate(&mut evaluator, Algorithm::ForwardDynamics(Form::Auto), &states, &mut out).expect("accelerations");
    for of_state in out.chunks_exact(2) {
        assert_near(of_state, qdd.as_slice());
    }
}

#[test]
fn motion_is_the_trees_and_joints_follow() {
    let scene = arm(MimicJoints::Coupled);
    let coupling = scene.coupling().expect("joints that follow");
    let (q, qd) = (coupling.configuration(&Q), coupling.rates(&QD));
    let mut settings = Settings::new(&scene, 1e-3);
    settings.method = Method::RungeKutta4;
    let mut rollout = Rollout::new(&scene, settings.clone(), &q, &qd).expect("a state that follows");
    rollout.advance(300, &Torque::Zero, None).expect("motion");
    let (q, qd) = rollout.state(0);
    assert_eq!(q, coupling.configuration(&coupling.independent_coordinates(q)));
    assert_eq!(qd, coupling.rates(&coupling.independent_rates(qd)));
    assert!((q[0] - Q[0]).abs() > 0.01, "it falls");

    let energy = |q: &[f64], qd: &[f64]| {
        let free = scene.tree();
        let energy = free.energy(&mut free.workspace(), q, qd).expect("energy");
        energy.kinetic + energy.potential
    };
    let before = energy(&coupling.configuration(&Q), &coupling.rates(&QD));
    assert!((energy(q, qd) - before).abs() < 1e-9 * before.abs().max(1.0));

    let error =
        Rollout::new(&scene, settings, &[0.4, 0.4, 0.0, 0.0], &[0.0; 4]).expect_err("the wrist does not follow");
    assert!(error.to_string().contains("follows another"), "{error}");
}

#[test]
fn what_has_no_form_says_so() {
    let scene = arm(MimicJoints::Coupled);
    let mut out = [f64::NAN; 2];
    let state = Arguments { q: &Q, qd: &QD, u: &TAU, ..Arguments::default() };
    let error = scene
        .recursion(&mut scene.workspace(), None, Algorithm::InverseDynamics, &state, &mut out)
        .expect_err("no form for it");
    assert!(matches!(&error, Error::Argument { argument, .. } if argument == "scene"), "{error}");
    assert!(error.to_string().contains("MimicJoints::Free"), "{error}");
}
