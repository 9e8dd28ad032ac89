//! `M^-1` in the plane, in closed form (6.1, as it holds), in the base's frame: nothing is turned between bodies.

use super::inward;
use super::mass_matrix::onto_base;
use super::model::{PlanarBody, PlanarModel};
use super::outward::{dot, placements, turned};
use super::scratch::{OnBase, PlanarScratch};
use crate::filter::pivots::PivotMonitor;
use crate::scalar::{ColumnsOf, Real};

/// `M^-1` at `q` into `out`, (nv x nv) row by row, as [`dynamics::mass_matrix_inverse`](crate::dynamics::mass_matrix_inverse()) gives it in
/// covariance form.
///
/// About 10 operations an entry below the diagonal. Where the monitor is not clear, `out` means nothing.
#[inline(always)]
pub fn mass_matrix_inverse<T: Real, C: ColumnsOf<T>>(
    model: &PlanarModel<T>,
    scratch: &mut PlanarScratch<T, C>,
    q: &[T],
    out: &mut [T],
) -> PivotMonitor<T> {
    let nv = model.bodies.len();
    let PlanarScratch { of, on_base, columns, parted, branches } = scratch;
    let (of, on_base) = (&mut of[..], &mut on_base[..]);
    placements(model, of, q);
    let monitor = inward::sweep::<T, false>(model, of, &[], &mut []);
    onto_base(model, of, on_base);
    for (k, body) in model.bodies.iter().enumerate() {
        let [moment, x, y] = of[k].gain;
        let [x, y] = turned(on_base[k].turn, [x, y]);
        on_base[k].gain = [moment, x, y];
        out[k * nv + k] = co_state_covariance(on_base, (k, body), of[k].pivot_inverse);
    }
    let mut first = 0;
    while first < nv {
        let end = (first + C::COLUMNS).min(nv);
        if branches[..end].contains(&true) {
            for column in first..end {
                part(model, on_base, branches, (column, column - first), parted);
            }
        }
        for (k, body) in model.bodies.iter().enumerate().skip(first) {
            let own = &on_base[k];
            let like = columns[k][0];
            let mut y = match body.parent {
                Some(parent) => {
                    let [angular, x, y] = if parent < first { parted[parent] } else { columns[parent] };
                    let (lx, ly) = (like.spread(own.lever[0]), like.spread(own.lever[1]));
                    [angular, x.minus_product(angular, ly), angular.mul_add(lx, y)]
                }
                None => [like.constant(0.0); 3],
            };
            let gain = [like.spread(own.gain[0]), like.spread(own.gain[1]), like.spread(own.gain[2])];
            let entry = projected(body.is_noise_free && body.turns(), gain, y);
            for column in first..k.min(end) {
                let value = entry.column(column - first);
                // Along the joints' own axes.
                let value = if body.is_reversed() == model.bodies[column].is_reversed() { value } else { -value };
                (out[k * nv + column], out[column * nv + k]) = (value, value);
            }
            if body.turns() {
                y[0] -= entry;
            } else {
                y[1] = y[1].minus_product(like.spread(own.turn[0]), entry);
                y[2] = y[2].minus_product(like.spread(own.turn[1]), entry);
            }
            columns[k] = y;
            if k < end {
                start(own, body.turns(), k - first, out[k * nv + k], &mut columns[k]);
                keep_parted(&parted[k], k + 1 - first..end - first, &mut columns[k]);
            }
        }
        first = end;
    }
    monitor
}

/// g* y; where g begins with one, that is not multiplied.
#[inline(always)]
fn projected<C: Real>(begins_with_one: bool, gain: [C; 3], y: [C; 3]) -> C {
    if begins_with_one { gain[1].mul_add(y[1], gain[2].mul_add(y[2], y[0])) } else { dot(gain, y) }
}

