//! All tolerances of the Rust tests.
//!
//! Run a test with `PHIPSI_SHOW_RATIOS=1` and `--nocapture` to print the ratio of each value to its bound.

use phipsi::scalar::{DoubleDouble, Real};

/// A count as a factor of a bound.
#[allow(clippy::cast_precision_loss)] // counts of bodies and joints
pub fn count(n: usize) -> f64 {
    n as f64
}

/// The float32 bound of generated code for a rounding bound in float64.
pub fn single(bound: f64) -> f64 {
    bound * (f64::from(f32::EPSILON) / f64::EPSILON)
}

/// For products and sums without a solve: `c * n * eps * scale`.
pub fn product(n: usize, scale: f64) -> f64 {
    8.0 * count(n.max(1)) * f64::EPSILON * scale
}

/// Largest deviation of an estimate in standard errors: larger ones have a probability of 5e-10, and the seeds are
/// fixed.
pub const SIGMAS: f64 = 6.0;

/// Largest condition number of M of the random trees of `tests/lanes.rs`.
pub const CONDITION_OF_TREES: f64 = 1e6;

/// Ratio of the terms of the sums to the results, for these trees.
pub const TERMS_OF_TREES: f64 = 1e2;

/// Largest error relative to the largest entry for a form with full precision, independent of the condition number.
pub const ALL_DIGITS: f64 = 1e-13;

/// Through the inverse of a matrix with condition number `cond`.
pub fn inverse(cond: f64, scale: f64) -> f64 {
    16.0 * cond * f64::EPSILON * scale
}

/// An identity between matrices of the paper that involves a factorization: `2 cond eps scale`, of which a tenth is
/// used.
pub fn identity(cond: f64, scale: f64) -> f64 {
    2.0 * cond * f64::EPSILON * scale
}

/// A solution of `M x = b` whose both sides are accurate to a few units in the last place:
/// `c * eps * (cond(M) |x| + |M^-1| |b|)`, with `|b|` the magnitude of the terms of b.
pub fn solution(conditioning: &Conditioning, x: f64, b: f64) -> f64 {
    8.0 * f64::EPSILON * (conditioning.number * x + conditioning.inverse_norm * b)
}

/// Largest difference of positions, and of velocities relative to the largest, after a few steps of the same method in
/// two orders of operations.
pub const SAME_STEPS: f64 = 1e-11;

/// As [`SAME_STEPS`], for steps with contacts. The law is solved to 1e-10 of the fastest contact, and how four corners
/// share the weight of a block, hence its friction torque, depends on gaps that are rounding errors.
pub const SAME_CONTACTS: f64 = 1e-6;

/// Smallest error of a misprinted form, relative to the correct value: rounding is below 1e-12;
/// on random data such forms have errors of 0.1 to 10.
pub const PRINTED_FORM_MARGIN: f64 = 1e-3;

/// Largest deviation of a sample moment in standard errors; seeds are fixed, so that a test is reproducible.
pub const STANDARD_ERRORS: f64 = 6.0;

/// A sample mean of `n` samples of variance `variance`.
pub fn sample_mean(n: usize, variance: f64) -> f64 {
    STANDARD_ERRORS * (variance / count(n)).sqrt()
}

/// A sample covariance of `n` Gaussian samples of known mean: the product of two components has variance
/// `c_ii c_jj + c_ij^2`.
pub fn sample_covariance(n: usize, c_ii: f64, c_jj: f64, c_ij: f64) -> f64 {
    STANDARD_ERRORS * ((c_ii * c_jj + c_ij * c_ij) / count(n)).sqrt()
}

/// A sample mean of x* x over `n` Gaussian samples, of variance 2 tr(C C).
pub fn sample_mean_square(n: usize, trace_of_square: f64) -> f64 {
    STANDARD_ERRORS * (2.0 * trace_of_square / count(n)).sqrt()
}

/// Largest error of forward dynamics, in the max-norm and relative to the largest acceleration, if the sensitivity is
/// smaller.
pub const KEPT: f64 = 1e-12;

/// Accelerations below this value are zero up to the rounding error of double-double arithmetic.
pub const NOTHING: f64 = 1e-25;

/// Number of random changes by one unit in the last place for a sensitivity.
pub const ULP_DRAWS: u64 = 3;

/// [`KEPT`], or twenty times the sensitivity of the problem.
pub fn kept(sensitivity: f64) -> f64 {
    KEPT.max(20.0 * sensitivity)
}

/// Products and sums in double-double arithmetic, `n` terms.
pub fn double_double(n: usize, scale: f64) -> f64 {
    8.0 * count(n.max(1)) * f64::EPSILON * f64::EPSILON * scale
}

/// Half the distance of the two states of a central difference in double-double arithmetic, 2^-40.
pub const STEP: f64 = 9.094_947_017_729_282e-13;

