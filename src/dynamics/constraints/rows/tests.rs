//! G of each kind of row on every scalar, compared with dense algebra.

use super::ConnectionRows;
use crate::dynamics::sweeps::{SweepModel, SweepScratch, general};
use crate::model::Model;
use crate::scalar::{DoubleDouble, Real, Traced};
use crate::scene::{Connection, ConnectionKind, Inertial, JointDescription, JointKind, LinkDescription, Polynomial};
use crate::scene::{Scene, SceneBuilder};
use crate::scenes::draw::Draw;
use crate::spatial::{RigidShift, Symmetric3};
use nalgebra::{DMatrix, Vector3};

/// A floating robot with every kind of joint, with origins and axes of this generator.
pub(in crate::dynamics) fn robot(vector: &mut impl FnMut(f64) -> Vector3<f64>) -> SceneBuilder {
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
    builder
}

/// A floating robot with every kind of joint, and connections of every kind between its branches and to the world.
pub(in crate::dynamics::constraints) fn scene() -> Scene {
    let mut random = Draw::new(3);
    let mut vector = |size: f64| Vector3::from_fn(|_, _| size * random.uniform(-1.0, 1.0));
    let mut builder = robot(&mut vector);
    for (i, (kind, link, other)) in [
        (ConnectionKind::Point, "l5", Some("l4")),
        (ConnectionKind::Weld, "l4", None),
        (ConnectionKind::Axis(Vector3::z()), "l2", Some("l0")),
        (ConnectionKind::Distance(Some(0.7)), "l3", Some("l5")),
        (ConnectionKind::Point, "l3", None),
        (ConnectionKind::Joint(Polynomial::new([0.1, 0.5, -0.7, 0.4, 0.3])), "j5", Some("j1")),
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

/// G at `q` on a scalar, whose lanes have the same state.
fn gram<T: Real>(scene: &Scene, sweeps: &SweepModel<T>, q: &[f64]) -> DMatrix<f64> {
    let (model, constraints): (Model<T>, _) = (scene.model().cast(), scene.constraints());
    let mut scratch = SweepScratch::new(&model, sweeps);
    let mut rows = ConnectionRows::new((&model, sweeps), constraints);
    let q: Vec<T> = q.iter().map(|&q| T::from_f64(q)).collect();
    general::factor((&model, sweeps), &mut scratch, &q);
    rows.whiten((&model, sweeps), &scratch, (&q, &vec![T::zero(); model.nv()]), [T::from_f64(f64::INFINITY); 2]);
    let m = constraints.rows;
    DMatrix::from_fn(m, m, |i, j| {
        let entry = rows.whitened.gram[i.max(j) * m + i.min(j)];
        assert!((0..T::LANES).all(|lane| entry.lane(lane).to_bits() == entry.lane(0).to_bits()));
        entry.lane(0)
    })
}

#[test]
fn rows_of_every_kind_have_the_same_gram_matrix_on_every_scalar() {
    let scene = scene();
    let (model, nv, m) = (scene.model(), scene.nv(), scene.constraint_rows());
    let mut random = Draw::new(7);
    let along: Vec<f64> = (0..nv).map(|_| random.uniform(-0.2, 0.2)).collect();
    let mut q = scene.neutral();
    scene.integrate(&scene.neutral(), &along, &mut q).expect("a configuration");
    let (mut workspace, mut scratch) = (scene.workspace(), scene.constraint_scratch());
    let (mut mass, mut jacobian) = (vec![f64::NAN; nv * nv], vec![f64::NAN; m * nv]);
    scene.mass_matrix(&mut workspace, &q, &mut mass).expect("M");
    scene.constraint_jacobian(&mut workspace, &mut scratch, &q, &mut jacobian).expect("J");
    let factor = DMatrix::from_row_slice(nv, nv, &mass).cholesky().expect("positive definite");
    let jacobian = DMatrix::from_row_slice(m, nv, &jacobian);
    let expected = &jacobian * factor.solve(&jacobian.transpose());
    let (traced, _) = Traced::counted(|| gram::<Traced>(&scene, &SweepModel::new(model), &q));
    #[allow(unused_mut)] // without lanes
    let mut all = vec![
        ("one state, in the frames of the bodies", gram::<f64>(&scene, &SweepModel::general(model), &q)),
        ("one state, in the frames of the kernels", gram::<f64>(&scene, &SweepModel::new(model), &q)),
        ("double-double", gram::<DoubleDouble>(&scene, &SweepModel::general(&model.cast()), &q)),
        ("traced", traced),
    ];
    #[cfg(all(target_arch = "x86_64", feature = "lanes"))]
    if pulp::x86::V3::try_new().is_some() {
        all.push(("lanes", gram::<crate::scalar::Lanes<pulp::x86::V3>>(&scene, &SweepModel::new(model), &q)));
    }
    for (scalar, found) in &all {
        let off = (found - &expected).amax();
        assert!(off <= 1e-12 * expected.amax(), "{scalar}: {off:.1e}");
    }
}
