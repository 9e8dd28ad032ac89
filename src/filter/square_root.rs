//! The Riccati recursion (3.6, 3.10) in square-root form: P = L W L^T. Covariances are never subtracted.
//!
//! The measurements of one stage compute D, g, the innovations and the root of P^+ from the root of P^- with its mean,
//! H and r. A measurement without noise removes a column. The time update joins the columns of the children to those of
//! the stage by rotations from the right ([`Root6::join`]). Together they take about 1100 operations per stage of one
//! row, 31 of them divisions.

use super::pivots::Scale;
use super::riccati::Measured;
use super::rounding::RootMonitor;
use super::system::{HingeMap, Rows, System};
use crate::scalar::Real;
use crate::spatial::{Dropped, Root6, root_row, scaled_add};
use nalgebra::Vector6;

/// The measurement update of eq. 3.6 on a root and its mean.
///
/// Without noise H g = 1 and H P^+ = 0 hold exactly and are written, not computed.
#[inline(always)]
fn measurement_update<T: Real, const POSITIVE: bool>(
    root: &mut Root6<T>,
    mean: &mut [T; 6],
    hinge: &HingeMap<T>,
    noise: T,
) -> Dropped<T> {
    let mut dropped = match *hinge {
        HingeMap::Axis(2) => root.measure_turn::<POSITIVE>(noise, Some(mean)),
        HingeMap::Axis(i) => root.measure(&root.row(i), root_row(i), noise, Some(mean)),
        HingeMap::Screw(pitch) => {
            let (mut row, advance) = (root.row(2), root.row(5));
            for (entry, &along) in row.iter_mut().zip(&advance) {
                *entry = pitch.mul_add(along, *entry);
            }
            root.measure(&row, root_row(2), noise, Some(mean))
        }
    };
    if let HingeMap::Axis(i) = *hinge
        && noise.lane(0) == 0.0
    {
        dropped.gain[i] = dropped.pivot.constant(1.0);
        root.clear(i);
    }
    dropped
}

/// The mean of one stage for one measurement: y and t; and the measurement.
pub type MeanOfRow<'a, T> = (&'a mut [T; 6], &'a mut Vector6<T>, T);

/// One row of a stage: D and g (3.6), e^- (4.2), and the update of the mean (4.5). With `POSITIVE` all weights of the
/// root are positive.
#[inline(always)]
pub fn measure_row<T: Real, const POSITIVE: bool>(
    (hinge, noise): (&HingeMap<T>, T),
    root: &mut Root6<T>,
    (y, t, measurement): MeanOfRow<'_, T>,
) -> (Measured<T>, T) {
    let dropped = measurement_update::<T, POSITIVE>(root, y, hinge, noise);
    // The prediction of y is removed with the dropped column: only t is compared with the measurement.
    let rest = measurement - hinge.project(t);
    *t = scaled_add(&dropped.gain, rest, t);
    let e = rest - dropped.predicted;
    (Measured { pivot: dropped.pivot, pivot_inverse: dropped.pivot_inverse, gain: dropped.gain }, e)
}

/// The mean of one stage, y and t, and slices of its measurements and innovations.
pub type StageMean<'a, T> = (&'a mut [T; 6], &'a mut Vector6<T>, &'a [T], &'a mut [T]);

/// The arguments of the rows of a stage.
struct StageRows<'a, 'm, T: Real> {
    root: &'a mut Root6<T>,
    scale: &'a Scale<T>,
    mean: StageMean<'m, T>,
    measured: &'a mut [Measured<T>],
    monitor: &'a mut RootMonitor<T>,
}

// A method, because a closure may be compiled as a function without the vector instructions.
impl<T: Real> StageRows<'_, '_, T> {
    #[inline(always)]
    fn one_row(&mut self, row: usize, hinge: &HingeMap<T>, noise: T) {
        let (y, t, measurement, innovations) = &mut self.mean;
        let (m, e) = measure_row::<T, false>((hinge, noise), self.root, (y, t, measurement[row]));
        innovations[row] = e;
        self.monitor.observe(&m, hinge, self.scale);
        self.measured[row] = m;
    }
}

/// All rows of a stage, last first. Returns true if they are one rotation without noise, after which two columns have
/// no linear part.
#[inline(always)]
pub fn through_stage<T: Real>(
    (system, k): (&System<T>, usize),
    (root, scale): (&mut Root6<T>, &Scale<T>),
    mean: StageMean<'_, T>,
    measured: &mut [Measured<T>],
    monitor: &mut RootMonitor<T>,
) -> bool {
    let stage = &system.stages[k];
    let mut of_stage = StageRows { root, scale, mean, measured, monitor };
    if let Rows::One(HingeMap::Axis(2)) = stage.rows {
        // The most frequent row is named, so that the compiler knows which columns it leaves.
        of_stage.one_row(stage.first_row, &HingeMap::Axis(2), system.noise[stage.first_row]);
        return system.is_noise_free(stage.first_row);
    }
    for i in (0..stage.rows.count()).rev() {
        let row = stage.first_row + i;
        of_stage.one_row(row, &stage.rows.row(i), system.noise[row]);
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix6;

    /// Rounding errors that remained would be inertia of a motion that the joint allows.
    #[test]
    fn a_measurement_without_noise_leaves_exact_zeros() {
        for (i, noise) in (0..6).flat_map(|i| [(i, 0.0), (i, 0.3)]) {
            let mut root = Root6::filled(0.0);
            for (row, k) in root.rows.iter_mut().zip(0_u8..) {
                row.iter_mut().zip(0_u8..).for_each(|(entry, j)| *entry = f64::from(7 * k + j).sin());
            }
            root.weights = [0.3, 1.7, 0.9, 2.1, 0.7, 1.1];
            let before = root.to_matrix() * root.to_matrix().transpose();
            let dropped = measurement_update::<f64, true>(&mut root, &mut [0.5; 6], &HingeMap::Axis(i), noise);

            let after = root.to_matrix() * root.to_matrix().transpose();
            let gain = before.column(i) / (before[(i, i)] + noise);
            let expected: Matrix6<f64> = before - gain * before.row(i);
            assert!((after - expected).abs().max() < 1e-13, "axis {i}, noise {noise}: {after} {expected}");
            assert!((dropped.gain - gain).abs().max() < 1e-13);
            let is_zero = root.to_matrix().row(i).iter().all(|&entry| entry == 0.0);
            assert_eq!((is_zero, dropped.gain[i] >= 1.0), (noise == 0.0, noise == 0.0), "axis {i}: {root:?}");
        }
    }
}
