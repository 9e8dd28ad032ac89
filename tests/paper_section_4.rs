//! Section 4 of the paper: filtering and smoothing. One test per equation.
//!
//! T is the centered torque tau - H phi b if the equation has no b; `Run` contains the results of the sweeps for it,
//! and `Biased`
//! the results with b(k) in 4.4 and tau as the measurement.

use crate::common::filter;
use crate::common::matrices::{Matrix, Vector};
use crate::common::paper::{Case, cases, column, six};
use nalgebra::Vector6;

/// One run of filter and smoother.
struct Run {
    /// e^- of every row.
    innovations: Vector,
    /// z^+ of every body, after all its measurements.
    filtered: Vec<Vector6<f64>>,
    /// lambda^- of every body.
    co_states: Vec<Vector6<f64>>,
    /// a of every row.
    accelerations: Vector,
}

fn run(case: &Case, b: &Vector, measurement: &Vector) -> Run {
    let (system, sweep) = (&case.scene.model().system, &case.sweep);
    let mut z = case.outermost(b);
    let mut innovations = vec![f64::NAN; case.nv()];
    filter::innovations(system, &sweep.shift, &sweep.measured, measurement.as_slice(), &mut z, &mut innovations);
    let (mut co_states, mut estimates) = (vec![Vector6::repeat(f64::NAN); z.len()], innovations.clone());
    filter::smoother(system, &sweep.shift, &sweep.measured, &mut co_states, &mut estimates);
    Run {
        innovations: Vector::from_vec(innovations),
        filtered: z,
        co_states,
        accelerations: Vector::from_vec(estimates),
    }
}

/// Centered torque.
fn centered(case: &Case) -> Vector {
    &case.tau - &case.d.h * &case.d.phi * case.bias()
}

/// A run on the centered torque, without b.
fn centered_run(case: &Case) -> (Vector, Run) {
    let t = centered(case);
    let run = run(case, &Vector::zeros(6 * case.nv()), &t);
    (t, run)
}

/// A run on tau, with b.
fn biased_run(case: &Case) -> (Vector, Run) {
    let b = case.bias();
    let run = run(case, &b, &case.tau);
    (b, run)
}

/// z^- and z^+ of every row by dense algebra, for the centered torque.
fn states(case: &Case, t: &Vector) -> (Vector, Vector) {
    let d = &case.d;
    let predicted = &d.psi * &d.g * t;
    let filtered = (case.one() + &d.a_psi) * &d.g * t;
    (predicted, filtered)
}

fn at_innermost(case: &Case, x: &Vector) -> Matrix {
    column(&case.stacked(&case.innermost(x)))
}

fn bodies(case: &Case, x: &[Vector6<f64>]) -> Matrix {
    column(&case.stacked(x))
}

/// Magnitudes of the terms of torques and of forces.
fn torque_terms(case: &Case, b: &Vector) -> Matrix {
    column(&(case.tau.abs() + (&case.d.h * &case.d.phi).abs() * b.abs()))
}

fn force_terms(case: &Case, b: &Vector) -> Matrix {
    column(&(case.d.phi.abs() * b.abs()))
}

#[test]
fn eq_4_1_accelerations_from_torques() {
    for case in cases() {
        let (f, t) = (&case.f, centered(case));
        let whitened = case.unit() - &f.l;
        let typed = whitened.transpose() * &f.d_inv * &whitened * &t;
        let dense = case.d.m.clone().lu().solve(&t).expect("a regular matrix");
        let mut solved = vec![f64::NAN; case.nv()];
        case.factor.solve(t.as_slice(), &mut solved);
        let terms = column(&(case.d.m_inv.abs() * t.abs()));
        case.holds_among("a, typed", &column(&typed), &column(&dense), &[&terms]);
        case.holds_among("a by Factor::solve", &column(&Vector::from_vec(solved)), &column(&dense), &[&terms]);
        // Printed with T not centered: the torque itself.
        case.fails("a from tau", &column(&(&case.d.m_inv * &case.tau)), &column(&case.forward_dynamics()));
    }
}

