//! Columns of M on their way inward, of one state or of one state a lane, side by side.
//!
//! A segment is a run of bodies on each of which hangs the next one and nothing else. Its rows are dealt out to blocks from the outermost
//! on, so that only the last block of a segment is not full; what hangs on a body is then some neighbouring blocks, each of one segment.

use super::body::LeanModel;
use super::columns::{Block, units};
use super::entries::Entries;
use crate::scalar::{ColumnsOf, Real};
use crate::scene::Model;

/// Where the column of a row is.
#[derive(Debug, Clone, Copy)]
struct Place {
    block: usize,
    lane: usize,
    /// Where the row's entries begin, those of its own column first and then outward.
    entries: usize,
}

/// Scratch of M.
#[derive(Debug)]
pub(crate) struct MassColumns<T: Real, C: ColumnsOf<T>> {
    /// By blocks: the force of each column at the body at hand; zero in lanes that no column is in.
    forces: Vec<Block<C>>,
    /// One in one lane, zero in the others.
    units: Vec<C>,
    /// How many columns each block holds, the last in the last lane.
    counts: Vec<usize>,
    places: Vec<Place>,
    /// In lanes of each row the columns from the diagonal to the last outward of it.
    entries: Entries<T, C>,
}

impl<T: Real, C: ColumnsOf<T>> MassColumns<T, C> {
    /// None yet: they are made when M is first asked for.
    pub fn new() -> Self {
        Self { forces: Vec::new(), units: Vec::new(), counts: Vec::new(), places: Vec::new(), entries: Entries::new() }
    }

    /// Makes them where there are none; gives what M is written to in lanes.
    #[inline(always)]
    pub fn prepare(&mut self, model: &Model<T>, lean: &LeanModel<T>) -> &mut Entries<T, C> {
        if !self.entries.is_made {
            self.make(model, lean);
        }
        &mut self.entries
    }

    /// As [`Entries::begin`].
    #[inline(always)]
    pub(super) fn begin(&mut self, out: &mut [C::Entry]) {
        self.entries.begin(out);
    }

    #[cold]
    fn make(&mut self, model: &Model<T>, lean: &LeanModel<T>) {
        let (o, nv, width) = (C::zero(), model.nv(), C::COLUMNS);
        self.units = units::<T, C>();
        let is_branched = lean.bodies.iter().any(|body| body.end_row != nv);
        let mut children = vec![0; lean.bodies.len()];
        for parent in lean.bodies.iter().filter_map(|body| body.parent) {
            children[parent] += 1;
        }
        self.places = vec![Place { block: 0, lane: 0, entries: 0 }; nv];
        let (mut dealt, mut blocks) = (0, 0);
        for (k, body) in lean.bodies.iter().enumerate().rev() {
            if children[k] != 1 {
                dealt = 0;
            }
            for row in (body.row..body.row + model.system.stages[k].rows.count()).rev() {
                if dealt % width == 0 {
                    blocks += 1;
                }
                self.places[row] = Place { block: blocks, lane: width - 1 - dealt % width, entries: row * nv + row };
                dealt += 1;
            }
        }
        // Counted from the last one.
        for place in &mut self.places {
            place.block = blocks - place.block;
        }
        self.counts = vec![1; blocks];
        self.forces = vec![[o; 6]; blocks];
        let places = &mut self.places;
        self.entries.make(is_branched, || {
            let (mut chosen, mut count) = (vec![0; nv * nv], 1);
            for (k, body) in lean.bodies.iter().enumerate() {
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

    /// A force at the body of `row` is the column of that row there; rows come from the outermost on.
    #[inline(always)]
    pub(super) fn insert(&mut self, row: usize, force: &[T; 6]) {
        let Place { block, lane, .. } = self.places[row];
        let to = &mut self.forces[block];
        if C::COLUMNS == 1 {
            for (to, &f) in to.iter_mut().zip(force) {
                to.set_column(0, f);
            }
            return;
        }
        self.counts[block] = C::COLUMNS - lane;
        let unit = self.units[lane];
        // No lane of a block that was begun in this state holds anything from another one.
        let is_first = lane == C::COLUMNS - 1;
        for (to, &f) in to.iter_mut().zip(force) {
            let own = unit.spread(f);
            *to = if is_first { own * unit } else { own.mul_add(unit, *to) };
        }
    }

    /// The blocks that hold the columns from `row` to before `end`.
    #[inline(always)]
    pub(super) fn blocks(&mut self, row: usize, end: usize) -> &mut [Block<C>] {
        let blocks = if row == end { 0..0 } else { self.places[row].block..self.places[end - 1].block + 1 };
        &mut self.forces[blocks]
    }

    /// Writes of a row the entries from the diagonal to before `end`, and carries the forces on.
    #[inline(always)]
    pub(super) fn put_row<const CHECK: bool>(
        &mut self,
        out: &mut [C::Entry],
        (row, end): (usize, usize),
        measured: &impl Measurement<C>,
    ) {
        let nv = self.places.len();
        let Place { block, entries: mut at, .. } = self.places[row];
        let blocks = block..self.places[end - 1].block + 1;
        let (mut mirrored, mut fault) = (row * nv + row, self.entries.fault);
        let Self { forces, counts, .. } = self;
        for (force, &count) in forces[blocks.clone()].iter_mut().zip(&counts[blocks]) {
            let entry = measured.entry(force);
            measured.carry(force);
            #[allow(clippy::eq_op)] // that is the point
            if CHECK {
                fault += entry - entry;
            }
            put_block::<T, C>(out, nv, (at, mirrored), count, entry);
            at += count;
            mirrored += count * nv;
        }
        self.entries.fault = fault;
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

/// As many entries of a row as the block has columns, the last in the last lane; of one state their mirror images too.
#[inline(always)]
fn put_block<T: Real, C: ColumnsOf<T>>(
    entries: &mut [C::Entry],
    nv: usize,
    (at, mirrored): (usize, usize),
    count: usize,
    entry: C,
) {
    let width = C::COLUMNS;
    if width == 1 || count == width {
        entry.store(&mut entries[at..at + width]);
        if T::LANES == 1 {
            for lane in 0..width {
                entries[mirrored + lane * nv] = C::kept(entry.column(lane));
            }
        }
        return;
    }
    // A copy, or the entry would live in memory above too.
    let (some, none) = (entry, width - count);
    for lane in 1..width {
        if lane >= none {
            let value = C::kept(some.column(lane));
            entries[at + lane - none] = value;
            if T::LANES == 1 {
                entries[mirrored + (lane - none) * nv] = value;
            }
        }
    }
}
