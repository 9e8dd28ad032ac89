//! How a solve went, and how far one goes.

/// How a solve went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SolveReport {
    /// The largest |`F_i`| / `r_i` of a contact over the scale: a velocity beside the largest free velocity.
    pub residual: f64,
    /// What rounding of G p + c alone leaves of it.
    pub floor: f64,
    /// Whether the residual is below the tolerance or the floor.
    pub converged: bool,
    /// Matrices that were factorized: one for each step of Newton's method, of the interior method and along the curve.
    pub iterations: usize,
}

impl SolveReport {
    /// Nothing had to be done.
    pub fn nothing() -> Self {
        Self { residual: 0.0, floor: 0.0, converged: true, iterations: 0 }
    }

    /// The worse of two, and the iterations of both.
    pub fn with(self, other: Self) -> Self {
        let worse = if other.residual > self.residual || other.residual.is_nan() { other } else { self };
        let converged = self.converged && other.converged;
        Self { converged, iterations: self.iterations + other.iterations, ..worse }
    }
}

/// How far a solve goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Effort {
    /// The residual that is enough.
    pub tolerance: f64,
    /// How many starts the interior method has; where not all, no curve is followed either.
    pub attempts: usize,
    /// Steps of each method, at the most.
    pub iterations: usize,
}

impl Default for Effort {
    fn default() -> Self {
        Self { tolerance: 1e-10, attempts: usize::MAX, iterations: usize::MAX }
    }
}
