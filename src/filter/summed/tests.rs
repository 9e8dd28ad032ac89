//! Estimates of systems with rows measured in sums, compared with dense algebra: (G^T M G)^-1 G^T with M = H phi Q phi*
//! H* + r.

use super::{SummedFactor, Sums};
use crate::filter::pivots::Scale;
use crate::filter::{HingeMap, Rows, Stage, System};
use crate::spatial::{RigidShift, Symmetric3, Symmetric6};
use nalgebra::{DMatrix, DVector, Matrix6, Rotation3, Vector3, Vector6};

/// Pseudorandom values.
fn numbers(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        #[allow(clippy::cast_precision_loss)] // 31 bits
        let unit = (state >> 33) as f64 / f64::from(1_u32 << 30);
        unit - 1.0
    }
}

struct Case {
    system: System<f64>,
    shift: Vec<RigidShift<f64>>,
    noise: Vec<Symmetric6<f64>>,
    measurement: Vec<f64>,
    bias: Vec<Vector6<f64>>,
}

fn case(parents: &[Option<usize>], rows: &[Rows<f64>], seed: u64) -> Case {
    let mut next = numbers(seed);
    let mut stages = Vec::new();
    let mut first_row = 0;
    for (&parent, &rows) in parents.iter().zip(rows) {
        stages.push(Stage { parent, rows, first_row });
        first_row += rows.count();
    }
    let mut vector = || Vector3::new(next(), next(), next());
    let shift = parents
        .iter()
        .map(|_| RigidShift { rotation: *Rotation3::new(vector() * 2.0).matrix(), lever: vector() })
        .collect();
    let noise = parents
        .iter()
        .map(|_| {
            let root = Matrix6::from_fn(|_, _| vector()[0]);
            let full = root * root.transpose() + Matrix6::identity() * 0.1;
            Symmetric6 {
                angular: Symmetric3::from_upper(&full.fixed_view::<3, 3>(0, 0).into_owned()),
                coupling: full.fixed_view::<3, 3>(0, 3).into_owned(),
                linear: Symmetric3::from_upper(&full.fixed_view::<3, 3>(3, 3).into_owned()),
            }
        })
        .collect();
    let bias = parents.iter().map(|_| Vector6::from_fn(|_, _| vector()[1])).collect();
    let armature = (0..first_row).map(|_| vector()[2].abs() * 0.1).collect();
    let measurement = (0..first_row).map(|_| vector()[0]).collect();
    Case { system: System { stages, noise: armature }, shift, noise, measurement, bias }
}

/// By dense algebra: a = G (G^T M G)^-1 G^T (tau - H phi b).
fn dense(case: &Case, sums: &[Vec<(usize, f64)>]) -> DVector<f64> {
    let Case { system, shift, noise, measurement, bias } = case;
    let (n, rows) = (system.stages.len(), system.rows());
    let mut phi = DMatrix::<f64>::zeros(6 * n, 6 * n);
    let mut h = DMatrix::<f64>::zeros(rows, 6 * n);
    let mut q = DMatrix::<f64>::zeros(6 * n, 6 * n);
    let mut b = DVector::<f64>::zeros(6 * n);
    for k in 0..n {
        let mut carried = Matrix6::identity();
        let mut at = Some(k);
        while let Some(stage) = at {
            phi.view_mut((6 * stage, 6 * k), (6, 6)).copy_from(&carried);
            carried = shift[stage].to_matrix() * carried;
            at = system.stages[stage].parent;
        }
        for i in 0..system.stages[k].rows.count() {
            let row = system.stages[k].rows.row(i).to_column();
            h.view_mut((system.stages[k].first_row + i, 6 * k), (1, 6)).copy_from(&row.transpose());
        }
        q.view_mut((6 * k, 6 * k), (6, 6)).copy_from(&noise[k].to_matrix());
        b.rows_mut(6 * k, 6).copy_from(&bias[k]);
    }
    let m = &h * &phi * q * phi.transpose() * h.transpose()
        + DMatrix::from_diagonal(&DVector::from_row_slice(&system.noise));
    let in_sums: Vec<usize> = sums.iter().flatten().map(|&(row, _)| row).collect();
    let alone: Vec<usize> = (0..rows).filter(|row| !in_sums.contains(row)).collect();
    let mut g = DMatrix::<f64>::zeros(rows, alone.len() + sums.len());
    for (column, &row) in alone.iter().enumerate() {
        g[(row, column)] = 1.0;
    }
    for (s, members) in sums.iter().enumerate() {
        for &(row, weight) in members {
            g[(row, alone.len() + s)] = weight;
        }
    }
    let right = g.transpose() * (DVector::from_row_slice(measurement) - h * phi * b);
    let reduced = g.transpose() * m * &g;
    g * reduced.lu().solve(&right).expect("positive definite")
}

