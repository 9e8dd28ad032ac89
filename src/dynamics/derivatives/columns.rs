//! Tip to base: the columns of all degrees of freedom, vectorized (SIMD) over columns, and the entries of each with the
//! degrees of freedom inboard of it.

use super::Kept;
use super::hinge::hinge_cross_force;
use super::hinge::{Column, column, in_column, in_row, parts};
use super::outward::ABOUT_Z;
use crate::dynamics::columns::{spread_hinge, spread_shift};
use crate::dynamics::sweeps::body::SweepBody;
use crate::dynamics::sweeps::column_layout::{ColumnLayout, put_block};
use crate::dynamics::sweeps::joint::{self, Joint, with_axial};
use crate::dynamics::sweeps::scratch::SweepScratch;
use crate::dynamics::sweeps::{Entries, SweepModel};
use crate::filter::{HingeMap, Rows};
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::transform::Transform;
use nalgebra::Vector6;
use std::ops::Range;

/// Number of scalars in lanes for each pair of a row and a column outward of it: by q and by qd, each as (row, column)
/// and as (column, row), and M.
const OF_PAIR: usize = 5;

/// The columns during the inward pass; allocated when derivatives are first computed.
#[derive(Debug)]
pub(crate) struct DerivativeColumns<T: Real, C: ColumnsOf<T>> {
    layout: ColumnLayout<C>,
    /// By blocks, at the current body; zero in lanes without a column.
    columns: Vec<Column<C>>,
    /// In lanes: the buffer of the entries of the three matrices.
    entries: Entries<T, C>,
}

impl<T: Real, C: ColumnsOf<T>> DerivativeColumns<T, C> {
    /// Empty columns.
    pub fn new() -> Self {
        Self { layout: ColumnLayout::empty(), columns: Vec::new(), entries: Entries::new() }
    }

    /// Allocates the columns if necessary. Returns the buffer of the entries of the three matrices in lanes.
    #[inline(always)]
    pub fn prepare(&mut self, model: &Model<T>, sweeps: &SweepModel<T>) -> &mut Entries<T, C> {
        if !self.entries.is_made {
            self.make(model, sweeps);
        }
        &mut self.entries
    }

    /// In lanes: the index in the buffer of each entry of the three matrices.
    #[inline(always)]
    pub fn chosen(&self) -> &[u32] {
        self.entries.chosen()
    }

    /// A zero of this type; other ways to create one query the processor's features at each call.
    #[inline(always)]
    pub fn like(&self) -> C {
        self.entries.zero()
    }

    #[cold]
    fn make(&mut self, model: &Model<T>, sweeps: &SweepModel<T>) {
        let (nv, layout) = (model.nv(), ColumnLayout::new(model, sweeps));
        self.columns = vec![[C::zero(); 21]; layout.blocks()];
        self.entries.make(layout.is_branched, || {
            // The buffer begins with one zero.
            let (mut chosen, mut next) = (vec![0; 3 * nv * nv], 1);
            sweeps.each_pair(model, |row, column| {
                let (across, down) = (row * nv + column, column * nv + row);
                let [by_q, by_qd, mass] = [0, 1, 2].map(|matrix| matrix * nv * nv);
                for (at, number) in [(by_q, next), (by_qd, next + 2)] {
                    // On the diagonal, both entries are the first one.
                    (chosen[at + down], chosen[at + across]) = (number + 1, number);
                }
                (chosen[mass + across], chosen[mass + down]) = (next + 4, next + 4);
                next += 5;
            });
            (next, chosen)
        });
        self.layout = layout;
    }
}

/// All entries of dtau/dq, dtau/dqd and M, one after another, from the results of the outward pass.
#[inline(always)]
pub(super) fn tip_to_base<T: Real, C: ColumnsOf<T>>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    kept: &mut Kept<T>,
    columns: &mut DerivativeColumns<T, C>,
    out: &mut [C::Entry],
) {
    columns.entries.begin(out);
    let like = columns.entries.zero();
    let DerivativeColumns { layout, columns, .. } = columns;
    let nv = model.nv();
    let mut inward = Inward { layout, columns, kept, like, noise: &model.system.noise, to: Places { out, nv } };
    for (place, body) in sweeps.swept().iter().enumerate().rev() {
        match body.joint {
            Joint::Axial(axis) => {
                with_axial!(axis, scratch.own[place].turn, sweeps, body.offset, transform, {
                    let across = &transform.spread(like);
                    inward.step((place, body), (transform, across), &Rows::One(HingeMap::Axis(ABOUT_Z)));
                });
            }
            Joint::Prismatic(at, _) | Joint::Free(at) | Joint::General(at) => {
                let transform = &scratch.shifts[at];
                let across = &spread_shift(like, transform);
                inward.step((place, body), (transform, across), &model.system.stages[body.index].rows);
            }
        }
    }
}

