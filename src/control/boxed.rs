//! The minimum of a quadratic function within bounds: the controls of one stage (D101).

use super::matrices::{factor, solve_lower, solve_upper};

/// Bounds of a change of the controls, (controls) each.
#[derive(Debug, Clone, Copy)]
pub struct Bounds<'a> {
    pub lower: &'a [f64],
    pub upper: &'a [f64],
}

/// Scratch, and the set of controls that no bound holds.
#[derive(Debug, Default)]
pub struct BoxedMinimum {
    free: Vec<usize>,
    triangle: Vec<f64>,
    slope: Vec<f64>,
    trial: Vec<f64>,
}

/// Largest number of rounds of the projected Newton method. Each changes the set of held controls or is the last.
const ROUNDS: usize = 100;

impl BoxedMinimum {
    pub fn new(controls: usize) -> Self {
        let nan = |length: usize| vec![f64::NAN; length];
        Self {
            free: Vec::with_capacity(controls),
            triangle: nan(controls * controls),
            slope: nan(controls),
            trial: nan(controls),
        }
    }

    /// The controls that no bound holds, in order.
    pub fn free(&self) -> &[usize] {
        &self.free
    }

    /// Cholesky's factor of the curvature of the free controls.
    pub fn factor(&self) -> &[f64] {
        &self.triangle
    }

    /// Minimizes 1/2 u* D u + g* u within the bounds, and writes u. Returns the smallest share of a pivot that remained,
    /// not positive if D is not positive definite.
    #[inline(always)]
    pub fn minimize(&mut self, d: &[f64], g: &[f64], bounds: Option<Bounds<'_>>, u: &mut [f64]) -> f64 {
        let m = u.len();
        self.free.clear();
        self.free.extend(0..m);
        let mut margin = self.newton(d, g, u, f64::INFINITY);
        let Some(Bounds { lower, upper }) = bounds else { return margin };
        let is_outside = |u: &[f64]| (0..m).any(|i| u[i] < lower[i] || u[i] > upper[i]);
        if !(margin > 0.0) || !is_outside(u) {
            return margin;
        }
        // The unbounded minimum, projected, is the first point.
        (0..m).for_each(|i| u[i] = u[i].clamp(lower[i], upper[i]));
        for _ in 0..ROUNDS {
            self.slope_at(d, g, u);
            let held = |i: usize, slope: f64| u[i] <= lower[i] && slope > 0.0 || u[i] >= upper[i] && slope < 0.0;
            self.free.clear();
            self.free.extend((0..m).filter(|&i| !held(i, self.slope[i])));
            let mut trial = std::mem::take(&mut self.trial);
            trial.copy_from_slice(u);
            margin = self.newton(d, g, &mut trial, margin);
            let is_done = !(margin > 0.0)
                || !is_outside(&trial) && {
                    u.copy_from_slice(&trial);
                    // Done if no held control wants to leave its bound.
                    self.slope_at(d, g, u);
                    let leaves = |&i: &usize| {
                        self.free.binary_search(&i).is_err()
                            && (u[i] <= lower[i] && self.slope[i] < 0.0 || u[i] >= upper[i] && self.slope[i] > 0.0)
                    };
                    !(0..m).any(|i| leaves(&i))
                };
            if !is_done && is_outside(&trial) {
                Self::descend((d, g), (lower, upper), &trial, u);
            }
            self.trial = trial;
            if is_done {
                break;
            }
        }
        margin
    }

    /// Replaces the free entries of u by those of the minimum for the held ones.
    #[inline(always)]
    fn newton(&mut self, d: &[f64], g: &[f64], u: &mut [f64], margin: f64) -> f64 {
        let (m, count) = (u.len(), self.free.len());
        for (a, &i) in self.free.iter().enumerate() {
            let held = (0..m).filter(|j| count < m && self.free.binary_search(j).is_err());
            self.slope[a] = -held.fold(g[i], |sum, j| sum + d[i * m + j] * u[j]);
            for (b, &j) in self.free.iter().enumerate() {
                self.triangle[a * count + b] = d[i * m + j];
            }
        }
        let margin = margin.min(factor(&mut self.triangle[..count * count], count));
        if margin > 0.0 {
            solve_lower(&self.triangle, count, &mut self.slope[..count], 1);
            solve_upper(&self.triangle, count, &mut self.slope[..count], 1);
            for (&i, &new) in self.free.iter().zip(&self.slope) {
                u[i] = new;
            }
        }
        margin
    }

    fn slope_at(&mut self, d: &[f64], g: &[f64], u: &[f64]) {
        let m = u.len();
        for (i, slope) in self.slope.iter_mut().enumerate() {
            *slope = (0..m).fold(g[i], |sum, j| sum + d[i * m + j] * u[j]);
        }
    }

    /// Moves u to `trial` along the projected path until the function decreases.
    fn descend((d, g): (&[f64], &[f64]), (lower, upper): (&[f64], &[f64]), trial: &[f64], u: &mut [f64]) {
        let m = u.len();
        let value = |u: &[f64]| -> f64 {
            (0..m).map(|i| u[i] * (g[i] + 0.5 * (0..m).map(|j| d[i * m + j] * u[j]).sum::<f64>())).sum()
        };
        let (start, before) = (u.to_vec(), value(u));
        let mut length = 1.0;
        while length > 1e-9 {
            (0..m).for_each(|i| u[i] = (start[i] + length * (trial[i] - start[i])).clamp(lower[i], upper[i]));
            if value(u) < before {
                return;
            }
            length *= 0.5;
        }
        u.copy_from_slice(&start);
    }
}