fn estimates(case: &Case, sums: &[Vec<(usize, f64)>]) -> Vec<f64> {
    let Case { system, shift, noise, measurement, bias } = case;
    let sums = Sums::new(system, sums);
    let mut factor = SummedFactor::new(system, &sums);
    let (p, scale) = factor.noise();
    p.copy_from_slice(noise);
    scale.fill(Scale::filled(10.0));
    let seen = factor.factorise(system, &sums, shift);
    assert!(seen.lost.clear(0));
    assert!(factor.lost_pivot(system, &sums, shift, &seen, |_| Vector6::repeat(1.0)).is_none());
    let mut found = vec![f64::NAN; system.rows()];
    factor.solve(system, &sums, shift, measurement, &mut bias.clone(), &mut found);
    found
}

fn assert_as_dense(case: &Case, sums: &[Vec<(usize, f64)>]) {
    let (found, expected) = (DVector::from_vec(estimates(case, sums)), dense(case, sums));
    let error = (&found - &expected).amax();
    assert!(error < 1e-11 * expected.amax(), "{error:e} of {:e}, sums {sums:?}", expected.amax());
}

const Z: Rows<f64> = Rows::One(HingeMap::Axis(2));
const SLIDE: Rows<f64> = Rows::One(HingeMap::Axis(5));
const SCREW: Rows<f64> = Rows::One(HingeMap::Screw(0.3));

#[test]
fn without_sums_it_is_the_filter() {
    let case = case(&[None, Some(0), Some(1), Some(0)], &[Rows::Six, Z, SCREW, Rows::Angular], 3);
    assert_as_dense(&case, &[]);
}

#[test]
fn rows_of_one_branch() {
    for seed in 0..8 {
        let case = case(&[None, Some(0), Some(1), Some(2), Some(3)], &[Z, Z, SLIDE, SCREW, Z], seed);
        assert_as_dense(&case, &[vec![(1, 1.0), (3, -2.5)]]);
        assert_as_dense(&case, &[vec![(1, 1.0), (2, 0.5), (4, -1.0)]]);
        assert_as_dense(&case, &[vec![(0, 1.0), (2, 0.5)], vec![(1, 1.0), (4, 2.0)]]);
        assert_as_dense(&case, &[vec![(0, 1.0), (4, 0.5)], vec![(1, 1.0), (3, 2.0)]]);
    }
}

#[test]
fn rows_of_several_branches() {
    let parents = [None, Some(0), Some(1), Some(1), Some(3), Some(0), Some(5), None, Some(7)];
    let rows = [Rows::Six, Z, Z, SLIDE, Z, SCREW, Rows::Angular, Z, Z];
    for seed in 0..8 {
        // Rows: 0-5 of the free stage, 6, 7, 8, 9, 10 (screw), 11-13, 14, 15.
        let case = case(&parents, &rows, seed);
        assert_as_dense(&case, &[vec![(7, 1.0), (9, -1.0)]]);
        assert_as_dense(&case, &[vec![(7, 1.0), (8, 1.5), (10, -1.0)]]);
        assert_as_dense(&case, &[vec![(6, 1.0), (10, 2.0)], vec![(7, 1.0), (9, 0.7)]]);
        assert_as_dense(&case, &[vec![(7, 1.0), (10, 2.0)], vec![(8, 1.0), (9, 0.7)]]);
        // Over two roots: complete at the base.
        assert_as_dense(&case, &[vec![(9, 1.0), (15, -0.4)]]);
        assert_as_dense(&case, &[vec![(9, 1.0), (15, -0.4)], vec![(8, 1.0), (14, 3.0)], vec![(6, 1.0), (7, 1.0)]]);
    }
}

#[test]
fn a_weight_of_zero_holds_a_row() {
    let case = case(&[None, Some(0), Some(1)], &[Z, Z, Z], 5);
    let sums = [vec![(0, 1.0), (1, 0.0)]];
    assert_as_dense(&case, &sums);
    assert!(estimates(&case, &sums)[1] == 0.0);
}

#[test]
fn a_sum_without_variance_is_lost() {
    let mut case = case(&[None, Some(0), Some(0)], &[Z, Z, Z], 5);
    // Zero at the two rows that are measured together.
    for k in 1..3 {
        case.noise[k] = Symmetric6::zero();
        case.system.noise[k] = 0.0;
    }
    let sums = Sums::new(&case.system, &[vec![(1, 1.0), (2, -1.0)]]);
    let mut factor = SummedFactor::new(&case.system, &sums);
    let (p, scale) = factor.noise();
    p.copy_from_slice(&case.noise);
    scale.fill(Scale::filled(10.0));
    let seen = factor.factorise(&case.system, &sums, &case.shift);
    let lost = factor.lost_pivot(&case.system, &sums, &case.shift, &seen, |_| Vector6::repeat(1.0));
    assert_eq!(lost.map(|lost| lost.row), Some(2));
}
