//! Residuals of the identities of the paper at one state, compared with dense algebra or another algorithm.
//!
//! ```
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(4)?;
//! let list = phipsi::report::residuals::residuals(&scene, &[0.3; 4], &[0.1; 4], &[1.0; 4])?;
//! assert!(list.iter().all(|residual| residual.value <= 1e-10));
//! # Ok(())
//! # }
//! ```

use crate::dynamics;
use crate::error::Error;
use crate::interrupt;
use crate::kinematics::{ReferenceFrame, coordinate_rates};
use crate::model::Model;
use crate::operators::dense::{Composite, ldlt_from_tip};
use crate::operators::{Factor, Kind, Operator};
use crate::scalar::{DoubleDouble, Real};
use crate::scene::Scene;
use crate::workspace::Workspace;
use faer::Mat;
use faer::linalg::solvers::Solve;

/// An identity and its residual, relative to the largest entry of the reference.
#[derive(Debug, Clone, PartialEq)]
pub struct Residual {
    /// The identity.
    pub name: &'static str,
    /// Largest difference relative to the largest entry.
    pub value: f64,
    /// True if rounding errors of the comparison grow with the condition number of M.
    pub through_inverse: bool,
}

/// Largest |a - b| relative to the largest |b|; NaN if either contains NaN, and 0 for empty matrices.
fn relative(a: &Mat<f64>, b: &Mat<f64>) -> f64 {
    let (mut worst, mut scale) = (0.0_f64, 0.0_f64);
    for j in 0..b.ncols() {
        for i in 0..b.nrows() {
            let difference = (a[(i, j)] - b[(i, j)]).abs();
            worst = if difference <= worst || worst.is_nan() { worst } else { difference };
            scale = scale.max(b[(i, j)].abs());
        }
    }
    if b.nrows() * b.ncols() == 0 || worst == 0.0 { 0.0 } else { worst / scale.max(f64::MIN_POSITIVE) }
}

/// Largest entrywise |a - b| / |b|.
fn relative_each(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| ((x - y) / y).abs()).fold(0.0_f64, |m, r| if r <= m || m.is_nan() { m } else { r })
}

/// The matrix of an operator, from its sweep applied to the columns of the identity.
fn swept(factor: &Factor<f64>, kind: Kind) -> Result<Mat<f64>, Error> {
    let operator = factor.operator(kind);
    let (rows, columns) = operator.shape();
    let mut matrix = Mat::zeros(rows, columns);
    let (mut x, mut y) = (vec![0.0; columns], vec![0.0; rows]);
    for j in 0..columns {
        interrupt::check_at(j, 16)?;
        x[j] = 1.0;
        operator.apply(&x, &mut y);
        x[j] = 0.0;
        for (i, value) in y.iter().enumerate() {
            matrix[(i, j)] = *value;
        }
    }
    Ok(matrix)
}

fn column(values: &[f64]) -> Mat<f64> {
    Mat::from_fn(values.len(), 1, |i, _| values[i])
}

/// The residuals at `q` (factorization, operators, inverse) and, with `qd` and `tau`, of the dynamics. Connections are
/// ignored.
///
/// # Errors
///
/// Invalid arguments, a singular joint, or too many degrees of freedom for the dense operators.
pub fn residuals(scene: &Scene, q: &[f64], qd: &[f64], tau: &[f64]) -> Result<Vec<Residual>, Error> {
    if !scene.connections().is_empty() {
        return residuals(&scene.without_constraints()?, q, qd, tau);
    }
    let model = scene.model();
    let nv = scene.nv();
    let mut workspace = scene.workspace();
    let dense = scene.composite(q)?;
    let factor = scene.factor(&mut workspace, q)?;
    let mut list = Vec::new();
    let mut add = |name, value, through_inverse| list.push(Residual { name, value, through_inverse });

    let mut flat = vec![f64::NAN; nv * nv];
    scene.mass_matrix(&mut workspace, q, &mut flat)?;
    let m = Mat::from_fn(nv, nv, |i, j| flat[i * nv + j]);
    add("M by composite inertias (3.5) = H phi Q phi* H* (5.1)", relative(&m, &dense.mass_matrix()?), false);

    let one = Mat::<f64>::identity(nv, nv);
    let (k, l) = (swept(&factor, Kind::K)?, swept(&factor, Kind::L)?);
    let pivots: Vec<f64> = factor.pivots().collect();
    let d = Mat::from_fn(nv, nv, |i, j| if i == j { pivots[i] } else { 0.0 });
    let unit = &one + &k;
    add("M = (1 + K) D (1 + K*) (3.1)", relative(&(&unit * &d * unit.transpose()), &m), false);
    let (faer_unit, faer_d) = ldlt_from_tip(&m)?;
    add("1 + K = unit factor of faer's LDLT of M", relative(&unit, &faer_unit), true);
    add("D = diagonal of faer's LDLT of M", relative_each(&pivots, &faer_d), true);
    add("(1 + K)(1 - L) = 1 (3.2)", relative(&(&unit * (&one - &l)), &one), true);
    add("K = L + K L (3.14)", relative(&(&l + &k * &l), &k), true);
    add("K L = L K (3.14)", commutator(&k, &l), true);
    operators_against_definitions(&factor, &dense, &mut add)?;

    let mut inverse = vec![f64::NAN; nv * nv];
    scene.mass_matrix_inverse(&mut workspace, &mut scene.inverse_scratch(), q, &mut inverse)?;
    let inverse = Mat::from_fn(nv, nv, |i, j| inverse[i * nv + j]);
    add("M M^-1 = 1, M^-1 in closed form (6.1)", relative(&(&m * &inverse), &one), true);
    add("M^-1 (6.1) = (1 - L*) D^-1 (1 - L) (3.3)", relative(&inverse, &swept(&factor, Kind::MassInverse)?), true);

    add("Omega of two links by Lambda and Psi A = J M^-1 J*: operational space", operational(scene, q, &dense)?, true);

    let (mut qdd, mut back) = (vec![f64::NAN; nv], vec![f64::NAN; nv]);
    scene.forward_dynamics(&mut workspace, q, qd, tau, &[], &mut qdd)?;
    scene.inverse_dynamics(&mut workspace, q, qd, &qdd, &[], &mut back)?;
    // Relative to the bias also, which is a term of both sides and can be larger than tau.
    let mut bias = vec![f64::NAN; nv];
    scene.bias_torque(&mut workspace, q, qd, &mut bias)?;
    let (back, tau_beside) = ([&back[..], &bias].concat(), [tau, &bias].concat());
    add("inverse dynamics of forward dynamics = tau", relative(&column(&back), &column(&tau_beside)), true);
    add("power: d(energy)/dt = tau . qd", power_residual(model, q, qd, &qdd, tau), true);
    Ok(list)
}

