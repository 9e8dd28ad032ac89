//! The layout of the columns of a matrix during the inward pass, in blocks that are vectorized (SIMD).
//!
//! A segment is a run of bodies on each of which hangs the next one and nothing else. Its rows are dealt out to blocks
//! from the outermost on, so that only the last block of a segment is not full; the columns outboard of a body are then
//! neighboring blocks, each of one segment.

use super::model::SweepModel;
use super::tiles::{below_overflow, units};
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use std::ops::Range;

/// Where the column of a row is.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::dynamics) struct Place {
    pub block: usize,
    pub lane: usize,
    /// One past the last block that holds a column outward of it.
    pub end_block: usize,
    /// Of one state where the diagonal is. In lanes the number of the pair (row, row) among the pairs of a row and a
    /// column outward of it: those of one row, by their columns, come one after another.
    pub entries: usize,
}

/// The columns of a scene, dealt out to blocks.
#[derive(Debug, Clone)]
pub(in crate::dynamics) struct ColumnLayout<C> {
    /// One in one lane, zero in the others.
    pub units: Vec<C>,
    /// One past the last column of each block, which is in its last lane.
    pub ends: Vec<usize>,
    /// Of each row.
    pub places: Vec<Place>,
    /// True if there are entries between branches, which are zero.
    pub is_branched: bool,
}

impl<C: Copy> ColumnLayout<C> {
    /// None yet.
    pub fn empty() -> Self {
        Self { units: Vec::new(), ends: Vec::new(), places: Vec::new(), is_branched: false }
    }

    #[cold]
    pub fn new<T: Real>(model: &Model<T>, sweeps: &SweepModel<T>) -> Self
    where
        C: ColumnsOf<T>,
    {
        let (nv, width) = (model.nv(), C::COLUMNS);
        let mut layout = Self {
            units: units::<T, C>(),
            ends: Vec::new(),
            places: vec![Place::default(); nv],
            is_branched: sweeps.bodies.iter().any(|body| body.end_row != nv),
        };
        let mut children = vec![0; sweeps.bodies.len()];
        for parent in sweeps.bodies.iter().filter_map(|body| body.parent) {
            children[parent] += 1;
        }
        let rows = |k: usize| sweeps.bodies[k].row..sweeps.bodies[k].row + model.system.stages[k].rows.count();
        let (mut dealt, mut blocks) = (0, 0);
        for k in (0..sweeps.bodies.len()).rev() {
            if children[k] != 1 {
                dealt = 0;
            }
            for row in rows(k).rev() {
                if dealt % width == 0 {
                    blocks += 1;
                    layout.ends.push(row + 1);
                }
                let place = &mut layout.places[row];
                // Blocks are counted from the last one; those outboard of a body precede it.
                (place.block, place.lane, place.entries) = (blocks, width - 1 - dealt % width, row * nv + row);
                dealt += 1;
            }
        }
        layout.ends.reverse();
        for place in &mut layout.places {
            place.block = blocks - place.block;
        }
        let mut pairs = 0;
        for (k, body) in sweeps.bodies.iter().enumerate() {
            for row in rows(k) {
                layout.places[row].end_block = layout.places[body.end_row - 1].block + 1;
                if T::LANES > 1 {
                    layout.places[row].entries = pairs;
                }
                pairs += body.end_row - row;
            }
        }
        layout
    }

    /// How many blocks there are.
    pub fn blocks(&self) -> usize {
        self.ends.len()
    }

    /// Which blocks hold the columns from `row` to before `end`.
    #[inline(always)]
    pub fn blocks_of(&self, row: usize, end: usize) -> Range<usize> {
        if row == end { 0..0 } else { self.places[row].block..self.places[end - 1].block + 1 }
    }

    /// Takes up a column in its lane; a block that it is the first of begins with it.
    #[inline(always)]
    pub fn insert<T: Real, const N: usize>(&self, lane: usize, block: &mut [C; N], column: &[T; N])
    where
        C: ColumnsOf<T>,
    {
        if C::COLUMNS == 1 {
            for (to, &x) in block.iter_mut().zip(column) {
                to.set_column(0, x);
            }
            return;
        }
        let unit = self.units[lane];
        // No lane of a block that was begun in this state holds anything from another one.
        if lane == C::COLUMNS - 1 {
            for (to, &x) in block.iter_mut().zip(column) {
                *to = unit.spread(x) * unit;
            }
        } else {
            for (to, &x) in block.iter_mut().zip(column) {
                *to = unit.spread(x).mul_add(unit, *to);
            }
        }
    }
}

/// Of one state: the entries of a row in the columns of a block, which ends before `end`, and those of the block's rows
/// in the row's column.
///
/// What is in lanes that no column is in comes where the next block inward, or a row further inward, writes after it;
/// or where there is nothing, a zero.
#[inline(always)]
pub(in crate::dynamics) fn put_block<T: Real, C: ColumnsOf<T>>(
    out: &mut [C::Entry],
    (nv, row): (usize, usize),
    end: usize,
    [across, down]: [C; 2],
) {
    // Copies, or the entries would live in memory above too.
    let (across, down, width) = (across, down, C::COLUMNS);
    if let Some(first) = end.checked_sub(width) {
        across.store(&mut out[row * nv + first..][..width]);
        let (below, side) = (&mut out[first * nv + row..], below_overflow(nv));
        assert!(below.len() > (width - 1) * side, "a column of the matrix");
        let mut at = 0;
        for lane in 0..width {
            below[at] = C::kept(down.column(lane));
            at += side;
        }
    } else {
        for column in 0..end {
            let lane = width - end + column;
            out[row * nv + column] = C::kept(across.column(lane));
            out[column * nv + row] = C::kept(down.column(lane));
        }
    }
}
