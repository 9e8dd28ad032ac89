//! One step: the exact minimum of a convex quadratic within limits.

/// The quadratic g d + d A d / 2 with lower <= d <= upper, where d = 0 is admissible, and scratch memory.
#[derive(Debug, Clone, Default)]
pub struct BoxStep {
    n: usize,
    factor: Vec<f64>,
    free: Vec<usize>,
    solved: Vec<usize>,
    slope: Vec<f64>,
    newton_step: Vec<f64>,
    trial: Vec<f64>,
}

/// Largest number of halvings of a step along the projected path.
const HALVINGS: usize = 30;
/// A step that comes this close to a limit, relative to its length, ends at the limit.
const MEETS: f64 = 1e-12;

impl BoxStep {
    pub fn new(n: usize) -> Self {
        let numbers = || vec![f64::NAN; n];
        Self {
            n,
            factor: vec![f64::NAN; n * n],
            free: Vec::with_capacity(n),
            solved: Vec::with_capacity(n),
            slope: numbers(),
            newton_step: numbers(),
            trial: numbers(),
        }
    }

    /// The coordinates of the last minimizer that no limit holds, in order.
    pub fn free(&self) -> &[usize] {
        &self.free
    }

    /// Cholesky's factor of A on the free coordinates, in the first entries of rows of n.
    pub fn factor(&self) -> &[f64] {
        &self.factor
    }

    /// Writes the minimizer to `step`. Returns false if A is not positive definite on the free coordinates.
    ///
    /// Projected Newton method: coordinates at a limit with an outward gradient are fixed, the others take the Newton
    /// step, projected onto the limits. If the quadratic does not decrease along that path, the step ends at the first
    /// limit. Ends after a full step with an unchanged set of free coordinates. O(n^3) per round; usually two or three
    /// rounds.
    pub fn minimize(&mut self, a: &[f64], g: &[f64], room: impl Fn(usize) -> (f64, f64), step: &mut [f64]) -> bool {
        let n = self.n;
        step.fill(0.0);
        let mut whole = false;
        for _ in 0..4 * n + 4 {
            for i in 0..n {
                self.slope[i] = g[i] + (0..n).map(|j| a[i * n + j] * step[j]).sum::<f64>();
            }
            std::mem::swap(&mut self.free, &mut self.solved);
            self.free.clear();
            for (i, &at) in step.iter().enumerate() {
                let (lower, upper) = room(i);
                let is_held = (at <= lower && self.slope[i] > 0.0) || (at >= upper && self.slope[i] < 0.0);
                if !is_held {
                    self.free.push(i);
                }
            }
            // Solved for this set of free coordinates, and no fixed coordinate has an inward gradient.
            if self.free.is_empty() || (whole && self.free == self.solved) {
                return true;
            }
            // Fixes coordinates at a limit that the Newton step would cross.
            loop {
                if !self.newton(a) {
                    return false;
                }
                let (count, mut at) = (self.free.len(), 0);
                let newton_step = &self.newton_step;
                self.free.retain(|&i| {
                    let ((lower, upper), component) = (room(i), newton_step[at]);
                    at += 1;
                    !(step[i] >= upper && component > 0.0 || step[i] <= lower && component < 0.0)
                });
                if self.free.len() == count || self.free.is_empty() {
                    break;
                }
            }
            let was = quadratic(a, g, step);
            let (mut length, mut bent, mut shortened) = (1.0, false, false);
            let mut first = 1.0_f64;
            for (&i, &component) in self.free.iter().zip(&self.newton_step) {
                let (lower, upper) = room(i);
                let limit = if component > 0.0 { upper } else { lower };
                if component != 0.0 {
                    first = first.min((limit - step[i]) / component);
                }
            }
            for halving in 0..HALVINGS {
                bent = false;
                self.trial.copy_from_slice(step);
                for (&i, &component) in self.free.iter().zip(&self.newton_step) {
                    let (lower, upper) = room(i);
                    let to = step[i] + length * component;
                    let limit = if component > 0.0 { upper } else { lower };
                    // Ends exactly at the limit; rounding would otherwise leave a small step for the next round.
                    let meets = (length * component).abs() >= (1.0 - MEETS) * (limit - step[i]).abs();
                    self.trial[i] = if meets { limit } else { to };
                    bent |= to < lower || to > upper;
                }
                if !bent && halving == 0 {
                    break;
                }
                let fall: f64 = self.free.iter().map(|&i| self.slope[i] * (self.trial[i] - step[i])).sum();
                if quadratic(a, g, &self.trial) <= was + 1e-4 * fall {
                    break;
                }
                // The quadratic decreases monotonically up to the first limit.
                (length, shortened) = (if halving == 0 { first } else { 0.5 * length }, true);
            }
            step.copy_from_slice(&self.trial);
            whole = !bent && !shortened;
        }
        true
    }

    /// Computes the Newton step of the free coordinates by Cholesky factorization.
    fn newton(&mut self, a: &[f64]) -> bool {
        let (n, m) = (self.n, self.free.len());
        for i in 0..m {
            for j in 0..=i {
                let mut sum = a[self.free[i] * n + self.free[j]];
                for k in 0..j {
                    sum -= self.factor[i * n + k] * self.factor[j * n + k];
                }
                if i == j {
                    if !(sum > 0.0) {
                        return false;
                    }
                    self.factor[i * n + i] = sum.sqrt();
                } else {
                    self.factor[i * n + j] = sum / self.factor[j * n + j];
                }
            }
        }
        for i in 0..m {
            let sum: f64 = (0..i).map(|k| self.factor[i * n + k] * self.newton_step[k]).sum();
            self.newton_step[i] = (-self.slope[self.free[i]] - sum) / self.factor[i * n + i];
        }
        for i in (0..m).rev() {
            let sum: f64 = (i + 1..m).map(|k| self.factor[k * n + i] * self.newton_step[k]).sum();
            self.newton_step[i] = (self.newton_step[i] - sum) / self.factor[i * n + i];
        }
        true
    }

