//! Covariances of the smoother's estimates: the diagonal blocks of 2.6 and 2.11.
//!
//! P^+, D and g of the filter and the co-state covariances (5.6, 5.7) determine the covariances given all measurements:
//! of a state, of a process noise, and of a measurement. About 700 operations per block in addition to those of Lambda.
//!
//! ```
//! use nalgebra::Matrix3;
//! use phipsi::filter::{HingeMap, covariance, riccati, smoothed};
//! use phipsi::spatial::{Symmetric3, Symmetric6};
//!
//! let one = Symmetric3::new([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]);
//! let mut p = Symmetric6 { angular: one, coupling: Matrix3::zeros(), linear: one };
//! let prior = p;
//! let measured = riccati::measurement_update(&mut p, &HingeMap::Axis(2), 0.0);
//! let (lambda, _) = covariance::row_update(&Symmetric6::zero(), &HingeMap::Axis(2), &measured);
//! // What remains unknown of the state once everything is measured.
//! let left = smoothed::remaining(&prior, &lambda);
//! assert_eq!(left.diagonal().as_slice(), [1.0, 1.0, 0.0, 1.0, 1.0, 1.0]);
//! ```

use super::riccati::Measured;
use crate::scalar::Real;
use crate::spatial::{Symmetric3, Symmetric6, dot};
use nalgebra::{Matrix3, Vector6};

/// `C - C Lambda C`: a covariance C given the measurements.
///
/// With C = P^+ and Lambda^+ (or P^- and Lambda^-: the two are equal) it is the block of 2.6; with C = Q and Lambda^-
/// that of 2.11. Rows and columns of C that are zero stay zero. Rounding is relative to C, not to the result.
#[inline(always)]
#[must_use]
pub fn remaining<T: Real>(covariance: &Symmetric6<T>, lambda: &Symmetric6<T>) -> Symmetric6<T> {
    let columns: [Vector6<T>; 6] = std::array::from_fn(|j| covariance.column(j));
    let images = columns.map(|column| lambda.mul_vector(&column));
    let entry = |i: usize, j: usize| columns[j][i] - dot(&columns[i], &images[j]);
    let block =
        |o: usize| Symmetric3::new([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|(i, j)| entry(i + o, j + o)));
    Symmetric6 { angular: block(0), coupling: Matrix3::from_fn(|i, j| entry(i, j + 3)), linear: block(3) }
}

/// The diagonal entry of (H R H* + r)^-1 for one row, 1/D + g* Lambda^+ g (6.1): the inverse of the variance of the
/// row's measurement given all others. Zero if the row is not measured.
#[inline(always)]
#[must_use]
pub fn information<T: Real>(measured: &Measured<T>, lambda: &Symmetric6<T>) -> T {
    measured.pivot_inverse + dot(&measured.gain, &lambda.mul_vector(&measured.gain))
}
