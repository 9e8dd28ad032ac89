//! M^-1 = (1 - L*) D^-1 (1 - L), multiplied out: for scenes whose joints have few others inward of them.
//!
//! A column of (1 - L)* is one joint's unit innovation on its way outward: c begins as -H*, and at each row further out gives
//! w = g* c and goes on as phi* (c - H* w). An entry of M^-1 is the sum of w w / D over the joints inward of both, the diagonal a sum of
//! squares. Costs the sum of depths for the factors and N^2 times the depth for the product, where [`mass_inverse`](super::mass_inverse)
//! pays for Lambda at each body.

use super::body::{Carrier, LeanModel};
use super::columns::{LeanColumns, TILE, blocks_of, put_block, set_column};
use super::scratch::LeanScratch;
use super::turn::{Axis, about};
use super::way::Way;
use crate::dynamics::columns::{spread_hinge, spread_shift, spread_vector};
use crate::scalar::{ColumnsOf, Real};
use crate::scene::Model;
use crate::spatial::{dot, zero};

/// M^-1 of the factor in the scratch.
#[inline(always)]
pub(super) fn multiplied_out<T: Real, C: ColumnsOf<T>>(
    scene: (&Model<T>, &LeanModel<T>),
    (scratch, columns): (&LeanScratch<T>, &mut LeanColumns<C>),
    out: &mut [T],
) {
    factors_base_to_tip(scene, (scratch, columns));
    product(scene, (scratch, columns), out);
}

/// Base to tip: w of every pair of joints one inward of the other. Columns are in the order of the path from the base.
#[inline(always)]
fn factors_base_to_tip<T: Real, C: ColumnsOf<T>>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    (scratch, columns): (&LeanScratch<T>, &mut LeanColumns<C>),
) {
    for (k, body) in lean.bodies.iter().enumerate() {
        let stage = &model.system.stages[k];
        let mut own = columns.take(body.places.outward);
        let depth = body.depth;
        let blocks = blocks_of::<T, C>(&(0..depth));
        match body.carrier {
            Carrier::Turn(axis) => about!(axis, X, Y, Z, {
                let (turn, gain) = (scratch.own[lean.at[k]].turn, &scratch.measured[body.row].gain);
                let way = Way::<C, X, Y, Z>::new(body, turn, gain, C::zero());
                for block in blocks {
                    let mut c = way.carried(&columns.at(body.places.parent_outward)[block]);
                    let w = way.entry(&c);
                    columns.put_factors(depth, block, body.row, &w);
                    if !body.is_leaf {
                        way.past_row(&mut c, w);
                        own[block] = c;
                    }
                }
            }),
            Carrier::Shift(at) => {
                let shift = spread_shift(C::zero(), &scratch.shifts[at]);
                for block in blocks {
                    let mut c = shift.motion_to_child(&columns.at(body.places.parent_outward)[block].into());
                    for i in 0..stage.rows.count() {
                        let w = dot(&spread_vector(c[0], &scratch.measured[body.row + i].gain), &c);
                        columns.put_factors(depth, block, body.row + i, &w);
                        c = spread_hinge(w, stage.rows.row(i)).spread_onto(&c, -w);
                    }
                    own[block] = c.into();
                }
            }
        }
        for i in 0..stage.rows.count() {
            columns.enter_path(depth + i, body.row + i);
            let mut c = stage.rows.row(i).spread_onto(&zero(), -T::one().everywhere(body.sense));
            for outer in i + 1..stage.rows.count() {
                let w = dot(&scratch.measured[body.row + outer].gain, &c);
                columns.put_factor(depth + i, body.row + outer, w);
                c = stage.rows.row(outer).spread_onto(&c, -w);
            }
            if !body.is_leaf {
                set_column(&mut own[(depth + i) / C::COLUMNS], (depth + i) % C::COLUMNS, &c.into());
            }
        }
        columns.give_back(body.places.outward, own);
    }
}

/// Row by row up to the diagonal: the sum of w w / D over the path from the base.
#[inline(always)]
fn product<T: Real, C: ColumnsOf<T>>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    (scratch, columns): (&LeanScratch<T>, &mut LeanColumns<C>),
    out: &mut [T],
) {
    let (nv, tiles) = (model.nv(), columns.tiles::<T>());
    let none = C::zero();
    let LeanColumns { path, factors, weights, .. } = columns;
    for (k, body) in lean.bodies.iter().enumerate() {
        for i in 0..model.system.stages[k].rows.count() {
            let row = body.row + i;
            let depth = body.depth + i + 1;
            path[depth - 1] = (row, row * tiles);
            let (block, lane) = (row / C::COLUMNS, row % C::COLUMNS);
            for (weight, &(joint, at)) in weights.iter_mut().zip(&path[..depth]) {
                let factor = &factors[at + block / TILE][block % TILE];
                *weight = none.spread(factor.column(lane) * scratch.measured[joint].pivot_inverse);
            }
            let mut common = 0;
            for tile in 0..=block / TILE {
                // Joints further out than the tile have nothing in it.
                while common < depth && path[common].0 < (tile + 1) * TILE * C::COLUMNS {
                    common += 1;
                }
                let mut sums = [none; TILE];
                for (&weight, &(_, at)) in weights[..common].iter().zip(&*path) {
                    let factors = &factors[at + tile];
                    for (sum, &factor) in sums.iter_mut().zip(factors) {
                        *sum = weight.mul_add(factor, *sum);
                    }
                }
                for (sum, block) in sums.iter().zip(tile * TILE..=block) {
                    put_block(out, nv, row, block, sum);
                }
            }
        }
    }
}
