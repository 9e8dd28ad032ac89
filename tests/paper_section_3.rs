//! Section 3 of the paper: sequential estimation, the Riccati recursion and the factors of M. One test per equation.
//!
//! With armature r the measurements are noisy and D = H P H* + r; all other equations are as printed unless stated.

use crate::common::matrices::{Matrix, block, inverse};
use crate::common::paper::{Case, cases, column, noise_free};
use crate::common::tolerance;
use nalgebra::DVector;
use phipsi::filter::HingeMap;
use phipsi::operators::dense::ldlt_from_tip;
use phipsi::spatial::{BodyInertia, Symmetric6};

/// Symmetric blocks, one per row, as a block diagonal matrix.
fn diagonal(blocks: &[Symmetric6<f64>]) -> Matrix {
    let mut matrix = Matrix::zeros(6 * blocks.len(), 6 * blocks.len());
    for (row, block) in blocks.iter().enumerate() {
        matrix.view_mut((6 * row, 6 * row), (6, 6)).copy_from(&block.to_matrix());
    }
    matrix
}

/// r(k) of every row by 3.5, where `start` multiplies the inertia of bodies without children.
fn composite_inertias(case: &Case, start: impl Fn(&BodyInertia<f64>) -> BodyInertia<f64>) -> Matrix {
    let model = case.scene.model();
    let stages = &model.system.stages;
    let is_tip = |k: usize| stages.iter().all(|stage| stage.parent != Some(k));
    let mut r: Vec<BodyInertia<f64>> = model.bodies.iter().map(|body| body.inertia).collect();
    for (k, stage) in stages.iter().enumerate().rev() {
        if is_tip(k) {
            r[k] = start(&r[k]);
        }
        if let Some(parent) = stage.parent {
            r[parent] = r[parent].add(&r[k].to_parent(&case.sweep.shift[k]));
        }
    }
    let rows = stages.iter().zip(&r).flat_map(|(stage, r)| std::iter::repeat_n(r.to_symmetric(), stage.rows.count()));
    diagonal(&rows.collect::<Vec<_>>())
}

/// Rows outboard of `row`, on any branch.
fn outboard(case: &Case, row: usize) -> Vec<usize> {
    (0..case.nv()).filter(|&other| other != row && case.meet(row, other) == Some(row)).collect()
}

/// cov(x(row)) given the measurements of `known`, by Gaussian conditioning.
fn conditional(case: &Case, row: usize, known: &[usize]) -> Matrix {
    let prior = block(&case.d.r, row, row);
    if known.is_empty() {
        return prior;
    }
    let with_torque = (&case.d.r * case.d.h.transpose()).rows(6 * row, 6).select_columns(known);
    let torques = case.d.m.select_rows(known).select_columns(known);
    prior - &with_torque * inverse(&torques) * with_torque.transpose()
}

#[test]
fn eq_3_1_mass_matrix_factors() {
    for case in cases() {
        let f = &case.f;
        let unit_factor = case.unit() + &f.k;
        case.holds_directly("(1 + K) D (1 + K*)", &(&unit_factor * &f.d * unit_factor.transpose()), &case.d.m);
        for j in 0..case.nv() {
            assert!((j..case.nv()).all(|i| f.k[(i, j)] == 0.0), "{}: K is not strictly causal", case.name);
        }
        // The unit factor is unique: that of faer.
        let m = faer::Mat::from_fn(case.nv(), case.nv(), |i, j| case.d.m[(i, j)]);
        let (unit, d) = ldlt_from_tip(&m).expect("a regular matrix");
        let unit = Matrix::from_fn(case.nv(), case.nv(), |i, j| unit[(i, j)]);
        case.holds("1 + K = faer's", &unit_factor, &unit);
        case.holds("D = faer's", &f.d, &Matrix::from_diagonal(&DVector::from_vec(d)));
    }
}

#[test]
fn eq_3_2_inverse_of_the_unit_factor() {
    for case in cases() {
        case.holds("(1 + K)^-1", &(case.unit() - &case.f.l), &inverse(&(case.unit() + &case.d.k)));
    }
}

#[test]
fn eq_3_3_inverse_of_the_mass_matrix() {
    for case in cases() {
        let (f, d) = (&case.f, &case.d);
        let whitened = case.unit() - &f.l;
        case.holds("(1 - L*) D^-1 (1 - L)", &(whitened.transpose() * &f.d_inv * &whitened), &inverse(&d.m));
        case.holds("M_inv by filter and smoother", &f.m_inv, &inverse(&d.m));
    }
}

