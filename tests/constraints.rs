//! Closed loops: accelerations and forces beside the KKT system by definition in 31 digits, rows beside differences, projections, inverses, and what is refused.

mod common;

use common::loops::{biped, exact, four_bar, state, stewart};
use common::tolerance;
use phipsi::filter::Form;
use phipsi::scene::ConnectionKind;
use phipsi::{Error, Scene};

/// A linkage that is closed in a configuration that is not the neutral one.
fn bars(kind: ConnectionKind) -> Scene {
    four_bar(kind, [1.0, 2.0, 0.5])
}

fn point() -> ConnectionKind {
    ConnectionKind::Point
}

fn hinge() -> ConnectionKind {
    ConnectionKind::Axis([0.0, 2.0, 0.0].into())
}

/// qdd, forces, rank and residual.
fn dynamics(
    scene: &Scene,
    form: Form,
    q: &[f64],
    qd: &[f64],
    tau: &[f64],
) -> Result<(Vec<f64>, Vec<f64>, usize, f64), Error> {
    let (mut workspace, mut scratch) = (scene.workspace().in_form(form), scene.constraint_scratch());
    let (mut qdd, mut forces) = (vec![f64::NAN; scene.nv()], vec![f64::NAN; scene.constraint_rows()]);
    let told = scene.constrained_dynamics(&mut workspace, &mut scratch, q, qd, tau, &[], (&mut qdd, &mut forces))?;
    Ok((qdd, forces, told.rank, told.residual))
}

fn jacobian(scene: &Scene, q: &[f64]) -> Vec<f64> {
    let mut out = vec![f64::NAN; scene.constraint_rows() * scene.nv()];
    scene.constraint_jacobian(&mut scene.workspace(), &mut scene.constraint_scratch(), q, &mut out).unwrap();
    out
}

fn transposed(scene: &Scene, jacobian: &[f64], forces: &[f64]) -> Vec<f64> {
    let nv = scene.nv();
    (0..nv).map(|k| forces.iter().enumerate().map(|(i, f)| jacobian[i * nv + k] * f).sum()).collect()
}

const FORMS: [Form; 4] = [Form::Auto, Form::Covariance, Form::Joseph, Form::SquareRoot];

/// The error of every form beside the definition, over the largest acceleration and the condition of the problem.
fn compare(what: &str, scene: &Scene, (q, qd, tau): &(Vec<f64>, Vec<f64>, Vec<f64>), rank: usize, bound: f64) {
    let exact = exact(scene, q, qd, tau);
    assert_eq!(exact.rank, rank, "{what}: rank of the definition");
    for form in FORMS {
        let (qdd, forces, found, residual) = dynamics(scene, form, q, qd, tau).unwrap();
        assert_eq!(found, rank, "{what} {form:?}: rank");
        let size = tolerance::size(&exact.qdd);
        let error = qdd.iter().zip(&exact.qdd).fold(0.0_f64, |e, (a, b)| e.max((a - b).abs())) / size;
        let torque = transposed(scene, &jacobian(scene, q), &forces);
        let of_torque = tolerance::size(&exact.torque);
        let torque_error = torque.iter().zip(&exact.torque).fold(0.0_f64, |e, (a, b)| e.max((a - b).abs())) / of_torque;
        println!(
            "{what} {form:?}: qdd {error:.1e}, J^T f {torque_error:.1e}, residual {residual:.1e}, cond G {:.1e}",
            exact.condition
        );
        assert!(error <= bound, "{what} {form:?}: qdd off by {error:e}");
        assert!(torque_error <= bound, "{what} {form:?}: J^T f off by {torque_error:e}");
    }
}

#[test]
fn a_linkage_closed_by_a_point_or_a_hinge_moves_as_defined() {
    for seed in 0..3 {
        let scene = bars(point());
        compare("point", &scene, &state(&scene, seed, 0.7), 2, 1e-12);
        let scene = bars(hinge());
        compare("axis", &scene, &state(&scene, seed, 0.7), 2, 1e-12);
    }
}

#[test]
fn print_more() {
    let scene = stewart();
    compare("stewart", &scene, &state(&scene, 1, 0.1), 15, 1e-11);
    let scene = biped(0);
    compare("biped", &scene, &state(&scene, 1, 0.1), 12, 1e-11);
    let scene = biped(4);
    compare("biped, corners", &scene, &state(&scene, 1, 0.1), 12, 1e-11);
    for masses in [[1.0, 1e8, 1.0], [1e8, 1.0, 1.0], [1.0, 1.0, 1e8], [1e8, 1.0, 1e8], [1.0, 1e8, 1e8]] {
        let scene = four_bar(point(), masses);
        compare(&format!("{masses:?}"), &scene, &state(&scene, 1, 0.7), 2, 1.0);
    }
}
