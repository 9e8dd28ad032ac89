//! Section 5 of the paper: covariances of states, innovations and co-states. One test per equation.
//!
//! Each compared with dense algebra from its definition as a covariance, and with samples of the random model.

use crate::common::filter;
use crate::common::matrices::{Matrix, apply, block, block_diagonal};
use crate::common::paper::{Case, cases, chains, trees};
use crate::common::sampling::{self, DRAWS, Draws, drawn, has_covariance, has_not_covariance, mean_square};
use crate::common::tolerance;
use nalgebra::Vector6;
use phipsi::dynamics;
use phipsi::filter::covariance;
use phipsi::operators::{Kind, Operator};
use phipsi::spatial::Symmetric6;
use std::sync::OnceLock;

/// Filter and smoother on every sample: e^-, and a.
fn filtered_and_smoothed(case: &Case, draws: &Draws) -> (Matrix, Matrix) {
    let (system, sweep) = (&case.scene.model().system, &case.sweep);
    let mut innovations = Matrix::from_element(case.nv(), DRAWS, f64::NAN);
    for (t, mut e) in draws.t.column_iter().zip(innovations.column_iter_mut()) {
        let mut z = vec![Vector6::zeros(); sweep.shift.len()];
        filter::innovations(system, &sweep.shift, &sweep.measured, t.as_slice(), &mut z, e.as_mut_slice());
    }
    let mut accelerations = innovations.clone();
    let mut co_states = vec![Vector6::zeros(); sweep.shift.len()];
    for mut a in accelerations.column_iter_mut() {
        filter::smoother(system, &sweep.shift, &sweep.measured, &mut co_states, a.as_mut_slice());
    }
    (innovations, accelerations)
}

/// P + (Psi on the matching side) P + its transpose.
fn whole(p: &Matrix, transition: &Matrix) -> Matrix {
    let carried = transition * p;
    p + &carried + carried.transpose()
}

#[test]
fn eq_5_1_mass_matrix_is_a_covariance() {
    for (case, draws) in drawn() {
        let f = &case.f;
        case.holds_directly("M = H R H* + r", &f.m, &(&case.d.h * &case.d.r * case.d.h.transpose() + &case.noise));
        let mut m = vec![f64::NAN; case.nv() * case.nv()];
        case.scene.mass_matrix(&mut case.scene.workspace(), &case.q, &mut m).unwrap();
        let m = Matrix::from_row_slice(case.nv(), case.nv(), &m);
        case.holds_directly("M of the scene", &m, &case.d.m);
        let sample = sampling::covariance(&draws.t);
        has_covariance("E T T*", &sample, &m);
        // Printed as E T T* with b in the model (1.3): including the mean, it is not M.
        let mean = &case.d.h * &case.d.phi * case.bias();
        case.fails("E T T* with b", &(&m + &mean * mean.transpose()), &m);
        if case.has_armature() {
            has_not_covariance("E T T* without the rotors", &sample, &(&m - &case.noise));
        }
    }
}

/// Covariance of X - Z^-, from Z^- = Psi g T; and of X - Z^+, from Z^+ = (1 + A Psi) g T.
fn error_covariances(case: &Case) -> (Matrix, Matrix) {
    let d = &case.d;
    let of = |gain: &Matrix| {
        let open = case.one() - gain * &d.h;
        &open * &d.r * open.transpose() + gain * &case.noise * gain.transpose()
    };
    (of(&(&d.psi * &d.g)), of(&((case.one() + &d.a_psi) * &d.g)))
}

#[test]
fn eq_5_2_covariance_of_the_state_errors() {
    for (case, draws) in drawn() {
        let f = &case.f;
        let (predicted, filtered) = error_covariances(case);
        let of_predicted = whole(&f.p, &f.psi_a);
        let of_filtered = whole(&f.p_plus, &f.a_psi);
        case.holds_among("cov(X - Z^-)", &of_predicted, &predicted, &[&case.d.r]);
        case.holds_among("cov(X - Z^+)", &of_filtered, &filtered, &[&case.d.r]);
        let from_predicted = sampling::covariance(&(&draws.x - draws.predicted(case)));
        let from_filtered = sampling::covariance(&(&draws.x - draws.filtered(case)));
        has_covariance("X - Z^-", &from_predicted, &of_predicted);
        has_covariance("X - Z^+", &from_filtered, &of_filtered);
        // Printed with Psi itself, for either P.
        for (p, name) in [(&f.p, "P^-"), (&f.p_plus, "P^+")] {
            let printed = whole(p, &f.psi);
            case.fails(&format!("{name} + Psi P + P Psi*, predicted"), &printed, &predicted);
            case.fails(&format!("{name} + Psi P + P Psi*, filtered"), &printed, &filtered);
            has_not_covariance("X - Z^-, printed", &from_predicted, &printed);
            has_not_covariance("X - Z^+, printed", &from_filtered, &printed);
        }
        has_not_covariance("X - Z^- by the filtered form", &from_predicted, &of_filtered);
    }
}

