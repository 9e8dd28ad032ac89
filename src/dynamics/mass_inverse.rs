//! The inverse of the mass matrix in closed form (6.1, as it holds), without forming or factoring M.

use super::forward::factorise;
use crate::filter::covariance;
use crate::filter::innovations::past_rows;
use crate::filter::pivots::PivotMonitor;
use crate::scalar::Real;
use crate::scene::Model;
use crate::spatial::{Symmetric6, dot};
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// Scratch that only the closed form needs.
#[derive(Debug, Clone)]
pub struct InverseScratch<T: Real> {
    /// Lambda^- of each body.
    co_state_covariance: Vec<Symmetric6<T>>,
    /// Lambda^+ g of each row.
    spread_gain: Vec<Vector6<T>>,
    /// Minus the co-state of the column at hand, outboard of each body.
    column: Vec<Vector6<T>>,
    /// One past the last body of each body's subtree.
    subtree_end: Vec<usize>,
}

impl<T: Real> InverseScratch<T> {
    /// Scratch for `model`.
    pub fn new(model: &Model<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        let bodies = model.bodies.len();
        let mut subtree_end: Vec<usize> = (1..=bodies).collect();
        for (k, stage) in model.system.stages.iter().enumerate().rev() {
            if let Some(parent) = stage.parent {
                subtree_end[parent] = subtree_end[parent].max(subtree_end[k]);
            }
        }
        Self {
            co_state_covariance: vec![Symmetric6::filled(nan); bodies],
            spread_gain: vec![Vector6::from_element(nan); model.nv()],
            column: vec![Vector6::from_element(nan); bodies],
            subtree_end,
        }
    }
}

/// M^-1 at `q` into `out`, (nv x nv) row by row, full and symmetric (6.1 with its cross-branch terms).
///
/// With L+ = Lambda^+ and A = 1 - gH: the diagonal is 1/D + g* L+ g; outboard of joint j the entry is g(i)* Psi* (A* L+ g - H*/D);
/// across branches that part at body c it is g(i)* Psi(c,i)* Lambda^-(c) Psi(c,j) g(j). O(N^2), the order of the output.
pub fn mass_matrix_inverse<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut InverseScratch<T>,
    q: &[T],
    out: &mut [T],
) -> PivotMonitor<T> {
    let monitor = factorise(model, workspace, q, |_, _| {});
    closed_form(model, workspace, scratch, out);
    monitor
}

/// [`mass_matrix_inverse`] with the factor already in the workspace.
#[inline(always)]
pub(crate) fn closed_form<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut InverseScratch<T>,
    out: &mut [T],
) {
    let spread_gain = &mut scratch.spread_gain;
    let measured = &workspace.measured;
    covariance::sweep(&model.system, &workspace.shift, measured, &mut scratch.co_state_covariance, |row, _, u| {
        spread_gain[row] = *u;
    });
    for k in 0..model.bodies.len() {
        for i in 0..model.system.stages[k].rows.count() {
            column(model, workspace, scratch, (k, i), out);
        }
    }
}

/// The column of row `i` of body `k`, from the diagonal downward, mirrored to the right.
#[inline(always)]
fn column<T: Real>(
    model: &Model<T>,
    workspace: &Workspace<T>,
    scratch: &mut InverseScratch<T>,
    (k, i): (usize, usize),
    out: &mut [T],
) {
    let nv = model.nv();
    let stages = &model.system.stages;
    let measured = &workspace.measured;

    // The diagonal, and y = A* L+ g - H*/D just outboard of this row.
    let stage = &stages[k];
    let j = stage.first_row + i;
    let y = scratch.spread_gain[j];
    let diagonal = measured[j].pivot_inverse + dot(&measured[j].gain, &y);
    put(out, nv, (j, j), diagonal);
    let mut y = stage.rows.row(i).spread_onto(&y, -diagonal);
    for other in i + 1..stage.rows.count() {
        y = cross_row(model, measured, (k, other), &y, (j, out));
    }
    scratch.column[k] = y;

    // Inward, u = Psi(c,j) g(j); where another branch leaves after this one, y = Lambda^-(c) u for it.
    let mut u = measured[j].gain;
    past_rows(stage, measured, 0..i, &mut u);
    let mut child = k;
    while let Some(parent) = stages[child].parent {
        u = workspace.shift[child].force_to_parent(&u);
        if scratch.subtree_end[parent] > scratch.subtree_end[k] {
            scratch.column[parent] = scratch.co_state_covariance[parent].mul_vector(&u);
        }
        past_rows(&stages[parent], measured, 0..stages[parent].rows.count(), &mut u);
        child = parent;
    }

    // Outward over everything that comes after: the subtree of k, then the later branches.
    for (b, stage) in stages.iter().enumerate().skip(k + 1) {
        let mut y = match stage.parent {
            Some(parent) => workspace.shift[b].motion_to_child(&scratch.column[parent]),
            None => crate::spatial::zero(),
        };
        for other in 0..stage.rows.count() {
            y = cross_row(model, measured, (b, other), &y, (j, out));
        }
        scratch.column[b] = y;
    }
}

/// One entry and its mirror image.
#[inline(always)]
fn put<T: Real>(out: &mut [T], nv: usize, (row, column): (usize, usize), value: T) {
    out[row * nv + column] = value;
    out[column * nv + row] = value;
}

/// Outward across one row: the entry g* y of `column`, and A* y.
#[inline(always)]
fn cross_row<T: Real>(
    model: &Model<T>,
    measured: &[crate::filter::riccati::Measured<T>],
    (k, i): (usize, usize),
    y: &Vector6<T>,
    (column, out): (usize, &mut [T]),
) -> Vector6<T> {
    let stage = &model.system.stages[k];
    let row = stage.first_row + i;
    let entry = dot(&measured[row].gain, y);
    put(out, model.nv(), (row, column), entry);
    stage.rows.row(i).spread_onto(y, -entry)
}
