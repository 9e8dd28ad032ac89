//! Introduction and section 1 of the paper: the random model. One test per equation.

use crate::common::filter;
use crate::common::matrices::{Matrix, Vector, apply, block, swept};
use crate::common::paper::{self, Case, cases, column, six, trees};
use crate::common::sampling::{DRAWS, covariance, drawn, has_covariance, has_mean};
use crate::common::{Random, tolerance};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use phipsi::operators::{Kind, Operator};
use phipsi::spatial::{BodyInertia, RigidShift, Symmetric3, spatial};

/// Five point masses, from the definition of kinetic energy: their spatial inertia about the origin, and their
/// moments.
fn point_masses(random: &mut Random) -> (Matrix6<f64>, f64, Vector3<f64>, Matrix3<f64>) {
    let points: Vec<(f64, Vector3<f64>)> = (0..5).map(|_| (random.uniform(0.1, 2.0), random.vector())).collect();
    let mass: f64 = points.iter().map(|(m, _)| m).sum();
    let center = points.iter().map(|(m, r)| *r * *m).sum::<Vector3<f64>>() / mass;
    let mut spatial_inertia = Matrix6::zeros();
    let mut central = Matrix3::zeros();
    for (m, r) in &points {
        // The velocity of a point at r is w x r + v: the columns are the contributions of the components of (w, v).
        let velocity = nalgebra::Matrix3x6::from_fn(|i, j| {
            if j < 3 { Vector3::ith(j, 1.0).cross(r)[i] } else { f64::from(u8::from(i == j - 3)) }
        });
        spatial_inertia += velocity.transpose() * velocity * *m;
        let arm = r - center;
        central += (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose()) * *m;
    }
    (spatial_inertia, mass, center, central)
}

#[test]
fn eq_0_1_spatial_inertia() {
    let mut random = Random::new(1);
    for _ in 0..20 {
        let (expected, mass, center, central) = point_masses(&mut random);
        let body = BodyInertia::from_central(mass, &center, &Symmetric3::from_upper(&central));
        let found = body.to_symmetric().to_matrix();
        let scale = tolerance::size(expected.as_slice());
        tolerance::assert_near("M(k)", found.as_slice(), expected.as_slice(), tolerance::product(30, scale));
        let motion = Vector6::from_fn(|_, _| random.uniform(-1.0, 1.0));
        let (product, force) = (expected * motion, body.mul_motion(&motion));
        tolerance::assert_near("M(k) v", force.as_slice(), product.as_slice(), tolerance::product(30, scale));
        // Printed with the identity as its lower right block.
        let mut printed = expected;
        printed.fixed_view_mut::<3, 3>(3, 3).copy_from(&Matrix3::identity());
        let off = (printed - expected).amax() / expected.amax();
        assert!(off > tolerance::PRINTED_FORM_MARGIN, "the printed M(k) is off by {off:e} only");
    }
}

#[test]
fn eq_0_2_transition_matrix() {
    let mut random = Random::new(2);
    for _ in 0..20 {
        let lever = random.vector();
        let plain = RigidShift { rotation: Matrix3::identity(), lever };
        let turned = RigidShift { rotation: random.rotation(), lever };
        for j in 0..6 {
            let unit = Vector6::ith(j, 1.0);
            let (moment, force) = (Vector3::new(unit[0], unit[1], unit[2]), Vector3::new(unit[3], unit[4], unit[5]));
            // A force at the origin of the child, about that of the parent: its moment increases by L x f.
            for shift in [&plain, &turned] {
                let (n, f) = (shift.rotation * moment, shift.rotation * force);
                let expected = spatial(&(n + lever.cross(&f)), &f);
                let by_matrix = shift.to_matrix() * unit;
                let bound = tolerance::product(6, 1.0);
                tolerance::assert_near("phi as a matrix", by_matrix.as_slice(), expected.as_slice(), bound);
                tolerance::assert_near("phi", shift.force_to_parent(&unit).as_slice(), expected.as_slice(), bound);
                let transposed = shift.to_matrix().transpose() * unit;
                tolerance::assert_near("phi*", shift.motion_to_child(&unit).as_slice(), transposed.as_slice(), bound);
            }
        }
        let printed = Matrix6::from_fn(|i, j| match (i < 3, j < 3) {
            (true, false) => Vector3::cross(&lever, &Vector3::ith(j - 3, 1.0))[i],
            _ => f64::from(u8::from(i == j)),
        });
        let found = plain.to_matrix();
        tolerance::assert_near("[[U, L~], [0, U]]", found.as_slice(), printed.as_slice(), tolerance::product(6, 1.0));
    }
}

