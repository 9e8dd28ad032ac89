//! One stage of the filter through time in array form (D98): nothing is subtracted, so that no digits are lost where
//! the weights of the end are millions of times those of the way.

use super::knot::{Law, Sizes, Step, Value};
use super::rows::Rows;
use crate::estimation::triangle::rotate_in;

/// Scratch, allocated by the first stage that needs it.
#[derive(Debug, Default)]
pub struct ArrayForm {
    triangle: Vec<f64>,
    rows: Vec<f64>,
    /// R' and z' of the next knot, (n x (n + 1)).
    next: Vec<f64>,
    a: Vec<f64>,
    b: Vec<f64>,
}

/// The share of a diagonal entry below which a pivot is zero.
const NOTHING: f64 = 16.0 * f64::EPSILON;

impl ArrayForm {
    /// Triangulates `[W_u W_x rho; R' B, R' A, R' c + z'] = [R_u R_ux y; 0 R z]` and replaces the value and the law of
    /// the covariance form, whose held controls, all that are not `free`, stay where they are; `q_uu` is its curvature
    /// of the controls.
    pub fn stage(
        &mut self,
        (sizes, free, q_uu): (Sizes, &[usize], &[f64]),
        step: &Step<'_>,
        (rows, knot): (&[Rows], usize),
        damping: f64,
        value: &mut Value,
        law: &mut Law<'_>,
    ) {
        let (n, m) = (sizes.state(), sizes.controls);
        let width = m + n + 1;
        self.read_next(sizes, (rows, knot + 1), value);
        self.system(sizes, step);
        let is_held = |i: usize| free.binary_search(&i).is_err();
        self.rows.clear();
        for rows in rows {
            for (error, start, values) in rows.of_knot(knot) {
                let at = self.rows.len();
                self.rows.resize(at + width, 0.0);
                let row = &mut self.rows[at..];
                row[width - 1] = error;
                for (j, &entry) in (start..).zip(values) {
                    row[if j < n { m + j } else { j - n }] = entry;
                }
            }
        }
        for i in 0..m {
            let at = self.rows.len();
            self.rows.resize(at + width, 0.0);
            self.rows[at + i] = (damping / (1.0 + damping) * q_uu[i * m + i]).sqrt();
        }
        for from in self.next.chunks_exact(n + 1) {
            let at = self.rows.len();
            self.rows.resize(at + width, 0.0);
            let row = &mut self.rows[at..];
            for (k, &r) in from[..n].iter().enumerate().filter(|(_, r)| **r != 0.0) {
                let (a, b) = (&self.a[k * n..][..n], &self.b[k * m..][..m]);
                row[..m].iter_mut().zip(b).for_each(|(to, b)| *to += r * b);
                row[m..m + n].iter_mut().zip(a).for_each(|(to, a)| *to += r * a);
                row[width - 1] += r * step.defect.get(k).copied().unwrap_or(0.0);
            }
            row[width - 1] += from[n];
        }
        for row in self.rows.chunks_exact_mut(width) {
            for i in (0..m).filter(|&i| is_held(i)) {
                row[width - 1] += row[i] * law.offset[i];
                row[i] = 0.0;
            }
        }
        for i in (0..m).filter(|&i| is_held(i)) {
            let at = self.rows.len();
            self.rows.resize(at + width, 0.0);
            self.rows[at + i] = 1.0;
        }
        self.triangle.clear();
        self.triangle.resize(width * width, 0.0);
        rotate_in(&mut self.triangle, &self.rows, width);
        self.write_law(sizes, is_held, law);
        value.root.clear();
        for row in self.triangle.chunks_exact(width).skip(m).take(n) {
            value.root.extend_from_slice(&row[m..]);
        }
        value.read_root(n);
    }

