//! Error estimates of the joint accelerations of one state, and the factorization form that computed them.

use crate::error::name_in;
use crate::filter::{FORMS, Form};
use crate::scalar::Real;

/// The factorization form that computed the joint accelerations of a state, and their estimated error.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Accuracy {
    /// The form; for `auto`, the form that it selected.
    pub form: Form,
    /// True if the square-root form ran in double-double arithmetic, with its result rounded to f64.
    pub doubled: bool,
    /// Estimated absolute error of the largest acceleration, rad/s^2 or m/s^2. NaN if there is no estimate, as for a
    /// singular pivot.
    ///
    /// The estimator propagates one or two additional right-hand sides. The estimate is typically five to ten times the
    /// true error; [`ESTIMATE_SPREAD`] bounds how far it can be below. It excludes rounding errors made before the
    /// sweeps, in phi and b, which are the same in every form.
    pub error: f64,
    /// The bound that the estimated error satisfies.
    pub bound: Bound,
}

/// The bound that an estimated error satisfies. Form `auto` accepts a result that satisfies one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Bound {
    /// The tolerance, relative to the largest acceleration.
    Tolerance,
    /// The sensitivity of the problem: a multiple of the change of the accelerations for a change of the forces by one
    /// unit in the last place.
    Sensitivity,
    /// Square-root form only: pivots and gains were within limits for which its rounding error is small, regardless of
    /// the estimate.
    Pivots,
    /// None of them; no more accurate result is available.
    Neither,
    /// There is no estimate.
    Unknown,
}

/// All bounds with their Python names.
const BOUNDS: [(&str, Bound); 5] = [
    ("tolerance", Bound::Tolerance),
    ("sensitivity", Bound::Sensitivity),
    ("pivots", Bound::Pivots),
    ("neither", Bound::Neither),
    ("unknown", Bound::Unknown),
];

impl Bound {
    /// The name used in Python.
    #[must_use]
    pub fn name(self) -> &'static str {
        BOUNDS.iter().find(|(_, bound)| *bound == self).map_or("", |(name, _)| name)
    }
}

/// Largest ratio of the true error to the estimated error, above all ratios observed in 400,000 random cases.
///
/// The cases include ordinary and extreme mechanisms, in rest, free fall, static equilibrium and motion; rounding
/// errors made before the sweeps are excluded. One in 10,000 cases exceeded a ratio of 20: a single right-hand side
/// detects most errors, but can miss one.
pub const ESTIMATE_SPREAD: f64 = 1000.0;

impl Accuracy {
    /// For a form without an error estimate.
    #[must_use]
    pub fn unknown(form: Form) -> Self {
        Self { form, doubled: false, error: f64::NAN, bound: Bound::Unknown }
    }

    /// Adds the bound that the error satisfies: the tolerance relative to the largest acceleration, or, for a result
    /// that was accepted despite a larger estimate, the sensitivity.
    pub(crate) fn judged(self, tolerance: f64, largest: f64, is_accepted: bool) -> Self {
        let bound = if self.error.is_nan() {
            Bound::Unknown
        } else if self.error <= tolerance * largest {
            Bound::Tolerance
        } else if is_accepted {
            Bound::Sensitivity
        } else {
            Bound::Neither
        };
        Self { bound, ..self }
    }

    /// The name of the form in Python: that of [`FORMS`](crate::filter::FORMS), or "double-double".
    #[must_use]
    pub fn name(&self) -> &'static str {
        if self.doubled {
            return "double-double";
        }
        name_in(&self.form, FORMS)
    }
}

/// Largest absolute number of lane 0; NaN does not count.
pub(crate) fn largest<T: Real>(x: &[T]) -> f64 {
    x.iter().fold(0.0_f64, |largest, x| largest.max(x.abs().lane(0)))
}
