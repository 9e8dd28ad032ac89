//! Samples of the random model: W with covariance Q, noise v with that of the armature, and bounds for
//! sample moments.

use super::Random;
use super::matrices::{Matrix, apply};
use super::paper::{Case, cases};
use super::tolerance::{self, sample_covariance, sample_mean, sample_mean_square};
use phipsi::operators::{Kind, Operator};
use std::sync::OnceLock;

/// Number of samples of every case.
pub const DRAWS: usize = 2000;

/// Every case with its samples, created once; case i with seed 1000 + i.
pub fn drawn() -> impl Iterator<Item = (&'static Case, &'static Draws)> {
    static DRAWN: OnceLock<Vec<Draws>> = OnceLock::new();
    let draws = DRAWN.get_or_init(|| cases().iter().zip(1000..).map(|(case, seed)| Draws::new(case, seed)).collect());
    cases().iter().zip(draws)
}

/// A standard normal value by the Box-Muller transform.
fn normal(random: &mut Random) -> f64 {
    let (u, angle) = (random.uniform(0.0, 1.0), random.uniform(0.0, std::f64::consts::TAU));
    (-2.0 * (1.0 - u).ln()).sqrt() * angle.cos()
}

/// Columns are samples: W - b with covariance Q, v with covariance diag(r), and derived quantities.
pub struct Draws {
    /// 6nv x samples.
    pub w: Matrix,
    /// nv x samples.
    pub v: Matrix,
    /// X = phi W.
    pub x: Matrix,
    /// T = H X + v, centered.
    pub t: Matrix,
}

impl Draws {
    /// Forces of the bodies by a Cholesky factor of each M(k); massless bodies have none.
    fn new(case: &Case, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let mut w = Matrix::zeros(6 * case.nv(), DRAWS);
        let model = case.scene.model();
        for (stage, body) in model.system.stages.iter().zip(&model.bodies) {
            let row = stage.first_row + stage.rows.count() - 1;
            if body.inertia.mass > 0.0 {
                let factor = body.inertia.to_symmetric().to_matrix().cholesky().expect("a body with mass").l();
                let white = nalgebra::Matrix6xX::from_fn(DRAWS, |_, _| normal(&mut random));
                w.rows_mut(6 * row, 6).copy_from(&(factor * white));
            }
        }
        let v = Matrix::from_fn(case.nv(), DRAWS, |i, _| model.system.noise[i].sqrt() * normal(&mut random));
        let factor = &case.factor;
        let x = apply(&factor.operator(Kind::Phi), &w);
        let t = apply(&factor.operator(Kind::H), &x) + &v;
        Self { w, v, x, t }
    }

    /// Predicted states Z^- = Psi g T (4.3).
    pub fn predicted(&self, case: &Case) -> Matrix {
        let factor = &case.factor;
        apply(&factor.operator(Kind::Psi).compose(factor.operator(Kind::Gain)), &self.t)
    }

    /// Filtered states Z^+ = (1 + A Psi) g T.
    pub fn filtered(&self, case: &Case) -> Matrix {
        let factor = &case.factor;
        let fresh = apply(&factor.operator(Kind::Gain), &self.t);
        &fresh + apply(&factor.operator(Kind::APsi), &fresh)
    }
}

/// Mean of x x* over the columns, for samples of known mean zero.
pub fn covariance(x: &Matrix) -> Matrix {
    x * x.transpose() / tolerance::count(x.ncols())
}

/// Largest difference of a sample covariance from `expected`, in units of its bound.
fn distance(sample: &Matrix, expected: &Matrix) -> f64 {
    assert_eq!(sample.shape(), expected.shape());
    // Exactly known entries, such as zeros, have the bound of rounding.
    let rounding = tolerance::inverse(1e3, tolerance::size(expected.as_slice()));
    let mut worst = 0.0_f64;
    for i in 0..expected.nrows() {
        for j in 0..expected.ncols() {
            let (c_ii, c_jj) = (expected[(i, i)].max(0.0), expected[(j, j)].max(0.0));
            let allowed = sample_covariance(DRAWS, c_ii, c_jj, expected[(i, j)]) + rounding;
            let off = (sample[(i, j)] - expected[(i, j)]).abs() / allowed;
            worst = if off <= worst || worst.is_nan() { worst } else { off };
        }
    }
    worst
}

/// Asserts that a sample covariance is this one.
#[track_caller]
pub fn has_covariance(what: &str, sample: &Matrix, expected: &Matrix) {
    assert!(sample.iter().any(|&x| x != 0.0), "{what}: draws of nothing");
    let off = distance(sample, expected);
    assert!(off <= 1.0, "{what}: sample covariance off by {off} times what {DRAWS} draws allow");
}

/// Asserts that a sample covariance clearly differs from the printed one.
#[track_caller]
pub fn has_not_covariance(what: &str, sample: &Matrix, printed: &Matrix) {
    let off = distance(sample, printed);
    assert!(off > 2.0, "{what}: the printed covariance is within {off} times what {DRAWS} draws allow");
}

/// Asserts that samples have this mean; `spread` is their covariance.
#[track_caller]
pub fn has_mean(what: &str, draws: &Matrix, expected: &[f64], spread: &Matrix) {
    let rounding = tolerance::inverse(1e3, tolerance::size(expected));
    for (i, (row, expected)) in draws.row_iter().zip(expected).enumerate() {
        let off = (row.mean() - expected).abs();
        let allowed = sample_mean(DRAWS, spread[(i, i)]) + rounding;
        assert!(off <= allowed, "{what}: entry {i} of the mean off by {off}, allowed {allowed}");
    }
}

/// Mean of x* x over the columns, and its bound for Gaussian samples with this covariance.
pub fn mean_square(draws: &Matrix, covariance: &Matrix) -> (f64, f64) {
    let trace_of_square = covariance.component_mul(&covariance.transpose()).sum();
    (draws.norm_squared() / tolerance::count(draws.ncols()), sample_mean_square(draws.ncols(), trace_of_square))
}
