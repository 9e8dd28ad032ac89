//! The largest estimated error of a result that form `auto` accepts.

use super::rounding::ROUNDING_MARGIN;

/// The bound of the covariance form, in eps of the largest entry: 5e-14 in f64.
const LEAST: f64 = 225.0;

/// The increase of the bound per row on the longest path to the base. The estimate is proportional to the number of
/// rows, the true error to its root: for chains of 100 to 10,000 links the estimate is 0.2 to 2.8 eps per row, 8 to 34
/// times the error.
const EACH_ROW: f64 = 4.0;

/// The default bound on the estimated error of products with derivatives, relative to their largest entry.
///
/// Their terms cancel in many states of many robots, and the sensitivity to one unit in the last place of the model is
/// not known. The estimate is eps times the terms. Over 2,200 random scenes, ordinary and extreme, the error is
/// typically half of the estimate, and in 99 of 100 scenes less than seven times the estimate. For robots it is below
/// 2e-12 (docs/derivatives.md).
const MOST_LOST: f64 = 1e-11;

/// The bound on the estimated error of a result, relative to its largest entry: the given tolerance, or the default for
/// the depth of the tree.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Tolerance {
    /// The tolerance given by the caller.
    pub given: Option<f64>,
    /// Number of rows on the longest path to the base.
    pub rows: usize,
}

impl Tolerance {
    /// Of the covariance form; the default is max(5e-14, 4 n eps).
    pub fn of_covariance(&self, epsilon: f64) -> f64 {
        self.or_usual(LEAST, epsilon)
    }

    /// Of the square-root form, whose estimates are closer; the default is max(2e-14, 4 n eps).
    pub fn of_roots(&self, epsilon: f64) -> f64 {
        self.or_usual(ROUNDING_MARGIN, epsilon)
    }

    /// Of products with derivatives.
    pub fn of_products(&self) -> f64 {
        self.given.unwrap_or(MOST_LOST)
    }

    #[allow(clippy::cast_precision_loss)] // a count
    fn or_usual(&self, least: f64, epsilon: f64) -> f64 {
        self.given.unwrap_or(epsilon * least.max(EACH_ROW * self.rows as f64))
    }
}