#[test]
fn eq_4_2_innovations() {
    for case in cases() {
        let (t, run) = centered_run(case);
        let dense = (case.unit() - &case.d.l) * &t;
        case.holds_among("e^- = (1 - L) T", &column(&run.innovations), &column(&dense), &[&column(&t)]);
        let (b, biased) = biased_run(case);
        let terms = torque_terms(case, &b);
        case.holds_among("e^- from tau and b", &column(&biased.innovations), &column(&dense), &[&terms]);
        // Printed with b in 4.4, (1 - L) is applied to tau: this does not give the innovations.
        let printed = (case.unit() - &case.d.l) * &case.tau;
        case.fails("(1 - L) tau", &column(&printed), &column(&biased.innovations));
    }
}

#[test]
fn eq_4_3_predicted_state() {
    for case in cases() {
        let (t, run) = centered_run(case);
        let printed = &case.f.psi * &case.f.g * &t;
        let (predicted, filtered) = states(case, &t);
        case.holds("z^- = Psi g T", &column(&printed), &column(&predicted));
        let found = bodies(case, &run.filtered);
        case.holds("z^+ = (1 + A Psi) g T", &found, &at_innermost(case, &filtered));
        // Printed as the filtered estimate.
        case.fails("z^+ = Psi g T", &column(&printed), &column(&filtered));
        case.fails("z^+ of the sweep = Psi g T", &at_innermost(case, &printed), &found);
    }
}

#[test]
fn eq_4_4_prediction() {
    for case in cases() {
        let (b, biased) = biased_run(case);
        let t = centered(case);
        let (predicted, filtered) = states(case, &t);
        case.holds("Z^- = E Z^+", &column(&(&case.f.e * &filtered)), &column(&predicted));
        // With b: z^-(k) = sum of phi z^+ + b(k), and the same minus the contribution of b, phi b.
        let stages = &case.scene.model().system.stages;
        let own = case.outermost(&b);
        let with_bias: Vec<Vector6<f64>> = (0..stages.len())
            .map(|k| {
                let children = (0..stages.len()).filter(|&c| stages[c].parent == Some(k));
                own[k] + children.map(|c| case.sweep.shift[c].to_matrix() * biased.filtered[c]).sum::<Vector6<f64>>()
            })
            .collect();
        let whole = &predicted + &case.d.phi * &b;
        let expected = bodies(case, &case.outermost(&whole));
        case.holds_among("z^- with b", &bodies(case, &with_bias), &expected, &[&force_terms(case, &b)]);
        // Printed without the remark that T is then tau: with b added, the centered recursion has another state.
        case.fails(
            "Psi g tau + phi b",
            &column(&(&case.d.psi * &case.d.g * &case.tau + &case.d.phi * &b)),
            &column(&whole),
        );
    }
}

#[test]
fn eq_4_5_measurement() {
    for case in cases() {
        let (t, run) = centered_run(case);
        let (predicted, filtered) = states(case, &t);
        let typed = &predicted + &case.f.g * &run.innovations;
        case.holds_among("Z^+ = Z^- + g e^-", &column(&typed), &column(&filtered), &[&column(&predicted)]);
        case.holds("z^+ of the sweep", &bodies(case, &run.filtered), &at_innermost(case, &filtered));
        let (b, biased) = biased_run(case);
        let whole = filtered + &case.d.phi * &b;
        let terms = force_terms(case, &b);
        case.holds_among("z^+ with b", &bodies(case, &biased.filtered), &at_innermost(case, &whole), &[&terms]);
    }
}

#[test]
fn eq_4_6_residuals() {
    for case in cases() {
        let (t, run) = centered_run(case);
        let scaled = Vector::from_fn(case.nv(), |i, _| run.innovations[i] * case.sweep.measured[i].pivot_inverse);
        let dense = &case.d.d_inv * (case.unit() - &case.d.l) * &t;
        let terms = column(&(&case.d.d_inv * t.abs()));
        case.holds_among("e^+ = D^-1 e^-", &column(&scaled), &column(&dense), &[&terms]);
    }
}

