//! Diagnostics of a solve, and its limits.

/// Diagnostics of a solve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SolveReport {
    /// The largest |`F_i`| / `r_i` of a contact, relative to the largest free velocity.
    pub residual: f64,
    /// True if the residual is below the tolerance, or is that of rounding errors of G p + c alone.
    pub converged: bool,
    /// Number of steps of Newton's method, of the interior-point method and of the continuation.
    pub iterations: usize,
}

impl SolveReport {
    /// The report for a problem without iterations.
    pub fn nothing() -> Self {
        Self { residual: 0.0, converged: true, iterations: 0 }
    }

    /// The report with the larger residual, and the iterations of both.
    pub fn with(self, other: Self) -> Self {
        let worse = if other.residual > self.residual || other.residual.is_nan() { other } else { self };
        let converged = self.converged && other.converged;
        Self { converged, iterations: self.iterations + other.iterations, ..worse }
    }
}

/// The residual at which a solve ends.
pub(super) const TOLERANCE: f64 = 1e-10;

/// Limits of a solve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Effort {
    /// The residual at which the solve ends.
    pub tolerance: f64,
    /// Number of starts of the interior-point method; the continuation is used only if all are allowed.
    pub attempts: usize,
    /// Largest number of steps of each method.
    pub iterations: usize,
}

impl Default for Effort {
    fn default() -> Self {
        Self { tolerance: TOLERANCE, attempts: usize::MAX, iterations: usize::MAX }
    }
}
