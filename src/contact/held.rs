//! Impulses for which no contact moves, by the Cholesky factor of G.

use super::gram::Gram;
use super::law::Cone;
use nalgebra::DVector;

/// Pivots of G above this fraction of its diagonal prove that its rows are independent, so that impulses are unique.
const INDEPENDENT: f64 = 1e-6;

/// A contact sticks at the start if its friction is below its bound by this fraction.
const BELOW: f64 = 1e-9;

/// The Cholesky factor of the rows of G on which impulses act: contacts without friction have normal impulses only.
pub(super) struct Held {
    /// The rows of G.
    rows: Vec<usize>,
    /// L, row by row, with the inverses of its diagonal in place of the diagonal.
    factor: Vec<f64>,
}

impl Held {
    /// The factor of G; `None` if its rows can be dependent.
    pub fn of(cone: &Cone) -> Option<Self> {
        // More rows than joints are dependent.
        let Gram::Dense(g) = &cone.g else { return None };
        let acts = |row: &usize| row % 3 == 2 || cone.friction[row / 3] > 0.0;
        let rows: Vec<usize> = (0..g.nrows()).filter(acts).collect();
        let m = rows.len();
        let mut factor = vec![0.0; m * m];
        for j in 0..m {
            let (before, own) = factor.split_at_mut(j * m);
            let own = &mut own[..=j];
            for (entry, &row) in own.iter_mut().zip(&rows) {
                *entry = g[(row, rows[j])];
            }
            let diagonal = own[j];
            for i in 0..j {
                let other = &before[i * m..=i * m + i];
                let products = own[..i].iter().zip(other).map(|(a, b)| a * b);
                own[i] = (own[i] - products.sum::<f64>()) * other[i];
            }
            let pivot = diagonal - own[..j].iter().map(|x| x * x).sum::<f64>();
            if !(pivot > INDEPENDENT * diagonal) {
                return None;
            }
            own[j] = pivot.sqrt().recip();
        }
        Some(Self { rows, factor })
    }

    /// -G^-1 c.
    pub fn impulses(&self, c: &DVector<f64>) -> DVector<f64> {
        let m = self.rows.len();
        let mut x: Vec<f64> = self.rows.iter().map(|&row| -c[row]).collect();
        for i in 0..m {
            let own = &self.factor[i * m..=i * m + i];
            let products = own[..i].iter().zip(&x).map(|(a, x)| a * x);
            x[i] = (x[i] - products.sum::<f64>()) * own[i];
        }
        for i in (0..m).rev() {
            let own = &self.factor[i * m..=i * m + i];
            let (before, rest) = x.split_at_mut(i);
            rest[0] *= own[i];
            for (x, entry) in before.iter_mut().zip(own) {
                *x -= entry * rest[0];
            }
        }
        let mut impulses = DVector::zeros(c.len());
        for (&row, x) in self.rows.iter().zip(x) {
            impulses[row] = x;
        }
        impulses
    }
}

impl Cone {
    /// True if all contacts stick at `start`, or if it has no impulses.
    pub(super) fn may_stick(&self, start: Option<&DVector<f64>>) -> bool {
        let Some(p) = start else { return true };
        let sticks = |i: usize| {
            let bound = self.friction[i] * p[3 * i + 2];
            p[3 * i + 2] > 0.0 && p[3 * i].hypot(p[3 * i + 1]) <= (1.0 - BELOW) * bound
        };
        (0..self.len()).all(sticks) || p.iter().all(|&p| p == 0.0)
    }
}
