//! The Riccati recursion (3.6, 3.10) in square-root form: P = L W L^T, and no covariance is ever subtracted.
//!
//! Given phi, the roots of the process noise, H and r; computes, from the leaves to the root, D, g and the root of P^+. Time update: the columns of the
//! children are joined to those of the stage by rotations from the right. A measurement without noise deletes a column. About
//! 1020 operations a stage of one row, 31 of them divisions.

use super::pivots::Scale;
use super::riccati::Measured;
use super::rounding::RootMonitor;
use super::system::{HingeMap, Rows, System};
use crate::scalar::Real;
use crate::spatial::{Dropped, RigidShift, Root6, RootColumns, root_row, scaled_add, sum};
use nalgebra::Vector6;

/// The arrays of the recursion, one entry a stage or a row.
#[derive(Debug)]
pub struct Roots<'a, T: Real> {
    /// phi of each stage to its parent.
    pub shift: &'a [RigidShift<T>],
    /// In: the root of Q(k). Out: that of P^+(k).
    pub root: &'a mut [Root6<T>],
    /// In: the bound of Q(k)'s terms. Out: that of P^-(k).
    pub scale: &'a mut [Scale<T>],
    /// D and g of each row.
    pub measured: &'a mut [Measured<T>],
}

/// The filter's state beside the root: z = L y + t, y the mean of the process noise and t what measurements added.
#[derive(Debug)]
pub struct Mean<'a, T: Real> {
    /// In: y of each stage's process noise, b(k) = L y + t. Out: y after the stage's measurements.
    pub coordinates: &'a mut [[T; 6]],
    /// In: t of each stage's process noise. Out: t after the stage's measurements.
    pub added: &'a mut [Vector6<T>],
    /// The measurements.
    pub measurement: &'a [T],
    /// Receives e^- of each row (4.2).
    pub innovations: &'a mut [T],
}

