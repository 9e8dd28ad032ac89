//! G of many contacts on few joints as sparse rows: products, factors and solutions are those of the dense matrix.

use super::{Draw, breach, in_the_cones};
use crate::contact::band::{Band, narrow};
use crate::contact::gram::Factor;
use crate::contact::{Cone, Effort, Gram, Limits, RowPattern};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use std::sync::Arc;

/// Contacts between adjacent links of a row of bodies with `dofs` joints each, `each` per pair, in a shuffled order.
fn row_of_bodies(draw: &mut Draw, (bodies, dofs, each): (usize, usize, usize)) -> Gram {
    let (mut contacts, mut entries) = (Vec::new(), Vec::new());
    let shuffled = |k: usize| (k * 7 + 3) % bodies;
    for k in 0..bodies {
        for _ in 0..each {
            let mut columns: Vec<usize> = (dofs * shuffled(k)..dofs * shuffled(k) + dofs).collect();
            if k + 1 < bodies {
                columns.extend(dofs * shuffled(k + 1)..dofs * shuffled(k + 1) + dofs);
            }
            entries.push(columns.iter().map(|_| Vector3::from_fn(|_, _| draw.next())).collect());
            contacts.push(columns);
        }
    }
    Gram::of_rows(&Arc::new(RowPattern::of_many(contacts).unwrap()), entries)
}

fn vector(draw: &mut Draw, len: usize) -> DVector<f64> {
    DVector::from_fn(len, |_, _| draw.next())
}

fn difference(a: &DVector<f64>, b: &DVector<f64>) -> f64 {
    (a - b).amax() / b.amax()
}

#[test]
fn a_band_is_solved_as_its_dense_matrix() {
    let mut draw = Draw(3);
    for (size, band) in [(1, 0), (7, 2), (40, 5), (12, 11), (30, 0)] {
        let mut dense = DMatrix::identity(size, size);
        let mut matrix = Band::identity(size, band);
        for i in 0..size {
            for j in i.saturating_sub(band)..(i + band + 1).min(size) {
                // Small entries on the diagonal, so that rows are exchanged.
                let value = if i == j { -1.0 + 1e-3 * draw.next() } else { draw.next() };
                dense[(i, j)] += value;
                matrix.add(i, j, value);
            }
        }
        let right = vector(&mut draw, size);
        let mut x = right.clone();
        assert!(matrix.factorize());
        matrix.solve(x.as_mut_slice());
        assert!((&dense * &x - &right).amax() < 1e-13 * dense.amax() * x.amax() * 40.0, "{size} {band}");
    }
    let mut singular = Band::identity(3, 1);
    singular.add(1, 1, -1.0);
    assert!(!singular.factorize());
}

#[test]
fn neighbors_in_a_row_are_next_to_each_other_in_the_band() {
    let groups: Vec<Vec<usize>> = (0..30).map(|k| vec![(k * 7 + 3) % 31, ((k + 1) * 7 + 3) % 31]).collect();
    let (order, band) = narrow(groups.iter().map(|of| &of[..]), 31);
    let mut sorted = order;
    sorted.sort_unstable();
    assert!(sorted.into_iter().eq(0..31) && band <= 2, "{band}");
    // Unknowns without a group, and two rows that are not coupled.
    let (order, band) = narrow([&[0, 2][..], &[5, 3]].into_iter(), 6);
    assert!(order.iter().collect::<std::collections::HashSet<_>>().len() == 6 && band == 1);
}

#[test]
fn products_and_factors_of_rows_are_those_of_the_matrix() {
    let mut draw = Draw(5);
    let sparse = row_of_bodies(&mut draw, (9, 3, 4));
    let m = sparse.len();
    let w = DVector::from_fn(m, |i, _| 1.0 + 0.1 * f64::from(u32::try_from(i / 3).unwrap()));
    for sparse in [sparse.clone(), sparse.softer(0.3), sparse.scaled(&w), sparse.softer(0.3).scaled(&w)] {
        let dense = Gram::from(sparse.dense().into_owned());
        let p = vector(&mut draw, m);
        assert!(difference(&sparse.times(&p), &dense.times(&p)) < 1e-14);
        for i in 0..m / 3 {
            assert!((sparse.diagonal(i) - dense.diagonal(i)).amax() < 1e-14 * dense.diagonal(i).amax());
        }
        // At least the terms of the matrix.
        let (mut sizes, mut least) = (DVector::zeros(m), DVector::zeros(m));
        sparse.add_sizes(&p, &mut sizes);
        dense.add_sizes(&p, &mut least);
        assert!(sizes.iter().zip(&least).all(|(size, least)| *size >= least * (1.0 - 1e-14) && *size < 1e3 * least));
        let block = |draw: &mut Draw| Matrix3::from_fn(|_, _| draw.next());
        for eps in [0.1, 1e-6] {
            let b: Vec<Matrix3<f64>> = (0..m / 3).map(|_| block(&mut draw) * 0.2 + Matrix3::identity()).collect();
            let none = Matrix3::zeros();
            let blocks: Vec<_> = b.into_iter().map(|b| (none, b)).collect();
            let [x, y] = [&sparse, &dense].map(|g| g.factor(&blocks, eps).and_then(|of| of.solve(&p)).unwrap());
            let residual = |x: &DVector<f64>| {
                let u = dense.times(x) + x * eps;
                let of = |i: usize| blocks[i].1 * u.fixed_rows::<3>(3 * i) - p.fixed_rows::<3>(3 * i);
                (0..m / 3).map(|i| of(i).amax()).fold(0.0, f64::max)
            };
            assert!(difference(&x, &y) < 1e-12 / eps && residual(&x) < 1e-11 / eps, "{eps} {}", residual(&x));
        }
    }
    let sparse = row_of_bodies(&mut draw, (9, 3, 4));
    assert!(matches!(
        sparse.factor(&vec![(Matrix3::identity(), Matrix3::identity()); m / 3], 0.0),
        Some(Factor::Rows { .. })
    ));
    assert!(sparse.factor(&vec![(Matrix3::zeros(), Matrix3::zeros()); m / 3], 0.0).is_none());
}

#[test]
fn many_contacts_on_few_joints_obey_the_law_as_on_the_matrix() {
    let mut others = 0;
    for seed in 0..40 {
        let mut draw = Draw(seed);
        let sparse = row_of_bodies(&mut draw, (8, 3, 4));
        let contacts = sparse.len() / 3;
        let friction: Vec<f64> = (0..contacts).map(|_| 0.5 * (draw.next() + 1.0)).collect();
        // Velocities in the range of G, as those of joints.
        let c = sparse.times(&vector(&mut draw, sparse.len()));
        let limits = Limits::beside(&c);
        let [own, other] = [sparse.clone(), sparse.dense().into_owned().into()].map(|g| {
            let cone = Cone::new(g, friction.clone());
            let (p, solved) = cone.impulses(&c, None, &limits, Effort::default());
            assert!(solved.converged && in_the_cones(&cone, &p, &limits.least), "{seed} {solved:?}");
            assert!(breach(&cone, &p, &c) < 1e-8, "{seed} {}", breach(&cone, &p, &c));
            let (q, solved) = cone.solve(&c, None, &limits, Effort::default());
            assert!(solved.converged && breach(&cone, &q, &c) < 1e-8, "{seed} {solved:?}");
            p
        });
        others += u32::from(!(difference(&sparse.times(&own), &sparse.times(&other)) < 1e-6));
    }
    // Contacts with friction can have several solutions.
    assert!(others <= 4, "{others}");
}