#[test]
fn eq_3_4_state_covariance_from_composite_inertias() {
    for case in cases() {
        let (f, d) = (&case.f, &case.d);
        let r = composite_inertias(case, |own| *own);
        let whole = &r + &f.phi_strict * &r + &r * f.phi_strict.transpose();
        case.holds_directly("R = r + Phi r + r Phi*", &whole, &d.r);
        // The mass matrix of the crate is its projection.
        let mut m = vec![f64::NAN; case.nv() * case.nv()];
        case.scene.mass_matrix(&mut case.scene.workspace(), &case.q, &mut m).unwrap();
        let m = Matrix::from_row_slice(case.nv(), case.nv(), &m);
        case.holds_directly("M = H (r + Phi r + r Phi*) H* + r", &m, &(&d.h * &whole * d.h.transpose() + &case.noise));
        case.holds_directly("M = H R H* + r", &m, &d.m);
    }
}

#[test]
fn eq_3_5_composite_inertias() {
    for case in cases() {
        let expected = crate::common::matrices::block_diagonal(&case.d.r);
        case.holds_directly("r", &composite_inertias(case, |own| *own), &expected);
        // Printed r^-(k) = 0, which must be r^+(0) = 0: with r^-(1) = 0 the tip would be lost.
        case.fails("r^-(1) = 0", &composite_inertias(case, |_| BodyInertia::zero()), &expected);
    }
}

#[test]
fn eq_3_6_riccati_recursion() {
    for case in cases() {
        let (d, sweep) = (&case.d, &case.sweep);
        case.holds("P^- of the sweep", &diagonal(&sweep.p_minus), &d.p);
        let pivots = Matrix::from_diagonal(&DVector::from_iterator(case.nv(), sweep.measured.iter().map(|m| m.pivot)));
        case.holds("D of the sweep", &pivots, &d.d);
        case.holds("P^+ of the factor", &case.f.p_plus, &d.p_plus);
        for (stage, p_plus) in case.scene.model().system.stages.iter().zip(&sweep.p_plus) {
            let found = Matrix::from_column_slice(6, 6, p_plus.to_matrix().as_slice());
            let terms = block(&d.p, stage.first_row, stage.first_row);
            case.holds_among("P^+", &found, &block(&d.p_plus, stage.first_row, stage.first_row), &[&terms]);
        }
        // Meaning of P: covariance of a state given the outboard measurements, and then its own.
        for row in 0..case.nv() {
            let mut known = outboard(case, row);
            let terms = [&block(&d.r, row, row)];
            case.holds_among("P^-(k)", &block(&case.f.p, row, row), &conditional(case, row, &known), &terms);
            known.push(row);
            case.holds_among("P^+(k)", &block(&case.f.p_plus, row, row), &conditional(case, row, &known), &terms);
        }
        // D H P^+ = r H P^-: zero without armature.
        let left = &d.d_inv * &case.noise * &d.h * &d.p;
        case.holds_among("H P^+ = (r / D) H P^-", &(&d.h * &case.f.p_plus), &left, &[&(&d.h * &d.p)]);
        if case.has_armature() {
            case.fails("D = H P H* without armature", &(&d.h * &d.p * d.h.transpose()), &case.f.d);
            assert!(tolerance::size(left.as_slice()) > 0.0);
        }
    }
    for case in noise_free() {
        for (stage, p_plus) in case.scene.model().system.stages.iter().zip(&case.sweep.p_plus) {
            if let HingeMap::Axis(i) = stage.rows.row(0) {
                assert!(p_plus.column(i).iter().all(|&x| x == 0.0), "{}: P^+ H* is not exactly zero", case.name);
            }
        }
    }
}

#[test]
fn eq_3_7_state_covariance_from_p_minus() {
    for case in cases() {
        let f = &case.f;
        let typed = |p: &Matrix| {
            let (phi, gained) = (&f.phi_strict, &f.phi_strict * p * f.h.transpose());
            p + phi * p + p * phi.transpose() + &gained * &f.d_inv * gained.transpose()
        };
        case.holds_directly("R, P = P^-", &typed(&f.p), &case.d.r);
        case.fails("R, P = P^+", &typed(&f.p_plus), &case.d.r);
    }
}

#[test]
fn eq_3_8_k_and_d() {
    for case in cases() {
        let f = &case.f;
        let typed = &f.h * &f.phi_strict * &f.p * f.h.transpose() * &f.d_inv;
        case.holds("K = H Phi P H* D^-1", &f.k, &typed);
        case.holds("K by definition", &f.k, &case.d.k);
        case.holds("D = H P H* + r", &f.d, &(&case.d.h * &case.d.p * case.d.h.transpose() + &case.noise));
    }
}

