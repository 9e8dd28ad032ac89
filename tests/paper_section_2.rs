//! Section 2 of the paper: conditional means and their covariances. One test per equation.
//!
//! Armature is measurement noise v of covariance r: T = H X + v, calligraphic M = H R H* + r.

use crate::common::filter;
use crate::common::matrices::{Matrix, Vector, apply, inverse};
use crate::common::paper::{Case, cases, column, noise_free};
use crate::common::sampling::{Draws, covariance, drawn, has_covariance, has_not_covariance};
use nalgebra::Vector6;
use phipsi::operators::{Kind, Operator};

/// T - H phi b in the state of the case.
fn centered(case: &Case, b: &Vector) -> Vector {
    &case.tau - &case.d.h * &case.d.phi * b
}

/// Forces on the bodies if the joint accelerations are `a`: phi (b + Q lambda), by the outward and the inward sweep.
fn spatial_forces(case: &Case, a: &Vector, b: &Vector) -> Vector {
    let at_joints = apply(&case.factor.operator(Kind::H).transposed(), &column(a));
    let co_states = apply(&case.factor.operator(Kind::Phi).transposed(), &at_joints);
    let inertial = apply(&case.factor.operator(Kind::Q), &co_states) + column(b);
    Vector::from_column_slice(apply(&case.factor.operator(Kind::Phi), &inertial).as_slice())
}

#[test]
fn eq_2_1_conditional_mean_of_the_state() {
    for case in cases() {
        let b = case.bias();
        let t = centered(case, &b);
        let estimate = &case.d.phi * &b + &case.f.batch_gain * &t;
        // Forward dynamics, then the forces of those accelerations: the conditional mean is the actual force.
        let actual = spatial_forces(case, &case.forward_dynamics(), &b);
        let terms = [&column(&(&case.d.phi * &b)), &column(&(&case.f.batch_gain * &t))];
        case.holds_among("E(X/T)", &column(&estimate), &column(&actual), &terms);
        // They give the measured torques, minus those of the rotors.
        let rotors = &case.noise * case.forward_dynamics();
        let tau = column(&case.tau);
        case.holds_among("H E(X/T)", &column(&(&case.d.h * &actual + rotors)), &tau, &terms);
        // Definition of the conditional mean of Gaussians: the error is uncorrelated with the measurements.
        let with_state = &case.d.r * case.d.h.transpose();
        let of_estimate = &case.f.batch_gain * (&case.d.h * &case.d.r * case.d.h.transpose() + &case.noise);
        case.holds("cov(X, T) = cov(E(X/T), T)", &of_estimate, &with_state);
    }
}

#[test]
fn eq_2_2_batch_gain() {
    for case in cases() {
        let (f, d) = (&case.f, &case.d);
        case.holds("G = R H* M^-1", &f.batch_gain, &(&d.r * d.h.transpose() * inverse(&d.m)));
        case.holds_directly("R = phi Q phi*", &(&f.phi * &f.q * f.phi.transpose()), &d.r);
    }
}

#[test]
fn eq_2_3_open_loop_covariance() {
    for (case, draws) in drawn() {
        case.holds_directly("R", &case.f.r, &(&case.d.phi * &case.d.q * case.d.phi.transpose()));
        has_covariance("X - phi b", &covariance(&draws.x), &case.f.r);
    }
}

/// (1 - G H) phi W - G v, by samples: the error of the conditional mean.
fn errors(case: &Case, draws: &Draws) -> Matrix {
    &draws.x - apply(&case.factor.operator(Kind::BatchGain), &draws.t)
}

