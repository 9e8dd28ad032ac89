//! The step, the value and the law of one knot of the filter through time.

use super::rows::Rows;

/// Numbers of the dimensions of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sizes {
    /// Degrees of freedom.
    pub nv: usize,
    /// Joints with a control.
    pub controls: usize,
    /// True if the rate of the effort has a cost.
    pub has_rate: bool,
}

impl Sizes {
    /// The length of x.
    pub fn state(&self) -> usize {
        2 * self.nv + if self.has_rate { self.controls } else { 0 }
    }

    /// The length of (x, u).
    pub fn all(&self) -> usize {
        self.state() + self.controls
    }
}

/// The Jacobians of the step of a joint with a rotation: its first degree of freedom and their number, then d q'/d q
/// and d q'/d(h v'), row by row.
#[derive(Debug, Clone, Copy)]
pub struct Turn {
    pub first: usize,
    pub count: usize,
    pub transport: [f64; 36],
    pub jacobian: [f64; 36],
}

impl Default for Turn {
    fn default() -> Self {
        Self { first: 0, count: 0, transport: [0.0; 36], jacobian: [0.0; 36] }
    }
}

/// A step about one knot.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    pub h: f64,
    /// F, (nv x 2 nv), and G, (nv x controls).
    pub by_state: &'a [f64],
    pub by_control: &'a [f64],
    pub turns: &'a [Turn],
    /// The step from this knot less the next knot, (2 nv); empty if all are zero.
    pub defect: &'a [f64],
}

/// The value 1/2 x* P x + p* x of the states of a knot.
#[derive(Debug, Clone, Default)]
pub struct Value {
    pub hessian: Vec<f64>,
    pub gradient: Vec<f64>,
    /// The triangle R and z of the array form, P = R* R and p = R* z; empty in covariance form.
    pub root: Vec<f64>,
}

/// The law u = k - K x of a stage, with what it changes in the cost.
#[derive(Debug)]
pub struct Law<'a> {
    /// K, (controls x state).
    pub gain: &'a mut [f64],
    /// k, (controls).
    pub offset: &'a mut [f64],
}

impl Value {
    pub fn new(sizes: Sizes) -> Self {
        let n = sizes.state();
        Self { hessian: vec![0.0; n * n], gradient: vec![0.0; n], root: Vec::new() }
    }

    /// The value of the end: that of its rows alone.
    pub fn of_end<'a>(&mut self, sizes: Sizes, rows: impl Iterator<Item = &'a Rows>, knot: usize) {
        let n = sizes.state();
        self.hessian.fill(0.0);
        self.gradient.fill(0.0);
        self.root.clear();
        for rows in rows {
            rows.add_squares(knot, n, &mut self.hessian);
            for (error, start, values) in rows.of_knot(knot) {
                for (to, value) in self.gradient.iter_mut().skip(start).zip(values) {
                    *to += value * error;
                }
            }
        }
    }
}