#[test]
fn eq_4_7_smoothing() {
    for case in cases() {
        let (t, run) = centered_run(case);
        let typed = (case.unit() - case.f.l.transpose()) * (&case.f.d_inv * &run.innovations);
        let dense = &case.d.m_inv * &t;
        let terms = column(&(case.d.m_inv.abs() * t.abs()));
        case.holds_among("a = (1 - L*) e^+", &column(&typed), &column(&dense), &[&terms]);
        case.holds_among("a of the sweep", &column(&run.accelerations), &column(&dense), &[&terms]);
    }
}

/// e^+, lambda^+ and lambda^- of every row by dense algebra: from their definitions, not from 4.8; and the magnitude
/// of their terms.
fn co_states(case: &Case, t: &Vector) -> (Vector, Vector, Vector, Matrix) {
    let d = &case.d;
    let e_plus = &d.d_inv * (case.unit() - &d.l) * t;
    let a = &d.m_inv * t;
    // Spatial accelerations: outboard of a joint with its own acceleration, inboard without.
    let minus = d.phi.transpose() * d.h.transpose() * &a;
    let plus = d.phi_strict.transpose() * d.h.transpose() * &a;
    let terms = column(&(d.phi.abs().transpose() * d.h.abs().transpose() * d.m_inv.abs() * t.abs()));
    (e_plus, plus, minus, terms)
}

#[test]
fn eq_4_8_co_states() {
    for case in cases() {
        let (t, run) = centered_run(case);
        let (_, plus, minus, terms) = co_states(case, &t);
        let e_plus = &case.f.d_inv * &run.innovations;
        let typed = case.f.psi.transpose() * case.f.h.transpose() * e_plus;
        case.holds_among("lambda^+ = Psi* H* e^+", &column(&typed), &column(&plus), &[&terms]);
        let outermost = bodies(case, &case.outermost(&minus));
        case.holds_among("lambda^- of the sweep = phi* H* a", &bodies(case, &run.co_states), &outermost, &[&terms]);
        // Printed as the lambda of 2.9, which is on the other side.
        case.fails("lambda^- = Psi* H* e^+", &column(&typed), &column(&minus));
    }
}

#[test]
fn eq_4_9_accelerations_from_residuals() {
    for case in cases() {
        let (t, run) = centered_run(case);
        let (e_plus, plus, minus, terms) = co_states(case, &t);
        let typed = |lambda: &Vector| column(&(&e_plus - case.f.g.transpose() * lambda));
        case.holds_among("a = e^+ - g* lambda^+", &typed(&plus), &column(&run.accelerations), &[&terms]);
        case.fails("a = e^+ - g* lambda^-", &typed(&minus), &column(&run.accelerations));
    }
}

#[test]
fn eq_4_10_co_states_outward() {
    for case in cases() {
        let (t, run) = centered_run(case);
        let (_, plus, minus, terms) = co_states(case, &t);
        let typed = case.f.e.transpose() * &minus;
        case.holds_among("lambda^+(k-1) = phi^T lambda^-(k)", &column(&typed), &column(&plus), &[&terms]);
        // With the results of the sweep, body by body; lambda^+ is zero at the base.
        for (k, stage) in case.scene.model().system.stages.iter().enumerate() {
            let carried = match stage.parent {
                Some(parent) => case.sweep.shift[k].motion_to_child(&run.co_states[parent]),
                None => Vector6::zeros(),
            };
            let expected = six(&plus, stage.first_row);
            let as_matrix = |x: &Vector6<f64>| Matrix::from_column_slice(6, 1, x.as_slice());
            case.holds_among("lambda^+(k)", &as_matrix(&carried), &as_matrix(&expected), &[&terms]);
        }
    }
}

#[test]
fn eq_4_11_co_states_across_a_joint() {
    for case in cases() {
        let (t, run) = centered_run(case);
        let (e_plus, plus, minus, terms) = co_states(case, &t);
        let (h, expected) = (case.f.h.transpose(), column(&minus));
        let with_a = &plus + &h * &run.accelerations;
        case.holds_among("lambda^- = lambda^+ + H* a", &column(&with_a), &expected, &[&terms]);
        let closed = case.f.a.transpose() * &plus + &h * &e_plus;
        case.holds_among("lambda^- = A* lambda^+ + H* e^+", &column(&closed), &expected, &[&terms]);
        case.fails("lambda^- = lambda^+ + H* e^+", &column(&(&plus + &h * &e_plus)), &expected);
    }
}
