//! The rows of a floating body: all six on the base, measured without noise. A floating body propagates nothing to the
//! base. A measured component is exactly zero for the later rows, so that each row has one column less than the
//! previous one.

use super::{Measures, RootMean};
use crate::filter::pivots::Scale;
use crate::filter::riccati::Measured;
use crate::filter::rounding::RootMonitor;
use crate::filter::{HingeMap, System};
use crate::scalar::Real;
use crate::spatial::Root6;
use nalgebra::Vector6;
use std::ops::Range;

/// The component that each row selects: linear, then angular. They are measured in reverse order.
pub(in crate::dynamics) const PICKED: [usize; 6] = [3, 4, 5, 0, 1, 2];

/// The components of a vector in the order of the rows.
#[inline(always)]
pub(in crate::dynamics) fn picked<N: Copy>(v: &[N; 6]) -> [N; 6] {
    let [a, b, c, d, e, f] = PICKED;
    [v[a], v[b], v[c], v[d], v[e], v[f]]
}

/// The index of an entry among the 21.
const fn place(i: usize, j: usize) -> usize {
    const PACKED: [[usize; 6]; 6] = [
        [0, 1, 2, 6, 7, 8],
        [1, 3, 4, 9, 10, 11],
        [2, 4, 5, 12, 13, 14],
        [6, 9, 12, 15, 16, 17],
        [7, 10, 13, 16, 18, 19],
        [8, 11, 14, 17, 19, 20],
    ];
    PACKED[i][j]
}

/// Six rows, the first of them among those of the scene.
#[derive(Debug, Clone, Copy)]
pub(in crate::dynamics) struct Six<'a, T: Real> {
    system: &'a System<T>,
    k: usize,
    first: usize,
}

impl<'a, T: Real> Six<'a, T> {
    #[inline(always)]
    pub fn new(system: &'a System<T>, k: usize) -> Self {
        Self { system, k, first: system.stages[k].first_row }
    }

    /// True if all six rows are currently free of noise: implicit friction can add noise to a row.
    #[inline(always)]
    pub fn is_noise_free(first: usize, system: &System<T>) -> bool {
        (first..first + 6).all(|row| system.is_noise_free(row))
    }

    #[inline(always)]
    fn rows(&self) -> Range<usize> {
        self.first..self.first + 6
    }
}

