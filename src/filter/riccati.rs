//! The Riccati recursion (3.6, 3.10), covariance form.
//!
//! ```
//! use nalgebra::Matrix3;
//! use phipsi::filter::{HingeMap, riccati};
//! use phipsi::spatial::{Symmetric3, Symmetric6};
//!
//! let one = Symmetric3::new([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]);
//! let mut p = Symmetric6 { angular: one, coupling: Matrix3::zeros(), linear: one };
//! // One measurement of component 2, without noise: nothing of its variance is left.
//! let measured = riccati::measurement_update(&mut p, &HingeMap::Axis(2), 0.0);
//! assert_eq!((measured.pivot, measured.gain[2]), (1.0, 1.0));
//! assert_eq!(p.diagonal().as_slice(), [1.0, 1.0, 0.0, 1.0, 1.0, 1.0]);
//! ```
//!
//! A tree of two stages is in the example of [`filter`](super).

use super::system::{HingeMap, Rows, System};
use crate::scalar::Real;
use crate::spatial::{Symmetric6, scaled};
use nalgebra::Vector6;

/// The result of one scalar measurement: pivot D, its inverse, and the gain g = P^- H^T / D.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured<T> {
    /// D(k) = H P^- H^T + r, the variance of the innovation.
    pub pivot: T,
    /// 1 / D(k).
    pub pivot_inverse: T,
    /// g(k), eq. 3.10.
    pub gain: Vector6<T>,
}

impl<T: Real> Measured<T> {
    /// `value` in every entry; workspaces start as NaN.
    pub fn filled(value: T) -> Self {
        Self { pivot: value, pivot_inverse: value, gain: Vector6::from_element(value) }
    }
}

/// The measurement update of eq. 3.6: replaces P^- by P^+ and returns D and g.
///
/// P^+ H^T = r g and, without noise, H g = 1 hold exactly. If H selects one component, these values are assigned, not
/// computed, because they would lose all precision for noise that is small compared with the prediction. 56 operations.
#[inline(always)]
pub fn measurement_update<T: Real>(p: &mut Symmetric6<T>, hinge: &HingeMap<T>, noise: T) -> Measured<T> {
    let ph = hinge.covariance_column(p);
    let pivot = hinge.project(&ph) + noise;
    let pivot_inverse = pivot.recip();
    let mut gain = scaled(&ph, pivot_inverse);
    *p = p.add_rank_one(&scaled(&ph, -pivot_inverse), &ph);
    // Equal in all lanes.
    let (is_noise_free, is_measured) = (noise.lane(0) == 0.0, noise.lane(0) < f64::INFINITY);
    match *hinge {
        HingeMap::Axis(i) if is_noise_free => {
            gain[i] = pivot.constant(1.0);
            p.clear(i);
        }
        HingeMap::Axis(i) if is_measured => p.write_column(i, &scaled(&gain, noise)),
        _ => {}
    }
    Measured { pivot, pivot_inverse, gain }
}

/// The rows of one stage, last first: D and g; replaces P^- by P^+. `seen` is called with the P^- of each row.
#[inline(always)]
pub fn measure_stage<T: Real>(
    system: &System<T>,
    k: usize,
    p: &mut Symmetric6<T>,
    measured: &mut [Measured<T>],
    mut seen: impl FnMut(usize, &Symmetric6<T>),
) {
    let stage = &system.stages[k];
    if let Rows::One(HingeMap::Axis(2)) = stage.rows {
        // A separate branch for the most frequent row lets the compiler fix the column of P.
        seen(stage.first_row, p);
        measured[stage.first_row] = measurement_update(p, &HingeMap::Axis(2), system.noise[stage.first_row]);
        return;
    }
    for i in (0..stage.rows.count()).rev() {
        let row = stage.first_row + i;
        seen(row, p);
        measured[row] = measurement_update(p, &stage.rows.row(i), system.noise[row]);
    }
}
