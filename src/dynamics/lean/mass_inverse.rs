//! M^-1: of shallow scenes its factors [multiplied out](super::inverse_product), else in closed form (6.1, as it holds), a row at a
//! time, several columns of it side by side.
//!
//! At a body every column inward of it, and every one of the branches before it, goes the same way: what the way is made of is read once,
//! and no column waits for another.

use super::body::{Carrier, LeanBody, LeanModel};
use super::carry::{in_joint_frame, packed, unpacked};
use super::columns::{LeanColumns, blocks_of, put_block, set_column};
use super::filter;
use super::inverse_product;
use super::motion::{carriers, cross};
use super::rotation::{Rotates, TiltedTurn, rotated};
use super::scratch::LeanScratch;
use super::tilt::Axle;
use super::turn::{Axis, about, packed_to_turn, to_parent};
use super::way::Way;
use crate::dynamics::columns::{put, spread_hinge, spread_shift, spread_vector};
use crate::filter::covariance::row_update;
use crate::filter::innovations::past_rows;
use crate::filter::pivots::PivotMonitor;
use crate::filter::riccati::Measured;
use crate::scalar::{ColumnsOf, Real};
use crate::scene::Model;
use crate::spatial::{Symmetric6, dot, scaled};
use nalgebra::Vector6;

/// The factor of M at `q`, in the scratch, in covariance form.
#[inline(always)]
pub(crate) fn factor<T: Real, C: ColumnsOf<T>>(
    scene: (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    q: &[T],
) -> PivotMonitor<T> {
    carriers(scene.1, scratch, C::zero(), q);
    let [monitor, _] = filter::tip_to_base::<T, { filter::FACTOR }>(scene, scratch, &[], &mut []);
    monitor
}

/// M^-1 of the factor in the scratch, (nv x nv), as [`mass_matrix_inverse`](crate::dynamics::mass_matrix_inverse) gives it in that form to rounding,
/// after the columns were [made](LeanColumns::prepare): of shallow scenes into `entries` as [`Entries`](super::Entries) has it, where with
/// CHECK it is seen whether all are finite, else into `out` row by row.
#[inline(always)]
pub(crate) fn closed_form<T: Real, C: ColumnsOf<T>, const CHECK: bool>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    (scratch, columns): (&mut LeanScratch<T>, &mut LeanColumns<T, C>),
    (entries, out): (&mut [C::Entry], &mut [T]),
) {
    if lean.is_shallow {
        inverse_product::multiplied_out::<T, C, CHECK>((model, lean), scratch, columns, entries);
    } else {
        by_co_covariances((model, lean), (scratch, columns), out);
    }
}

/// (6.1) as it holds: O(N^2), the order of the output.
#[inline(always)]
fn by_co_covariances<T: Real, C: ColumnsOf<T>>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    (scratch, columns): (&mut LeanScratch<T>, &mut LeanColumns<T, C>),
    out: &mut [T],
) {
    co_covariances_base_to_tip((model, lean), scratch);
    for (k, body) in lean.bodies.iter().enumerate().filter(|(_, body)| body.is_parted) {
        for column in body.row..body.row + model.system.stages[k].rows.count() {
            parted_inward((model, lean), (scratch, columns), (k, column));
        }
    }
    rows_base_to_tip((model, lean), (scratch, columns), out);
}

/// Base to tip: Lambda^- of every body (5.6, 5.7), and Lambda^+ g of every row.
#[inline(always)]
fn co_covariances_base_to_tip<T: Real>((model, lean): (&Model<T>, &LeanModel<T>), scratch: &mut LeanScratch<T>) {
    let o = T::zero();
    for (k, body) in lean.bodies.iter().enumerate() {
        let outer = body.parent.map_or([o; 21], |parent| scratch.co_covariances[parent]);
        scratch.co_covariances[k] = match body.carrier {
            Carrier::Turn(axle) => {
                let lambda = if body.parent.is_some() {
                    rotated!(axle, scratch.own[lean.at[k]].turn, lean.tilts, rotation, {
                        let outer = about!(axle.axis(), X, Y, Z, packed_to_turn::<T, X, Y, Z>(&outer));
                        co_carried(body, &rotation, &outer)
                    })
                } else {
                    outer
                };
                let (lambda, u) = updated(&lambda, &scratch.measured[body.row]);
                scratch.spread_gains[body.row] = u;
                lambda
            }
            Carrier::Shift(at) => {
                let mut lambda = match body.parent {
                    Some(_) => scratch.shifts[at].co_covariance_to_child(&unpacked(&outer)),
                    None => Symmetric6::zero(),
                };
                let stage = &model.system.stages[k];
                for i in 0..stage.rows.count() {
                    let row = body.row + i;
                    (lambda, scratch.spread_gains[row]) =
                        row_update(&lambda, &stage.rows.row(i), &scratch.measured[row]);
                }
                packed(&lambda)
            }
        };
    }
}

