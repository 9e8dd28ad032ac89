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
use crate::spatial::{Dropped, RigidShift, Root6, root_row, scaled_add, sum};
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
fn measurement_update<T: Real>(
    root: &mut Root6<T>,
    mean: Option<&mut [T; 6]>,
    hinge: &HingeMap<T>,
    noise: T,
) -> Dropped<T> {
    let (h, last) = match *hinge {
        HingeMap::Axis(i) => (root.row(i), root_row(i)),
        HingeMap::Screw(pitch) => {
            let (turn, advance) = (root.row(2), root.row(5));
            let mut row = turn;
            for (entry, &along) in row.iter_mut().zip(&advance) {
                *entry = pitch.mul_add(along, *entry);
            }
            (row, root_row(2))
        }
    };
    let mut dropped = root.measure(&h, last, noise, mean);
    if let HingeMap::Axis(i) = *hinge
        && noise.lane(0) == 0.0
    {
        dropped.gain[i] = dropped.pivot.constant(1.0);
        root.clear(i);
    }
    dropped
}

/// The mean of one stage: y, t, and where its measurements and innovations are.
type StageMean<'a, T> = (&'a mut [T; 6], &'a mut Vector6<T>, &'a [T], &'a mut [T]);

/// One row of a stage: 3.6, and with a mean 4.2 and 4.5.
#[inline(always)]
fn one_row<T: Real>(
    (row, hinge, noise): (usize, &HingeMap<T>, T),
    root: &mut Root6<T>,
    mean: &mut Option<StageMean<'_, T>>,
) -> Measured<T> {
    let dropped = match mean {
        None => measurement_update(root, None, hinge, noise),
        Some((y, t, measurement, innovations)) => {
            let dropped = measurement_update(root, Some(y), hinge, noise);
            // What y predicts leaves with the dropped column: only t meets the measurement.
            let rest = measurement[row] - hinge.project(t);
            **t = scaled_add(&dropped.gain, rest, t);
            innovations[row] = rest - dropped.predicted;
            dropped
        }
    };
    Measured { pivot: dropped.pivot, pivot_inverse: dropped.pivot_inverse, gain: dropped.gain }
}

impl<T: Real> Roots<'_, T> {
    /// One stage, all its rows (last first), then the time update onto its parent; `seen` is called with each row's root of P^-.
    #[inline(always)]
    pub fn step(
        &mut self,
        system: &System<T>,
        k: usize,
        mean: Option<&mut Mean<'_, T>>,
        monitor: &mut RootMonitor<T>,
        mut seen: impl FnMut(usize, &Root6<T>),
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
        let sent = Scale::sent_by_root(&diagonal, shift);
        let noise_free_turn = if let Rows::One(HingeMap::Axis(2)) = stage.rows {
            // The commonest row is named, so that the compiler sees which columns it leaves.
            let (row, hinge) = (stage.first_row, HingeMap::Axis(2));
            seen(row, root);
            let m = one_row((row, &hinge, system.noise[row]), root, &mut mean);
            monitor.observe(&m, &hinge, &scale);
            self.measured[row] = m;
            system.is_noise_free(row)
        } else {
            for i in (0..stage.rows.count()).rev() {
                let (row, hinge) = (stage.first_row + i, stage.rows.row(i));
                seen(row, root);
                let m = one_row((row, &hinge, system.noise[row]), root, &mut mean);
                monitor.observe(&m, &hinge, &scale);
                self.measured[row] = m;
            }
            false
        };
        let Some(parent) = stage.parent else { return };
        let columns = shift.root_to_parent(root);
        let turned = match (mean, &mut inward_mean) {
            (Some((y, t, ..)), Some((y_inward, t_inward))) => {
                t_inward[parent] = sum(&t_inward[parent], &shift.force_to_parent(t));
                Some((&mut y_inward[parent], *y))
            }
            _ => None,
        };
        if noise_free_turn {
            inward[parent].join::<2>(columns, turned);
        } else {
            inward[parent].join::<3>(columns, turned);
        }
        self.scale[parent] = self.scale[parent].sum(&sent);
    }
}

/// Tip to base: D, g and the root of P^+ of every stage; with a mean also e^-.
#[inline(always)]
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