#[test]
fn eq_5_3_mean_square_error() {
    for (case, draws) in drawn() {
        let (predicted, filtered) = error_covariances(case);
        let (minus, plus) = (case.f.p.trace(), case.f.p_plus.trace());
        let bound = tolerance::inverse(case.condition, case.d.r.trace());
        tolerance::assert_close("Tr cov(X - Z^-) = Tr P^-", predicted.trace(), minus, bound);
        tolerance::assert_close("Tr cov(X - Z^+) = Tr P^+", filtered.trace(), plus, bound);
        let (from_predicted, allowed) = mean_square(&(&draws.x - draws.predicted(case)), &predicted);
        tolerance::assert_close("mean of |X - Z^-|^2", from_predicted, minus, allowed);
        let (from_filtered, allowed) = mean_square(&(&draws.x - draws.filtered(case)), &filtered);
        tolerance::assert_close("mean of |X - Z^+|^2", from_filtered, plus, allowed);
        // Printed with a P without a side: the other one has another value.
        let off = (minus - plus) / minus;
        assert!(off > tolerance::PRINTED_FORM_MARGIN, "{}: Tr P^- and Tr P^+ differ by {off:e} only", case.name);
    }
}

#[test]
fn eq_5_4_innovations_are_white() {
    for (case, draws) in drawn() {
        let d = &case.d;
        let whitened = case.unit() - &d.l;
        let dense = &whitened * &d.m * whitened.transpose();
        case.holds_among("(1 - L) M (1 - L*)", &case.f.d, &dense, &[&d.m]);
        let (innovations, _) = filtered_and_smoothed(case, draws);
        has_covariance("e^-", &sampling::covariance(&innovations), &case.f.d);
        has_not_covariance("T itself", &sampling::covariance(&draws.t), &case.f.d);
    }
}

/// cov(lambda^+) and cov(lambda^-) of the smoother: lambda^- = phi* H* a, lambda^+ = Phi* H* a, cov(a) = M^-1.
fn co_state_covariances(case: &Case) -> (Matrix, Matrix) {
    let d = &case.d;
    let of = |transition: &Matrix| {
        let to_joints = &d.h * transition;
        to_joints.transpose() * &d.m_inv * to_joints
    };
    (of(&d.phi_strict), of(&d.phi))
}

/// Sample covariances of lambda^+ and lambda^- of every case, computed once: a of the smoother on every sample, then
/// outward.
fn sampled_co_states() -> impl Iterator<Item = (&'static Case, &'static (Matrix, Matrix))> {
    static SAMPLED: OnceLock<Vec<(Matrix, Matrix)>> = OnceLock::new();
    let sampled = SAMPLED.get_or_init(|| {
        let of = |(case, draws): (&Case, &Draws)| {
            let (_, accelerations) = filtered_and_smoothed(case, draws);
            let at_joints = apply(&case.factor.operator(Kind::H).transposed(), &accelerations);
            let outboard = apply(&case.factor.operator(Kind::Phi).transposed(), &at_joints);
            let inboard = apply(&case.factor.operator(Kind::Shifts).transposed(), &outboard);
            (sampling::covariance(&inboard), sampling::covariance(&outboard))
        };
        drawn().map(of).collect()
    });
    cases().iter().zip(sampled)
}

#[test]
fn eq_5_5_covariance_of_the_co_states() {
    for (case, sampled) in sampled_co_states() {
        let f = &case.f;
        let (plus, minus) = co_state_covariances(case);
        let observed = &f.h * &f.psi;
        let scale = [&case.d.phi.abs().transpose() * minus.diagonal().amax()];
        let terms: Vec<&Matrix> = scale.iter().collect();
        case.holds_among(
            "cov(lambda^+) = Psi* H* D^-1 H Psi",
            &(observed.transpose() * &f.d_inv * &observed),
            &plus,
            &terms,
        );
        let of_plus = whole(&f.lambda_plus, &f.a_psi.transpose());
        let of_minus = whole(&f.lambda, &f.psi_a.transpose());
        // On a tree the blocks across branches are Psi(c,i)* Lambda^-(c) Psi(c,j); Psi A for lambda^-.
        let across_plus = case.across_branches(&f.psi, &f.lambda);
        let across_minus = case.across_branches(&f.psi_a, &f.lambda);
        case.holds_among("cov(lambda^+)", &(&of_plus + &across_plus), &plus, &terms);
        case.holds_among("cov(lambda^-)", &(&of_minus + &across_minus), &minus, &terms);

        let (inboard, outboard) = sampled;
        has_covariance("lambda^-", outboard, &(&of_minus + across_minus));
        has_covariance("lambda^+", inboard, &(&of_plus + across_plus));
        // Printed with one Lambda and Psi itself.
        for lambda in [&f.lambda, &f.lambda_plus] {
            let printed = whole(lambda, &f.psi.transpose());
            case.fails("Lambda + Lambda Psi + Psi* Lambda, +", &printed, &plus);
            case.fails("Lambda + Lambda Psi + Psi* Lambda, -", &printed, &minus);
            has_not_covariance("lambda^+, printed", inboard, &printed);
            has_not_covariance("lambda^-, printed", outboard, &printed);
        }
    }
}