/// Forces on each body, the total forces from `predict`, and the torques.
fn predicted(case: &Case, w: &[Vector6<f64>]) -> (Vec<Vector6<f64>>, Vector) {
    let (mut z, mut torque) = (w.to_vec(), vec![f64::NAN; case.nv()]);
    filter::predict(&case.scene.model().system, &case.sweep.shift, &mut z, &mut torque);
    (z, Vector::from_vec(torque))
}

fn random_forces(case: &Case, seed: u64) -> Vec<Vector6<f64>> {
    let mut random = Random::new(seed);
    case.scene.model().bodies.iter().map(|_| Vector6::from_fn(|_, _| random.uniform(-1.0, 1.0))).collect()
}

#[test]
fn eq_1_1_forces_add_up_inward() {
    for case in cases() {
        let w = random_forces(case, 11);
        let (z, _) = predicted(case, &w);
        let stages = &case.scene.model().system.stages;
        let expected: Vec<Vector6<f64>> = (0..w.len())
            .map(|k| {
                let of_children = (0..w.len()).filter(|&c| stages[c].parent == Some(k));
                w[k] + of_children.map(|c| case.sweep.shift[c].to_matrix() * z[c]).sum::<Vector6<f64>>()
            })
            .collect();
        case.holds_directly("z^-(k)", &column(&case.stacked(&z)), &column(&case.stacked(&expected)));
        let dense = &case.d.phi * case.stacked(&w);
        case.holds_directly("X = phi W", &column(&case.stacked(&z)), &column(&case.stacked(&case.outermost(&dense))));
    }
}

#[test]
fn eq_1_2_force_is_continuous_across_a_joint() {
    for case in cases() {
        let w = random_forces(case, 12);
        let (z, _) = predicted(case, &w);
        let mut states = vec![f64::NAN; 6 * case.nv()];
        case.factor.operator(Kind::Phi).apply(case.stacked(&w).as_slice(), &mut states);
        // All rows of a joint, outermost to innermost, transmit the same force.
        let states = Vector::from_vec(states);
        for (stage, z) in case.scene.model().system.stages.iter().zip(&z) {
            for i in 0..stage.rows.count() {
                let (row, bound) = (stage.first_row + i, tolerance::product(case.nv(), states.amax()));
                tolerance::assert_near("z^+ = z^-", six(&states, row).as_slice(), z.as_slice(), bound);
            }
        }
        // A measurement changes the estimate: A is not the identity.
        case.fails("A = 1", &case.one(), &case.f.a);
    }
}

#[test]
fn eq_1_3_bias_and_inertia_are_mean_and_covariance() {
    for (case, draws) in drawn() {
        // b(k), compared with the bias torque of the crate.
        let b = case.bias();
        let mut torque = vec![f64::NAN; case.nv()];
        case.scene.bias_torque(&mut case.scene.workspace(), &case.q, &case.qd, &mut torque).unwrap();
        let torque = Vector::from_vec(torque);
        let terms = column(&(&case.d.h.abs() * case.d.phi.abs() * b.abs()));
        case.holds_among("H phi b", &column(&torque), &column(&(&case.d.h * &case.d.phi * &b)), &[&terms]);

        let w = Matrix::from_fn(b.len(), DRAWS, |i, j| draws.w[(i, j)] + b[i]);
        has_mean("w(k)", &w, b.as_slice(), &case.f.q);
        has_covariance("w(k) - b(k)", &covariance(&draws.w), &case.f.q);
    }
}

#[test]
fn eq_1_4_torque_is_force_along_the_axis() {
    for case in cases() {
        let w = random_forces(case, 14);
        let (z, torque) = predicted(case, &w);
        let mut states = vec![Vector6::zeros(); case.nv()];
        let model = case.scene.model();
        for (stage, z) in model.system.stages.iter().zip(&z) {
            states[stage.first_row..stage.first_row + stage.rows.count()].fill(*z);
        }
        let stacked = Vector::from_iterator(6 * case.nv(), states.iter().flatten().copied());
        case.holds_directly("tau = H x", &column(&torque), &column(&(&case.d.h * stacked)));
    }
}