/// A central difference with [`STEP`] in double-double arithmetic of a quantity of magnitude `scale` that
/// varies over times (or distances) of about 1: truncation, with a third derivative of up to 1e4 times its
/// magnitude, and rounding.
pub fn difference(n: usize, scale: f64) -> f64 {
    1e4 * STEP * STEP * scale + double_double(n, scale) / STEP
}

/// Amplification of errors by a matrix, in the 2-norm.
#[derive(Debug, Clone, Copy)]
pub struct Conditioning {
    pub number: f64,
    pub norm: f64,
    pub inverse_norm: f64,
}

/// Computed from the singular values of a square matrix, stored by rows (or columns).
pub fn conditioning(n: usize, matrix: &[f64]) -> Conditioning {
    if n == 0 {
        return Conditioning { number: 1.0, norm: 0.0, inverse_norm: 0.0 };
    }
    let s = nalgebra::DMatrix::from_row_slice(n, n, matrix).svd(false, false).singular_values;
    let (largest, smallest) = (s.max(), s.min());
    assert!(smallest > 0.0, "a singular matrix has no condition number");
    Conditioning { number: largest / smallest, norm: largest, inverse_norm: 1.0 / smallest }
}

/// Largest absolute entry; NaN if any is NaN.
pub fn size(values: &[f64]) -> f64 {
    if values.iter().any(|x| x.is_nan()) {
        return f64::NAN;
    }
    values.iter().fold(0.0, |m: f64, x| m.max(x.abs()))
}

/// The nearest f64.
pub fn to_f64(x: DoubleDouble) -> f64 {
    x.lane(0)
}

/// Asserts |a - b| <= bound; NaN fails.
#[track_caller]
pub fn assert_close(what: &str, a: f64, b: f64, bound: f64) {
    assert_near(what, &[a], &[b], bound);
}

/// Asserts |a - b| <= bound entry by entry; NaN fails.
#[track_caller]
pub fn assert_near(what: &str, a: &[f64], b: &[f64], bound: f64) {
    assert_eq!(a.len(), b.len(), "{what}: lengths");
    let mut worst = 0.0_f64;
    for (i, (x, y)) in a.iter().zip(b).enumerate() {
        assert!(
            (x - y).abs() <= bound,
            "{what}: entry {i}: {x} against {y}, off by {:e}, bound {bound:e}",
            (x - y).abs()
        );
        worst = worst.max((x - y).abs());
    }
    show_ratio(what, worst, bound);
}

/// Asserts |a - b| <= bound entry by entry, with the difference in double-double arithmetic; NaN fails.
#[track_caller]
pub fn assert_near_double(what: &str, a: &[DoubleDouble], b: &[DoubleDouble], bound: f64) {
    assert_eq!(a.len(), b.len(), "{what}: lengths");
    let error: Vec<f64> = a.iter().zip(b).map(|(&x, &y)| to_f64(x - y)).collect();
    for (i, error) in error.iter().enumerate() {
        assert!(error.abs() <= bound, "{what}: entry {i}: {} against {}, bound {bound:e}", a[i], b[i]);
    }
    show_ratio(what, size(&error), bound);
}

fn show_ratio(what: &str, worst: f64, bound: f64) {
    if worst > 0.0 && std::env::var_os("PHIPSI_SHOW_RATIOS").is_some() {
        eprintln!("ratio {:.3e} of bound {bound:.1e}: {what}", worst / bound);
    }
}

/// Max-norm error of the square-root form, in addition to the sensitivity of the problem to one unit in the last
/// place.
pub fn square_root(sensitivity: f64) -> f64 {
    (20.0 * sensitivity).max(1e-13)
}

/// The same for one acceleration relative to itself.
pub fn square_root_component(sensitivity: f64) -> f64 {
    (20.0 * sensitivity).max(1e-12)
}

/// Largest deviation of a measured order of convergence from that of the method.
pub const ORDER: f64 = 0.1;

/// Largest deflection of a spring of 1e8 N m/rad or more under the torques of the tests, rad.
pub const BENT: f64 = 1e-6;

/// Smallest deflection of the springs of 1e9 N m/rad of the moving rods, which carry about 1 N m.
pub const BENT_LEAST: f64 = 1e-10;

/// Error of 200 implicit steps of 1 ms along the slow motion with springs of 1e9 N m/rad, for the first order, which
/// is the largest.
pub const SLOW: f64 = 2e-3;

/// The same for third order, which is as large as the deflection of the springs.
pub const SLOW_ORDER_3: f64 = 1e-8;

/// Largest error of derivatives of forward dynamics on the extreme scenes in form `auto`, relative to their largest
/// entry.
pub const EXTREME_DERIVATIVES: f64 = 1e-11;

/// The same on random extreme scenes, for which estimated errors up to 1e-9 are accepted.
pub const CANCELLED_DERIVATIVES: f64 = 1e-7;

/// A mixed second difference with step 1e-4 of values of about 1: truncation, and rounding divided by 1e-8.
pub const MIXED_DIFFERENCE: f64 = 1e-6;