#[test]
fn eq_5_5_without_the_terms_across_branches() {
    for case in chains() {
        assert!(case.across_branches(&case.f.psi, &case.f.lambda).iter().all(|&x| x == 0.0));
    }
    for case in
        trees().filter(|case| (0..case.nv()).any(|i| (0..i).any(|j| case.apart(i, j) && case.meet(i, j).is_some())))
    {
        let (plus, minus) = co_state_covariances(case);
        case.fails("cov(lambda^+) on a tree", &whole(&case.f.lambda_plus, &case.f.a_psi.transpose()), &plus);
        case.fails("cov(lambda^-) on a tree", &whole(&case.f.lambda, &case.f.psi_a.transpose()), &minus);
    }
}

/// Lambda^+ of every row and Lambda^- of every body, by the sweep of the crate.
fn swept(case: &Case) -> (Vec<Matrix>, Vec<Matrix>) {
    let (system, sweep) = (&case.scene.model().system, &case.sweep);
    let full = |lambda: &Symmetric6<f64>| Matrix::from_column_slice(6, 6, lambda.to_matrix().as_slice());
    let mut plus = vec![Matrix::zeros(0, 0); case.nv()];
    let mut minus = vec![Symmetric6::filled(f64::NAN); sweep.shift.len()];
    let factor = (&sweep.shift[..], &sweep.measured[..]);
    dynamics::co_state_covariances(system, factor, &mut minus, |(_, row), lambda, _| plus[row] = full(lambda));
    (plus, minus.iter().map(full).collect())
}

#[test]
fn eq_5_6_across_a_joint() {
    for (case, (_, outboard)) in sampled_co_states() {
        let (f, d) = (&case.f, &case.d);
        let (_, minus) = co_state_covariances(case);
        let closed = f.a.transpose() * &f.lambda_plus * &f.a + f.h.transpose() * &f.d_inv * &f.h;
        case.holds("A* Lambda^+ A + H* D^-1 H", &closed, &block_diagonal(&minus));
        case.holds("Lambda^-", &f.lambda, &d.lambda);
        let model = case.scene.model();
        for (k, (stage, found)) in model.system.stages.iter().zip(swept(case).1).enumerate() {
            let row = stage.first_row + stage.rows.count() - 1;
            case.holds(&format!("Lambda^-({k}) of the sweep"), &found, &block(&minus, row, row));
        }
        for row in 0..case.nv() {
            has_covariance("lambda^-(k)", &block(outboard, row, row), &block(&f.lambda, row, row));
        }
        // The kernel of one row, on a general covariance.
        for (row, measured) in case.sweep.measured.iter().enumerate() {
            let stage = model.system.stages.iter().rfind(|stage| stage.first_row <= row).expect("a stage has it");
            let given = case.sweep.p_minus[row];
            let (full, a, h) =
                (given.to_matrix(), block(&d.a, row, row), d.h.view((row, 6 * row), (1, 6)).into_owned());
            let full = Matrix::from_column_slice(6, 6, full.as_slice());
            let expected = a.transpose() * &full * &a + h.transpose() * &h * measured.pivot_inverse;
            let (found, _) = covariance::row_update(&given, &stage.rows.row(row - stage.first_row), measured);
            let found = Matrix::from_column_slice(6, 6, found.to_matrix().as_slice());
            case.holds("row_update", &found, &expected);
        }
    }
}

#[test]
fn eq_5_7_outward() {
    for (case, (inboard, _)) in sampled_co_states() {
        let f = &case.f;
        let (plus, _) = co_state_covariances(case);
        let carried = block_diagonal(&(f.e.transpose() * &f.lambda * &f.e));
        let expected = block_diagonal(&plus);
        case.holds("phi^T Lambda^- phi", &carried, &expected);
        case.holds("Lambda^+", &f.lambda_plus, &case.d.lambda_plus);
        for (row, found) in swept(case).0.iter().enumerate() {
            case.holds("Lambda^+(k) of the sweep", found, &block(&expected, row, row));
            if case.inward[row].is_some() {
                has_covariance("lambda^+(k)", &block(inboard, row, row), &block(&f.lambda_plus, row, row));
            } else {
                // The terminal condition: zero at the base.
                assert!(found.iter().all(|&x| x == 0.0), "{}: Lambda^+(N)", case.name);
            }
        }
    }
}
