//! M^-1 = (1 - L*) D^-1 (1 - L) as a product of its factors, for scenes with few joints inward of each joint.
//!
//! A column of (1 - L)* propagates the unit innovation of one joint outward: c starts as -H*; each row outward of it
//! has the entry w = g* c, and c continues as phi* (c - H* w). With w scaled by D^-1/2, an entry of M^-1 is the sum of
//! products of w over the joints inward of both of its joints, and a diagonal entry is a sum of squares. The cost is
//! the sum of depths for the factors and N^2 times the depth for the product, while
//! [the closed form](crate::dynamics::mass_inverse) needs Lambda of each body.
//! The columns are those of one state, or of one state per lane, in blocks.

use super::joint::{self, Joint, with_axial};
use super::model::SweepModel;
use super::rows::{ABOUT_Z, along};
use super::scratch::SweepScratch;
use super::tiles::{Entries, Pair, TILE, Tiles, put, put_factors};
use crate::dynamics::columns::{spread_hinge, spread_shift, spread_vector};
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::transform::Transform;
use crate::spatial::{dot, zero};
use nalgebra::Vector6;

/// M^-1 from the factor in the scratch, into `out`, in the layout of [`Entries`](super::Entries). With CHECK it also
/// checks that all entries are finite.
#[inline(always)]
pub(crate) fn multiplied_out<T: Real, C: ColumnsOf<T>, const CHECK: bool>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &SweepScratch<T>,
    columns: &mut InverseColumns<T, C>,
    out: &mut [C::Entry],
) {
    factors_base_to_tip(scene, (scratch, columns));
    product::<T, C, CHECK>(&mut columns.tiles, out);
}

/// Base to tip: w of every pair of joints on one path, divided by the square root of D. Columns are in the order of the
/// path from the base; lanes beyond the path hold zeros.
#[inline(always)]
fn factors_base_to_tip<T: Real, C: ColumnsOf<T>>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    (scratch, columns): (&SweepScratch<T>, &mut InverseColumns<T, C>),
) {
    let InverseColumns { slots, tiles: Tiles { factors, targets, units, blocks: blocks_of_row, entries, .. }, .. } =
        columns;
    let (none, mut targets) = (entries.zero(), &targets[..]);
    for (body, of_body) in sweeps.swept().iter().zip(&scratch.own) {
        let mut own = std::mem::take(&mut slots[body.places.outward]);
        let parents: &[Block<C>] = if body.parent.is_some() { &slots[body.places.parent_outward] } else { &[] };
        let blocks = body.depth.div_ceil(C::COLUMNS);
        match body.joint {
            Joint::Axial(axis) => with_axial!(axis, of_body.turn, sweeps, body.offset, transform, {
                let transform = transform.spread(none);
                let row = Row::new(none, body.sense, &scratch.measured[body.row].gain);
                let lane = body.row % C::COLUMNS;
                let (parents, here) = (&parents[..blocks], &targets[..blocks]);
                targets = &targets[blocks..];
                // An index loop: iterators over both slices would need divisions for their length.
                for at in 0..parents.len().min(here.len()) {
                    let mut c = transform.carry_motion(&parents[at]);
                    let w = along(&row.gain, &c);
                    put_factors(factors, &here[at], lane, &w);
                    if !body.is_leaf {
                        c[ABOUT_Z] = c[ABOUT_Z].minus_product(row.sense, w);
                        own[at] = c;
                    }
                }
                let root = scratch.measured[body.row].pivot_inverse.sqrt();
                factors[body.row * *blocks_of_row + body.row / C::COLUMNS].set_column(lane, root);
                if !body.is_leaf {
                    let begun = -(row.sense * (units[body.depth % C::COLUMNS] * none.spread(root)));
                    if body.depth.is_multiple_of(C::COLUMNS) {
                        own[blocks] = [none, none, begun, none, none, none];
                    } else {
                        own[blocks - 1][ABOUT_Z] += begun;
                    }
                }
            }),
            Joint::Prismatic(at, _) | Joint::Free(at) | Joint::General(at) => {
                let stage = &model.system.stages[body.index];
                let (rows, shift) = (stage.rows.count(), spread_shift(none, &scratch.shifts[at]));
                for (parent, own) in parents[..blocks].iter().zip(&mut own) {
                    let mut c = shift.motion_to_child(&(*parent).into());
                    let here;
                    (here, targets) = targets.split_at(rows);
                    for (row, here) in (body.row..body.row + rows).zip(here) {
                        let w = dot(&spread_vector(none, &scratch.measured[row].gain), &c);
                        put_factors(factors, here, row % C::COLUMNS, &w);
                        c = spread_hinge(w, stage.rows.row(row - body.row)).spread_onto(&c, -w);
                    }
                    *own = c.into();
                }
                own[blocks..(body.depth + rows).div_ceil(C::COLUMNS)].fill([none; 6]);
                for i in 0..rows {
                    let joint = body.row + i;
                    let root = scratch.measured[joint].pivot_inverse.sqrt();
                    factors[joint * *blocks_of_row + joint / C::COLUMNS].set_column(joint % C::COLUMNS, root);
                    let mut c = stage.rows.row(i).spread_onto(&zero(), -root.splat(body.sense) * root);
                    for outer in i + 1..rows {
                        let w = dot(&scratch.measured[body.row + outer].gain, &c);
                        let row = body.row + outer;
                        factors[joint * *blocks_of_row + row / C::COLUMNS].set_column(row % C::COLUMNS, w);
                        c = stage.rows.row(outer).spread_onto(&c, -w);
                    }
                    set_column(&mut own[(body.depth + i) / C::COLUMNS], (body.depth + i) % C::COLUMNS, &c.into());
                }
            }
        }
        slots[body.places.outward] = own;
    }
}

