//! The layout of the columns of a matrix during the inward pass, in blocks that are vectorized (SIMD).
//!
//! A segment is a chain of bodies, each of which has only the next one as its child. Its rows are assigned to blocks
//! from the outermost row inward, so that only the last block of a segment can be partly filled. The columns outboard
//! of a body are then adjacent blocks, each within one segment.

use super::model::SweepModel;
use super::tiles::{below_overflow, units};
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use std::ops::Range;

/// The location of the column of a row.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::dynamics) struct Place {
    pub block: usize,
    pub lane: usize,
    /// One past the last block that holds a column outward of it.
    pub end_block: usize,
    /// For one state, the index of the diagonal. In lanes, the index of the pair (row, row) among the pairs of a row
    /// and a column outward of it; the pairs of one row are adjacent, in the order of their columns.
    pub entries: usize,
}

/// The columns of a scene, assigned to blocks.
#[derive(Debug, Clone)]
pub(in crate::dynamics) struct ColumnLayout<C> {
    /// One in one lane, zero in the others; for each lane.
    pub units: Vec<C>,
    /// One past the last column of each block, which is in its last lane.
    pub ends: Vec<usize>,
    /// One per row.
    pub places: Vec<Place>,
    /// True if there are entries between branches, which are zero.
    pub is_branched: bool,
}

impl<C: Copy> ColumnLayout<C> {
    /// An empty layout.
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

    /// Number of blocks.
    pub fn blocks(&self) -> usize {
        self.ends.len()
    }

    /// The blocks that hold the columns from `row` to before `end`.
    #[inline(always)]
    pub fn blocks_of(&self, row: usize, end: usize) -> Range<usize> {
        if row == end { 0..0 } else { self.places[row].block..self.places[end - 1].block + 1 }
    }

    /// Inserts a column into its lane. The first column of a block initializes the block.
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
        // The last lane is inserted first and clears the values of the previous state.
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

/// For one state: writes the entries of a row in the columns of a block that ends before `end`, and the entries of the
/// block's rows in the column of the row.
///
/// Lanes without a column are written to places that a later step of the inward pass overwrites, or where the matrix is
/// zero, as zeros.
#[inline(always)]
pub(in crate::dynamics) fn put_block<T: Real, C: ColumnsOf<T>>(
    out: &mut [C::Entry],
    (nv, row): (usize, usize),
    end: usize,
    [across, down]: [C; 2],
) {
    // Local copies keep the entries in registers.
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
