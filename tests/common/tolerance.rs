//! Every tolerance of the Rust tests, in one place.
//!
//! Run a test with `PHIPSI_SHOW_RATIOS=1` and `--nocapture` to see how much of each bound it uses.

use phipsi::scalar::{DoubleDouble, Real};

/// A count as a factor of a bound.
#[allow(clippy::cast_precision_loss)] // counts of bodies and joints
pub fn count(n: usize) -> f64 {
    n as f64
}

/// What a bound on rounding in float64 is in float32, where the numbers of the scene are rounded too.
pub fn single(bound: f64) -> f64 {
    bound * (f64::from(f32::EPSILON) / f64::EPSILON)
}

/// How far sine and cosine in float32 may be off, in units in the last place: 0.80 is the most for any angle up to 1e5.
pub const SINGLE_ULPS: f64 = 0.81;

/// For products and sums without a solve: `c * n * eps * scale`.
pub fn product(n: usize, scale: f64) -> f64 {
    8.0 * count(n.max(1)) * f64::EPSILON * scale
}

/// Standard errors that an estimate may be off: one in two billion is further, and the seeds are fixed.
pub const SIGMAS: f64 = 6.0;

/// The condition number of M that the random trees of `tests/lanes.rs` stay below.
pub const CONDITION_OF_TREES: f64 = 1e6;

/// How much larger than the results the terms are that they are sums of, on those trees.
pub const TERMS_OF_TREES: f64 = 1e2;

/// Largest error over largest entry where a form claims to lose no digit, whatever the condition number.
pub const ALL_DIGITS: f64 = 1e-13;

/// Through the inverse of a matrix of condition number `cond`.
pub fn inverse(cond: f64, scale: f64) -> f64 {
    16.0 * cond * f64::EPSILON * scale
}

/// An identity between the paper's matrices that goes through a factorisation: `2 cond eps scale`, of which a tenth is used.
pub fn identity(cond: f64, scale: f64) -> f64 {
    2.0 * cond * f64::EPSILON * scale
}

/// A solution of `M x = b` where both sides are known to a few units in the last place:
/// `c * eps * (cond(M) |x| + |M^-1| |b|)`, with `|b|` the size of the terms that b is the sum of.
pub fn solution(conditioning: &Conditioning, x: f64, b: f64) -> f64 {
    8.0 * f64::EPSILON * (conditioning.number * x + conditioning.inverse_norm * b)
}

/// By how much a form that the paper misprints must fail, relative to the size of what it should be: rounding is 1e-12 and
/// less, on random data such forms are off by 0.1 to 10.
pub const PRINTED_FORM_MARGIN: f64 = 1e-3;

/// How many standard errors a sample moment may be off; seeds are fixed, so a test that passes keeps passing.
pub const STANDARD_ERRORS: f64 = 6.0;

/// A sample mean of `n` draws of variance `variance`.
pub fn sample_mean(n: usize, variance: f64) -> f64 {
    STANDARD_ERRORS * (variance / count(n)).sqrt()
}

/// A sample covariance of `n` Gaussian draws of known mean: the product of two components has variance
/// `c_ii c_jj + c_ij^2`.
pub fn sample_covariance(n: usize, c_ii: f64, c_jj: f64, c_ij: f64) -> f64 {
    STANDARD_ERRORS * ((c_ii * c_jj + c_ij * c_ij) / count(n)).sqrt()
}

/// A sample mean of x* x over `n` Gaussian draws, of variance 2 tr(C C).
pub fn sample_mean_square(n: usize, trace_of_square: f64) -> f64 {
    STANDARD_ERRORS * (2.0 * trace_of_square / count(n)).sqrt()
}

/// The error that forward dynamics may have, in the max norm and relative to the largest acceleration, where the problem allows it.
pub const KEPT: f64 = 1e-12;

/// Accelerations below this are none: what double-double arithmetic leaves of zero.
pub const NOTHING: f64 = 1e-25;

/// Draws of one unit in the last place from which a sensitivity is taken.
pub const ULP_DRAWS: u64 = 3;