/// The row of a revolute joint, broadcast over columns.
struct Row<C> {
    /// 1 or -1: H is this along z.
    sense: C,
    /// g of the row, with its sign.
    gain: [C; 6],
}

impl<C: Real> Row<C> {
    #[inline(always)]
    fn new<T: Real>(like: C, sense: T::Parameter, gain: &Vector6<T>) -> Self
    where
        C: ColumnsOf<T>,
    {
        let sense = gain[0].splat(sense);
        let mut row = Self { sense: like.spread(sense), gain: [like; 6] };
        for (to, &g) in row.gain.iter_mut().zip(gain.iter()) {
            *to = like.spread(g * sense);
        }
        row
    }
}

/// For each tile of the lower triangle: the sum of products of w over the joints inward of both its rows and its
/// columns.
#[inline(always)]
#[allow(clippy::eq_op)] // that is the point
fn product<T: Real, C: ColumnsOf<T>, const CHECK: bool>(tiles: &mut Tiles<T, C>, out: &mut [C::Entry]) {
    let none = tiles.entries.zero();
    let (across, at_once) = (Tiles::<T, C>::ACROSS, Tiles::<T, C>::AT_ONCE);
    tiles.entries.begin(out);
    let Tiles { factors, pairs, inward, nv, .. } = &*tiles;
    let (factors, inward, nv, mut fault) = (&factors[..], &inward[..], *nv, none);
    for (number, &Pair { side, other, ref joints }) in pairs.iter().enumerate() {
        let mut sums = [[none; TILE]; TILE];
        for &at in &inward[joints.clone()] {
            let columns = &factors[at + other * across..][..across * at_once];
            for row in 0..TILE {
                let factor = none.spread(factors[at + side * across + row / C::COLUMNS].column(row % C::COLUMNS));
                for column in 0..across * at_once {
                    sums[row][column] = factor.mul_add(columns[column], sums[row][column]);
                }
            }
        }
        if CHECK {
            // Not finite if an entry is not finite. If only this sum overflows, the state is recomputed unnecessarily.
            let mut all = none;
            for row in &sums {
                for &some in &row[..across * at_once] {
                    all += some;
                }
            }
            fault += all - all;
        }
        put::<T, C, 0>(out, nv, (side, other), number, &sums);
        if at_once == 2 && other < side {
            put::<T, C, 1>(out, nv, (side, other + 1), number, &sums);
        }
    }
    tiles.entries.fault = fault;
}

/// Vectors of adjacent columns, one column per lane of `C`.
pub(super) type Block<C> = [C; 6];

/// Scratch of M^-1. A block begins at a position on the path from the base that is a multiple of its width.
#[derive(Debug)]
pub(crate) struct InverseColumns<T: Real, C: ColumnsOf<T>> {
    /// In slots, outward: c of the innovation D^-1/2 of every joint on the path; zero beyond the path.
    pub(super) slots: Vec<Vec<Block<C>>>,
    /// Scratch of the product of the factors.
    pub(super) tiles: Tiles<T, C>,
}

impl<T: Real, C: ColumnsOf<T>> InverseColumns<T, C> {
    /// Empty: allocated when M^-1 is first computed.
    pub fn new() -> Self {
        Self { slots: Vec::new(), tiles: Tiles::new() }
    }

    /// Allocates the columns if necessary. Returns the buffer of the entries of M^-1 in lanes, or None for a scene
    /// whose factors are not [multiplied](super::inverse_product).
    #[inline(always)]
    pub fn prepare(&mut self, model: &Model<T>, sweeps: &SweepModel<T>) -> Option<&mut Entries<T, C>> {
        if !sweeps.is_shallow {
            return None;
        }
        if self.slots.is_empty() {
            self.make(model, sweeps);
        }
        Some(&mut self.tiles.entries)
    }

    #[cold]
    fn make(&mut self, model: &Model<T>, sweeps: &SweepModel<T>) {
        let nan = [C::from_f64(f64::NAN); 6];
        self.slots = vec![vec![nan; sweeps.longest_path.div_ceil(C::COLUMNS)]; sweeps.swept_slots.outward];
        self.tiles.prepare(model, sweeps);
    }
}

/// Writes the vector of one column to its lane.
#[inline(always)]
pub(super) fn set_column<T: Real, C: ColumnsOf<T>>(block: &mut Block<C>, lane: usize, x: &[T; 6]) {
    for (block, &x) in block.iter_mut().zip(x) {
        block.set_column(lane, x);
    }
}