/// phi* Lambda phi across a turn, Lambda in its frame: along the lever, about z.
#[inline(always)]
fn co_carried<T: Real>(body: &LeanBody<T::Parameter>, rotation: &impl Rotates<T>, lambda: &[T; 21]) -> [T; 21] {
    let [a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5] = *lambda;
    let (mut c, mut b) = ([[c0, c1, c2], [c3, c4, c5], [c6, c7, c8]], [b0, b1, b2, b3, b4, b5]);
    if body.lever.is_there() {
        let [x, y, z] = body.lever.entries;
        let l = [a0.everywhere(x), a0.everywhere(y), a0.everywhere(z)];
        // v becomes v + w x l: C' = C + a x l, a the rows of A; B' = B + (C' x l) + (C x l)^T, column by column.
        let moved = [cross([a0, a1, a2], l, c[0]), cross([a1, a3, a4], l, c[1]), cross([a2, a4, a5], l, c[2])];
        b = [
            both(b[0], &moved, &c, l, 0, 0),
            both(b[1], &moved, &c, l, 0, 1),
            both(b[2], &moved, &c, l, 0, 2),
            both(b[3], &moved, &c, l, 1, 1),
            both(b[4], &moved, &c, l, 1, 2),
            both(b[5], &moved, &c, l, 2, 2),
        ];
        c = moved;
    }
    let ([b0, b1, b2, b3, b4, b5], [[c0, c1, c2], [c3, c4, c5], [c6, c7, c8]]) = (b, c);
    rotation.covariance_back(&[a0, a1, a2, a3, a4, a5, c0, c1, c2, c3, c4, c5, c6, c7, c8, b0, b1, b2, b3, b4, b5])
}

/// b + (column j of C' x l) at i + (column i of C x l) at j.
#[inline(always)]
fn both<T: Real>(b: T, moved: &[[T; 3]; 3], c: &[[T; 3]; 3], l: [T; 3], i: usize, j: usize) -> T {
    let (y, z) = ((i + 1) % 3, (i + 2) % 3);
    let (u, v) = ((j + 1) % 3, (j + 2) % 3);
    let first = moved[y][j].mul_add(l[z], b.minus_product(moved[z][j], l[y]));
    c[u][i].mul_add(l[v], first.minus_product(c[v][i], l[u]))
}

/// Lambda^- and Lambda^+ g across a turn's row, as [`row_update`] has it.
#[inline(always)]
fn updated<T: Real>(lambda: &[T; 21], m: &Measured<T>) -> ([T; 21], Vector6<T>) {
    let u = unpacked(lambda).mul_vector(&m.gain);
    let whole = dot(&m.gain, &u) + m.pivot_inverse;
    let mut next = *lambda;
    next[2] -= u[0];
    next[4] -= u[1];
    next[5] += whole - (u[2] + u[2]);
    next[12] -= u[3];
    next[13] -= u[4];
    next[14] -= u[5];
    (next, u)
}

