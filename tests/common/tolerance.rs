//! Every tolerance of the Rust tests, in one place.

/// For products and sums without a solve: `c * n * eps * scale`.
pub fn product(n: usize, scale: f64) -> f64 {
    64.0 * (n.max(1) as f64) * f64::EPSILON * scale
}

/// Through the inverse of a matrix of condition number `cond`.
pub fn inverse(cond: f64, scale: f64) -> f64 {
    64.0 * cond * f64::EPSILON * scale
}

/// Largest absolute entry.
pub fn size(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m: f64, x| m.max(x.abs()))
}

/// Asserts |a - b| <= bound entry by entry; NaN fails.
#[track_caller]
pub fn assert_near(what: &str, a: &[f64], b: &[f64], bound: f64) {
    assert_eq!(a.len(), b.len(), "{what}: lengths");
    for (i, (x, y)) in a.iter().zip(b).enumerate() {
        assert!(
            (x - y).abs() <= bound,
            "{what}: entry {i}: {x} against {y}, off by {:e}, bound {bound:e}",
            (x - y).abs()
        );
    }
}
