//! Polynomials that couple the coordinates of two joints.

use crate::scalar::Real;

/// Number of coefficients.
const COUNT: usize = 5;

/// Factors k! / (k - n)! of the coefficients k in the n-th derivative, row by row.
const FACTORS: [[f64; COUNT]; 4] =
    [[1.0; COUNT], [0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 2.0, 6.0, 12.0], [0.0, 0.0, 0.0, 6.0, 24.0]];

/// Newton steps of [`Polynomial::solve`].
const STEPS: usize = 100;

/// A polynomial of degree four at most, P(x) = c0 + c1 x + c2 x^2 + c3 x^3 + c4 x^4.
///
/// ```
/// use phipsi::scene::Polynomial;
/// assert_eq!(Polynomial::linear(2.0, 0.1).coefficients(), [0.1, 2.0, 0.0, 0.0, 0.0]);
/// assert_eq!(Polynomial::new([1.0, 0.0, 3.0, 0.0, 0.0]).value(2.0), 13.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Polynomial([f64; COUNT]);

impl Polynomial {
    /// The polynomial with these coefficients, that of degree zero first.
    #[must_use]
    pub const fn new(coefficients: [f64; COUNT]) -> Self {
        Self(coefficients)
    }

    /// multiplier x + offset.
    #[must_use]
    pub const fn linear(multiplier: f64, offset: f64) -> Self {
        Self([offset, multiplier, 0.0, 0.0, 0.0])
    }

    /// The coefficients, that of degree zero first.
    #[must_use]
    pub const fn coefficients(&self) -> [f64; COUNT] {
        self.0
    }

    /// P(x).
    #[must_use]
    pub fn value(&self, x: f64) -> f64 {
        self.derivative(0, x)
    }

    /// True if no coefficient of this or a higher degree differs from zero.
    pub(crate) fn is_below_degree(&self, degree: usize) -> bool {
        self.0[degree..].iter().all(|&c| c == 0.0)
    }

    /// The derivative of this order, up to 3, at x; of order 0 the value. Coefficients of zero cost no operation, so
    /// that the slope of a linear polynomial is a constant.
    #[inline(always)]
    pub(crate) fn derivative<T: Real>(&self, order: usize, x: T) -> T {
        let (mut sum, mut is_zero) = (x.constant(0.0), true);
        for power in (order..COUNT).rev() {
            let coefficient = FACTORS[order][power] * self.0[power];
            if is_zero {
                (sum, is_zero) = (x.constant(coefficient), coefficient == 0.0);
            } else {
                sum = sum.mul_add(x, x.constant(coefficient));
            }
        }
        sum
    }

    /// A root of P(x) = value by Newton's method from `start`, with the absolute residual, which decreases in each
    /// step: a step that would increase it is halved.
    pub(crate) fn solve(&self, value: f64, start: f64) -> (f64, f64) {
        let residual = |x: f64| self.value(x) - value;
        let newton = |x: f64| residual(x) / self.derivative(1, x);
        let (mut x, mut left, mut step) = (start, residual(start).abs(), newton(start));
        for _ in 0..STEPS {
            let next = residual(x - step).abs();
            if next < left {
                (x, left) = (x - step, next);
                step = newton(x);
            } else {
                step *= 0.5;
            }
        }
        (x, left)
    }
}

#[cfg(test)]
mod tests {
    use super::Polynomial;

    #[test]
    fn derivatives_are_those_of_the_powers() {
        let (p, x) = (Polynomial::new([0.3, -0.7, 0.5, 0.9, -0.2]), 1.5_f64);
        let expected = [
            0.3 - 0.7 * x + 0.5 * x.powi(2) + 0.9 * x.powi(3) - 0.2 * x.powi(4),
            -0.7 + x + 2.7 * x.powi(2) - 0.8 * x.powi(3),
            1.0 + 5.4 * x - 2.4 * x.powi(2),
            5.4 - 4.8 * x,
        ];
        for (order, expected) in expected.into_iter().enumerate() {
            assert!((p.derivative(order, x) - expected).abs() <= 1e-14, "{order}");
        }
        let line = Polynomial::linear(2.0, 0.5);
        for (order, expected) in [3.5, 2.0, 0.0, 0.0].into_iter().enumerate() {
            assert!((line.derivative(order, x) - expected).abs() <= f64::EPSILON);
        }
        assert_eq!([0, 1, 2, 5].map(|degree| line.is_below_degree(degree)), [false, false, true, true]);
    }

    #[test]
    fn roots_are_found_from_nearby() {
        let p = Polynomial::new([0.0, 1.0, 0.0, 1.0, 0.0]);
        let (root, left) = p.solve(2.0, 0.3);
        assert!((root - 1.0).abs() <= 1e-14 && left <= 1e-14);
        assert!(Polynomial::new([1.0, 0.0, 1.0, 0.0, 0.0]).solve(0.0, 0.5).1 > 0.1);
    }
}
