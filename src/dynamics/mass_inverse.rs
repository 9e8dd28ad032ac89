//! The inverse of the mass matrix in closed form (6.1, as it holds), without forming or factoring M.

use super::columns::{
    Block, Columns, body_of_row, put, put_row, spread_hinge, spread_shift, spread_symmetric, spread_vector,
};
use super::forward::factorise;
use super::refined::DoubleDoubleState;
use super::sweeps::co_state_covariances;
use crate::filter::Form;
use crate::filter::innovations::past_rows;
use crate::filter::pivots::PivotMonitor;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::{Symmetric6, dot, scaled_add, zero};
use crate::workspace::{Made, Workspace};
use nalgebra::Vector6;

/// Scratch of the closed form, for the columns in `C`.
#[derive(Debug, Clone)]
pub struct InverseScratch<T: Real, C: Real = T> {
    /// Lambda^- of each body.
    co_state_covariance: Vec<Symmetric6<T>>,
    /// Lambda^+ g of each row.
    spread_gain: Vec<Vector6<T>>,
    /// Psi(k,j) g(j) of the current columns, propagated inward.
    inward: Columns<C>,
    /// Minus their co-states, outboard of each body; at a body with another branch, Lambda^- Psi g.
    outward: Columns<C>,
    /// True for bodies with more than one child.
    branches: Vec<bool>,
    /// Identity of the model.
    identity: u64,
}

impl<T: Real, C: ColumnsOf<T>> InverseScratch<T, C> {
    /// Scratch for `model`.
    pub fn new(model: &Model<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        let bodies = model.bodies.len();
        let mut children = vec![0_usize; bodies];
        for parent in model.system.stages.iter().filter_map(|stage| stage.parent) {
            children[parent] += 1;
        }
        Self {
            co_state_covariance: vec![Symmetric6::filled(nan); bodies],
            spread_gain: vec![Vector6::from_element(nan); model.nv()],
            inward: Columns::new(bodies),
            outward: Columns::new(bodies),
            branches: children.into_iter().map(|count| count > 1).collect(),
            identity: model.identity(),
        }
    }
}

impl InverseScratch<f64> {
    /// Identity of the model of this scratch.
    pub(crate) fn identity(&self) -> u64 {
        self.identity
    }
}

/// M^-1 at `q` into `out`, (nv x nv) row by row, full and symmetric (6.1 with its cross-branch terms).
///
/// With L+ = Lambda^+ and A = 1 - gH: the diagonal is 1/D + g* L+ g. Outboard of joint j, the entry is g(i)* Psi* (A*
/// L+ g - H*/D). For branches that separate at body c, it is g(i)* Psi(c,i)* Lambda^-(c) Psi(c,j) g(j). O(N^2), the
/// size of the output.
///
/// In form `auto`, a state is recomputed in double-double arithmetic and rounded if the error estimate of the factor of
/// M exceeds the tolerance (f64 only).
pub fn mass_matrix_inverse<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut InverseScratch<T>,
    q: &[T],
    out: &mut [T],
) -> PivotMonitor<T> {
    let monitor = factorise(model, workspace, q);
    if !(workspace.form == Form::Auto && monitor.of_roots && doubled((model, &mut workspace.wide), q, out)) {
        closed_form(model, workspace, scratch, out);
    }
    monitor
}

/// M^-1 in double-double arithmetic, see [`DoubleDoubleState::recompute`].
fn doubled<T: Real>(model: (&Model<T>, &mut Made), q: &[T], out: &mut [T]) -> bool {
    DoubleDoubleState::recompute(model, (q, &[], &[]), &[], out, |wide, out| {
        let DoubleDoubleState { model, workspace, q, .. } = wide;
        mass_matrix_inverse(model, workspace, &mut InverseScratch::new(model), q, out);
        true
    })
}

/// [`mass_matrix_inverse`] with the factor already in the workspace, block by block of columns.
#[inline(always)]
pub(crate) fn closed_form<T: Real, C: ColumnsOf<T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut InverseScratch<T, C>,
    out: &mut [T],
) {
    let spread_gain = &mut scratch.spread_gain;
    let factor = (&workspace.store.shifts[..], &workspace.store.measured[..]);
    co_state_covariances(&model.system, factor, &mut scratch.co_state_covariance, |(_, row), _, u| {
        spread_gain[row] = *u;
    });
    let nv = model.nv();
    let mut first = 0;
    while first < nv {
        let block = Block::from(first, C::COLUMNS, nv);
        first = block.end;
        inward(model, workspace, scratch, block);
        outward(model, workspace, scratch, block, out);
    }
}

