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
//! The sweep over a tree is in the example of [`filter`](super).

use super::pivots::{PivotMonitor, Scale};
use super::system::{HingeMap, Rows, System};
use crate::scalar::Real;
use crate::spatial::{RigidShift, Symmetric6, scaled};
use nalgebra::Vector6;

/// What one scalar measurement leaves: pivot D, its inverse, and the gain g = P^- H^T / D.
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

/// The measurement update of eq. 3.6: turns P^- into P^+ and gives D and g.
///
/// P^+ H^T = r g, and without noise H g = 1, hold exactly and are written, not computed, where H picks one component: where the noise is small beside the
/// prediction, nothing would be left of them. 56 operations.
#[inline(always)]
pub fn measurement_update<T: Real>(p: &mut Symmetric6<T>, hinge: &HingeMap<T>, noise: T) -> Measured<T> {
    let ph = hinge.covariance_column(p);
    let pivot = hinge.project(&ph) + noise;
    let pivot_inverse = pivot.recip();
    let mut gain = scaled(&ph, pivot_inverse);
    *p = p.add_rank_one(&scaled(&ph, -pivot_inverse), &ph);
    // In every lane or in none.
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

/// The arrays of the recursion, one entry a stage or a row.
#[derive(Debug)]
pub struct Covariances<'a, T: Real> {
    /// phi of each stage to its parent.
    pub shift: &'a [RigidShift<T>],
    /// In: process noise Q(k). Out: P^+(k), children's contributions added on the way.
    pub p: &'a mut [Symmetric6<T>],
    /// In: the bound of Q(k)'s terms. Out: that of P^-(k).
    pub scale: &'a mut [Scale<T>],
    /// D and g of each row.
    pub measured: &'a mut [Measured<T>],
}

impl<T: Real> Covariances<'_, T> {
    /// One stage, all its rows (last first), then the time update onto its parent; `seen` is called with each row's P^-.
    #[doc(hidden)]
    pub fn step(
        &mut self,
        system: &System<T>,
        k: usize,
        monitor: &mut PivotMonitor<T>,
        seen: &mut dyn FnMut(usize, &Symmetric6<T>),
    ) {
        let (shift, p, scale) = (&self.shift[k], &mut self.p[k], self.scale[k]);
        let sent = Scale::sent_by(p, shift);
        measure_stage(system, k, p, self.measured, seen);
        monitor.observe_stage(&system.stages[k], self.measured, &scale);
        let carried = shift.inertia_to_parent(p);
        if let Some(parent) = system.stages[k].parent {
            let at_parent = &mut self.p[parent];
            *at_parent = at_parent.add(&carried);
            self.scale[parent] = self.scale[parent].sum(&sent);
        }
    }
}

/// The rows of one stage, last first: D and g, and P^- becomes P^+. `seen` is called with each row's P^-.
#[inline(always)]
#[doc(hidden)]
pub fn measure_stage<T: Real>(
    system: &System<T>,
    k: usize,
    p: &mut Symmetric6<T>,
    measured: &mut [Measured<T>],
    mut seen: impl FnMut(usize, &Symmetric6<T>),
) {
    let stage = &system.stages[k];
    if let Rows::One(HingeMap::Axis(2)) = stage.rows {
        // The commonest row is named, so that the compiler sees which column of P is meant.
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

/// Tip to base: D, g and P^+ of every stage, covariance form. `seen` is called with each row's P^-.
pub fn sweep<T: Real>(
    system: &System<T>,
    covariances: &mut Covariances<'_, T>,
    mut seen: impl FnMut(usize, &Symmetric6<T>),
) -> PivotMonitor<T> {
    let mut monitor = PivotMonitor::new();
    for k in (0..system.stages.len()).rev() {
        covariances.step(system, k, &mut monitor, &mut seen);
    }
    monitor
}
