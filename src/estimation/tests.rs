//! With the noise of the filter itself the analysis reproduces the paper: C = M and t = r give Pi = P, V = Lambda and
//! the diagonal of M^-1.

use super::variance::{Factored, VarianceScratch, Variances, base_to_tip, tip_to_base};
use crate::dynamics::{InverseScratch, co_state_covariances, factorise, mass_matrix_inverse};
use crate::filter::Form;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use crate::scene::Scene;
use crate::spatial::Symmetric6;
use crate::workspace::Workspace;

/// The largest difference of two packed matrices over the largest entry.
fn off(found: &Symmetric6<DoubleDouble>, expected: &Symmetric6<DoubleDouble>) -> f64 {
    let (found, expected) = (found.to_matrix(), expected.to_matrix());
    let largest = expected.iter().map(|x| x.high.abs()).fold(1e-300, f64::max);
    (found - expected).iter().map(|x| x.high.abs()).fold(0.0, f64::max) / largest
}

fn check(scene: &Scene, armature: f64) {
    let mut model: Model<DoubleDouble> = scene.model().cast();
    model.system.noise.fill(DoubleDouble::from_f64(armature));
    let nv = model.nv();
    let mut angle = 0.2;
    let mut next = || {
        angle += 0.1;
        DoubleDouble::from_f64(angle)
    };
    let q: Vec<DoubleDouble> = (0..model.nq).map(|_| next()).collect();
    let mut workspace = Workspace::new(&model).in_form(Form::Covariance);
    let mut before = vec![Symmetric6::zero(); nv];
    factorise(&model, &mut workspace, &q);
    let (shift, measured) = (&workspace.store.shifts, &workspace.store.measured);
    for (k, (sum, body)) in workspace.store.covariances().iter().zip(&model.bodies).enumerate() {
        let seen = |row: usize, p: &Symmetric6<DoubleDouble>| before[row] = *p;
        sum.measured((&model.system, k), &body.inertia, &mut measured.clone(), seen);
    }
    let mut lambda = vec![Symmetric6::zero(); model.bodies.len()];
    co_state_covariances(&model.system, (shift, measured), &mut lambda, |_, _, _| {});

    let mut scratch = VarianceScratch::new(&model);
    for (noise, body) in scratch.own.iter_mut().zip(&model.bodies) {
        *noise = body.inertia.to_symmetric();
    }
    scratch.torque.copy_from_slice(&model.system.noise);
    let factor = Factored { shift, measured };
    tip_to_base(&model, factor, &mut scratch);
    for (row, (found, expected)) in scratch.before_row.iter().zip(&before).enumerate() {
        assert!(off(found, expected) <= 1e-27, "P of row {row}");
    }
    let nan = DoubleDouble::from_f64(f64::NAN);
    let mut joints = vec![nan; nv];
    let mut bodies = vec![Symmetric6::filled(nan); model.bodies.len()];
    base_to_tip(&model, factor, &mut scratch, &mut Variances { joints: &mut joints, bodies: &mut bodies });
    for (k, (found, expected)) in bodies.iter().zip(&lambda).enumerate() {
        assert!(off(found, expected) <= 1e-24, "V of body {k}");
    }
    let mut inverse = vec![nan; nv * nv];
    let mut own = Workspace::new(&model).in_form(Form::Covariance);
    mass_matrix_inverse(&model, &mut own, &mut InverseScratch::new(&model), &q, &mut inverse);
    for (row, found) in joints.iter().enumerate() {
        let expected = inverse[row * nv + row].high;
        assert!((found.high / expected - 1.0).abs() <= 1e-14, "variance of row {row}");
    }
}

#[test]
fn with_its_own_noise_the_filter_is_the_papers() -> Result<(), crate::Error> {
    let chain = crate::scenes::chain(5)?;
    for armature in [0.0, 0.3] {
        check(&chain, armature);
    }
    Ok(())
}

/// Siblings, and joints of several rows: what the other children bring, and rows in their order.
#[cfg(feature = "urdf")]
#[test]
fn siblings_and_free_joints_too() -> Result<(), crate::Error> {
    let text = include_str!("../../tests/data/mixed.urdf");
    for floating in [false, true] {
        let scene = crate::SceneBuilder::from_urdf(text)?.floating_base(floating).build()?;
        check(&scene, 0.1);
    }
    Ok(())
}