/// The measurement update of eq. 3.6 on a root, and on the mean where there is one.
///
/// Without noise H g = 1 and H P^+ = 0 hold exactly and are written, not computed.
#[inline(always)]
fn measurement_update<T: Real, const POSITIVE: bool>(
    root: &mut Root6<T>,
    mean: Option<&mut [T; 6]>,
    hinge: &HingeMap<T>,
    noise: T,
) -> Dropped<T> {
    let mut dropped = match *hinge {
        HingeMap::Axis(2) => root.measure_turn::<POSITIVE>(noise, mean),
        HingeMap::Axis(i) => root.measure(&root.row(i), root_row(i), noise, mean),
        HingeMap::Screw(pitch) => {
            let (mut row, advance) = (root.row(2), root.row(5));
            for (entry, &along) in row.iter_mut().zip(&advance) {
                *entry = pitch.mul_add(along, *entry);
            }
            root.measure(&row, root_row(2), noise, mean)
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

/// The mean of one stage as one measurement sees it: y and t; and the measurement.
pub type MeanOfRow<'a, T> = (&'a mut [T; 6], &'a mut Vector6<T>, T);

/// One row of a stage: D and g (3.6); with a mean e^- (4.2) and what becomes of it (4.5), else zero. `POSITIVE` where every weight of the
/// root is.
#[inline(always)]
pub fn measure_row<T: Real, const POSITIVE: bool>(
    (hinge, noise): (&HingeMap<T>, T),
    root: &mut Root6<T>,
    mean: Option<MeanOfRow<'_, T>>,
) -> (Measured<T>, T) {
    let (dropped, e) = match mean {
        None => (measurement_update::<T, POSITIVE>(root, None, hinge, noise), noise.constant(0.0)),
        Some((y, t, measurement)) => {
            let dropped = measurement_update::<T, POSITIVE>(root, Some(y), hinge, noise);
            // What y predicts leaves with the dropped column: only t meets the measurement.
            let rest = measurement - hinge.project(t);
            *t = scaled_add(&dropped.gain, rest, t);
            let e = rest - dropped.predicted;
            (dropped, e)
        }
    };
    (Measured { pivot: dropped.pivot, pivot_inverse: dropped.pivot_inverse, gain: dropped.gain }, e)
}

/// The mean of one stage: y, t, and where its measurements and innovations are.
pub type StageMean<'a, T> = (&'a mut [T; 6], &'a mut Vector6<T>, &'a [T], &'a mut [T]);

/// What the rows of a stage read and write.
struct OfStage<'a, 'm, T: Real> {
    root: &'a mut Root6<T>,
    scale: &'a Scale<T>,
    mean: &'a mut Option<StageMean<'m, T>>,
    measured: &'a mut [Measured<T>],
    monitor: &'a mut RootMonitor<T>,
}

impl<T: Real> OfStage<'_, '_, T> {
    #[inline(always)]
    fn one_row(&mut self, row: usize, hinge: &HingeMap<T>, noise: T) {
        #[allow(clippy::manual_map)] // a closure may stay a function, compiled without the vector instructions
        let of_row = match self.mean {
            Some((y, t, measurement, _)) => Some((&mut **y, &mut **t, measurement[row])),
            None => None,
        };
        let (m, e) = measure_row::<T, false>((hinge, noise), self.root, of_row);
        if let Some((.., innovations)) = self.mean {
            innovations[row] = e;
        }
        self.monitor.observe(&m, hinge, self.scale);
        self.measured[row] = m;
    }
}

/// All rows of a stage, last first; whether they are one turn without noise, which leaves two columns free of any linear part. `seen` is
/// called with each row's root of P^-.
#[inline(always)]
pub fn through_stage<T: Real>(
    (system, k): (&System<T>, usize),
    (root, scale): (&mut Root6<T>, &Scale<T>),
    mean: &mut Option<StageMean<'_, T>>,
    measured: &mut [Measured<T>],
    monitor: &mut RootMonitor<T>,
    mut seen: impl FnMut(usize, &Root6<T>),
) -> bool {
    let stage = &system.stages[k];
    let mut of_stage = OfStage { root, scale, mean, measured, monitor };
    if let Rows::One(HingeMap::Axis(2)) = stage.rows {
        // The commonest row is named, so that the compiler sees which columns it leaves.
        seen(stage.first_row, of_stage.root);
        of_stage.one_row(stage.first_row, &HingeMap::Axis(2), system.noise[stage.first_row]);
        return system.is_noise_free(stage.first_row);
    }
    for i in (0..stage.rows.count()).rev() {
        let row = stage.first_row + i;
        seen(row, of_stage.root);
        of_stage.one_row(row, &stage.rows.row(i), system.noise[row]);
    }
    false
}

impl<T: Real> Roots<'_, T> {
    /// One stage, all its rows (last first), then the time update onto its parent; `seen` is called with each row's root of P^-.
    pub fn step(
        &mut self,
        system: &System<T>,
        k: usize,
        mean: Option<&mut Mean<'_, T>>,
        monitor: &mut RootMonitor<T>,
        seen: &mut dyn FnMut(usize, &Root6<T>),
    ) {
        let stage = &system.stages[k];
        let shift = &self.shift[k];
        let scale = self.scale[k];
        // A parent comes before its children: what is inward and what is here can both be written to.
        let (inward, here) = self.root.split_at_mut(k);
        let root = &mut here[0];
        let (mut mean, mut inward_mean) = match mean {
            None => (None, None),
            Some(mean) => {
                let (y_inward, y) = mean.coordinates.split_at_mut(k);
                let (t_inward, t) = mean.added.split_at_mut(k);
                let of_stage: StageMean<'_, T> = (&mut y[0], &mut t[0], mean.measurement, mean.innovations);
                (Some(of_stage), Some((y_inward, t_inward)))
            }
        };
        let diagonal = root.diagonal();
        monitor.observe_root(root, &diagonal);
        let sent = Scale::sent_by_root(&diagonal, shift.lever_square());
        let noise_free_turn = through_stage((system, k), (root, &scale), &mut mean, self.measured, monitor, seen);
        let Some(parent) = stage.parent else { return };
        let mut columns = RootColumns::filled(root.weights[0]);
        shift.root_to_parent(root, &mut columns);
        let mut coordinates;
        let turned = match (mean, &mut inward_mean) {
            (Some((y, t, ..)), Some((y_inward, t_inward))) => {
                t_inward[parent] = sum(&t_inward[parent], &shift.force_to_parent(t));
                coordinates = *y;
                Some((&mut y_inward[parent], &mut coordinates))
            }
            _ => None,
        };
        if noise_free_turn {
            inward[parent].join::<2, false>(&mut columns, turned);
        } else {
            inward[parent].join::<3, false>(&mut columns, turned);
        }
        self.scale[parent] = self.scale[parent].sum(&sent);
    }
}

/// Tip to base: D, g and the root of P^+ of every stage; with a mean also e^-.
pub fn sweep<T: Real>(
    system: &System<T>,
    roots: &mut Roots<'_, T>,
    mut mean: Option<&mut Mean<'_, T>>,
    mut seen: impl FnMut(usize, &Root6<T>),
) -> RootMonitor<T> {
    let mut monitor = RootMonitor::new();
    for k in (0..system.stages.len()).rev() {
        roots.step(system, k, mean.as_deref_mut(), &mut monitor, &mut seen);
    }
    monitor
}
