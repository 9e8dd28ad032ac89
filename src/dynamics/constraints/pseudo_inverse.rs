//! The inverse of a Gram matrix where it has one.

use nalgebra::{DMatrix, DVector};

/// Eigenvalues of G, its diagonal scaled to one, that are lost in the rounding of its entries.
const LOST: f64 = 1e-13;

/// A row of W that is so small beside the terms that it is formed from moves nothing.
const NOTHING: f64 = 1e-12;

/// G^+ = S V mu^-1 V* S, S the scale that makes G's diagonal one, over the eigenvalues mu that mean something.
#[derive(Debug, Clone, Default)]
pub(super) struct GramInverse {
    scale: Vec<f64>,
    /// Columns V / sqrt(mu), (m x rank).
    vectors: DMatrix<f64>,
    pub rank: usize,
}

impl GramInverse {
    pub fn of(gram: &DMatrix<f64>, sizes: &[f64]) -> Self {
        let m = gram.nrows();
        if m == 0 {
            return Self::default();
        }
        let moves = |i: usize| gram[(i, i)] > (NOTHING * sizes[i]).powi(2);
        let scale: Vec<f64> = (0..m).map(|i| if moves(i) { gram[(i, i)].sqrt().recip() } else { 0.0 }).collect();
        let scaled = DMatrix::from_fn(m, m, |i, j| gram[(i, j)] * scale[i] * scale[j]);
        let eigen = scaled.symmetric_eigen();
        let kept: Vec<usize> = (0..m).filter(|&i| eigen.eigenvalues[i] > LOST).collect();
        let vectors = DMatrix::from_fn(m, kept.len(), |i, j| {
            eigen.eigenvectors[(i, kept[j])] / eigen.eigenvalues[kept[j]].sqrt()
        });
        Self { scale, vectors, rank: kept.len() }
    }

    /// G^+ x, into `out`.
    pub fn apply(&self, x: &[f64], out: &mut [f64]) {
        let scaled = DVector::from_iterator(x.len(), x.iter().zip(&self.scale).map(|(x, s)| x * s));
        let result = &self.vectors * self.vectors.tr_mul(&scaled);
        for ((out, y), s) in out.iter_mut().zip(result.iter()).zip(&self.scale) {
            *out = y * s;
        }
    }

    /// S: zero for rows that move nothing.
    pub fn scale(&self) -> &[f64] {
        &self.scale
    }

    /// The columns of S V mu^-1/2: rows of W*, combined by them, are orthonormal.
    pub fn columns(&self) -> DMatrix<f64> {
        let mut columns = self.vectors.clone();
        for (i, scale) in self.scale.iter().enumerate() {
            columns.row_mut(i).scale_mut(*scale);
        }
        columns
    }
}