#[test]
fn eq_1_5_composite_model() {
    for case in cases() {
        let w = case.stacked(&random_forces(case, 15));
        let (_, torque) = predicted(case, &case.outermost(&w));
        let (phi, h) = (case.factor.operator(Kind::Phi), case.factor.operator(Kind::H));
        let x = apply(&phi, &column(&w));
        case.holds_directly("X = phi W", &x, &column(&(&case.d.phi * &w)));
        case.holds_directly("T = H X", &apply(&h, &x), &column(&torque));
        case.holds_directly("T = H phi W", &apply(&h.compose(phi), &column(&w)), &column(&torque));
        case.holds_directly("H", &swept(&h), &case.d.h);
    }
}

#[test]
fn eq_1_6_noise_is_block_diagonal() {
    for (case, draws) in drawn() {
        let model = case.scene.model();
        let mut expected = Matrix::zeros(6 * case.nv(), 6 * case.nv());
        for (stage, body) in model.system.stages.iter().zip(&model.bodies) {
            let at = 6 * (stage.first_row + stage.rows.count() - 1);
            expected.view_mut((at, at), (6, 6)).copy_from(&body.inertia.to_symmetric().to_matrix());
        }
        case.holds_directly("Q = diag M(k)", &case.f.q, &expected);
        has_covariance("W - b", &covariance(&draws.w), &case.f.q);
    }
}

#[test]
fn eq_1_7_phi_is_causal() {
    for case in cases() {
        case.holds_directly("phi = (1 - E)^-1", &case.f.phi, &case.d.phi);
        case.holds_directly("E", &case.f.e, &case.d.e);
        for i in 0..case.nv() {
            for j in 0..case.nv() {
                let found = block(&case.f.phi, i, j);
                // Product of the shifts along the path inward from j, if i is on it; the identity for i = j.
                let mut expected = Matrix::identity(6, 6);
                let mut row = j;
                while row != i {
                    let Some(next) = case.inward[row] else {
                        expected.fill(0.0);
                        break;
                    };
                    expected = block(&case.d.e, next, row) * expected;
                    row = next;
                }
                let bound = tolerance::product(6 * case.nv(), 1.0f64.max(expected.amax()));
                tolerance::assert_near("phi(i,j)", found.as_slice(), expected.as_slice(), bound);
                if j < i {
                    assert!(found.iter().all(|&x| x == 0.0), "phi({i},{j}) is not causal");
                }
            }
        }
    }
}

#[test]
fn cases_are_what_their_names_say() {
    use phipsi::scene::JointKind;
    let kinds = |wanted: fn(&JointKind) -> bool| {
        let joints = |case: &Case| case.scene.joints().iter().any(|joint| wanted(&joint.kind));
        assert!(cases().iter().any(joints));
    };
    kinds(|kind| matches!(kind, JointKind::Revolute));
    kinds(|kind| matches!(kind, JointKind::Continuous));
    kinds(|kind| matches!(kind, JointKind::Prismatic));
    kinds(|kind| matches!(kind, JointKind::Screw { .. }));
    kinds(|kind| matches!(kind, JointKind::Planar));
    kinds(|kind| matches!(kind, JointKind::Spherical));
    kinds(|kind| matches!(kind, JointKind::Floating));
    let pairs = |case: &Case, meeting: bool| {
        (0..case.nv()).any(|i| (0..i).any(|j| case.apart(i, j) && case.meet(i, j).is_some() == meeting))
    };
    assert!(trees().count() >= 3 && paper::chains().count() >= 3);
    assert!(trees().any(|case| pairs(case, true) && case.has_armature()));
    assert!(trees().any(|case| pairs(case, true) && !case.has_armature()));
    assert!(trees().any(|case| pairs(case, false)));
    assert!(paper::chains().any(Case::has_armature) && paper::noise_free().count() >= 4);
    for case in cases() {
        assert!((3..=20).contains(&case.nv()), "{}: {} degrees of freedom", case.name, case.nv());
    }
}