/// The outputs: dtau/dq, dtau/dqd and M one after another, row by row; in lanes pair by pair, after one zero.
struct Places<'a, E> {
    out: &'a mut [E],
    nv: usize,
}

impl<E> Places<'_, E> {
    /// For one state: the entries of a row in the columns of a block, and those of the block's rows in the column of
    /// the row.
    #[inline(always)]
    fn put<T: Real, C: ColumnsOf<T, Entry = E>>(&mut self, row: usize, end: usize, across: [C; 3], down: [C; 2]) {
        let (nv, size) = (self.nv, self.nv * self.nv);
        let ([by_q, by_qd, mass], [q_down, qd_down]) = (across, down);
        let (of_q, rest) = self.out.split_at_mut(size);
        let (of_qd, of_mass) = rest.split_at_mut(size);
        put_block::<T, C>(of_q, (nv, row), end, [by_q, q_down]);
        put_block::<T, C>(of_qd, (nv, row), end, [by_qd, qd_down]);
        put_block::<T, C>(of_mass, (nv, row), end, [mass; 2]);
    }

    /// For one state: one entry of each matrix.
    #[inline(always)]
    fn put_one<T: Real, C: ColumnsOf<T, Entry = E>>(&mut self, row: usize, column: usize, entries: [T; 3]) {
        for (matrix, entry) in entries.into_iter().enumerate() {
            self.out[(matrix * self.nv + row) * self.nv + column] = C::kept(entry);
        }
    }

    /// In lanes: all entries of a pair.
    #[inline(always)]
    fn put_pair<T: Real, C: ColumnsOf<T, Entry = E>>(&mut self, pair: usize, across: [C; 3], down: [C; 2]) {
        let to = &mut self.out[1 + OF_PAIR * pair..][..OF_PAIR];
        for (to, entry) in to.chunks_exact_mut(1).zip([across[0], down[0], across[1], down[1], across[2]]) {
            entry.store(to);
        }
    }

    /// In lanes: the entries of a pair within one joint, as (row, column), or as (column, row) if it is `below` the
    /// diagonal.
    #[inline(always)]
    fn put_own<T: Real, C: ColumnsOf<T, Entry = E>>(&mut self, pair: usize, below: bool, entries: [T; 3]) {
        let to = &mut self.out[1 + OF_PAIR * pair..][..OF_PAIR];
        let at = usize::from(below);
        (to[at], to[2 + at], to[4]) = (C::kept(entries[0]), C::kept(entries[1]), C::kept(entries[2]));
    }
}

/// phi of a column: three forces and a moment.
#[inline(always)]
fn send<C: Real>(whole: &mut Column<C>, across: &impl Transform<C>) {
    let (mut by_acceleration, moment, mut by_position, mut by_rate) = parts(whole);
    for force in [&mut by_acceleration, &mut by_position, &mut by_rate] {
        across.send_force(&{ *force }, true, force);
    }
    *whole = column(&by_acceleration, &across.rotate_to_parent(moment), &by_position, &by_rate);
}

/// The arguments of the inward pass.
struct Inward<'a, T: Real, C: ColumnsOf<T>> {
    layout: &'a ColumnLayout<C>,
    columns: &'a mut [Column<C>],
    kept: &'a mut Kept<T>,
    like: C,
    noise: &'a [T],
    to: Places<'a, C::Entry>,
}

