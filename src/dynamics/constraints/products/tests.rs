//! Gradients of the rows of connections, compared with differences in double-double arithmetic.

use super::super::rows::ConnectionRows;
use super::super::rows::tests::scene;
use super::RowGradients;
use crate::kinematics::placements_base_to_tip;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use crate::scene::Scene;
use crate::scenes::draw::Draw;
use crate::spatial::RigidShift;
use crate::workspace::Workspace;

/// multipliers* (J qdd + J' qd), by the definition of the rows.
fn value(
    model: &Model<DoubleDouble>,
    scene: &Scene,
    (q, qd, qdd): (&[DoubleDouble], &[DoubleDouble], &[DoubleDouble]),
    multipliers: &[f64],
) -> DoubleDouble {
    let mut workspace = Workspace::new(model);
    let mut rows = ConnectionRows::new((model, &workspace.sweeps), scene.constraints());
    rows.place(model, &mut workspace, (q, qd)).expect("rows");
    let mut out = vec![DoubleDouble::from_f64(0.0); multipliers.len()];
    let mut terms = out.clone();
    rows.times::<true>((model, &workspace.sweeps), &workspace.store, qdd, (&mut out, &mut terms));
    let products = out.into_iter().zip(multipliers).map(|(row, r)| row * DoubleDouble::from_f64(*r));
    products.fold(DoubleDouble::from_f64(0.0), |sum, product| sum + product)
}

#[test]
fn gradients_of_rows_are_differences() {
    const STEP: f64 = 1e-7;
    let scene = scene();
    let (model, nv) = (scene.model(), scene.nv());
    let wide: Model<DoubleDouble> = model.cast();
    let mut random = Draw::new(5);
    for is_moving in [false, true] {
        let mut many = |count: usize| -> Vec<f64> { (0..count).map(|_| random.uniform(-0.5, 0.5)).collect() };
        let (start, along) = (scene.neutral(), many(nv));
        let mut q = start.clone();
        scene.integrate(&start, &along, &mut q).expect("a configuration");
        let (qd, qdd, r) = (many(nv), many(nv), many(scene.constraints().rows));
        let qd = if is_moving { qd } else { vec![0.0; nv] };
        let mut shifts = vec![RigidShift::identity(); model.bodies.len()];
        placements_base_to_tip(model, &q, &mut shifts);
        let (mut by_q, mut by_qd) = (vec![0.0; nv], vec![0.0; nv]);
        let system = (model, scene.constraints());
        let mut gradients = RowGradients::new(system);
        if is_moving {
            let out = [&mut by_q[..], &mut by_qd[..]];
            gradients.add_acceleration_gradient(&shifts, (&q, &qd, &qdd), &r, out).expect("gradients");
        } else {
            gradients.add_row_gradient(&shifts, (&q, &qdd), &r, &mut by_q).expect("gradients");
        }
        let widened = |x: &[f64]| -> Vec<DoubleDouble> { x.iter().map(|&x| DoubleDouble::from_f64(x)).collect() };
        let (at, rates, accelerations) = (widened(&q), widened(&qd), widened(&qdd));
        for j in 0..nv {
            let difference = |of_q: bool| -> f64 {
                let ends = [STEP, -STEP].map(|step| {
                    let mut change = vec![DoubleDouble::from_f64(0.0); nv];
                    change[j] = DoubleDouble::from_f64(step);
                    let (mut next, mut faster) = (at.clone(), rates.clone());
                    if of_q {
                        for (body, stage) in wide.bodies.iter().zip(&wide.system.stages) {
                            body.motion.advance(&at[body.q..], &change[stage.first_row..], &mut next[body.q..]);
                        }
                    } else {
                        faster[j] += change[j];
                    }
                    value(&wide, &scene, (&next, &faster, &accelerations), &r)
                });
                (ends[0] - ends[1]).lane(0) / (2.0 * STEP)
            };
            let (expected_q, expected_qd) = (difference(true), difference(false));
            assert!((by_q[j] - expected_q).abs() <= 1e-11, "{j} by q: {} and {expected_q}", by_q[j]);
            assert!(!is_moving || (by_qd[j] - expected_qd).abs() <= 1e-11, "{j}: {} and {expected_qd}", by_qd[j]);
        }
        assert!(by_q.iter().any(|x| x.abs() > 0.1));
    }
}
