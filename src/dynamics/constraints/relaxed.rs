//! The combinations of rows that are kept if others count as dependent.

use nalgebra::DMatrix;

/// The combinations of rows that are kept at one configuration.
#[derive(Debug, Clone)]
pub(crate) struct Relaxed {
    /// Q; None if all combinations are kept, or if the dropped ones move no joint to rounding.
    pub projector: Option<DMatrix<f64>>,
    /// Independent combinations that span the kept rows, one per row: U* A^-1 for a group with dropped combinations,
    /// the rows themselves for other groups.
    pub basis: DMatrix<f64>,
    /// a of each row, which makes errors dimensionless.
    pub sizes: Vec<f64>,
    /// Bound on the errors of dropped combinations, in units of a; zero if all are kept.
    pub allowed: f64,
}

impl Default for Relaxed {
    fn default() -> Self {
        Self { projector: None, basis: DMatrix::zeros(0, 0), sizes: Vec::new(), allowed: 0.0 }
    }
}

impl Relaxed {
    /// Q x into x, and (1 - Q) x into `rest`.
    pub fn split(&self, x: &mut [f64], rest: &mut [f64]) {
        rest.fill(0.0);
        let Some(projector) = &self.projector else { return };
        rest.copy_from_slice(x);
        for (i, x) in x.iter_mut().enumerate() {
            *x = projector.row(i).iter().zip(&*rest).map(|(q, x)| q * x).sum();
        }
        for (rest, x) in rest.iter_mut().zip(x) {
            *rest -= *x;
        }
    }

    /// The combinations of rows that are kept, if some are dropped.
    pub fn basis(&self) -> Option<&DMatrix<f64>> {
        self.projector.is_some().then_some(&self.basis)
    }

    /// The row of `rest` that exceeds the allowed error the most, in units of a, divided by `speed`.
    pub fn beyond(&self, rest: &[f64], speed: f64) -> Option<usize> {
        let relative = |i: usize| rest[i].abs() / self.sizes[i];
        let within = |i: &usize| relative(*i) <= self.allowed * speed;
        let worst = (0..self.sizes.len()).max_by(|&i, &j| relative(i).total_cmp(&relative(j)))?;
        (self.projector.is_some() && !within(&worst)).then_some(worst)
    }
}
