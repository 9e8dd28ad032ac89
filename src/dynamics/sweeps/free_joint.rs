//! A body that floats: all six rows on the base, measured without noise. Nothing goes on from it, and what a row is measured at is exactly
//! zero for those after it, so that each row has one column less.

use super::scratch::Moving;
use super::vectors::cross;
use crate::dynamics::forces::{Motion, Needed};
use crate::filter::pivots::{PivotMonitor, Scale};
use crate::filter::riccati::Measured;
use crate::filter::{HingeMap, System};
use crate::scalar::Real;
use crate::spatial::{RigidShift, Root6};
use nalgebra::{Vector3, Vector6};

/// The component that each row picks: linear, then angular. They are measured last first.
pub(super) const PICKED: [usize; 6] = [3, 4, 5, 0, 1, 2];

/// The components of a vector in the order of the rows.
#[inline(always)]
pub(super) fn picked<N: Copy>(v: &[N; 6]) -> [N; 6] {
    let [a, b, c, d, e, f] = PICKED;
    [v[a], v[b], v[c], v[d], v[e], v[f]]
}

/// Where an entry is among the 21.
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

/// Against a base that accelerates by `base` and does not turn.
#[inline(always)]
pub(super) fn moving<T: Real>(
    row: usize,
    shift: &RigidShift<T>,
    base: &[T; 3],
    state: Motion<'_, T>,
    needed: Needed,
) -> Moving<T> {
    let o = base[0].constant(0.0);
    let felt = shift.rotate_back(&Vector3::new(base[0], base[1], base[2]));
    let (mut w, mut dw, mut a) = ([o; 3], [o; 3], [felt[0], felt[1], felt[2]]);
    if needed.velocity {
        let qd = &state.qd[row..row + 6];
        w = [qd[3], qd[4], qd[5]];
        a = cross(w, [qd[0], qd[1], qd[2]], a);
    }
    if let Some(qdd) = state.qdd {
        let qdd = &qdd[row..row + 6];
        dw = [qdd[3], qdd[4], qdd[5]];
        a = [a[0] + qdd[0], a[1] + qdd[1], a[2] + qdd[2]];
    }
    [w, dw, a]
}

/// D and g of the six rows (3.6, 3.10), last first.
#[inline(always)]
pub(super) fn measure<T: Real>(
    mut p: [T; 21],
    scale: &Scale<T>,
    measured: &mut [Measured<T>],
    monitor: &mut PivotMonitor<T>,
) {
    row::<T, 5>(&mut p, scale, measured, monitor);
    row::<T, 4>(&mut p, scale, measured, monitor);
    row::<T, 3>(&mut p, scale, measured, monitor);
    row::<T, 2>(&mut p, scale, measured, monitor);
    row::<T, 1>(&mut p, scale, measured, monitor);
    row::<T, 0>(&mut p, scale, measured, monitor);
}

/// One of them: what it leaves of those before it.
#[inline(always)]
fn row<T: Real, const ROW: usize>(
    p: &mut [T; 21],
    scale: &Scale<T>,
    measured: &mut [Measured<T>],
    monitor: &mut PivotMonitor<T>,
) {
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
    monitor.observe(pivot, &HingeMap::Axis(own), scale);
    measured[ROW] = Measured { pivot, pivot_inverse, gain };
}

/// D, g and e^- of the six rows, last first, in square-root form; z = L y + t is what was measured then.
#[inline(always)]
pub(super) fn measure_root<T: Real>(
    root: &mut Root6<T>,
    (y, t): (&mut [T; 6], &mut Vector6<T>),
    measurement: &[T],
    measured: &mut [Measured<T>],
    innovations: &mut [T],
) {
    let mut of_rows = (root, y, t, measurement, measured, innovations);
    measure_root_row::<T, 6>(&mut of_rows);
    measure_root_row::<T, 5>(&mut of_rows);
    measure_root_row::<T, 4>(&mut of_rows);
    measure_root_row::<T, 3>(&mut of_rows);
    measure_root_row::<T, 2>(&mut of_rows);
    measure_root_row::<T, 1>(&mut of_rows);
}

/// Root, y, t, measurements, D and g, e^-.
type OfRows<'a, T> =
    (&'a mut Root6<T>, &'a mut [T; 6], &'a mut Vector6<T>, &'a [T], &'a mut [Measured<T>], &'a mut [T]);

/// The last of the first `ROWS` rows. A row's place in the root is its own.
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

/// The filter of one right side: z^- becomes z^+, which is what was measured (4.2, 4.5).
#[inline(always)]
pub(super) fn filter<T: Real>(measured: &[Measured<T>], measurement: &[T], z: &mut [T; 6], innovations: &mut [T]) {
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

/// The smoother, first to last: the estimates (4.9), which are the co-state (4.11).
#[inline(always)]
pub(super) fn smooth<T: Real>(measured: &[Measured<T>], estimates: &mut [T]) -> [T; 6] {
    let mut lambda = [estimates[0]; 6];
    for row in 0..6 {
        let m = &measured[row];
        let mut a = estimates[row] * m.pivot_inverse;
        for &i in &PICKED[..row] {
            a = a.minus_product(m.gain[i], lambda[i]);
        }
        lambda[PICKED[row]] = a;
        estimates[row] = a;
    }
    lambda
}

/// Whether a body is on a free joint that is measured without noise now: friction, taken implicitly, comes and goes.
#[inline(always)]
pub(super) fn is_noise_free<T: Real>(is_free_joint: bool, first_row: usize, system: &System<T>) -> bool {
    is_free_joint && rows(first_row).all(|row| system.is_noise_free(row))
}

/// Rows of a body that floats among those of the state.
#[inline(always)]
pub(super) fn rows(first_row: usize) -> std::ops::Range<usize> {
    first_row..first_row + 6
}
