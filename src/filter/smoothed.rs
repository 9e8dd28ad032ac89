//! Covariances of the smoother's estimates: the diagonal blocks of 2.6 and 2.11, in O(N).
//!
//! From P^+, D and g of the filter, a pass base to tip with the co-state covariances (5.6, 5.7) computes the
//! covariances given all measurements: of a state, of a process noise, and of a measurement. About 700 operations per
//! block in addition to those of Lambda.
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

use super::covariance;
use super::riccati::Measured;
use super::system::System;
use crate::scalar::Real;
use crate::spatial::{RigidShift, Symmetric3, Symmetric6, dot};
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

/// The results of [`sweep`].
#[derive(Debug)]
pub struct Smoothed<'a, T: Real> {
    /// Covariance of each stage's state given all measurements, a diagonal block of 2.6.
    pub state: &'a mut [Symmetric6<T>],
    /// Lambda^- of each stage.
    pub co_state: &'a mut [Symmetric6<T>],
    /// [`information`] of each row.
    pub information: &'a mut [T],
}

/// Base to tip, with P^+ of every stage known.
///
/// Evaluated on the inboard side of a stage's rows, where the zeros of noise-free measurements in P^+ make H P = 0
/// exact.
pub fn sweep<T: Real>(
    system: &System<T>,
    shift: &[RigidShift<T>],
    measured: &[Measured<T>],
    p_plus: &[Symmetric6<T>],
    smoothed: &mut Smoothed<'_, T>,
) {
    let mut stages = system.stages.iter().zip(p_plus).zip(smoothed.state.iter_mut()).peekable();
    let information_of = &mut smoothed.information;
    covariance::sweep(system, shift, measured, smoothed.co_state, |row, lambda, _| {
        information_of[row] = information(&measured[row], lambda);
        // Rows come in order, a stage's innermost first.
        if let Some(((_, p), state)) = stages.next_if(|((stage, _), _)| stage.first_row == row) {
            *state = remaining(p, lambda);
        }
    });
}