    /// Writes the inverse of A, restricted to the rows of `is_free`, to `out`, with zeros elsewhere. Returns whether A
    /// is positive definite there.
    pub fn inverse(&mut self, a: &[f64], is_free: impl Fn(usize) -> bool, out: &mut [f64]) -> bool {
        let n = self.n;
        out.fill(0.0);
        self.free.clear();
        self.free.extend((0..n).filter(|&i| is_free(i)));
        for column in 0..self.free.len() {
            self.slope.fill(0.0);
            self.slope[self.free[column]] = -1.0;
            if !self.newton(a) {
                return false;
            }
            for (&i, &value) in self.free.iter().zip(&self.newton_step) {
                out[i * n + self.free[column]] = value;
            }
        }
        true
    }
}

/// Adds J^T J to `a`, (n x n), row-major, and J^T e to `g`.
pub fn add_squares(jacobian: &[f64], errors: &[f64], a: &mut [f64], g: &mut [f64]) {
    let n = g.len();
    for (row, &error) in jacobian.chunks_exact(n.max(1)).zip(errors) {
        for (i, &of_i) in row.iter().enumerate().filter(|(_, of_i)| **of_i != 0.0) {
            g[i] += of_i * error;
            for (entry, &of_j) in a[i * n..=i * n + i].iter_mut().zip(row) {
                *entry += of_i * of_j;
            }
        }
    }
    for i in 0..n {
        for j in 0..i {
            a[j * n + i] = a[i * n + j];
        }
    }
}

/// g d + d A d / 2.
pub fn quadratic(a: &[f64], g: &[f64], d: &[f64]) -> f64 {
    let n = d.len();
    (0..n).map(|i| d[i] * (g[i] + 0.5 * (0..n).map(|j| a[i * n + j] * d[j]).sum::<f64>())).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The best admissible point over all choices of coordinates fixed at a limit.
    fn by_trying_all(a: &[f64], g: &[f64], lower: &[f64], upper: &[f64]) -> f64 {
        let n = g.len();
        let mut best = f64::INFINITY;
        for choice in 0..3_usize.pow(u32::try_from(n).unwrap()) {
            let of = |i: usize| choice / 3_usize.pow(u32::try_from(i).unwrap()) % 3;
            let fixed = nalgebra::DVector::from_fn(n, |i, _| [0.0, lower[i], upper[i]][of(i)]);
            let free: Vec<usize> = (0..n).filter(|&i| of(i) == 0).collect();
            let full = nalgebra::DMatrix::from_row_slice(n, n, a);
            let slope = nalgebra::DVector::from_row_slice(g) + &full * &fixed;
            let part = nalgebra::DMatrix::from_fn(free.len(), free.len(), |i, j| full[(free[i], free[j])]);
            let right = nalgebra::DVector::from_fn(free.len(), |i, _| -slope[free[i]]);
            let mut d: Vec<f64> = fixed.as_slice().to_vec();
            if !free.is_empty() {
                let solved = part.lu().solve(&right).expect("positive definite");
                free.iter().zip(solved.iter()).for_each(|(&i, &x)| d[i] = x);
            }
            if (0..n).all(|i| d[i] >= lower[i] - 1e-12 && d[i] <= upper[i] + 1e-12) {
                best = best.min(quadratic(a, g, &d));
            }
        }
        best
    }

    #[test]
    fn it_is_the_best_of_all_choices() {
        let mut state = 7_u64;
        let mut draw = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            f64::from(u32::try_from(state >> 33).unwrap()) / f64::from(1_u32 << 30) - 1.0
        };
        for (n, penalty) in (1..6).flat_map(|n| [(n, 0.0), (n, 1e4)]) {
            for _ in 0..40 {
                let root = nalgebra::DMatrix::from_fn(n, n, |_, _| draw());
                // With a large penalty on one row, as for connections.
                let row = nalgebra::DVector::from_fn(n, |_, _| draw());
                let a = &root * root.transpose()
                    + nalgebra::DMatrix::identity(n, n) * 0.1
                    + &row * row.transpose() * penalty;
                let a: Vec<f64> = a.transpose().as_slice().to_vec();
                let g: Vec<f64> = (0..n).map(|_| 3.0 * draw()).collect();
                let lower: Vec<f64> = (0..n).map(|_| -draw().abs()).collect();
                let upper: Vec<f64> = (0..n).map(|_| draw().abs()).collect();
                let mut step = vec![f64::NAN; n];
                assert!(BoxStep::new(n).minimize(&a, &g, |i| (lower[i], upper[i]), &mut step));
                assert!((0..n).all(|i| step[i] >= lower[i] && step[i] <= upper[i]));
                let (found, best) = (quadratic(&a, &g, &step), by_trying_all(&a, &g, &lower, &upper));
                assert!((found - best).abs() <= 1e-9 * best.abs().max(1.0), "{found} {best}");
            }
        }
    }

    #[test]
    fn a_problem_without_minimum_is_reported() {
        let mut step = [f64::NAN];
        assert!(!BoxStep::new(1).minimize(&[0.0], &[1.0], |_| (-1.0, 1.0), &mut step));
    }
}