/// Lambda^-(k) from the parent's (5.6, 5.7), and u = Lambda^+ g; gives g* u + 1/D, the diagonal entry of `M^-1`.
#[inline(always)]
fn co_state_covariance<T: Real>(on_base: &mut [OnBase<T>], (k, body): (usize, &PlanarBody<T>), pivot_inverse: T) -> T {
    let OnBase { lever: [lx, ly], turn: [c, s], gain, .. } = on_base[k];
    let mut lambda = [lx.constant(0.0); 6];
    if let Some(parent) = body.parent {
        let [w, wx, wy, xx, xy, yy] = on_base[parent].co_state_covariance;
        // With v = e x l: c' = c + v w, B' = B + v c* + c' v*.
        let (moved_x, moved_y) = (wx.minus_product(ly, w), lx.mul_add(w, wy));
        lambda = [
            w,
            moved_x,
            moved_y,
            xx.minus_product(ly, wx + moved_x),
            lx.mul_add(moved_x, xy.minus_product(ly, wy)),
            lx.mul_add(wy + moved_y, yy),
        ];
    }
    let u = times(lambda, gain);
    let whole = dot(gain, u) + pivot_inverse;
    if body.turns() {
        lambda[0] += whole - (u[0] + u[0]);
        lambda[1] -= u[1];
        lambda[2] -= u[2];
    } else {
        // Lambda^- = Lambda^+ + H* w + w* H with w = H whole / 2 - u.
        let half = whole * whole.constant(0.5);
        let (wx, wy) = ((c * half) - u[1], (s * half) - u[2]);
        lambda[1] = lambda[1].minus_product(c, u[0]);
        lambda[2] = lambda[2].minus_product(s, u[0]);
        lambda[3] += (c + c) * wx;
        lambda[4] += c.mul_add(wy, s * wx);
        lambda[5] += (s + s) * wy;
    }
    on_base[k].co_state_covariance = lambda;
    on_base[k].spread_gain = u;
    whole
}

/// A symmetric matrix times a vector.
#[inline(always)]
fn times<T: Real>([a, b, c, d, e, f]: [T; 6], x: [T; 3]) -> [T; 3] {
    [dot([a, b, c], x), dot([b, d, e], x), dot([c, e, f], x)]
}

/// Inward from a column's body: u = Psi(c,j) g(j) at every body c that carries it, and Lambda^-(c) u where branches part.
#[inline(always)]
fn part<T: Real, C: ColumnsOf<T>>(
    model: &PlanarModel<T>,
    on_base: &[OnBase<T>],
    branches: &[bool],
    (column, lane): (usize, usize),
    parted: &mut [[C; 3]],
) {
    let mut u = on_base[column].gain;
    let mut child = column;
    while let Some(k) = model.bodies[child].parent {
        let [lx, ly] = on_base[child].lever;
        u[0] = lx.mul_add(u[2], u[0].minus_product(ly, u[1]));
        let own = &on_base[k];
        if branches[k] {
            for (entry, y) in parted[k].iter_mut().zip(times(own.co_state_covariance, u)) {
                entry.set_column(lane, y);
            }
        }
        let [c, s] = own.turn;
        let along = if model.bodies[k].turns() { u[0] } else { c.mul_add(u[1], s * u[2]) };
        for (u, gain) in u.iter_mut().zip(own.gain) {
            *u = u.minus_product(gain, along);
        }
        child = k;
    }
}

/// A column begins at its own body: y = Lambda^+ g - H* times the diagonal entry.
#[inline(always)]
fn start<T: Real, C: ColumnsOf<T>>(own: &OnBase<T>, turns: bool, lane: usize, diagonal: T, y: &mut [C; 3]) {
    let ([c, s], [u, ux, uy]) = (own.turn, own.spread_gain);
    let own =
        if turns { [u - diagonal, ux, uy] } else { [u, ux.minus_product(c, diagonal), uy.minus_product(s, diagonal)] };
    for (y, own) in y.iter_mut().zip(own) {
        y.set_column(lane, own);
    }
}

/// Columns that belong further out have here what they leave to other branches.
#[inline(always)]
fn keep_parted<T: Real, C: ColumnsOf<T>>(parted: &[C; 3], lanes: std::ops::Range<usize>, y: &mut [C; 3]) {
    for lane in lanes {
        for (y, parted) in y.iter_mut().zip(parted) {
            y.set_column(lane, parted.column(lane));
        }
    }
}