/// Tip to base from the last body of the block: u = Psi(c,j) g(j) at every body c inboard, and y = Lambda^-(c) u where
/// branches separate.
#[inline(always)]
fn inward<T: Real, C: ColumnsOf<T>>(
    model: &Model<T>,
    workspace: &Workspace<T>,
    scratch: &mut InverseScratch<T, C>,
    block: Block,
) {
    let last = body_of_row(model, block.end - 1);
    let InverseScratch { inward, outward, branches, co_state_covariance, .. } = scratch;
    outward.clear(last);
    // Without branches, only the outward pass of the columns is needed.
    if !branches[..=last].contains(&true) {
        return;
    }
    inward.clear(last);
    let like = inward.at[0][0];
    for k in (0..=last).rev() {
        let stage = &model.system.stages[k];
        let rows = stage.first_row..stage.first_row + stage.rows.count();
        if inward.active[k] {
            if branches[k] {
                outward.at[k] = spread_symmetric(like, &co_state_covariance[k]).mul_vector(&inward.at[k]);
            }
            for row in rows.clone().rev() {
                let hinge = spread_hinge(like, stage.rows.row(row - rows.start));
                let gain = spread_vector(like, &workspace.store.measured[row].gain);
                inward.at[k] = scaled_add(&gain, -hinge.project(&inward.at[k]), &inward.at[k]);
            }
        }
        for column in block.between(rows.start, rows.end) {
            let mut u = workspace.store.measured[column].gain;
            past_rows(stage, &workspace.store.measured, 0..column - rows.start, &mut u);
            inward.insert(k, column - block.first, &u);
        }
        if inward.active[k]
            && let Some(parent) = stage.parent
        {
            let carried = spread_shift(like, &workspace.store.shifts[k]).force_to_parent(&inward.at[k]);
            inward.add(parent, &carried);
        }
    }
}

/// Base to tip from the first body of the block: the entries of every row further out, and their mirror images.
#[inline(always)]
fn outward<T: Real, C: ColumnsOf<T>>(
    model: &Model<T>,
    workspace: &Workspace<T>,
    scratch: &mut InverseScratch<T, C>,
    block: Block,
    out: &mut [T],
) {
    let nv = model.nv();
    let (first, last) = (body_of_row(model, block.first), body_of_row(model, block.end - 1));
    let InverseScratch { outward, spread_gain, .. } = scratch;
    // The type of zero and unused columns.
    let like = outward.at[0][0];
    let nothing = zero();
    for (k, stage) in model.system.stages.iter().enumerate().skip(first) {
        let rows = stage.first_row..stage.first_row + stage.rows.count();
        // Columns of bodies further out: their contribution here to other branches.
        let parted = if k <= last { outward.at[k] } else { nothing };
        outward.at[k] = match stage.parent {
            Some(parent) => spread_shift(like, &workspace.store.shifts[k]).motion_to_child(&outward.at[parent]),
            None => nothing,
        };
        for row in rows.clone() {
            let y = &outward.at[k];
            let entry = dot(&spread_vector(like, &workspace.store.measured[row].gain), y);
            put_row(out, nv, row, (block, block.between(block.first, rows.start)), &entry);
            outward.at[k] = spread_hinge(like, stage.rows.row(row - rows.start)).spread_onto(y, -entry);
        }
        if k > last {
            continue;
        }
        for column in block.between(rows.start, rows.end) {
            let y = own_rows(model, workspace, (k, column), &spread_gain[column], out);
            outward.insert(k, column - block.first, &y);
        }
        for column in block.between(rows.end, nv) {
            let lane = column - block.first;
            for (entry, parted) in outward.at[k].iter_mut().zip(parted.iter()) {
                entry.set_column(lane, parted.column(lane));
            }
        }
    }
}

/// The entries of a column in the rows of its own joint, from the diagonal. Returns y = A* L+ g - H*/D past all of
/// these rows.
#[inline(always)]
fn own_rows<T: Real>(
    model: &Model<T>,
    workspace: &Workspace<T>,
    (k, column): (usize, usize),
    spread_gain: &Vector6<T>,
    out: &mut [T],
) -> Vector6<T> {
    let (stage, measured) = (&model.system.stages[k], &workspace.store.measured);
    let mut y = *spread_gain;
    let end = stage.first_row + stage.rows.count();
    for (row, of_row) in measured.iter().enumerate().take(end).skip(column) {
        let along = dot(&of_row.gain, &y);
        let entry = if row == column { of_row.pivot_inverse + along } else { along };
        put(out, model.nv(), (row, column), entry);
        y = stage.rows.row(row - stage.first_row).spread_onto(&y, -entry);
    }
    y
}