#[test]
fn eq_2_4_error_of_the_state_estimate() {
    for (case, draws) in drawn() {
        let f = &case.f;
        let open = case.one() - &f.batch_gain * &f.h;
        let typed = &open * &f.phi * &draws.w - &f.batch_gain * &draws.v;
        case.holds_among("X - E(X/T)", &errors(case, draws), &typed, &[&draws.x]);
        // Printed with W instead of W - b: the error would contain the mean.
        let first = column(&typed.column(0).into_owned());
        let with_mean = &first + column(&(&open * &f.phi * case.bias()));
        case.fails("(1 - G H) phi W", &with_mean, &first);
    }
}

#[test]
fn eq_2_5_error_covariance_as_a_product() {
    for (case, draws) in drawn() {
        let (f, d) = (&case.f, &case.d);
        let open = case.one() - &f.batch_gain * &f.h;
        let product = &open * &f.r * open.transpose();
        let with_noise = &product + &f.batch_gain * &case.noise * f.batch_gain.transpose();
        // Covariance of X given T.
        let conditional = &d.r - &d.r * d.h.transpose() * &d.m_inv * &d.h * &d.r;
        case.holds_among("P", &with_noise, &conditional, &[&d.r]);
        let errors = covariance(&errors(case, draws));
        has_covariance("X - E(X/T)", &errors, &with_noise);
        if case.has_armature() {
            case.fails("P without G r G*", &product, &conditional);
            has_not_covariance("X - E(X/T)", &errors, &d.r);
        }
    }
}

#[test]
fn eq_2_6_error_covariance_alternatives() {
    for case in cases() {
        let (f, d) = (&case.f, &case.d);
        let p = &d.r - &d.r * d.h.transpose() * &d.m_inv * &d.h * &d.r;
        let open = case.one() - &f.batch_gain * &f.h;
        case.holds_among("(1 - G H) R", &(&open * &f.r), &p, &[&d.r]);
        case.holds_among("R (1 - G H)*", &(&f.r * open.transpose()), &p, &[&d.r]);
        // H P = r M^-1 H R: zero without noise.
        let left = &case.noise * &d.m_inv * &d.h * &d.r;
        case.holds_among("H P", &(&f.h * &open * &f.r), &left, &[&(&d.h * &d.r)]);
        if case.has_armature() {
            assert!(left.amax() > 1e-3 * (&d.h * &d.r).amax(), "{}: the noise leaves nothing", case.name);
        }
    }
    for case in noise_free() {
        let (f, d) = (&case.f, &case.d);
        let p = &f.r - &f.batch_gain * &f.h * &f.r;
        let (nv, wide) = (case.nv(), 6 * case.nv());
        case.holds_among("H P = 0", &(&f.h * &p), &Matrix::zeros(nv, wide), &[&(&d.h * &d.r)]);
        case.holds_among("P H* = 0", &(&p * f.h.transpose()), &Matrix::zeros(wide, nv), &[&(&d.h * &d.r)]);
        case.holds_among("H P H* = 0", &(&f.h * &p * f.h.transpose()), &Matrix::zeros(nv, nv), &[&d.m]);
    }
}

#[test]
fn eq_2_7_conditional_mean_of_the_process_noise() {
    for case in cases() {
        let (d, b) = (&case.d, case.bias());
        let t = centered(case, &b);
        let typed = &b + &d.q * d.phi.transpose() * d.h.transpose() * inverse(&d.m) * &t;
        // Force on each body by Newton-Euler: the difference of the spatial forces on both sides.
        let forces = spatial_forces(case, &case.forward_dynamics(), &b);
        let on_bodies = &forces - &d.e * &forces;
        case.holds_among("E(W/T)", &column(&on_bodies), &column(&typed), &[&column(&forces), &column(&b)]);
    }
}

#[test]
fn eq_2_8_joint_accelerations() {
    for case in cases() {
        let b = case.bias();
        let t = centered(case, &b);
        let dense = case.d.m.clone().lu().solve(&t).expect("a regular matrix");
        let terms = column(&(case.d.m_inv.abs() * (case.tau.abs() + (&case.d.h * &case.d.phi).abs() * b.abs())));
        case.holds_among("a = M^-1 (T - H phi b)", &column(&case.forward_dynamics()), &column(&dense), &[&terms]);
        let m = &case.f.h * &case.f.r * case.f.h.transpose() + &case.noise;
        case.holds_directly("M = H R H* + r", &case.f.m, &m);
    }
}

