//! Columns of M during the inward pass, of one state or of one state per lane, in blocks.

use super::column_layout::{ColumnLayout, Place, put_block};
use super::entries::Entries;
use super::inverse_columns::Block;
use super::model::SweepModel;
use super::rows::{PICKED, picked};
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};

/// Rows of a floating body.
const FREE_ROWS: usize = PICKED.len();

/// Scratch of M.
#[derive(Debug, Clone)]
pub(crate) struct MassColumns<T: Real, C: ColumnsOf<T>> {
    /// By blocks: the force of each column at the current body; zero in lanes without a column.
    forces: Vec<Block<C>>,
    layout: ColumnLayout<C>,
    /// In lanes: for each row, the columns from the diagonal to the last one outward of it.
    entries: Entries<T, C>,
}

impl<T: Real, C: ColumnsOf<T>> MassColumns<T, C> {
    /// Empty: allocated when M is first computed.
    pub fn new() -> Self {
        Self { forces: Vec::new(), layout: ColumnLayout::empty(), entries: Entries::new() }
    }

    /// Allocates the columns if necessary. Returns the buffer of the entries of M in lanes.
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
        let (nv, layout) = (model.nv(), ColumnLayout::new(model, sweeps));
        self.forces = vec![[C::zero(); 6]; layout.blocks()];
        self.entries.make(layout.is_branched, || {
            // The buffer begins with one zero.
            let (mut chosen, mut count) = (vec![0; nv * nv], 1);
            sweeps.each_pair(model, |row, column| {
                (chosen[row * nv + column], chosen[column * nv + row]) = (count, count);
                count += 1;
            });
            (count, chosen)
        });
        self.layout = layout;
    }

    /// A zero of this type; other ways to create one query the processor's features at each call.
    #[inline(always)]
    pub(super) fn like(&self) -> C {
        self.entries.fault
    }

    /// The blocks that hold the columns from `row` to before `end`.
    #[inline(always)]
    pub(super) fn blocks(&mut self, row: usize, end: usize) -> &mut [Block<C>] {
        let blocks = self.layout.blocks_of(row, end);
        &mut self.forces[blocks]
    }

    /// Inserts the column of `row` with this force at its body, writes the row's entries from the diagonal to before
    /// `end`, and propagates the columns outward of it. Rows are processed from the outermost one.
    #[inline(always)]
    pub(super) fn put_row<const CHECK: bool>(
        &mut self,
        out: &mut [C::Entry],
        (row, end): (usize, usize),
        force: &[T; 6],
        measured: &impl Measurement<C>,
    ) {
        let nv = self.layout.places.len();
        let Place { block, lane, end_block, entries } = self.layout.places[row];
        let Self { forces, layout, entries: Entries { fault: faults, .. }, .. } = self;
        let (forces, ends) = (&mut forces[block..end_block], &layout.ends[block..end_block]);
        let to = if T::LANES > 1 { &mut out[1 + entries..][..end - row] } else { &mut *out };
        let mut fault = *faults;
        // An index loop: iterators over both slices would need a division for their length.
        for at in (1..forces.len().min(ends.len())).rev() {
            let entry = through::<C, CHECK>(&mut forces[at], measured, &mut fault);
            put_entry::<T, C>(to, (nv, row), (at, ends[at]), entry);
        }
        // The block of the row itself is last, because its force is completed in registers.
        let (Some(own), Some(&end)) = (forces.first_mut(), ends.first()) else { return };
        let mut whole = *own;
        layout.insert(lane, &mut whole, force);
        let entry = through::<C, CHECK>(&mut whole, measured, &mut fault);
        *own = whole;
        put_entry::<T, C>(to, (nv, row), (0, end), entry);
        *faults = fault;
    }

    /// Writes all six rows of a floating body, from `row` to before `end`. Nothing is propagated.
    #[inline(always)]
    #[allow(clippy::eq_op)] // that is the point
    pub(super) fn put_free_joint<const CHECK: bool>(
        &mut self,
        out: &mut [C::Entry],
        (row, end): (usize, usize),
        own: impl Fn(usize) -> [T; FREE_ROWS],
    ) {
        let first = row + FREE_ROWS;
        let outward = self.layout.blocks_of(first, end);
        let Self { forces, layout: ColumnLayout { ends, places, .. }, entries: Entries { fault, .. }, .. } = self;
        let (nv, ends) = (places.len(), &ends[outward.clone()]);
        let forces = &forces[outward];
        // From the last block, as in the rows of other bodies; the rows of the body itself are last.
        for at in (0..forces.len().min(ends.len())).rev() {
            let entries = picked(&forces[at]);
            for (i, entry) in entries.iter().enumerate() {
                if CHECK {
                    *fault += *entry - *entry;
                }
                if T::LANES > 1 {
                    entry.store(&mut out[1 + places[row + i].entries + (FREE_ROWS - i) + at..][..1]);
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
            // In lanes: from the diagonal.
            let (place, first) =
                if T::LANES > 1 { (1 + places[row + i].entries, i) } else { ((row + i) * nv + row, 0) };
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

    /// Adds to a diagonal entry.
    #[inline(always)]
    #[allow(clippy::eq_op)] // that is the point
    pub(super) fn add_to_diagonal<const CHECK: bool>(&mut self, out: &mut [C::Entry], row: usize, value: T) {
        let at = self.layout.places[row].entries;
        let kept = &mut out[if T::LANES > 1 { 1 + at } else { at }];
        let entry = C::taken(*kept) + value;
        *kept = C::kept(entry);
        if CHECK {
            self.entries.fault += self.entries.fault.spread(entry - entry);
        }
    }
}

/// The operations on the columns at one row. A trait, because a closure is not always inlined.
pub(super) trait Measurement<C> {
    /// H f.
    fn entry(&self, force: &Block<C>) -> C;

    /// The force at the next row.
    fn carry(&self, force: &mut Block<C>);
}

/// Writes entries: in lanes to `at`; for one state by [`put_block`], symmetrically.
#[inline(always)]
fn put_entry<T: Real, C: ColumnsOf<T>>(
    out: &mut [C::Entry],
    place: (usize, usize),
    (at, end): (usize, usize),
    entry: C,
) {
    if T::LANES > 1 {
        entry.store(&mut out[at..=at]);
    } else {
        put_block::<T, C>(out, place, end, [entry; 2]);
    }
}

/// For one state: the entries of each column of a block in the rows of a floating body, one after another.
#[inline(always)]
fn put_columns<T: Real, C: ColumnsOf<T>>(out: &mut [C::Entry], nv: usize, entries: &[C; FREE_ROWS]) {
    const { assert!(C::COLUMNS <= FREE_ROWS, "a square lies within the rows") }
    let width = C::COLUMNS;
    for start in (0..FREE_ROWS).step_by(width) {
        // The last square may overlap the previous one.
        let start = start.min(FREE_ROWS - width);
        let mut square = *entries;
        let square = &mut square[start..start + width];
        C::transpose(square);
        for (lane, column) in square.iter().enumerate() {
            column.store(&mut out[lane * nv + start..][..width]);
        }
    }
}

/// Propagates one block past a row. Returns the entries.
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
