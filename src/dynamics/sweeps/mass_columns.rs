//! Columns of M on their way inward, of one state or of one state a lane, side by side.
//!
//! A segment is a run of bodies on each of which hangs the next one and nothing else. Its rows are dealt out to blocks from the outermost
//! on, so that only the last block of a segment is not full; what hangs on a body is then some neighbouring blocks, each of one segment.

use super::entries::Entries;
use super::inverse_columns::Block;
use super::model::SweepModel;
use super::rows::{PICKED, picked};
use super::tiles::below_overflow;
use super::tiles::units;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};

/// Where the column of a row is.
#[derive(Debug, Clone, Copy, Default)]
struct Place {
    block: usize,
    lane: usize,
    /// One past the last block that holds a column outward of it.
    end_block: usize,
    /// Where the row's entries begin, those of its own column first and then outward.
    entries: usize,
}

/// Rows of a body that floats.
const FREE_ROWS: usize = PICKED.len();

/// Scratch of M.
#[derive(Debug)]
pub(crate) struct MassColumns<T: Real, C: ColumnsOf<T>> {
    /// By blocks: the force of each column at the body at hand; zero in lanes that no column is in.
    forces: Vec<Block<C>>,
    /// One in one lane, zero in the others.
    units: Vec<C>,
    /// One past the last column of each block, which is in its last lane.
    ends: Vec<usize>,
    places: Vec<Place>,
    /// In lanes of each row the columns from the diagonal to the last outward of it.
    entries: Entries<T, C>,
}

impl<T: Real, C: ColumnsOf<T>> MassColumns<T, C> {
    /// None yet: they are made when M is first asked for.
    pub fn new() -> Self {
        Self { forces: Vec::new(), units: Vec::new(), ends: Vec::new(), places: Vec::new(), entries: Entries::new() }
    }

    /// Makes them where there are none; gives what M is written to in lanes.
    #[inline(always)]
    pub fn prepare(&mut self, model: &Model<T>, sweeps: &SweepModel<T>) -> &mut Entries<T, C> {
        if !self.entries.is_made {
            self.make(model, sweeps);
        }
        &mut self.entries
    }

    /// As [`Entries::begin`].
    #[inline(always)]
    pub(super) fn begin(&mut self, out: &mut [C::Entry]) {
        self.entries.begin(out);
    }

    #[cold]
    fn make(&mut self, model: &Model<T>, sweeps: &SweepModel<T>) {
        let (o, nv, width) = (C::zero(), model.nv(), C::COLUMNS);
        self.units = units::<T, C>();
        let is_branched = sweeps.bodies.iter().any(|body| body.end_row != nv);
        let mut children = vec![0; sweeps.bodies.len()];
        for parent in sweeps.bodies.iter().filter_map(|body| body.parent) {
            children[parent] += 1;
        }
        self.places = vec![Place::default(); nv];
        let (mut dealt, mut blocks) = (0, 0);
        for (k, body) in sweeps.bodies.iter().enumerate().rev() {
            if children[k] != 1 {
                dealt = 0;
            }
            for row in (body.row..body.row + model.system.stages[k].rows.count()).rev() {
                if dealt % width == 0 {
                    blocks += 1;
                    self.ends.push(row + 1);
                }
                let place = &mut self.places[row];
                // Blocks are counted from the last one; what hangs on a body comes before it.
                (place.block, place.lane, place.entries) = (blocks, width - 1 - dealt % width, row * nv + row);
                dealt += 1;
            }
        }
        self.ends.reverse();
        for place in &mut self.places {
            place.block = blocks - place.block;
        }
        for (k, body) in sweeps.bodies.iter().enumerate() {
            for row in body.row..body.row + model.system.stages[k].rows.count() {
                self.places[row].end_block = self.places[body.end_row - 1].block + 1;
            }
        }
        self.forces = vec![[o; 6]; blocks];
        let places = &mut self.places;
        self.entries.make(is_branched, || {
            let (mut chosen, mut count) = (vec![0; nv * nv], 1);
            for (k, body) in sweeps.bodies.iter().enumerate() {
                for row in body.row..body.row + model.system.stages[k].rows.count() {
                    places[row].entries = count as usize;
                    for column in row..body.end_row {
                        (chosen[row * nv + column], chosen[column * nv + row]) = (count, count);
                        count += 1;
                    }
                }
            }
            (count, chosen)
        });
    }