impl<T: Real> Measures<T> for Six<'_, T> {
    type Gains = ();

    #[inline(always)]
    fn stage(&self) -> (&System<T>, usize) {
        (self.system, self.k)
    }

    /// P is not propagated: returned unchanged.
    #[inline(always)]
    fn measure(&self, p: &[T; 21], measured: &mut [Measured<T>]) -> ((), [T; 21]) {
        let (mut left, measured) = (*p, &mut measured[self.rows()]);
        row::<T, 5>(&mut left, measured);
        row::<T, 4>(&mut left, measured);
        row::<T, 3>(&mut left, measured);
        row::<T, 2>(&mut left, measured);
        row::<T, 1>(&mut left, measured);
        row::<T, 0>(&mut left, measured);
        ((), *p)
    }

    #[inline(always)]
    fn keep(&self, (): (), _measured: &mut [Measured<T>]) {}

    #[inline(always)]
    fn filter(&self, measured: &[Measured<T>], measurement: &[T], z: &mut [T; 6], innovations: &mut [T]) {
        let (measured, measurement, innovations) =
            (&measured[self.rows()], &measurement[self.rows()], &mut innovations[self.rows()]);
        for row in (0..6).rev() {
            let own = PICKED[row];
            let e = measurement[row] - z[own];
            for &i in &PICKED[..row] {
                z[i] = measured[row].gain[i].mul_add(e, z[i]);
            }
            z[own] = measurement[row];
            innovations[row] = e;
        }
    }

    #[inline(always)]
    fn spread(&self, u: &[T], motion: &mut [T; 6]) {
        for (&u, own) in u[self.rows()].iter().zip(PICKED) {
            motion[own] += u;
        }
    }

    /// The base does not move.
    #[inline(always)]
    fn spread_moving(&self, qd: &[T], velocity: &mut [T; 6], _acceleration: &mut [T; 6]) {
        self.spread(qd, velocity);
    }

    #[inline(always)]
    fn weights(&self, measured: &[Measured<T>]) -> [T; 2] {
        let m = &measured[self.rows()];
        // The linear rows precede the angular ones.
        [
            m[3].pivot_inverse + m[4].pivot_inverse + m[5].pivot_inverse,
            m[0].pivot_inverse + m[1].pivot_inverse + m[2].pivot_inverse,
        ]
    }

    /// The base has no co-state: the estimates are the co-state of the body.
    #[inline(always)]
    fn smooth(&self, measured: &[Measured<T>], lambda: &mut [T; 6], estimates: &mut [T]) {
        let (measured, estimates) = (&measured[self.rows()], &mut estimates[self.rows()]);
        for row in 0..6 {
            let m = &measured[row];
            let mut a = estimates[row] * m.pivot_inverse;
            for &i in &PICKED[..row] {
                a = a.minus_product(m.gain[i], lambda[i]);
            }
            lambda[PICKED[row]] = a;
            estimates[row] = a;
        }
    }

    #[inline(always)]
    fn measure_root(
        &self,
        (root, scale, _): (&mut Root6<T>, &Scale<T>, bool),
        (y, t): RootMean<'_, T>,
        (measurement, innovations): (&[T], &mut [T]),
        measured: &mut [Measured<T>],
        monitor: &mut RootMonitor<T>,
    ) -> bool {
        let (measured, innovations) = (&mut measured[self.rows()], &mut innovations[self.rows()]);
        let mut of_rows = (root, y, t, &measurement[self.rows()], &mut *measured, innovations);
        measure_root_row::<T, 6>(&mut of_rows);
        measure_root_row::<T, 5>(&mut of_rows);
        measure_root_row::<T, 4>(&mut of_rows);
        measure_root_row::<T, 3>(&mut of_rows);
        measure_root_row::<T, 2>(&mut of_rows);
        measure_root_row::<T, 1>(&mut of_rows);
        for (m, own) in measured.iter().zip(PICKED) {
            monitor.observe(m, &HingeMap::Axis(own), scale);
        }
        false
    }
}

/// One of the rows, and the remaining part of those before it.
#[inline(always)]
fn row<T: Real, const ROW: usize>(p: &mut [T; 21], measured: &mut [Measured<T>]) {
    let own = PICKED[ROW];
    let pivot = p[place(own, own)];
    let pivot_inverse = pivot.recip();
    let mut gain = Vector6::from_element(pivot.constant(0.0));
    gain[own] = pivot.constant(1.0);
    for &i in &PICKED[..ROW] {
        gain[i] = p[place(own, i)] * pivot_inverse;
    }
    for (before, &i) in PICKED[..ROW].iter().enumerate() {
        for &j in &PICKED[..=before] {
            p[place(i, j)] = p[place(i, j)].minus_product(gain[i], p[place(own, j)]);
        }
    }
    measured[ROW] = Measured { pivot, pivot_inverse, gain };
}

/// Root, y, t, measurements, D and g, e^-.
type OfRows<'a, T> =
    (&'a mut Root6<T>, &'a mut [T; 6], &'a mut Vector6<T>, &'a [T], &'a mut [Measured<T>], &'a mut [T]);

/// The last of the first `ROWS` rows. Each row has its own column in the root.
#[inline(always)]
fn measure_root_row<T: Real, const ROWS: usize>((root, y, t, measurement, measured, innovations): &mut OfRows<'_, T>) {
    let (row, own) = (ROWS - 1, PICKED[ROWS - 1]);
    let mut dropped = root.measure_last::<ROWS, false>(measurement[row].constant(0.0), Some(y));
    dropped.gain[own] = dropped.pivot.constant(1.0);
    root.clear(own);
    let rest = measurement[row] - t[own];
    for &i in &PICKED[..ROWS] {
        t[i] = dropped.gain[i].mul_add(rest, t[i]);
    }
    innovations[row] = rest - dropped.predicted;
    measured[row] = Measured { pivot: dropped.pivot, pivot_inverse: dropped.pivot_inverse, gain: dropped.gain };
}
