//! Columns of M^-1 of one state, or of one state a lane, side by side.

use super::body::LeanModel;
use super::entries::Entries;
use super::tiles::Tiles;
use crate::dynamics::columns::spread_symmetric;
use crate::scalar::{ColumnsOf, Real};
use crate::scene::Model;
use crate::spatial::Symmetric6;
use nalgebra::Vector6;
use std::ops::Range;

/// A vector of as many neighbouring columns as `C` holds.
pub(super) type Block<C> = [C; 6];

/// Scratch of M^-1; a block begins at a column, where the factors are multiplied out at a place on the path from the base, that is a multiple of its width.
#[derive(Debug)]
pub(crate) struct LeanColumns<T: Real, C: ColumnsOf<T>> {
    /// In slots outward: of every column minus its co-state, what a lane has beyond them means nothing. Where the factors are multiplied out, of every
    /// joint on the path c of the innovation D^-1/2, and beyond them zero.
    pub(super) slots: Vec<Vec<Block<C>>>,
    /// Of a body that a sibling follows, from the block of its row on: Psi g of the columns from there outward, at the parent.
    parted: Vec<Vec<Block<C>>>,
    /// What multiplies the factors out.
    pub(super) tiles: Tiles<T, C>,
}

/// The blocks that hold some columns.
#[inline(always)]
pub(super) fn blocks_of<T: Real, C: ColumnsOf<T>>(columns: &Range<usize>) -> Range<usize> {
    columns.start / C::COLUMNS..columns.end.div_ceil(C::COLUMNS)
}

impl<T: Real, C: ColumnsOf<T>> LeanColumns<T, C> {
    /// None yet: they are made when M^-1 is first asked for.
    pub fn new() -> Self {
        Self { slots: Vec::new(), parted: Vec::new(), tiles: Tiles::new() }
    }

    /// Makes them for a scene, where there are none; gives what M^-1 is written to in lanes if its factors are
    /// [multiplied out](super::inverse_product).
    #[inline(always)]
    pub fn prepare(&mut self, model: &Model<T>, lean: &LeanModel<T>) -> Option<&mut Entries<T, C>> {
        if self.slots.is_empty() {
            self.make(model, lean);
        }
        Some(&mut self.tiles.entries).filter(|_| lean.is_shallow)
    }

    #[cold]
    fn make(&mut self, model: &Model<T>, lean: &LeanModel<T>) {
        let nan = [C::from_f64(f64::NAN); 6];
        let (slots, columns) = lean.column_slots();
        self.slots = vec![vec![nan; columns.div_ceil(C::COLUMNS)]; slots];
        if lean.is_shallow {
            self.tiles.prepare(model, lean);
            return;
        }
        let parted = lean.bodies.iter().map(|body| {
            let blocks = if body.sibling_follows() { blocks_of::<T, C>(&(body.row..body.end_row)) } else { 0..0 };
            vec![nan; blocks.len()]
        });
        self.parted = parted.collect();
    }

    /// The columns in one slot.
    #[inline(always)]
    pub(super) fn at(&self, slot: usize) -> &[Block<C>] {
        &self.slots[slot]
    }

    /// The same, to be given back: they are written while another slot is read.
    #[inline(always)]
    pub(super) fn take(&mut self, slot: usize) -> Vec<Block<C>> {
        std::mem::take(&mut self.slots[slot])
    }

    #[inline(always)]
    pub(super) fn give_back(&mut self, slot: usize, columns: Vec<Block<C>>) {
        self.slots[slot] = columns;
    }

    /// Keeps what a column is at the parent of `body`, whose first row is `row`.
    #[inline(always)]
    pub(super) fn part(&mut self, (body, row): (usize, usize), column: usize, u: &[T; 6]) {
        let block = column / C::COLUMNS - row / C::COLUMNS;
        set_column(&mut self.parted[body][block], column % C::COLUMNS, u);
    }

    /// Lambda^- times what was kept of `body`, of the columns of its branch, into the slot of its parent.
    #[inline(always)]
    pub(super) fn arrive(&mut self, slot: usize, body: usize, branch: Range<usize>, lambda: &Symmetric6<T>) {
        let lambda = spread_symmetric(C::zero(), lambda);
        let (blocks, width) = (blocks_of::<T, C>(&branch), C::COLUMNS);
        for ((block, at), u) in blocks.clone().zip(&mut self.slots[slot][blocks]).zip(&self.parted[body]) {
            let y: Block<C> = lambda.mul_vector(&Vector6::from(*u)).into();
            let lanes =
                branch.start.max(block * width) - block * width..branch.end.min((block + 1) * width) - block * width;
            if lanes.len() == width {
                *at = y;
            } else {
                for lane in lanes {
                    for (at, y) in at.iter_mut().zip(&y) {
                        at.set_column(lane, y.column(lane));
                    }
                }
            }
        }
    }
}

/// One in one lane and zero in the others, for each lane.
pub(super) fn units<T: Real, C: ColumnsOf<T>>() -> Vec<C> {
    let unit = |lane| {
        let mut unit = C::zero();
        unit.set_column(lane, T::one());
        unit
    };
    (0..C::COLUMNS).map(unit).collect()
}

/// One column's vector into its lane.
#[inline(always)]
pub(super) fn set_column<T: Real, C: ColumnsOf<T>>(block: &mut Block<C>, lane: usize, x: &[T; 6]) {
    for (block, &x) in block.iter_mut().zip(x) {
        block.set_column(lane, x);
    }
}

/// The entries of one block in a row, and their mirror images. What the block has beyond the diagonal means nothing, and is written
/// over by later rows.
#[inline(always)]
pub(super) fn put_block<T: Real, C: ColumnsOf<T>>(out: &mut [T], nv: usize, row: usize, block: usize, entry: &C) {
    let first = block * C::COLUMNS;
    if let Some(whole) = out[row * nv..][..nv].get_mut(first..first + C::COLUMNS) {
        for (lane, value) in whole.iter_mut().enumerate() {
            *value = entry.column(lane);
        }
    } else {
        for column in first..nv {
            out[row * nv + column] = entry.column(column - first);
        }
    }
    for lane in 0..C::COLUMNS.min(row + 1 - first) {
        out[(first + lane) * nv + row] = entry.column(lane);
    }
}
