//! The combinations of rows that are kept where the others count as dependent.

use nalgebra::DMatrix;

/// The combinations of rows that are kept at one configuration.
#[derive(Debug, Clone)]
pub(crate) struct Relaxed {
    /// Q; none where all are kept, or all that are not move nothing to rounding.
    pub projector: Option<DMatrix<f64>>,
    /// Independent combinations of rows that span what is kept, a row each: U* A^-1 of a group with some that are not kept, the rows themselves of others.
    pub basis: DMatrix<f64>,
    /// a of each row, with which errors have no unit.
    pub sizes: Vec<f64>,
    /// Bound on the errors of combinations that are not kept, in units of a; zero where all are kept.
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

    /// The combinations of rows that are kept, if some are not.
    pub fn basis(&self) -> Option<&DMatrix<f64>> {
        self.projector.is_some().then_some(&self.basis)
    }

    /// The row of `rest` that is further from holding than allowed: in units of a, over `speed`.
    pub fn beyond(&self, rest: &[f64], speed: f64) -> Option<usize> {
        let relative = |i: usize| rest[i].abs() / self.sizes[i];
        let within = |i: &usize| relative(*i) <= self.allowed * speed;
        let worst = (0..self.sizes.len()).max_by(|&i, &j| relative(i).total_cmp(&relative(j)))?;
        (self.projector.is_some() && !within(&worst)).then_some(worst)
    }
}