#[test]
fn eq_3_9_sides_of_psi() {
    for case in cases() {
        let f = &case.f;
        case.holds("A = 1 - g H", &f.a, &(case.one() - &case.d.g * &case.d.h));
        for (row, inward) in case.inward.iter().enumerate() {
            let Some(inward) = *inward else { continue };
            // psi(k^-, k-1^+) = phi(k, k-1): from an inboard side to the next outboard side, without a measurement
            // between.
            let shift = block(&case.d.e, inward, row);
            case.holds_directly("psi(k-, k-1+)", &block(&f.psi, inward, row), &shift);
            case.holds("psi(k-, k-1-)", &block(&f.psi_a, inward, row), &(&shift * block(&case.d.a, row, row)));
            case.holds("psi(k+, k-1+)", &block(&f.a_psi, inward, row), &(block(&case.d.a, inward, inward) * &shift));
        }
        // The sides are not printed, and no other choice gives L.
        let l = |transition: &Matrix| &f.h * transition * &f.g;
        case.fails("L with Psi from - to -", &l(&f.psi_a), &case.d.l);
        case.fails("L with Psi from + to +", &l(&f.a_psi), &case.d.l);
    }
}

#[test]
fn eq_3_10_kalman_gain() {
    for case in cases() {
        case.holds("g = P H* D^-1", &case.f.g, &(&case.d.p * case.d.h.transpose() * inverse(&case.d.d)));
        for (row, measured) in case.sweep.measured.iter().enumerate() {
            let found = column(&DVector::from_column_slice(measured.gain.as_slice()));
            case.holds("g(k) of the sweep", &found, &case.d.g.view((6 * row, row), (6, 1)).into_owned());
        }
    }
}

#[test]
fn eq_3_11_psi_is_a_product_along_the_path() {
    for case in cases() {
        let f = &case.f;
        case.holds("Psi = (1 - E A)^-1 E", &f.psi, &case.d.psi);
        case.holds("Psi A", &f.psi_a, &case.d.psi_a);
        case.holds("A Psi", &f.a_psi, &case.d.a_psi);
        let scale = tolerance::size(case.d.psi.as_slice());
        for j in 0..case.nv() {
            // Inward from the + side of j: shift, measurement, shift, ...; every row that is not on the path has a
            // zero.
            let mut expected = Matrix::zeros(6 * case.nv(), 6);
            let (mut row, mut transition) = (j, Matrix::identity(6, 6));
            while let Some(next) = case.inward[row] {
                transition = block(&case.d.e, next, row) * transition;
                expected.rows_mut(6 * next, 6).copy_from(&transition);
                transition = block(&case.d.a, next, next) * transition;
                row = next;
            }
            let found = f.psi.columns(6 * j, 6).into_owned();
            let bound = tolerance::inverse(case.condition, scale);
            tolerance::assert_near("psi(k,m)", found.as_slice(), expected.as_slice(), bound);
        }
    }
}

#[test]
fn eq_3_12_open_and_closed_loop() {
    for case in cases() {
        let f = &case.f;
        let (phi, psi) = (&f.phi_strict, &f.psi);
        let loop_gain = &f.g * &f.h;
        case.holds_among("Psi = (1 - Psi g H) Phi", &((case.one() - psi * &loop_gain) * phi), &case.d.psi, &[phi]);
        case.holds_among("Psi = Phi (1 - g H Psi)", &(phi * (case.one() - &loop_gain * psi)), &case.d.psi, &[phi]);
        case.fails("Psi = (1 - g H) Phi", &((case.one() - loop_gain) * phi), &case.d.psi);
    }
}

#[test]
fn eq_3_13_inverse_from_both_sides() {
    for case in cases() {
        let (k, l) = (case.unit() + &case.f.k, case.unit() - &case.f.l);
        case.holds_among("(1 + K)(1 - L)", &(&k * &l), &case.unit(), &[&k, &l]);
        case.holds_among("(1 - L)(1 + K)", &(&l * &k), &case.unit(), &[&k, &l]);
    }
}

#[test]
fn eq_3_14_l() {
    for case in cases() {
        let f = &case.f;
        case.holds("L = H Psi P H* D^-1", &f.l, &(&f.h * &f.psi * &f.p * f.h.transpose() * &f.d_inv));
        case.holds("L = 1 - (1 + K)^-1", &f.l, &case.d.l);
    }
}

#[test]
fn result_3_5_k_and_l() {
    for case in cases() {
        let (k, l) = (&case.f.k, &case.f.l);
        case.holds("K = L + K L", &(l + k * l), k);
        case.holds("K = L + L K", &(l + l * k), k);
        case.holds_among("K L = L K", &(k * l), &(l * k), &[k, l]);
    }
    // K L has an entry only with three rows on a path.
    assert!(cases().iter().filter(|case| (&case.f.k * &case.f.l).amax() > 1e-3).count() >= 7);
}