/// [`KEPT`], or twenty times the problem's own sensitivity.
pub fn kept(sensitivity: f64) -> f64 {
    KEPT.max(20.0 * sensitivity)
}

/// Products and sums in double-double arithmetic, `n` terms.
pub fn double_double(n: usize, scale: f64) -> f64 {
    8.0 * count(n.max(1)) * f64::EPSILON * f64::EPSILON * scale
}

/// Half the distance between the two states of a central difference in double-double arithmetic, 2^-40.
pub const STEP: f64 = 9.094_947_017_729_282e-13;

/// A central difference over [`STEP`]s in double-double arithmetic of something of size `scale` that varies over times (or
/// distances) of about 1: truncation, its third derivative allowed 1e4 times its size, and rounding.
pub fn difference(n: usize, scale: f64) -> f64 {
    1e4 * STEP * STEP * scale + double_double(n, scale) / STEP
}

/// What a matrix does to errors, in the 2-norm.
#[derive(Debug, Clone, Copy)]
pub struct Conditioning {
    pub number: f64,
    pub norm: f64,
    pub inverse_norm: f64,
}

/// Measured from the singular values of a square matrix, row by row (or column by column).
pub fn conditioning(n: usize, matrix: &[f64]) -> Conditioning {
    if n == 0 {
        return Conditioning { number: 1.0, norm: 0.0, inverse_norm: 0.0 };
    }
    let s = nalgebra::DMatrix::from_row_slice(n, n, matrix).svd(false, false).singular_values;
    let (largest, smallest) = (s.max(), s.min());
    assert!(smallest > 0.0, "a singular matrix has no condition number");
    Conditioning { number: largest / smallest, norm: largest, inverse_norm: 1.0 / smallest }
}

/// Largest absolute entry; NaN where any is NaN.
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

/// Asserts |a - b| <= bound entry by entry, the difference taken in double-double arithmetic; NaN fails.
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

/// What the square-root form may be off in the max-norm, beside the problem's sensitivity to one unit in the last place.
pub fn square_root(sensitivity: f64) -> f64 {
    (20.0 * sensitivity).max(1e-13)
}

/// The same of one acceleration against its own size.
pub fn square_root_component(sensitivity: f64) -> f64 {
    (20.0 * sensitivity).max(1e-12)
}

/// How far a measured order of convergence may be from the method's.
pub const ORDER: f64 = 0.1;

/// The same of the largest error of one step, which is found at another time with another step.
pub const ORDER_OF_A_STEP: f64 = 0.3;

/// How many times the drift of energy may be what it is without momentum kept.
pub const ENERGY_KEEPING_MOMENTUM: f64 = 2.0;

/// What a solution of so many adaptive steps may be off that controls the error of each to `step`.
pub fn adaptive(steps: usize, step: f64) -> f64 {
    10.0 * count(steps) * step
}

/// How far a spring of 1e8 N m/rad and more gives way to the torques of the tests, rad.
pub const BENT: f64 = 1e-6;

/// How far the springs of 1e9 N m/rad of the swinging rods give way at the least: they carry about a N m.
pub const BENT_LEAST: f64 = 1e-10;

/// The error of 200 implicit steps of 1 ms along the slow motion beside springs of 1e9 N m/rad, the first order's the largest.
pub const SLOW: f64 = 2e-3;

/// The same of the third order, where what the springs give way by is as much.
pub const SLOW_ORDER_3: f64 = 1e-8;

/// The error that derivatives of forward dynamics may have on the extreme scenes in form `auto`, relative to their largest entry.
pub const EXTREME_DERIVATIVES: f64 = 1e-11;

/// The same on random extreme scenes, where digits may cancel down to 1e-9 by an estimate before more are taken.
pub const CANCELLED_DERIVATIVES: f64 = 1e-7;

/// A mixed second difference over 1e-4 of numbers of about 1: truncation, and rounding over 1e-8.
pub const MIXED_DIFFERENCE: f64 = 1e-6;