/// Magnitude of the terms of phi* H* M^-1 t.
fn co_state_terms(case: &Case, t: &Vector) -> Matrix {
    let d = &case.d;
    column(&(d.phi.abs().transpose() * d.h.abs().transpose() * d.m_inv.abs() * t.abs()))
}

/// Results of the smoother for the centered torques `t`: lambda^- of each body, and a.
fn smoothed(case: &Case, t: &Vector) -> (Vec<Vector6<f64>>, Vector) {
    let (system, sweep) = (&case.scene.model().system, &case.sweep);
    let mut z = vec![Vector6::zeros(); sweep.shift.len()];
    let mut a = vec![f64::NAN; case.nv()];
    filter::innovations(system, &sweep.shift, &sweep.measured, t.as_slice(), &mut z, &mut a);
    filter::smoother(system, &sweep.shift, &sweep.measured, &mut z, &mut a);
    (z, Vector::from_vec(a))
}

#[test]
fn eq_2_9_spatial_accelerations() {
    for case in cases() {
        let t = centered(case, &case.bias());
        let (lambda, a) = smoothed(case, &t);
        let dense = case.d.phi.transpose() * case.d.h.transpose() * &case.d.m_inv * &t;
        let outboard = column(&case.stacked(&case.outermost(&dense)));
        let terms = co_state_terms(case, &t);
        case.holds_among("lambda = phi* H* a", &column(&case.stacked(&lambda)), &outboard, &[&terms]);
        let typed = case.f.phi.transpose() * case.f.h.transpose() * &a;
        case.holds_among("lambda = phi* H* a, typed", &column(&typed), &column(&dense), &[&terms]);
    }
}

#[test]
fn eq_2_10_inertial_forces() {
    for case in cases() {
        let (d, b) = (&case.d, case.bias());
        let t = centered(case, &b);
        let (lambda, _) = smoothed(case, &t);
        let typed = &b + &case.f.q * case.stacked(&lambda);
        let dense = &b + &d.q * d.phi.transpose() * d.h.transpose() * &d.m_inv * &t;
        let terms = [&column(&b), &(d.q.abs() * co_state_terms(case, &t))];
        case.holds_among("E(W/T) = b + Q lambda", &column(&typed), &column(&dense), &terms);
    }
}

#[test]
fn eq_2_11_error_of_the_process_noise() {
    for (case, draws) in drawn() {
        let (f, d) = (&case.f, &case.d);
        // W - E(W/T) by sweeps, by samples; its covariance, and that of the formula.
        let accelerations = apply(&case.factor.operator(Kind::MassInverse), &draws.t);
        let to_inertial =
            case.factor.operator(Kind::Phi).transposed().compose(case.factor.operator(Kind::H).transposed());
        let errors = covariance(&(&draws.w - &f.q * apply(&to_inertial, &accelerations)));
        let h_phi_q = &f.h * &f.phi * &f.q;
        let typed = &f.q - h_phi_q.transpose() * &f.m_inv * &h_phi_q;
        has_covariance("W - E(W/T)", &errors, &typed);
        has_not_covariance("W - E(W/T)", &errors, &d.q);
        // From the definition of the error: [1 - Q phi* H* M^-1 H phi] W and the contribution of the noise.
        let gain = &d.q * d.phi.transpose() * d.h.transpose() * &d.m_inv;
        let open = case.one() - &gain * &d.h * &d.phi;
        let dense = &open * &d.q * open.transpose() + &gain * &case.noise * gain.transpose();
        case.holds_among("cov(W - E(W/T))", &typed, &dense, &[&d.q]);
    }
}