    /// A number of their kind: any other way asks the processor each time.
    #[inline(always)]
    pub(super) fn like(&self) -> C {
        self.entries.fault
    }

    /// Which blocks hold the columns from `row` to before `end`.
    #[inline(always)]
    fn blocks_of(&self, row: usize, end: usize) -> std::ops::Range<usize> {
        if row == end { 0..0 } else { self.places[row].block..self.places[end - 1].block + 1 }
    }

    /// The same, themselves.
    #[inline(always)]
    pub(super) fn blocks(&mut self, row: usize, end: usize) -> &mut [Block<C>] {
        let blocks = self.blocks_of(row, end);
        &mut self.forces[blocks]
    }

    /// Takes up the column of `row`, this force at its body, writes the row's entries from the diagonal to before `end`, and carries on the columns outward
    /// of it. Rows come from the outermost on.
    #[inline(always)]
    pub(super) fn put_row<const CHECK: bool>(
        &mut self,
        out: &mut [C::Entry],
        (row, end): (usize, usize),
        force: &[T; 6],
        measured: &impl Measurement<C>,
    ) {
        let nv = self.places.len();
        let Place { block, lane, end_block, entries } = self.places[row];
        let Self { forces, ends, units, entries: Entries { fault: faults, .. }, .. } = self;
        let (forces, ends) = (&mut forces[block..end_block], &ends[block..end_block]);
        let to = if T::LANES > 1 { &mut out[entries..entries + (end - row)] } else { &mut *out };
        let mut fault = *faults;
        // By their index, or a division would say how many there are.
        for at in (1..forces.len().min(ends.len())).rev() {
            let entry = through::<C, CHECK>(&mut forces[at], measured, &mut fault);
            put_block::<T, C>(to, (nv, row), (at, ends[at]), entry);
        }
        // Its own block last, which becomes whole in registers.
        let (Some(own), Some(&end)) = (forces.first_mut(), ends.first()) else { return };
        let mut whole = *own;
        if C::COLUMNS == 1 {
            for (whole, &f) in whole.iter_mut().zip(force) {
                whole.set_column(0, f);
            }
        } else {
            let unit = units[lane];
            // No lane of a block that was begun in this state holds anything from another one.
            if lane == C::COLUMNS - 1 {
                for (whole, &f) in whole.iter_mut().zip(force) {
                    *whole = unit.spread(f) * unit;
                }
            } else {
                for (whole, &f) in whole.iter_mut().zip(force) {
                    *whole = unit.spread(f).mul_add(unit, *whole);
                }
            }
        }
        let entry = through::<C, CHECK>(&mut whole, measured, &mut fault);
        *own = whole;
        put_block::<T, C>(to, (nv, row), (0, end), entry);
        *faults = fault;
    }

    /// Writes all six rows of a body that floats, from `row` to before `end`: nothing is carried on.
    #[inline(always)]
    #[allow(clippy::eq_op)] // that is the point
    pub(super) fn put_free_joint<const CHECK: bool>(
        &mut self,
        out: &mut [C::Entry],
        (row, end): (usize, usize),
        own: impl Fn(usize) -> [T; FREE_ROWS],
    ) {
        let nv = self.places.len();
        let first = row + FREE_ROWS;
        let outward = self.blocks_of(first, end);
        let Self { forces, ends, places, entries: Entries { fault, .. }, .. } = self;
        let ends = &ends[outward.clone()];
        let forces = &forces[outward];
        // From the last one, as in a row of another body; and the body's own rows last.
        for at in (0..forces.len().min(ends.len())).rev() {
            let entries = picked(&forces[at]);
            for (i, entry) in entries.iter().enumerate() {
                if CHECK {
                    *fault += *entry - *entry;
                }
                if T::LANES > 1 {
                    entry.store(&mut out[places[row + i].entries + (FREE_ROWS - i) + at..][..1]);
                } else {
                    entry.store(&mut out[(row + i) * nv + ends[at] - C::COLUMNS..][..C::COLUMNS]);
                }
            }
            if T::LANES == 1 {
                put_columns::<T, C>(&mut out[(ends[at] - C::COLUMNS) * nv + row..], nv, &entries);
            }
        }
        let mut of_own = T::zero();
        for i in 0..FREE_ROWS {
            let own = own(i);
            // In lanes from the diagonal on.
            let (place, first) = if T::LANES > 1 { (places[row + i].entries, i) } else { ((row + i) * nv + row, 0) };
            for (to, &own) in out[place..][..FREE_ROWS - first].iter_mut().zip(&own[first..]) {
                *to = C::kept(own);
            }
            if CHECK {
                for &own in &own[i..] {
                    of_own += own - own;
                }
            }
        }
        if CHECK {
            *fault += fault.spread(of_own);
        }
    }