// A function call in debug builds: inlined without sharing of stack slots, its frame would exceed the stack of a
// thread.
impl<T: Real, C: ColumnsOf<T>> Inward<'_, T, C> {
    /// One body: the entries of its rows, its own columns, and the propagation to its parent.
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn step(
        &mut self,
        (place, body): (usize, &SweepBody<T::Parameter>),
        (transform, across): (&impl Transform<T>, &impl Transform<C>),
        rows: &Rows<T>,
    ) {
        let (count, first) = (rows.count(), body.row);
        let goes_on = body.places.parent.checked_sub(1);
        let outboard = self.layout.blocks_of(first + count, body.end_row);
        // Blocks that contain columns of the body itself are propagated after these columns are inserted.
        let own = self.layout.blocks_of(first, first + count);
        let carried = outboard.start.max(own.end)..outboard.end;
        for i in 0..count {
            let carries = goes_on.is_some() && i + 1 == count;
            self.entries_of_row((body, rows, i), outboard.clone(), carries.then_some(across), &carried);
        }
        if count == 0 && goes_on.is_some() {
            self.carry(outboard, across);
        }
        // From the last row: the first column of a block initializes the block.
        for i in (0..count).rev() {
            let column = self.own_column((place, body), rows, i);
            let at = &self.layout.places[first + i];
            self.layout.insert(at.lane, &mut self.columns[at.block], &column);
        }
        let Some(parent) = goes_on else { return };
        self.carry(own, across);
        let Kept { composites, coriolis, forces, .. } = &mut *self.kept;
        composites[parent] = composites[parent].add(&transform.composite_to_parent(&composites[place]));
        coriolis[parent] = coriolis[parent].add(&coriolis[place].across(transform));
        let force = forces[place];
        transform.send_force(&force, false, &mut forces[parent]);
    }

    /// The entries of all columns outboard of a joint in one of its rows, and of the row's column in their rows. If
    /// `across` is given, the columns are propagated to the parent.
    #[inline(always)]
    fn entries_of_row(
        &mut self,
        (body, rows, i): (&SweepBody<T::Parameter>, &Rows<T>, usize),
        blocks: Range<usize>,
        across: Option<&impl Transform<C>>,
        carried: &Range<usize>,
    ) {
        let row = body.row + i;
        let (hinge, sense) =
            (spread_hinge(self.like, rows.row(i)), self.like.spread(self.noise[row].splat(body.sense)));
        let effect = self.kept.effect[row].spread(self.like);
        let at_row = &self.layout.places[row];
        // From the last block: lanes without a column are overwritten.
        for at in blocks.rev() {
            let mut column = self.columns[at];
            let entries = in_row(&column, &hinge, sense);
            let mirrored = in_column(&column, &effect, &hinge, sense);
            if T::LANES > 1 {
                self.to.put_pair::<T, C>(at_row.entries + (at - at_row.block), entries, mirrored);
            } else {
                self.to.put::<T, C>(row, self.layout.ends[at], entries, mirrored);
            }
            if let Some(across) = across.filter(|_| carried.contains(&at)) {
                send(&mut column, across);
                self.columns[at] = column;
            }
        }
    }

    /// phi of all columns of some blocks.
    #[inline(always)]
    fn carry(&mut self, blocks: Range<usize>, across: &impl Transform<C>) {
        for column in &mut self.columns[blocks] {
            send(column, across);
        }
    }

    /// The column of a row at its own body, and its entries in the rows of its own joint.
    #[inline(always)]
    fn own_column(&mut self, (place, body): (usize, &SweepBody<T::Parameter>), rows: &Rows<T>, i: usize) -> Column<T> {
        let (hinge, row) = (rows.row(i), body.row + i);
        let sense = self.noise[row].splat(body.sense);
        let Kept { composites, coriolis, forces, effect, .. } = &*self.kept;
        let (composite, b, effect) = (&composites[place], &coriolis[place], &effect[row]);
        let along: [T; 6] = hinge.covariance_column(&composite.to_symmetric()).into();
        let (moment, rate) = (b.moment(&hinge), b.column(&hinge));
        let position: [T; 6] = composite.mul_motion(&Vector6::from(effect.acceleration)).into();
        let by_rate: [T; 6] = composite.mul_motion(&Vector6::from(effect.by_rate)).into();
        let turned = b.mul_angular(&effect.velocity);
        let mut whole = column(&along, &moment, &position, &by_rate);
        for k in 0..6 {
            whole[k] *= sense;
            whole[9 + k] += turned[k];
            whole[15 + k] = sense.mul_add(rate[k], by_rate[k]);
        }
        for moment in &mut whole[6..9] {
            *moment *= sense;
        }
        for other in 0..rows.count() {
            let mut entries = in_row(&whole, &rows.row(other), sense);
            if other == i {
                entries[2] += self.noise[row];
            }
            let (other, places) = (body.row + other, &self.layout.places);
            if T::LANES > 1 {
                let (inner, outer) = (row.min(other), row.max(other));
                self.to.put_own::<T, C>(places[inner].entries + (outer - inner), other > row, entries);
            } else {
                self.to.put_one::<T, C>(other, row, entries);
            }
        }
        // The frame in which F is propagated inward moves with the joint. The rows of the joint itself rotate with it
        // and are not affected.
        let pushed = hinge_cross_force(&hinge, &forces[place]);
        for k in 0..6 {
            whole[9 + k] = sense.mul_add(pushed[k], whole[9 + k]);
        }
        whole
    }
}
