//! Detection of lost pivots D(k): a cheap monitor for the passes, and a test for pivots below its bound.
//!
//! A pivot is lost if it is not above the rounding of the terms that form it, 64 eps of their absolute sum; a small
//! pivot is not lost. The passes keep only a bound on those terms ([`Scale`], a few operations a stage) and never
//! branch on it. If a pivot is below the bound, [`first_lost`] adds up the terms themselves.

use super::riccati::Measured;
use super::system::{HingeMap, Stage, System};
use crate::scalar::Real;
use crate::spatial::{RigidShift, Symmetric6};
use nalgebra::{Matrix3, Vector3, Vector6};

/// The multiple of the rounding of its terms that a pivot must exceed.
pub(crate) const PIVOT_MARGIN: f64 = 64.0;

/// The largest ratio of the bound of a pivot's terms to the pivot for which one test vector suffices: five digits of D.
///
/// Weights that cancel do not measure a row that has lost ten digits. Chains of slender rods reach 8e4, robots 1e4.
pub(crate) const SINGLE_ESTIMATE_LIMIT: f64 = 1e5;

/// A bound on the terms that form any angular, and any linear, diagonal entry of P^- of one stage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale<T> {
    /// For the angular entries, kg m^2.
    pub angular: T,
    /// For the linear entries, kg.
    pub linear: T,
}

impl<T: Real> Scale<T> {
    /// Both bounds the same; workspaces start as NaN.
    #[must_use]
    pub fn filled(value: T) -> Self {
        Self { angular: value, linear: value }
    }

    /// The bound of a stage's own process noise, from the terms of its diagonal.
    #[inline(always)]
    #[must_use]
    #[doc(hidden)]
    pub fn of_noise(terms: &Vector6<T>) -> Self {
        Self { angular: terms[0] + terms[1] + terms[2], linear: terms[3] + terms[4] + terms[5] }
    }

    /// The bound that P^- of a stage adds to the entries of its parent, from the traces a and b of its blocks and the
    /// square of the lever. The rotation satisfies |R| |A| |R| <= a and the terms of the lever are <= a + 2 |l|^2 b.
    /// The result is doubled for the terms that measurements subtract.
    #[inline(always)]
    pub(crate) fn sent((a, b): (T, T), lever_square: T) -> Self {
        let four = a.constant(4.0);
        Self { angular: four * lever_square.mul_add(b, a), linear: four * b }
    }

    /// The bound from a root of P^-, by its [`diagonal`](crate::spatial::Root6::diagonal).
    #[inline(always)]
    #[must_use]
    pub(crate) fn sent_by_root(square: &[T; 6], lever_square: T) -> Self {
        Self::sent((square[3] + square[4] + square[5], square[0] + square[1] + square[2]), lever_square)
    }

    /// The sum with another.
    #[inline(always)]
    #[must_use]
    #[doc(hidden)]
    pub fn sum(&self, other: &Self) -> Self {
        Self { angular: self.angular + other.angular, linear: self.linear + other.linear }
    }

    /// Adds the bound of one child, or starts with it.
    #[inline(always)]
    pub(crate) fn accumulate(&mut self, sent: &Self, begins: bool) {
        *self = if begins { *sent } else { self.sum(sent) };
    }

    /// The bound for one row.
    #[inline(always)]
    pub(crate) fn of_row(&self, hinge: &HingeMap<T>) -> T {
        match *hinge {
            HingeMap::Axis(i) if i < 3 => self.angular,
            HingeMap::Axis(_) => self.linear,
            HingeMap::Screw(pitch) => {
                let bound = self.angular + pitch * pitch * self.linear;
                bound + bound
            }
        }
    }
}

/// The smallest `D - 64 eps scale` in a sweep.
#[derive(Debug, Clone, Copy)]
pub struct PivotMonitor<T> {
    worst: T,
    threshold: T,
    /// True if the pivots are those of the square-root form.
    pub(crate) of_roots: bool,
}

impl<T: Real> PivotMonitor<T> {
    /// A monitor without observations.
    #[inline(always)]
    #[must_use]
    pub fn new() -> Self {
        Self { worst: T::one(), threshold: T::epsilon() * T::from_f64(PIVOT_MARGIN), of_roots: false }
    }

    /// A monitor that accepts a pivot only if it is within [`SINGLE_ESTIMATE_LIMIT`] of the bound of its terms.
    #[inline(always)]
    #[must_use]
    pub(crate) fn for_a_single_estimate() -> Self {
        Self { threshold: T::from_f64(1.0 / SINGLE_ESTIMATE_LIMIT), ..Self::new() }
    }

    /// A monitor for the square-root form, where the rounding of a pivot is the square of that of the root's row.
    #[inline(always)]
    #[must_use]
    pub(crate) fn of_roots() -> Self {
        let threshold = T::epsilon() * T::from_f64(PIVOT_MARGIN);
        Self { worst: T::one(), threshold: threshold * threshold, of_roots: true }
    }

    /// Observes one pivot.
    #[inline(always)]
    #[doc(hidden)]
    pub fn observe(&mut self, pivot: T, hinge: &HingeMap<T>, scale: &Scale<T>) {
        self.worst = self.worst.worst(pivot - self.threshold * scale.of_row(hinge));
    }

    /// Observes every row of a stage.
    #[inline(always)]
    pub(crate) fn observe_stage(&mut self, stage: &Stage<T>, measured: &[Measured<T>], scale: &Scale<T>) {
        for i in 0..stage.rows.count() {
            self.observe(measured[stage.first_row + i].pivot, &stage.rows.row(i), scale);
        }
    }

