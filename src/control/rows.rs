//! The rows of a cost: residuals of all knots with the entries of their derivatives.

/// Residuals r, divided by their standard deviations, and their derivatives by (dq, dv, p, u), of all knots. The cost
/// is half the sum of their squares.
#[derive(Debug, Clone, Default)]
pub struct Rows {
    entries: Vec<Row>,
    values: Vec<f64>,
    /// The number of entries before each knot, and after the last.
    knots: Vec<usize>,
}

/// One residual: its derivative is zero but for `length` entries from column `start` on.
#[derive(Debug, Clone, Copy)]
struct Row {
    error: f64,
    start: usize,
    first: usize,
    length: usize,
}

impl Rows {
    pub fn clear(&mut self) {
        self.entries.clear();
        self.values.clear();
        self.knots.clear();
        self.knots.push(0);
    }

    /// Adds a residual to the current knot.
    pub fn push(&mut self, error: f64, start: usize, values: impl IntoIterator<Item = f64>) {
        let first = self.values.len();
        self.values.extend(values);
        self.entries.push(Row { error, start, first, length: self.values.len() - first });
    }

    /// Ends the current knot.
    pub fn end_knot(&mut self) {
        self.knots.push(self.entries.len());
    }

    /// The index of the last knot.
    pub fn last_knot(&self) -> usize {
        self.knots.len().saturating_sub(2)
    }

    /// The residuals of a knot: each with the first column of its derivative and the entries from there.
    #[inline(always)]
    pub fn of_knot(&self, knot: usize) -> impl Iterator<Item = (f64, usize, &[f64])> {
        let entries = &self.entries[self.knots[knot]..self.knots[knot + 1]];
        entries.iter().map(|row| (row.error, row.start, &self.values[row.first..row.first + row.length]))
    }

    /// Adds the second derivatives of a knot, without those beyond column `width`, to `hessian`, (width x width).
    pub fn add_squares(&self, knot: usize, width: usize, hessian: &mut [f64]) {
        for (_, start, values) in self.of_knot(knot) {
            let values = &values[..values.len().min(width.saturating_sub(start))];
            for (i, x) in (start..).zip(values) {
                for (to, y) in hessian[i * width + start..].iter_mut().zip(values) {
                    *to += x * y;
                }
            }
        }
    }

    /// Half the sum of the squares of all residuals.
    pub fn cost(&self) -> f64 {
        0.5 * self.entries.iter().map(|row| row.error * row.error).sum::<f64>()
    }

    /// The number of all residuals.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// All residuals.
    pub fn errors(&self) -> impl Iterator<Item = f64> {
        self.entries.iter().map(|row| row.error)
    }

    /// The largest residual, or zero.
    pub fn largest(&self) -> f64 {
        self.errors().fold(0.0, f64::max)
    }

    /// Replaces inequalities g <= 0 by the residuals of their augmented Lagrangian, sqrt(penalty) max(0, g + multiplier
    /// / penalty).
    pub fn penalize(&mut self, multipliers: &[f64], penalty: f64) {
        let root = penalty.sqrt();
        for (row, multiplier) in self.entries.iter_mut().zip(multipliers) {
            let error = row.error + multiplier / penalty;
            let share = if error > 0.0 { root } else { 0.0 };
            row.error = share * error;
            self.values[row.first..row.first + row.length].iter_mut().for_each(|value| *value *= share);
        }
    }
}
