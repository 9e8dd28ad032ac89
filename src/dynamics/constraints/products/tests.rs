//! Gradients of the rows of connections, compared with differences in double-double arithmetic.

use super::super::rows::ConnectionRows;
use super::RowGradients;
use crate::kinematics::placements_base_to_tip;
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real};
use crate::scene::{Connection, ConnectionKind, Inertial, JointDescription, JointKind, LinkDescription};
use crate::scene::{Scene, SceneBuilder};
use crate::scenes::draw::Draw;
use crate::spatial::{RigidShift, Symmetric3};
use crate::workspace::Workspace;
use nalgebra::Vector3;

/// A floating robot with every kind of joint, and connections of every kind between its branches and to the world.
fn scene() -> Scene {
    let mut random = Draw::new(3);
    let central = Symmetric3::new([0.04, 0.0, 0.0, 0.05, 0.0, 0.03]);
    let inertial = || Inertial { mass: 1.0, center: Vector3::zeros(), central };
    let kinds = [
        JointKind::Spherical,
        JointKind::Revolute,
        JointKind::Prismatic,
        JointKind::Screw { pitch: 0.2 },
        JointKind::Planar,
        JointKind::Revolute,
    ];
    let mut vector = |size: f64| Vector3::from_fn(|_, _| size * random.uniform(-1.0, 1.0));
    let mut builder = SceneBuilder::new()
        .floating_base(true)
        .link(LinkDescription { name: "base".into(), inertial: Some(inertial()) });
    for (k, kind) in kinds.into_iter().enumerate() {
        let parent = if k < 2 { "base".to_owned() } else { format!("l{}", k - 2) };
        let mut joint = JointDescription::new(format!("j{k}"), kind, parent, format!("l{k}"));
        joint.origin.lever = vector(0.4);
        joint.axis = vector(1.0);
        builder = builder.link(LinkDescription { name: format!("l{k}"), inertial: Some(inertial()) }).joint(joint);
    }
    for (i, (kind, link, other)) in [
        (ConnectionKind::Point, "l5", Some("l4")),
        (ConnectionKind::Weld, "l4", None),
        (ConnectionKind::Axis(Vector3::z()), "l2", Some("l0")),
        (ConnectionKind::Distance(Some(0.7)), "l3", Some("l5")),
    ]
    .into_iter()
    .enumerate()
    {
        let mut connection = Connection::new(format!("c{i}"), kind, link, other);
        connection.frame.lever = vector(0.3);
        connection.other_frame = Some(RigidShift { lever: vector(0.3), ..RigidShift::identity() });
        builder = builder.connect(connection);
    }
    builder.build().expect("a scene")
}

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
            gradients.add_acceleration_gradient(system, &shifts, (&q, &qd, &qdd), &r, out).expect("gradients");
        } else {
            gradients.add_row_gradient(system, &shifts, (&q, &qdd), &r, &mut by_q).expect("gradients");
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