    /// R' and z' of the next knot: its own, those of the rows of the end, or Cholesky's.
    fn read_next(&mut self, sizes: Sizes, (rows, end): (&[Rows], usize), value: &Value) {
        let n = sizes.state();
        self.next.clear();
        if !value.root.is_empty() {
            self.next.extend_from_slice(&value.root);
        } else if rows.iter().all(|rows| rows.last_knot() == end) {
            self.rows.clear();
            for (error, start, values) in rows.iter().flat_map(|rows| rows.of_knot(end)) {
                let at = self.rows.len();
                self.rows.resize(at + n + 1, 0.0);
                let row = &mut self.rows[at..];
                row[n] = error;
                for (to, &entry) in row[..n][start.min(n)..].iter_mut().zip(values) {
                    *to = entry;
                }
            }
            let mut triangle = vec![0.0; (n + 1) * (n + 1)];
            rotate_in(&mut triangle, &self.rows, n + 1);
            self.next.extend_from_slice(&triangle[..n * (n + 1)]);
        } else {
            self.next.resize(n * (n + 1), 0.0);
            let mut remaining = value.hessian.clone();
            let mut gradient = value.gradient.clone();
            for i in 0..n {
                let pivot = remaining[i * n + i];
                if pivot > NOTHING * value.hessian[i * n + i].abs() {
                    let root = pivot.sqrt();
                    let row = &mut self.next[i * (n + 1)..][..=n];
                    for j in i..n {
                        row[j] = remaining[i * n + j] / root;
                    }
                    row[n] = gradient[i] / root;
                    for k in i..n {
                        gradient[k] -= row[k] * row[n];
                        for j in k..n {
                            remaining[k * n + j] -= row[k] * row[j];
                        }
                    }
                }
            }
        }
    }

    /// A (n x n) and B (n x m) of the step.
    fn system(&mut self, sizes: Sizes, step: &Step<'_>) {
        self.a.clear();
        self.a.resize(sizes.state() * sizes.state(), 0.0);
        self.b.clear();
        self.b.resize(sizes.state() * sizes.controls, 0.0);
        write_system(sizes, step, &mut self.a, &mut self.b);
    }

    fn write_law(&self, sizes: Sizes, is_held: impl Fn(usize) -> bool, law: &mut Law<'_>) {
        let (n, m) = (sizes.state(), sizes.controls);
        let width = m + n + 1;
        let of = |i: usize, j: usize| self.triangle[i * width + j];
        for i in (0..m).rev() {
            for column in 0..=n {
                let after = |j: usize| match column {
                    column if column < n => law.gain[j * n + column],
                    _ if is_held(j) => 0.0,
                    _ => -law.offset[j],
                };
                let sum = (i + 1..m).fold(of(i, m + column), |sum, j| sum - of(i, j) * after(j));
                let found = sum / of(i, i);
                if column < n {
                    law.gain[i * n + column] = found;
                } else if !is_held(i) {
                    law.offset[i] = -found;
                }
            }
        }
    }
}

impl Value {
    /// P = R* R and p = R* z.
    fn read_root(&mut self, n: usize) {
        self.hessian.fill(0.0);
        self.gradient.fill(0.0);
        for (first, row) in self.root.chunks_exact(n + 1).enumerate() {
            for i in first..n {
                self.gradient[i] += row[i] * row[n];
                for j in first..n {
                    self.hessian[i * n + j] += row[i] * row[j];
                }
            }
        }
    }
}

/// Writes A (n x n) and B (n x m) of a step into zeros.
pub fn write_system(sizes: Sizes, step: &Step<'_>, a: &mut [f64], b: &mut [f64]) {
    let (nv, n, m) = (sizes.nv, sizes.state(), sizes.controls);
    for i in 0..nv {
        let (f, g) = (&step.by_state[i * 2 * nv..][..2 * nv], &step.by_control[i * m..][..m]);
        a[(nv + i) * n..][..2 * nv].copy_from_slice(f);
        b[(nv + i) * m..][..m].copy_from_slice(g);
    }
    let turn_of = |i: usize| step.turns.iter().find(|turn| (turn.first..turn.first + turn.count).contains(&i));
    for i in 0..nv {
        let turn = turn_of(i);
        let (first, count) = turn.map_or((i, 1), |turn| (turn.first, turn.count));
        for k in 0..count {
            let entry = |block: &[f64; 36]| block[(i - first) * count + k];
            let (jacobian, transport) = turn.map_or((1.0, 1.0), |turn| (entry(&turn.jacobian), entry(&turn.transport)));
            let (f, g) = (&step.by_state[(first + k) * 2 * nv..][..2 * nv], &step.by_control[(first + k) * m..][..m]);
            for (to, f) in a[i * n..][..2 * nv].iter_mut().zip(f) {
                *to += step.h * jacobian * f;
            }
            for (to, g) in b[i * m..][..m].iter_mut().zip(g) {
                *to += step.h * jacobian * g;
            }
            a[i * n + first + k] += transport;
        }
    }
    if sizes.has_rate {
        for i in 0..m {
            b[(2 * nv + i) * m + i] = 1.0;
        }
    }
}
