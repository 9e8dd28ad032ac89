//! Covariance of the co-states, Lambda (5.6, 5.7).
//!
//! ```
//! use nalgebra::Matrix3;
//! use phipsi::filter::{HingeMap, covariance, riccati};
//! use phipsi::spatial::{Symmetric3, Symmetric6};
//!
//! let one = Symmetric3::new([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]);
//! let mut p = Symmetric6 { angular: one, coupling: Matrix3::zeros(), linear: one };
//! let measured = riccati::measurement_update(&mut p, &HingeMap::Axis(2), 0.0);
//! // Nothing is known inboard of the root, so the co-state outboard of its joint varies about the axis alone,
//! // by 1 / D.
//! let (lambda, _) = covariance::row_update(&Symmetric6::zero(), &HingeMap::Axis(2), &measured);
//! assert_eq!(lambda.diagonal().as_slice(), [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
//! ```

use super::riccati::Measured;
use super::system::HingeMap;
use crate::scalar::Real;
use crate::spatial::{Symmetric6, scaled_add};
use nalgebra::Vector6;

/// Lambda^- from Lambda^+ across one row: (1 - gH)^T Lambda^+ (1 - gH) + H^T H / D (5.6).
///
/// Also returns u = Lambda^+ g. The form Lambda^+ - H^T u^T - u H + H^T H (g.u + 1/D) changes one row and column only.
#[inline(always)]
#[must_use]
pub fn row_update<T: Real>(
    lambda: &Symmetric6<T>,
    hinge: &HingeMap<T>,
    measured: &Measured<T>,
) -> (Symmetric6<T>, Vector6<T>) {
    let u = lambda.mul_vector(&measured.gain);
    let whole = crate::spatial::dot(&measured.gain, &u) + measured.pivot_inverse;
    if let HingeMap::Axis(i) = *hinge {
        // One row and column: minus u; the remainder of the sum on the diagonal.
        let column = lambda.column(i);
        let mut next = *lambda;
        let mut changed = scaled_add(&u, whole.constant(-1.0), &column);
        changed[i] = column[i] + (whole - (u[i] + u[i]));
        next.write_column(i, &changed);
        return (next, u);
    }
    let h = hinge.to_column();
    // The change is H^T w^T + w H with w = H^T half - u.
    let w: Vector6<T> = h * (whole * T::from_f64(0.5)) - u;
    let mut next = *lambda;
    for i in 0..3 {
        for j in 0..3 {
            next.coupling[(i, j)] += h[i] * w[j + 3] + w[i] * h[j + 3];
        }
    }
    let pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
    for (entry, (i, j)) in pairs.into_iter().enumerate() {
        next.angular.entries[entry] += h[i] * w[j] + w[i] * h[j];
        next.linear.entries[entry] += h[i + 3] * w[j + 3] + w[i + 3] * h[j + 3];
    }
    (next, u)
}