    /// Adds to an entry on the diagonal.
    #[inline(always)]
    #[allow(clippy::eq_op)] // that is the point
    pub(super) fn add_to_diagonal<const CHECK: bool>(&mut self, out: &mut [C::Entry], row: usize, value: T) {
        let kept = &mut out[self.places[row].entries];
        let entry = C::taken(*kept) + value;
        *kept = C::kept(entry);
        if CHECK {
            self.entries.fault += self.entries.fault.spread(entry - entry);
        }
    }
}

/// What is done with the columns at one row: a trait, for a closure is not always compiled into its caller.
pub(super) trait Measurement<C> {
    /// H f.
    fn entry(&self, force: &Block<C>) -> C;

    /// What the force is at the next row.
    fn carry(&self, force: &mut Block<C>);
}

/// Of one state: the columns of a row before `end`, as many as the block has lanes, and their mirror images. In lanes the entry alone, the one at `at`.
///
/// What is in lanes that no column is in comes where the next block inward, or a row further inward, writes after it; or where there is nothing, a zero.
#[inline(always)]
fn put_block<T: Real, C: ColumnsOf<T>>(
    out: &mut [C::Entry],
    (nv, row): (usize, usize),
    (at, end): (usize, usize),
    entry: C,
) {
    if T::LANES > 1 {
        entry.store(&mut out[at..=at]);
        return;
    }
    // A copy, or the entry would live in memory above too.
    let (some, width) = (entry, C::COLUMNS);
    if let Some(first) = end.checked_sub(width) {
        entry.store(&mut out[row * nv + first..][..width]);
        let (below, side) = (&mut out[first * nv + row..], below_overflow(nv));
        assert!(below.len() > (width - 1) * side, "a column of the matrix");
        let mut at = 0;
        for lane in 0..width {
            below[at] = C::kept(some.column(lane));
            at += side;
        }
    } else {
        for column in 0..end {
            let value = C::kept(some.column(width - end + column));
            (out[row * nv + column], out[column * nv + row]) = (value, value);
        }
    }
}

/// Of one state: of each column of a block its entries in the rows of a body that floats, one after another.
#[inline(always)]
fn put_columns<T: Real, C: ColumnsOf<T>>(out: &mut [C::Entry], nv: usize, entries: &[C; FREE_ROWS]) {
    const { assert!(C::COLUMNS <= FREE_ROWS, "a square lies within the rows") }
    let width = C::COLUMNS;
    for start in (0..FREE_ROWS).step_by(width) {
        // The last square may lie over the one before it.
        let start = start.min(FREE_ROWS - width);
        let mut square = *entries;
        let square = &mut square[start..start + width];
        C::transpose(square);
        for (lane, column) in square.iter().enumerate() {
            column.store(&mut out[lane * nv + start..][..width]);
        }
    }
}

/// One block past a row: gives the entries.
#[inline(always)]
fn through<C: Real, const CHECK: bool>(force: &mut Block<C>, measured: &impl Measurement<C>, fault: &mut C) -> C {
    let entry = measured.entry(force);
    measured.carry(force);
    #[allow(clippy::eq_op)] // that is the point
    if CHECK {
        *fault += entry - entry;
    }
    entry
}
