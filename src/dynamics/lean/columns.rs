//! Columns of M^-1 of one state, or of one state a lane, side by side.

use super::body::LeanModel;
use crate::dynamics::columns::spread_symmetric;
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::Symmetric6;
use nalgebra::Vector6;
use std::ops::Range;

/// A vector of as many neighbouring columns as `C` holds.
pub(super) type Block<C> = [C; 6];

/// As many neighbouring blocks of a row as are multiplied at once.
pub(super) type Tile<C> = [C; TILE];
pub(super) const TILE: usize = 4;

/// Scratch of the closed form; a block begins at a column that is a multiple of its width.
#[derive(Debug)]
pub(crate) struct LeanColumns<C> {
    /// In slots outward: of every column minus its co-state, what a lane has beyond them means nothing.
    slots: Vec<Vec<Block<C>>>,
    /// Of a body that a sibling follows, from the block of its row on: Psi g of the columns from there outward, at the parent.
    parted: Vec<Vec<Block<C>>>,
    /// 1 - L by rows, in blocks of columns; zero where the column's joint is not outward of the row's.
    pub(super) factors: Vec<Tile<C>>,
    /// The rows from the base to the one at hand, and where they begin in the factors.
    pub(super) path: Vec<(usize, usize)>,
    /// w / D of that row, along the path.
    pub(super) weights: Vec<C>,
}

/// The blocks that hold some columns.
#[inline(always)]
pub(super) fn blocks_of<T: Real, C: ColumnsOf<T>>(columns: &Range<usize>) -> Range<usize> {
    columns.start / C::COLUMNS..columns.end.div_ceil(C::COLUMNS)
}

impl<C: Real> LeanColumns<C> {
    /// None yet: they are made when M^-1 is first asked for.
    pub fn new() -> Self {
        Self { slots: Vec::new(), parted: Vec::new(), factors: Vec::new(), path: Vec::new(), weights: Vec::new() }
    }

    /// Makes them for a scene of `nv` rows, where there are none.
    pub(super) fn prepare<T: Real>(&mut self, lean: &LeanModel<T>, nv: usize)
    where
        C: ColumnsOf<T>,
    {
        if !self.slots.is_empty() {
            return;
        }
        let nan = [C::from_f64(f64::NAN); 6];
        let blocks = nv.div_ceil(C::COLUMNS);
        self.slots = vec![vec![nan; blocks]; lean.row_slots.outward];
        if lean.is_shallow {
            self.factors = vec![[C::zero(); TILE]; nv * blocks.div_ceil(TILE)];
            self.path = vec![(0, 0); nv];
            self.weights = vec![nan[0]; nv];
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

    /// The path's joint at `depth` is that of `row`.
    #[inline(always)]
    pub(super) fn enter_path<T: Real>(&mut self, depth: usize, row: usize)
    where
        C: ColumnsOf<T>,
    {
        self.path[depth] = (row, row * self.tiles::<T>());
        self.put_factor(depth, row, T::one());
    }

    /// w of the path's joint at `depth` in a row outward of it.
    #[inline(always)]
    pub(super) fn put_factor<T: Real>(&mut self, depth: usize, row: usize, w: T)
    where
        C: ColumnsOf<T>,
    {
        let block = row / C::COLUMNS;
        self.factors[self.path[depth].1 + block / TILE][block % TILE].set_column(row % C::COLUMNS, w);
    }

    /// Of one row.
    #[inline(always)]
    pub(super) fn tiles<T: Real>(&self) -> usize
    where
        C: ColumnsOf<T>,
    {
        self.weights.len().div_ceil(C::COLUMNS * TILE)
    }

    /// The same of the joints in one block of a path of `length`.
    #[inline(always)]
    pub(super) fn put_factors<T: Real>(&mut self, length: usize, block: usize, row: usize, w: &C)
    where
        C: ColumnsOf<T>,
    {
        let (first, of_row) = (block * C::COLUMNS, row / C::COLUMNS);
        for (lane, (_, at)) in self.path[first..length.min(first + C::COLUMNS)].iter().enumerate() {
            self.factors[at + of_row / TILE][of_row % TILE].set_column(row % C::COLUMNS, w.column(lane));
        }
    }

    /// Keeps what a column is at the parent of `body`, whose first row is `row`.
    #[inline(always)]
    pub(super) fn part<T: Real>(&mut self, (body, row): (usize, usize), column: usize, u: &[T; 6])
    where
        C: ColumnsOf<T>,
    {
        let block = column / C::COLUMNS - row / C::COLUMNS;
        set_column(&mut self.parted[body][block], column % C::COLUMNS, u);
    }

    /// Lambda^- times what was kept of `body`, of the columns of its branch, into the slot of its parent.
    #[inline(always)]
    pub(super) fn arrive<T: Real>(&mut self, slot: usize, body: usize, branch: Range<usize>, lambda: &Symmetric6<T>)
    where
        C: ColumnsOf<T>,
    {
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