    /// The margin of the worst pivot.
    #[inline(always)]
    pub(crate) fn margin(&self) -> T {
        self.worst
    }

    /// True if every pivot of one lane exceeds the bound. Otherwise
    /// [`Workspace::lost_pivot`](crate::Workspace::lost_pivot) decides.
    #[inline(always)]
    #[must_use]
    pub fn clear(&self, lane: usize) -> bool {
        self.worst.lane(lane) > 0.0
    }
}

impl<T: Real> Default for PivotMonitor<T> {
    fn default() -> Self {
        Self::new()
    }
}

/// A lost pivot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LostPivot {
    /// The stage.
    pub stage: usize,
    /// The row.
    pub row: usize,
    /// D as computed.
    pub pivot: f64,
    /// The absolute sum of the terms that form it.
    pub terms: f64,
}

/// The arrays of the recursion that the test reads.
#[derive(Debug, Clone, Copy)]
pub struct Evidence<'a, T: Real> {
    /// phi of each stage to its parent.
    pub shift: &'a [RigidShift<T>],
    /// P^+ of each stage.
    pub p: &'a [Symmetric6<T>],
    /// D and g of each row.
    pub measured: &'a [Measured<T>],
    /// The bound of each stage.
    pub scale: &'a [Scale<T>],
}

/// The lost pivot furthest from the root, if any. `noise_terms` returns the terms of the diagonal of Q(k).
///
/// The terms of D(k) are those of H Q(k) H*, |H phi| |P^+| |H phi|* of every child, and twice the amount that each
/// measurement in between has subtracted. Called only if the monitor is not clear: O(N) for each pivot below the bound.
pub fn first_lost<T: Real>(
    system: &System<T>,
    evidence: &Evidence<'_, T>,
    monitor: &PivotMonitor<T>,
    noise_terms: impl Fn(usize) -> Vector6<T>,
) -> Option<LostPivot> {
    let threshold = monitor.threshold.lane(0);
    for (k, stage) in system.stages.iter().enumerate().rev() {
        for i in (0..stage.rows.count()).rev() {
            let row = stage.first_row + i;
            let hinge = stage.rows.row(i);
            let pivot = evidence.measured[row].pivot.lane(0);
            if pivot > threshold * evidence.scale[k].of_row(&hinge).lane(0) {
                continue;
            }
            let terms = terms_of(system, evidence, &noise_terms(k), (k, i)).lane(0);
            if !(pivot > threshold * terms) {
                return Some(LostPivot { stage: k, row, pivot, terms });
            }
        }
    }
    None
}

/// The absolute sum of the terms that form the pivot of row `i` of stage `k`.
fn terms_of<T: Real>(system: &System<T>, evidence: &Evidence<'_, T>, own: &Vector6<T>, (k, i): (usize, usize)) -> T {
    let stage = &system.stages[k];
    let hinge = stage.rows.row(i);
    let h = hinge.to_column().map(Real::abs);
    let mut terms = h.component_mul(&h).dot(own) + system.noise[stage.first_row + i];
    for other in i + 1..stage.rows.count() {
        terms += subtracted(&evidence.measured[stage.first_row + other], &h);
    }
    for (child, inner) in system.stages.iter().enumerate().filter(|(_, inner)| inner.parent == Some(k)) {
        let w = absolute_shift_transpose(&evidence.shift[child], &h);
        terms += (w.transpose() * evidence.p[child].to_matrix().map(Real::abs) * w)[(0, 0)];
        for other in 0..inner.rows.count() {
            terms += subtracted(&evidence.measured[inner.first_row + other], &w);
        }
    }
    terms
}

/// 2 (|g|.w)^2 D: the amount that a measurement subtracts, and the same amount of the minuend.
fn subtracted<T: Real>(measured: &Measured<T>, w: &Vector6<T>) -> T {
    let along = measured.gain.map(Real::abs).dot(w);
    if along == T::zero() {
        // Nothing is subtracted: a row that is not measured has an infinite pivot.
        return along;
    }
    let taken = along * along * measured.pivot.abs();
    taken + taken
}

/// |phi|^T |h| with every term taken absolutely; `h` has no negative entry.
#[inline(always)]
fn absolute_shift_transpose<T: Real>(shift: &RigidShift<T>, h: &Vector6<T>) -> Vector6<T> {
    let r = &shift.rotation;
    let r = Matrix3::new(
        r[(0, 0)].abs(),
        r[(0, 1)].abs(),
        r[(0, 2)].abs(),
        r[(1, 0)].abs(),
        r[(1, 1)].abs(),
        r[(1, 2)].abs(),
        r[(2, 0)].abs(),
        r[(2, 1)].abs(),
        r[(2, 2)].abs(),
    );
    let l = Vector3::new(shift.lever[0].abs(), shift.lever[1].abs(), shift.lever[2].abs());
    let turned = RigidShift { rotation: r, lever: l };
    let (a, b) = (crate::spatial::angular(h), crate::spatial::linear(h));
    let moved = Vector3::new(
        l[1].mul_add(a[2], l[2].mul_add(a[1], b[0])),
        l[2].mul_add(a[0], l[0].mul_add(a[2], b[1])),
        l[0].mul_add(a[1], l[1].mul_add(a[0], b[2])),
    );
    crate::spatial::spatial(&turned.rotate_back(&a), &turned.rotate_back(&moved))
}
