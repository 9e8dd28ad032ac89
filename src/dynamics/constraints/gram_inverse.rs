//! The pseudoinverse of G = J M^-1 J*, and the combinations of rows that are kept if others count as dependent.

use crate::decompositions::eigenvalues;
use nalgebra::{Cholesky, DMatrix, DVector, DVectorViewMut, Dyn};

/// Eigenvalues of G, scaled to unit diagonal, below this are rounding errors.
const LOST: f64 = 1e-13;

/// A row of W that is smaller than this relative to its terms is zero: the row moves no joint.
pub(super) const NOTHING: f64 = 1e-12;

/// Pivots of G, scaled to unit diagonal, above this prove by the Cholesky factor alone that G is regular.
pub(super) const REGULAR: f64 = 1e-9;

/// G^+ for combinations C of the rows, C* (C G C*)^+ C. For C = 1 it is S B B* S, where S scales the diagonal of G to
/// one. B = L^-* of the Cholesky factor if G is regular, otherwise V mu^-1/2 over the eigenvalues mu above rounding.
#[derive(Debug, Clone, Default)]
pub(super) struct GramInverse {
    scale: Vec<f64>,
    factor: Factor,
    /// C; None if all rows are kept.
    kept: Option<DMatrix<f64>>,
    pub rank: usize,
}

#[derive(Debug, Clone)]
enum Factor {
    Cholesky(Cholesky<f64, Dyn>),
    /// V / sqrt(mu), (m x rank).
    Eigenvectors(DMatrix<f64>),
}

impl Default for Factor {
    fn default() -> Self {
        Self::Eigenvectors(DMatrix::zeros(0, 0))
    }
}

impl GramInverse {
    /// `sizes` are the squares of the rows of W without cancellation. None if the combinations of rows overflow.
    pub fn of(gram: &DMatrix<f64>, sizes: &[f64], kept: Option<&DMatrix<f64>>) -> Option<Self> {
        if let Some(kept) = kept {
            let size = |row: usize| (0..sizes.len()).map(|i| kept[(row, i)].powi(2) * sizes[i]).sum::<f64>();
            let combined: Vec<f64> = (0..kept.nrows()).map(size).collect();
            let of_combined = Self::of(&(kept * gram * kept.transpose()), &combined, None)?;
            return Some(Self { kept: Some(kept.clone()), ..of_combined });
        }
        let m = gram.nrows();
        if m == 0 {
            return Some(Self::default());
        }
        let moves = |i: usize| gram[(i, i)] > NOTHING * NOTHING * sizes[i];
        let scale: Vec<f64> = (0..m).map(|i| if moves(i) { gram[(i, i)].sqrt().recip() } else { 0.0 }).collect();
        let scaled = DMatrix::from_fn(m, m, |i, j| gram[(i, j)] * scale[i] * scale[j]);
        // The pivots are the squares of the diagonal.
        let is_regular = |factor: &Cholesky<f64, Dyn>| (0..m).all(|i| factor.l_dirty()[(i, i)].powi(2) > REGULAR);
        if let Some(factor) = Cholesky::new(scaled.clone()).filter(is_regular) {
            return Some(Self { scale, factor: Factor::Cholesky(factor), kept: None, rank: m });
        }
        let eigen = eigenvalues(scaled)?;
        let kept: Vec<usize> = (0..m).filter(|&i| eigen.eigenvalues[i] > LOST).collect();
        let vectors = DMatrix::from_fn(m, kept.len(), |i, j| {
            eigen.eigenvectors[(i, kept[j])] / eigen.eigenvalues[kept[j]].sqrt()
        });
        Some(Self { scale, factor: Factor::Eigenvectors(vectors), kept: None, rank: kept.len() })
    }

    /// G^+ x, into `out`.
    pub fn apply(&self, x: &[f64], out: &mut [f64]) {
        if let Some(kept) = &self.kept {
            let mut combined = kept * DVector::from_column_slice(x);
            self.solve(combined.as_mut_slice());
            out.copy_from_slice(kept.tr_mul(&combined).as_slice());
        } else {
            out.copy_from_slice(x);
            self.solve(out);
        }
    }

    /// (C G C*)^+ x, in place.
    fn solve(&self, out: &mut [f64]) {
        for (out, s) in out.iter_mut().zip(&self.scale) {
            *out *= s;
        }
        match &self.factor {
            Factor::Cholesky(factor) => {
                let rows = out.len();
                factor.solve_mut(&mut DVectorViewMut::from_slice(out, rows));
            }
            Factor::Eigenvectors(vectors) => {
                let scaled = DVector::from_column_slice(out);
                out.copy_from_slice((vectors * vectors.tr_mul(&scaled)).as_slice());
            }
        }
        for (out, s) in out.iter_mut().zip(&self.scale) {
            *out *= s;
        }
    }

    /// The sum of |`lambda_j`| divided by the scale of each row; zero for rows that move no joint.
    pub fn weighed(&self, forces: &[f64]) -> f64 {
        let scale = |i: usize| match &self.kept {
            Some(kept) => {
                kept.column(i).iter().zip(&self.scale).map(|(kept, scale)| (kept * scale).powi(2)).sum::<f64>().sqrt()
            }
            None => self.scale[i],
        };
        let weighed = forces.iter().enumerate().map(|(i, force)| (force.abs(), scale(i)));
        weighed.filter(|&(_, scale)| scale > 0.0).map(|(force, scale)| force / scale).sum()
    }

    /// C* S: the forces of the kept combinations, scaled.
    pub fn scaled_forces(&self) -> DMatrix<f64> {
        let mut forces = self
            .kept
            .as_ref()
            .map_or_else(|| DMatrix::identity(self.scale.len(), self.scale.len()), DMatrix::transpose);
        for (j, scale) in self.scale.iter().enumerate() {
            forces.column_mut(j).scale_mut(*scale);
        }
        forces
    }

    /// The columns of C* S B. They combine the rows of W* to orthonormal vectors.
    pub fn columns(&self) -> DMatrix<f64> {
        let mut columns = match &self.factor {
            Factor::Eigenvectors(vectors) => vectors.clone(),
            Factor::Cholesky(factor) => {
                let m = self.scale.len();
                let mut inverse = DMatrix::identity(m, m);
                // The diagonal has no zeros.
                factor.l_dirty().tr_solve_lower_triangular_mut(&mut inverse);
                inverse
            }
        };
        for (i, scale) in self.scale.iter().enumerate() {
            columns.row_mut(i).scale_mut(*scale);
        }
        self.kept.as_ref().map_or_else(|| columns.clone(), |kept| kept.tr_mul(&columns))
    }
}

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