/// Omega of the last link and of one halfway, in O(N), compared with a dense solve with M from its definition.
fn operational(scene: &Scene, q: &[f64], dense: &Composite) -> Result<f64, Error> {
    let nv = scene.nv();
    let names: Vec<&str> = scene.links().iter().map(|link| link.name.as_str()).collect();
    let links = [names[names.len() / 2], names[names.len() - 1]];
    let (mut omega, mut rows) = (vec![f64::NAN; 144], vec![f64::NAN; 12 * nv]);
    let (mut workspace, mut scratch) = (scene.workspace(), scene.operational_scratch());
    scene.operational_inverse_inertia(&mut workspace, &mut scratch, q, &links, &mut omega)?;
    let (first, second) = rows.split_at_mut(6 * nv);
    scene.jacobian(q, links[0], ReferenceFrame::Local, first)?;
    scene.jacobian(q, links[1], ReferenceFrame::Local, second)?;
    let jacobian = Mat::from_fn(12, nv, |i, k| rows[i * nv + k]);
    let solved = dense.mass_matrix()?.partial_piv_lu().solve(jacobian.transpose());
    Ok(relative(&Mat::from_fn(12, 12, |i, k| omega[12 * i + k]), &(&jacobian * solved)))
}

/// |K L - L K| relative to the size of the terms of the products.
fn commutator(k: &Mat<f64>, l: &Mat<f64>) -> f64 {
    let (left, right) = (k * l, l * k);
    relative(&left, &right)
}

/// phi, Psi, K, L, R, P and M as sweeps, compared with their definitions.
fn operators_against_definitions(
    factor: &Factor<f64>,
    dense: &Composite,
    add: &mut impl FnMut(&'static str, f64, bool),
) -> Result<(), Error> {
    for (name, kind, through_inverse) in [
        ("phi by sweep = (1 - E)^-1 (1.7)", Kind::Phi, false),
        ("Psi by sweep = (1 - E A)^-1 E (3.11)", Kind::Psi, true),
        ("R by sweep = phi Q phi* (2.3)", Kind::R, false),
        ("P by blocks = P by full matrices (3.6)", Kind::P, true),
        ("K by sweep = H Phi g (3.8)", Kind::K, true),
        ("L by sweep = H Psi g (3.14)", Kind::L, true),
        ("G by sweep = R H* M^-1 (2.2)", Kind::BatchGain, true),
        ("Lambda- = diagonal of phi* H* M^-1 H phi (5.6)", Kind::Lambda, true),
        ("Lambda+ = diagonal of Psi* H* D^-1 H Psi (5.7)", Kind::LambdaPlus, true),
        ("S by sweep = its definition (6.2)", Kind::S, true),
    ] {
        add(name, relative(&swept(factor, kind)?, &dense.matrix(kind)?), through_inverse);
    }
    Ok(())
}

/// |dE/dt - tau . qd| relative to the sum of |`tau_i` `qd_i`|, with dE/dt by a central difference in double-double
/// arithmetic.
fn power_residual(model: &Model<f64>, q: &[f64], qd: &[f64], qdd: &[f64], tau: &[f64]) -> f64 {
    let precise: Model<DoubleDouble> = model.cast();
    let mut workspace = Workspace::new(&precise);
    let (q, qd, qdd) = (DoubleDouble::each_of(q), DoubleDouble::each_of(qd), DoubleDouble::each_of(qdd));
    let mut rates = q.clone();
    coordinate_rates(&precise, &q, &qd, &mut rates);
    // The truncation error is quadratic in the step, 1e-18 here; rounding adds 1e-31 / 1e-9.
    let step = DoubleDouble::from_f64(1e-9);
    let moved = |x: &[DoubleDouble], v: &[DoubleDouble], h: DoubleDouble| -> Vec<DoubleDouble> {
        x.iter().zip(v).map(|(x, v)| *x + *v * h).collect()
    };
    let mut total = |h: DoubleDouble| {
        let energy = dynamics::energy(&precise, &mut workspace, &moved(&q, &rates, h), &moved(&qd, &qdd, h));
        energy.kinetic + energy.potential
    };
    let change = total(step) - total(-step);
    let power = (change / (step + step)).lane(0);
    let terms = || tau.iter().zip(&qd).map(|(t, v)| t * v.lane(0));
    let given: f64 = terms().sum();
    let scale: f64 = terms().map(f64::abs).sum();
    if scale == 0.0 { (power - given).abs() } else { (power - given).abs() / scale }
}