/// Tip to base from the column's body: Psi(c,j) g(j) at every body c inboard that later branches leave.
#[inline(always)]
fn parted_inward<T: Real, C: ColumnsOf<T>>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    (scratch, columns): (&LeanScratch<T>, &mut LeanColumns<T, C>),
    (mut k, column): (usize, usize),
) {
    let mut body = &lean.bodies[k];
    let gain = &scratch.measured[column].gain;
    let mut u = scaled(gain, gain[0].everywhere(body.sense));
    past_rows(&model.system.stages[k], &scratch.measured, 0..column - body.row, &mut u);
    while let Some(parent) = body.parent {
        let there = match body.carrier {
            Carrier::Turn(axle) => rotated!(axle, scratch.own[lean.at[k]].turn, lean.tilts, rotation, {
                let sent = in_joint_frame(&body.lever, &rotation, &u.into());
                about!(axle.axis(), X, Y, Z, to_parent::<T, X, Y, Z>(&sent))
            }),
            Carrier::Shift(at) => scratch.shifts[at].force_to_parent(&u).into(),
        };
        if body.sibling_follows() {
            columns.part((k, body.row), column, &there);
        }
        (k, body) = (parent, &lean.bodies[parent]);
        if !body.is_parted {
            break;
        }
        let stage = &model.system.stages[k];
        u = there.into();
        past_rows(stage, &scratch.measured, 0..stage.rows.count(), &mut u);
    }
}

/// Base to tip: of every row the entries up to the diagonal. Minus a co-state is carried: of a body's own columns
/// y = A* L+ g - H*/D, of the others phi* y past its rows.
#[inline(always)]
fn rows_base_to_tip<T: Real, C: ColumnsOf<T>>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    (scratch, columns): (&LeanScratch<T>, &mut LeanColumns<T, C>),
    out: &mut [T],
) {
    let nv = model.nv();
    let mut tree = 0;
    for (k, body) in lean.bodies.iter().enumerate() {
        let stage = &model.system.stages[k];
        let rows = body.row..body.row + stage.rows.count();
        if body.parent.is_none() {
            tree = body.row;
        }
        if let (Some(parent), Some(sibling)) = (body.parent, body.sibling) {
            let (lambda, branch) = (unpacked(&scratch.co_covariances[parent]), lean.bodies[sibling].row..body.row);
            columns.arrive(body.places.parent_outward, sibling, branch, &lambda);
        }
        let mut own = columns.take(body.places.outward);
        if body.parent.is_some() {
            let blocks = blocks_of::<T, C>(&(tree..body.row));
            let parents = columns.at(body.places.parent_outward);
            match body.carrier {
                Carrier::Turn(axle) => rotated!(axle, scratch.own[lean.at[k]].turn, lean.tilts, rotation, X, Y, Z, {
                    let gain = &scratch.measured[body.row].gain;
                    let way = Way::<C, _, X, Y, Z>::new(body, rotation.spread(C::zero()), gain, C::zero());
                    for block in blocks {
                        let mut y = way.carried(&parents[block]);
                        let entry = way.entry(&y);
                        put_block(out, nv, body.row, block, &entry);
                        if !body.is_leaf {
                            way.past_row(&mut y, entry);
                            own[block] = y;
                        }
                    }
                }),
                Carrier::Shift(at) => {
                    let shift = spread_shift(C::zero(), &scratch.shifts[at]);
                    for block in blocks {
                        let mut y = shift.motion_to_child(&parents[block].into());
                        for row in rows.clone() {
                            let entry = dot(&spread_vector(y[0], &scratch.measured[row].gain), &y);
                            put_block(out, nv, row, block, &entry);
                            y = spread_hinge(entry, stage.rows.row(row - body.row)).spread_onto(&y, -entry);
                        }
                        own[block] = y.into();
                    }
                }
            }
        }
        // Of another tree on the same base nothing, though a block that begins there may hold something.
        for row in rows.clone() {
            for column in 0..tree {
                put(out, nv, (row, column), T::zero());
            }
        }
        for column in rows.clone() {
            let mut y = scratch.spread_gains[column];
            for row in column..rows.end {
                let m = &scratch.measured[row];
                let along = dot(&m.gain, &y);
                let entry = if row == column { m.pivot_inverse + along } else { along };
                put(out, nv, (row, column), entry);
                y = stage.rows.row(row - body.row).spread_onto(&y, -entry);
            }
            if !body.is_leaf {
                // The row of a turn is about z here, in its sense for the others.
                let y = scaled(&y, y[0].everywhere(body.sense));
                set_column(&mut own[column / C::COLUMNS], column % C::COLUMNS, &y.into());
            }
        }
        columns.give_back(body.places.outward, own);
    }
}
