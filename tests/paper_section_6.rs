//! Section 6 of the paper: the inverse of M in closed form. One test per equation.
//!
//! On a tree 6.1 and 6.2 have additional terms across branches, with armature 6.2 has the term r D^-2; each is shown
//! to be necessary.

use crate::common::matrices::{Matrix, Vector, apply, inverse};
use crate::common::paper::{Case, cases, chains, column};
use phipsi::dynamics;
use phipsi::operators::Kind;

/// 6.1 for one path.
fn closed_form(case: &Case) -> Matrix {
    let f = &case.f;
    let spread = f.a.transpose() * &f.lambda_plus * &f.g - f.h.transpose() * &f.d_inv;
    let half = f.g.transpose() * f.psi.transpose() * spread;
    &f.d_inv + f.g.transpose() * &f.lambda_plus * &f.g + &half + half.transpose()
}

/// 6.2 for one path.
fn s_on_a_path(case: &Case) -> Matrix {
    let f = &case.f;
    let half = &f.p * f.psi.transpose() * (f.a.transpose() * &f.lambda_plus * &f.p - case.one());
    &f.p + &f.p * &f.lambda_plus * &f.p + &half + half.transpose()
}

/// Covariance of lambda^+ between branches.
fn across(case: &Case) -> Matrix {
    case.across_branches(&case.f.psi, &case.f.lambda)
}

/// Rows on different branches that meet at a moving body.
fn meets_on_a_body(case: &Case) -> bool {
    (0..case.nv()).any(|i| (0..i).any(|j| case.apart(i, j) && case.meet(i, j).is_some()))
}

/// S by definition: cov(x) given T in 6.2 is P - Psi P - P Psi* + P cov(lambda^+) P.
fn s_by_definition(case: &Case) -> Matrix {
    let d = &case.d;
    let to_joints = &d.h * &d.phi_strict;
    let (psi_p, co_states) = (&d.psi * &d.p, to_joints.transpose() * &d.m_inv * to_joints);
    &d.p - &psi_p - psi_p.transpose() + &d.p * co_states * &d.p
}

#[test]
fn eq_6_1_inverse_in_closed_form() {
    for case in cases() {
        let f = &case.f;
        let expected = inverse(&case.d.m);
        let mut found = vec![f64::NAN; case.nv() * case.nv()];
        let (scene, q) = (&case.scene, &case.q);
        scene.mass_matrix_inverse(&mut scene.workspace(), &mut scene.inverse_scratch(), q, &mut found).unwrap();
        let found = Matrix::from_row_slice(case.nv(), case.nv(), &found);
        case.holds("M^-1 of the scene", &found, &expected);
        let typed = closed_form(case) + f.g.transpose() * across(case) * &f.g;
        case.holds("M^-1, typed", &typed, &expected);
        // Printed with a Lambda without a side, and without A.
        for lambda in [&f.lambda, &f.lambda_plus] {
            let half = f.g.transpose() * f.psi.transpose() * (lambda * &f.g - f.h.transpose() * &f.d_inv);
            let printed = &f.d_inv + f.g.transpose() * lambda * &f.g + &half + half.transpose();
            case.fails("6.1", &printed, &expected);
        }
        if meets_on_a_body(case) {
            case.fails("6.1 without the terms across branches", &closed_form(case), &expected);
        }
    }
    for case in chains() {
        case.holds("M^-1 on a chain", &closed_form(case), &inverse(&case.d.m));
    }
}

#[test]
fn eq_6_2_inverse_by_s() {
    for case in cases() {
        let f = &case.f;
        let expected = inverse(&case.d.m);
        let s = s_by_definition(case);
        let terms = [&case.d.p, &(&case.d.psi * &case.d.p)];
        case.holds_among("S by sweep", &f.s, &s, &terms);
        let typed = s_on_a_path(case) + &f.p * across(case) * &f.p;
        case.holds_among("S, typed", &typed, &s, &terms);
        let project = |s: &Matrix| &f.d_inv * &f.h * s * f.h.transpose() * &f.d_inv;
        let rotors = &case.noise * &f.d_inv * &f.d_inv;
        case.holds_among("D^-1 H S H* D^-1 + r D^-2", &(project(&f.s) + &rotors), &expected, &[&rotors]);
        for lambda in [&f.lambda, &f.lambda_plus] {
            let half = &f.p * f.psi.transpose() * (lambda * &f.p - case.one());
            let printed = &f.p + &f.p * lambda * &f.p + &half + half.transpose();
            case.fails("6.2", &printed, &s);
            case.fails("M^-1 by 6.2", &project(&printed), &expected);
        }
        if meets_on_a_body(case) {
            case.fails("6.2 without the terms across branches", &s_on_a_path(case), &s);
        }
        if case.has_armature() {
            case.fails("6.2 without r D^-2", &project(&f.s), &expected);
        }
    }
}

#[test]
fn eq_6_3_equations_of_motion() {
    for case in cases() {
        let model = case.scene.model();
        let mut workspace = case.scene.workspace();
        let a = case.tau.as_slice();
        let expected = column(&(&case.d.m * &case.tau));
        // M a: the operator, the sweep of the dynamics, and inverse dynamics minus the bias.
        case.holds_directly("the operator", &apply(&case.factor.operator(Kind::Mass), &column(&case.tau)), &expected);
        let (mut whole, mut bias, mut swept) =
            (vec![f64::NAN; a.len()], vec![f64::NAN; a.len()], vec![f64::NAN; a.len()]);
        case.scene.inverse_dynamics(&mut workspace, &case.q, &case.qd, a, &[], &mut whole).unwrap();
        case.scene.bias_torque(&mut workspace, &case.q, &case.qd, &mut bias).unwrap();
        // The poses that mul_mass reads.
        dynamics::bias_torque(model, &mut workspace, &case.q, &case.qd, &[], &mut swept);
        dynamics::mul_mass(model, &mut workspace, a, &mut swept);
        case.holds_directly("mul_mass", &column(&Vector::from_vec(swept)), &expected);
        let bias = Vector::from_vec(bias);
        let difference = Vector::from_vec(whole) - &bias;
        let terms = column(&((&case.d.h * &case.d.phi).abs() * case.bias().abs()));
        case.holds_among("inverse dynamics - bias", &column(&difference), &expected, &[&terms]);
        assert!(bias.amax() > 0.0, "{}: no bias", case.name);
    }
}

#[test]
fn eq_6_4_accelerations_without_m() {
    for case in cases() {
        let expected = case.d.m.clone().lu().solve(&case.tau).expect("a regular matrix");
        let expected = column(&expected);
        let terms = column(&(case.d.m_inv.abs() * case.tau.abs()));
        let operator = apply(&case.factor.operator(Kind::MassInverse), &column(&case.tau));
        case.holds_among("filter and smoother", &operator, &expected, &[&terms]);
        let by_closed_form = closed_form(case) + case.f.g.transpose() * across(case) * &case.f.g;
        case.holds_among("closed form", &(by_closed_form * column(&case.tau)), &expected, &[&terms]);
        let mut solved = vec![f64::NAN; case.nv()];
        let mut workspace = case.scene.workspace();
        dynamics::factorise(case.scene.model(), &mut workspace, &case.q);
        dynamics::solve(case.scene.model(), &mut workspace, case.tau.as_slice(), &mut solved);
        case.holds_among("dynamics::solve", &column(&Vector::from_vec(solved)), &expected, &[&terms]);
    }
}
