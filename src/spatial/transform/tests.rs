//! Compares every transform with 6x6 matrices.

use super::{
    Axes, Axial, AxialRotation, Axis, Base, ConstantRotation, ObliqueRotation, Offset, Order, Rotates, TERMS_SPREAD,
    Transform,
};
use super::{about, packed, unpacked};
use crate::spatial::{BodyInertia, RigidShift, Root6, RootColumns, Symmetric3, Symmetric6};
use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3, Vector6};

fn wave(i: usize) -> f64 {
    (1.7 * f64::from(u8::try_from(i).expect("small")) + 0.3).sin()
}

/// True if all entries agree to rounding, relative to the largest.
fn near(found: &[f64], expected: &[f64]) -> bool {
    let size = expected.iter().fold(1.0_f64, |size, x| size.max(x.abs()));
    found.len() == expected.len()
        && found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= 64.0 * f64::EPSILON * size)
}

/// L with its unit diagonal, in the order of matrices (angular first).
fn root_matrix(root: &Root6<f64>) -> Matrix6<f64> {
    let entry = |i: usize, j: usize| match i.cmp(&j) {
        std::cmp::Ordering::Less => 0.0,
        std::cmp::Ordering::Equal => root.weights[j].sqrt(),
        std::cmp::Ordering::Greater => root.rows[i][j] * root.weights[j].sqrt(),
    };
    Matrix6::from_fn(|i, j| entry((i + 3) % 6, j))
}

/// True if every operation of a transform equals that of phi, alone and added to a sum.
pub(super) fn check(transform: &impl Transform<f64>, phi: &Matrix6<f64>) {
    let z = Vector6::from_fn(|i, _| wave(i));
    let there: [f64; 6] = std::array::from_fn(|i| wave(i + 6));
    for begins in [true, false] {
        let kept = if begins { 0.0 } else { 1.0 };
        let mut sum = there;
        transform.send_force(z.as_ref(), begins, &mut sum);
        assert!(near(&sum, (phi * z + Vector6::from(there) * kept).as_slice()), "force, {begins}");
        let p: [f64; 21] = std::array::from_fn(|i| wave(i + 20));
        let before: [f64; 21] = std::array::from_fn(|i| wave(i + 50));
        let mut sum = before;
        transform.send_covariance(&p, begins, &mut sum);
        let expected = phi * unpacked(&p).to_matrix() * phi.transpose() + unpacked(&before).to_matrix() * kept;
        assert!(near(unpacked(&sum).to_matrix().as_slice(), expected.as_slice()), "covariance, {begins}");
    }
    let lambda = transform.carry_motion(z.as_ref());
    assert!(near(&lambda, (phi.transpose() * z).as_slice()), "motion");
    let offset = Matrix3::from(phi.fixed_view::<3, 3>(0, 3)) * Matrix3::from(phi.fixed_view::<3, 3>(3, 3)).transpose();
    let square = 0.5 * offset.norm_squared();
    assert!((transform.offset_square() - square).abs() <= 16.0 * f64::EPSILON * (1.0 + square), "the offset");
    let r = BodyInertia {
        mass: 2.5,
        first_moment: Vector3::from_fn(|i, _| wave(i + 80)),
        rotational: Symmetric3::new(std::array::from_fn(|i| wave(i + 90))),
    };
    let sent = transform.composite_to_parent(&r).to_symmetric().to_matrix();
    assert!(near(sent.as_slice(), (phi * r.to_symmetric().to_matrix() * phi.transpose()).as_slice()), "composite");
    let root = Root6 {
        weights: std::array::from_fn(|i| 1.0 + wave(i + 100).abs()),
        rows: std::array::from_fn(|i| std::array::from_fn(|j| wave(6 * i + j + 110))),
    };
    let mut columns = RootColumns::filled(f64::NAN);
    transform.root_to_parent(&root, &mut columns);
    let column = |i: usize, j: usize| {
        let is_left_out = (i + 3) % 6 < 3 && j >= 3;
        if is_left_out { 0.0 } else { columns.rows[(i + 3) % 6][j] * columns.weights[j].sqrt() }
    };
    let found = Matrix6::from_fn(column);
    let root = phi * root_matrix(&root);
    assert!(near((found * found.transpose()).as_slice(), (root * root.transpose()).as_slice()), "root");
}

/// Every diagonal entry is at most its bound, and the bounds are not far above the largest possible entry.
#[allow(clippy::disallowed_methods)] // square
fn check_terms(transform: &impl Transform<f64>, phi: &Matrix6<f64>, seed: u8) {
    #[allow(clippy::cast_precision_loss)] // small indices
    let wave = |of: f64, i: usize| (1.0 + 7.3 * (of + f64::from(seed)) + 2.9 * i as f64).sin();
    let root = Matrix6::from_fn(|i, j| wave(0.0, 6 * i + j) * 10_f64.powf(3.0 * wave(1000.0, j)));
    let p = root * root.transpose();
    let (sent, mut bound) = ((phi * p * phi.transpose()).diagonal(), [f64::NAN; 6]);
    transform.send_terms(p.diagonal().as_ref(), true, &mut bound);
    for i in 0..6 {
        assert!(sent[i] <= bound[i], "{seed} {i}: {} {}", sent[i], bound[i]);
    }
    let most = TERMS_SPREAD * 3.0 * (p.trace() * (1.0 + 2.0 * transform.offset_square()));
    assert!(Vector6::from(bound).max() <= most, "{seed}: {bound:?} {most}");
}

