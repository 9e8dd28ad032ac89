//! The Riccati recursion (3.6, 3.10), covariance form.

use super::system::{HingeMap, System};
use crate::scalar::Real;
use crate::spatial::{RigidShift, Symmetric6};
use nalgebra::Vector6;

/// How many times its rounding a pivot must exceed the absolute sum of the terms that form it.
pub const PIVOT_MARGIN: f64 = 64.0;

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
    /// NaN throughout, as workspaces start.
    pub fn filled(value: T) -> Self {
        Self { pivot: value, pivot_inverse: value, gain: Vector6::from_element(value) }
    }
}

/// The measurement update of eq. 3.6: turns P^- into P^+ and gives D and g.
///
/// Without noise H g = 1 and H P^+ = 0 hold exactly and are written, not computed. About 60 operations.
#[inline(always)]
pub fn measurement_update<T: Real>(p: &mut Symmetric6<T>, hinge: &HingeMap<T>, noise: T) -> Measured<T> {
    let ph = hinge.covariance_column(p);
    let pivot = hinge.project(&ph) + noise;
    let pivot_inverse = pivot.recip();
    let mut gain = ph * pivot_inverse;
    *p = p.add_rank_one(&-gain, &ph);
    if let HingeMap::Axis(i) = *hinge
        && noise == T::zero()
    {
        gain[i] = T::one();
        p.clear(i);
    }
    Measured { pivot, pivot_inverse, gain }
}

/// The worst margin `D - 64 eps * terms` seen in a sweep: the sweep never branches on it.
///
/// `terms` is D plus what the measurements one step further out subtracted along this row, that is, the size of the
/// numbers whose difference D is.
#[derive(Debug, Clone, Copy)]
pub struct PivotMonitor<T> {
    worst: T,
    threshold: T,
}

impl<T: Real> PivotMonitor<T> {
    /// A monitor that has seen nothing.
    #[inline(always)]
    #[must_use]
    pub fn new() -> Self {
        Self { worst: T::one(), threshold: T::epsilon() * T::from_f64(PIVOT_MARGIN) }
    }

    /// Takes note of one pivot.
    #[inline(always)]
    pub fn observe(&mut self, pivot: T, subtracted: T) {
        self.worst = self.worst.worst(self.margin(pivot, subtracted));
    }

    /// Positive where the pivot stands clear of its rounding; NaN where it is not a number.
    #[inline(always)]
    pub fn margin(&self, pivot: T, subtracted: T) -> T {
        pivot - self.threshold * (pivot + subtracted)
    }

    /// Whether every pivot of one lane stood clear.
    pub fn clear(&self, lane: usize) -> bool {
        self.worst.lane(lane) > 0.0
    }
}

impl<T: Real> Default for PivotMonitor<T> {
    fn default() -> Self {
        Self::new()
    }
}

/// The arrays of the recursion, one entry a stage or a row.
#[derive(Debug)]
pub struct Covariances<'a, T: Real> {
    /// phi of each stage to its parent.
    pub shift: &'a [RigidShift<T>],
    /// In: process noise Q(k). Out: P^+(k), children's contributions added on the way.
    pub p: &'a mut [Symmetric6<T>],
    /// What measurements further out subtracted, by component; zero on entry.
    pub subtracted: &'a mut [Vector6<T>],
    /// D and g of each row.
    pub measured: &'a mut [Measured<T>],
}

impl<T: Real> Covariances<'_, T> {
    /// One stage, all its rows (last first), then the time update onto its parent; `seen` is called with each row's P^-.
    #[inline(always)]
    pub fn step(
        &mut self,
        system: &System<T>,
        k: usize,
        monitor: &mut PivotMonitor<T>,
        mut seen: impl FnMut(usize, &Symmetric6<T>),
    ) {
        let stage = &system.stages[k];
        let mut state =
            Sending { p: self.p[k], subtracted: self.subtracted[k], sent: Vector6::from_element(T::zero()) };
        let shift = &self.shift[k];
        // The common rows are named, so that the compiler sees which column of P is meant.
        let carried = match stage.rows {
            super::Rows::One(HingeMap::Axis(2)) => {
                let (row, noise) = (stage.first_row, system.noise[stage.first_row]);
                seen(row, &state.p);
                self.measured[row] = state.measure(&HingeMap::Axis(2), noise, shift, monitor);
                if noise == T::zero() {
                    shift.inertia_to_parent_past_z(&state.p)
                } else {
                    shift.inertia_to_parent(&state.p)
                }
            }
            rows => {
                for i in (0..rows.count()).rev() {
                    let row = stage.first_row + i;
                    seen(row, &state.p);
                    self.measured[row] = state.measure_any(&rows.row(i), system.noise[row], shift, monitor);
                }
                shift.inertia_to_parent(&state.p)
            }
        };
        self.p[k] = state.p;
        if let Some(parent) = stage.parent {
            let at_parent = &mut self.p[parent];
            *at_parent = at_parent.add(&carried);
            self.subtracted[parent] += state.sent;
        }
    }
}

/// One stage's covariance on its way through the measurements.
struct Sending<T: Real> {
    p: Symmetric6<T>,
    /// What measurements so far subtracted, by component, in this stage's frame.
    subtracted: Vector6<T>,
    /// The same for this stage's own measurements, in its parent's frame.
    sent: Vector6<T>,
}

impl<T: Real> Sending<T> {
    #[inline(always)]
    fn measure(
        &mut self,
        hinge: &HingeMap<T>,
        noise: T,
        shift: &RigidShift<T>,
        monitor: &mut PivotMonitor<T>,
    ) -> Measured<T> {
        let m = measurement_update(&mut self.p, hinge, noise);
        monitor.observe(m.pivot, hinge.bound_square(&self.subtracted));
        self.subtracted += m.gain.component_mul(&m.gain) * m.pivot;
        let carried = shift.force_to_parent(&m.gain);
        self.sent += carried.component_mul(&carried) * m.pivot;
        m
    }

    /// The same for rows that the compiler cannot tell apart.
    #[inline(never)]
    fn measure_any(
        &mut self,
        hinge: &HingeMap<T>,
        noise: T,
        shift: &RigidShift<T>,
        monitor: &mut PivotMonitor<T>,
    ) -> Measured<T> {
        self.measure(hinge, noise, shift, monitor)
    }
}

/// Tip to base: D, g and P^+ of every stage.
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
