//! Tip to base: composite inertias (3.5), and from each joint the column of M inward of it (3.4), vectorized (SIMD)
//! over the columns of a body.
//!
//! All columns outboard of a body pass its joint in the same way: the transform is read once, and the columns are
//! independent. They are those of one state, or of one state per lane, in blocks.

use super::body::SweepBody;
use super::column_layout::{ColumnLayout, Place, put_block};
use super::inverse_product::Block;
use super::joint::{self, Joint, with_axial};
use super::model::SweepModel;
use super::motion::carriers;
use super::rows::{ABOUT_Z, PICKED, picked};
use super::scratch::SweepScratch;
use super::tiles::Entries;
use crate::dynamics::columns::{spread_hinge, spread_shift};
use crate::filter::{HingeMap, Rows};
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::BodyInertia;
use crate::spatial::transform::{Axes, Axial, Rotates, Transform};

/// M at `q` into `out`, in the layout of [`Entries`](super::Entries) and equal to
/// [`mass_matrix`](crate::dynamics::mass_matrix) to rounding. The columns must be [prepared](MassColumns::prepare).
/// With CHECK it also checks that all entries are finite.
#[inline(always)]
pub(crate) fn mass_matrix<T: Real, C: ColumnsOf<T>, const CHECK: bool>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    (scratch, columns): (&mut SweepScratch<T>, &mut MassColumns<T, C>),
    q: &[T],
    out: &mut [C::Entry],
) {
    columns.begin(out);
    carriers(sweeps, scratch, columns.like(), q);
    let SweepScratch { own, shifts, composites, .. } = scratch;
    let system = &model.system;
    // For one state, the inertia propagated to the next body of the pass stays in registers; lanes do not benefit.
    let (mut sent, mut is_next) = (composites[0], false);
    for (place, (body, own)) in sweeps.swept().iter().zip(own).enumerate().rev() {
        let arrived = if is_next { sent } else { composites[body.places.inward] };
        let composite = sweeps.load(body).with_inertia(&arrived);
        is_next = false;
        let carried = match body.joint {
            Joint::Axial(axis) => with_axial!(axis, own.turn, sweeps, body.offset, transform, {
                let noise = system.noise[body.row];
                through_axial::<T, C, _, _, CHECK>(body, transform, noise, &composite, (&mut *columns, &mut *out))
            }),
            Joint::Free(_) => {
                let (whole, noise) = (composite.to_symmetric(), &system.noise[body.row..body.row + PICKED.len()]);
                columns.put_free_joint::<CHECK>(out, (body.row, body.end_row), |i| {
                    let mut row = picked(&Rows::Six.row(i).covariance_column(&whole).into());
                    row[i] += noise[i];
                    row
                });
                continue;
            }
            Joint::Prismatic(at, _) | Joint::General(at) => {
                let rows = system.stages[body.index].rows;
                for i in (0..rows.count()).rev() {
                    let (row, hinge) = (body.row + i, rows.row(i));
                    let force = hinge.covariance_column(&composite.to_symmetric()).into();
                    columns.put_row::<CHECK>(out, (row, body.end_row), &force, &spread_hinge(columns.like(), hinge));
                    columns.add_to_diagonal::<CHECK>(out, row, system.noise[row]);
                }
                if body.parent.is_none() {
                    continue;
                }
                let shift = spread_shift(columns.like(), &shifts[at]);
                for force in columns.blocks(body.row, body.end_row) {
                    shift.send_force(&{ *force }, true, force);
                }
                composite.to_parent(&shifts[at])
            }
        };
        if body.parent.is_some() {
            let to = &mut composites[body.places.parent_inward];
            sent = if body.places.accumulates_first { carried } else { to.add(&carried) };
            is_next = T::LANES == 1 && body.places.parent == place;
            if !is_next {
                *to = sent;
            }
        }
    }
}

/// The row of a revolute joint, and the propagation to the parent. Returns the propagated inertia.
#[inline(always)]
fn through_axial<T: Real, C: ColumnsOf<T>, R: Rotates<T>, A: Axes, const CHECK: bool>(
    body: &SweepBody<T::Parameter>,
    transform: &Axial<T, R, A>,
    noise: T,
    composite: &BodyInertia<T>,
    (columns, out): (&mut MassColumns<T, C>, &mut [C::Entry]),
) -> BodyInertia<T> {
    let (h, i) = (&composite.first_moment, &composite.rotational.entries);
    let (like, ends) = (h[0], body.parent.is_none());
    let sense = like.splat(body.sense);
    // r(k) H*(k), where H selects the rotation about z with the sign of the axis.
    let force = [sense * i[2], sense * i[4], sense * i[5], -(sense * h[1]), sense * h[0], like.constant(0.0)];
    let none = columns.like();
    let measured = Turn { sense: none.spread(sense), transform: transform.spread(none), ends };
    columns.put_row::<CHECK>(out, (body.row, body.end_row), &force, &measured);
    columns.add_to_diagonal::<CHECK>(out, body.row, noise);
    // A root body propagates no inertia.
    if ends { *composite } else { transform.composite_to_parent(composite) }
}

/// The row of a revolute joint, and phi across it.
struct Turn<C, X> {
    sense: C,
    transform: X,
    /// True if the body has no parent.
    ends: bool,
}

impl<C: Real, X: Transform<C>> Measurement<C> for Turn<C, X> {
    #[inline(always)]
    fn entry(&self, force: &Block<C>) -> C {
        self.sense * force[ABOUT_Z]
    }

    #[inline(always)]
    fn carry(&self, force: &mut Block<C>) {
        if !self.ends {
            self.transform.send_force(&{ *force }, true, force);
        }
    }
}

/// A row of another joint: all rows of the joint are read before anything is propagated.
impl<C: Real> Measurement<C> for HingeMap<C> {
    #[inline(always)]
    fn entry(&self, force: &Block<C>) -> C {
        match *self {
            HingeMap::Axis(i) => force[i],
            HingeMap::Screw(pitch) => pitch.mul_add(force[5], force[2]),
        }
    }

    #[inline(always)]
    fn carry(&self, _force: &mut Block<C>) {}
}

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