/// phi for a rotation and an offset in the parent frame.
fn phi(rotation: Matrix3<f64>, lever: Vector3<f64>) -> Matrix6<f64> {
    RigidShift { rotation, lever }.to_matrix()
}

fn check_axial<R: Rotates<f64>, A: Axes>(rotation: R, axes: A, matrix: &Matrix3<f64>, names: &Matrix3<f64>, seed: u8) {
    for l in [Vector3::new(0.3, -0.5, 0.2), Vector3::zeros()] {
        let transform = Axial::new(rotation, axes, &Offset::new(l.into(), |x| x));
        let phi = phi(names * matrix, names * l);
        check(&transform, &phi);
        check(&transform.spread(0.0), &phi);
        check_terms(&transform, &phi, seed);
    }
}

/// A revolute joint about each axis of its parent, with known and looked-up permutations, and about oblique axes.
#[test]
fn a_revolute_joint_carries_what_its_matrix_does() {
    let turn = AxialRotation { s: 0.28, c: 0.96 };
    let about_z = Matrix3::new(0.96, -0.28, 0.0, 0.28, 0.96, 0.0, 0.0, 0.0, 1.0);
    for (seed, axis) in (0..).zip([Axis::X, Axis::Y, Axis::Z]) {
        let names = axis.rotation();
        check_axial(turn, axis, &about_z, &names, seed);
        about!(axis, X, Y, Z, check_axial(turn, Order::<X, Y, Z>, &about_z, &names, seed + 10));
    }
    for (seed, (direction, axis, in_plane)) in (20..).zip([
        (Vector3::new(0.0, -0.6, 0.8), 2, true),
        (Vector3::new(-0.6, 0.0, 0.8), 0, true),
        (Vector3::new(1e-5, 1.0, 0.0).normalize(), 0, true),
        (Vector3::new(0.6, -0.64, -0.48), 0, false),
        (Vector3::new(0.6, -0.64, -0.48), 1, false),
        (Vector3::new(0.6, -0.64, -0.48), 2, false),
    ]) {
        let constant = ConstantRotation::to(&direction, Axis::new(axis), in_plane);
        let rotation = ObliqueRotation::new(turn, &constant);
        check_axial(rotation, Order::<0, 1, 2>, &(constant.matrix() * about_z), &Matrix3::identity(), seed);
    }
}

/// A part that vanishes about an oblique axis close to y of the parent has a small bound.
#[test]
fn what_is_small_about_an_oblique_axis_is_seen_to_be() {
    let constant = ConstantRotation::to(&Vector3::new(1e-5, 1.0, 0.0).normalize(), Axis::Y, true);
    let rotation = ObliqueRotation::new(AxialRotation { s: 0.6, c: 0.8 }, &constant);
    let transform = Axial::new(rotation, Order::<0, 1, 2>, &Offset::new([0.0; 3], |x| x));
    let mut bound = [f64::NAN; 6];
    transform.send_terms(&[1.0, 1.0, 0.0, 1.0, 1.0, 0.0], true, &mut bound);
    assert!(bound[1] < 1e-8 && bound[4] < 1e-8 && bound[0] >= TERMS_SPREAD, "{bound:?}");
}

#[test]
fn any_joint_carries_what_its_matrix_does() {
    for seed in 0..40 {
        let turn = Vector3::from_fn(|i, _| 3.0 * wave(usize::from(seed) + 10 * i));
        let lever = Vector3::from_fn(|i, _| 10_f64.powf(wave(usize::from(seed) + i)) * wave(usize::from(seed) + 7 * i));
        let shift = RigidShift { rotation: *Rotation3::new(turn).matrix(), lever };
        check(&shift, &shift.to_matrix());
        check_terms(&shift, &shift.to_matrix(), seed);
    }
}

/// Nothing is propagated to or from the base.
#[test]
fn the_base_takes_and_gives_nothing() {
    let (mut force, mut p, mut terms) = ([1.0; 6], [2.0; 21], [3.0; 6]);
    let base = Base(0.0_f64);
    base.send_force(&[7.0; 6], false, &mut force);
    base.send_covariance(&[7.0; 21], false, &mut p);
    base.send_terms(&[7.0; 6], false, &mut terms);
    assert_eq!((force, p, terms), ([1.0; 6], [2.0; 21], [3.0; 6]));
    assert_eq!((base.carry_motion(&[7.0; 6]), base.offset_square()), ([0.0; 6], 0.0));
}

/// The two layouts of a covariance are equivalent.
#[test]
fn a_covariance_is_packed_and_unpacked() {
    let p: [f64; 21] = std::array::from_fn(wave);
    let whole: Symmetric6<f64> = unpacked(&p);
    assert!(packed(&whole).iter().zip(p).all(|(found, given)| found.to_bits() == given.to_bits()));
}
