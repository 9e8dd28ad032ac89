//! Tip to base: composite inertias (3.5), and from each joint the column of M inward of it (3.4).

use super::body::{Carrier, LeanBody, LeanModel};
use super::filter::one_inward;
use super::motion::carriers;
use super::scratch::{Composite, LeanScratch};
use super::turn::{BRANCH, Renaming, Turn};
use crate::dynamics::columns::put;
use crate::filter::Rows;
use crate::scalar::Real;
use crate::scene::Model;
use crate::spatial::{BodyInertia, Symmetric3};
use nalgebra::{Vector3, Vector6};

/// M at `q` into `out`, (nv x nv) row by row, as [`mass_matrix`](crate::dynamics::mass_matrix) gives it to rounding.
#[inline(always)]
pub(crate) fn mass_matrix<T: Real>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &mut LeanScratch<T>,
    q: &[T],
    out: &mut [T],
) {
    let like = T::zero();
    carriers((model, lean), scratch, q);
    let nv = model.nv();
    out.fill(like);
    for (k, body) in lean.bodies.iter().enumerate().rev() {
        let composite = if body.is_leaf { own(body, like) } else { scratch.composites[body.inward] };
        if body.arrives_first
            && let Some(parent) = body.parent
        {
            scratch.composites[body.parent_inward] = own(&lean.bodies[parent], like);
        }
        match &body.carrier {
            Carrier::Turn(renaming) => {
                let Composite { first_moment: h, rotational: i } = &composite;
                // r(k) H*(k), H picking the rotation about z.
                let force = [i[2], i[4], i[5], -h[1], h[0], like];
                put(out, nv, (body.row, body.row), i[5] + model.system.noise[body.row]);
                column_inward((model, lean), scratch, (k, body.row), force, out);
                if body.parent.is_some() {
                    to_parent(
                        body,
                        renaming,
                        scratch.turns[k],
                        &composite,
                        &mut scratch.composites[body.parent_inward],
                    );
                }
            }
            Carrier::Shift(at) => {
                let inertia = BodyInertia {
                    mass: like.everywhere(body.composite_mass),
                    first_moment: Vector3::from(composite.first_moment),
                    rotational: Symmetric3::new(composite.rotational),
                };
                let stage = &model.system.stages[k];
                for row in 0..stage.rows.count() {
                    let force = inertia.mul_motion(&stage.rows.row(row).to_column());
                    for other in 0..=row {
                        let entry = stage.rows.row(other).project(&force);
                        let noise = model.system.noise[body.row + row];
                        let entry = if other == row { entry + noise } else { entry };
                        put(out, nv, (body.row + row, body.row + other), entry);
                    }
                    column_inward((model, lean), scratch, (k, body.row + row), force.into(), out);
                }
                if body.parent.is_some() {
                    let carried = inertia.to_parent(&scratch.shifts[*at]);
                    let to = &mut scratch.composites[body.parent_inward];
                    for (to, &h) in to.first_moment.iter_mut().zip(carried.first_moment.iter()) {
                        *to += h;
                    }
                    for (to, &i) in to.rotational.iter_mut().zip(&carried.rotational.entries) {
                        *to += i;
                    }
                }
            }
        }
    }
}

/// What a force at body `k`, a column of M, is at every row inward of it.
#[inline(always)]
fn column_inward<T: Real>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    scratch: &LeanScratch<T>,
    (mut k, column): (usize, usize),
    mut force: [T; 6],
    out: &mut [T],
) {
    let nv = model.nv();
    while let Some(parent) = lean.bodies[k].parent {
        let body = &lean.bodies[k];
        force = one_inward((k, body), scratch, &force);
        let inward = &lean.bodies[parent];
        let rows = &model.system.stages[parent].rows;
        if let Carrier::Turn(_) = inward.carrier {
            put(out, nv, (column, inward.row), force[2]);
        } else if let Rows::Six = rows {
            // Linear rows first; spelt out, for every column of a floating robot ends here.
            let [a, b, c, d, e, f] = force;
            let six = [d, e, f, a, b, c];
            out[column * nv + inward.row..][..6].copy_from_slice(&six);
            for (above, &value) in out[inward.row * nv + column..].iter_mut().step_by(nv).zip(&six) {
                *above = value;
            }
        } else {
            let force = Vector6::from(force);
            for row in 0..rows.count() {
                put(out, nv, (column, inward.row + row), rows.row(row).project(&force));
            }
        }
        k = parent;
    }
}

/// A body by itself.
#[inline(always)]
fn own<T: Real>(body: &LeanBody<T::Parameter>, like: T) -> Composite<T> {
    let ([x, y, z], [xx, xy, xz, yy, yz, zz]) = (body.first_moment, body.rotational);
    Composite {
        first_moment: [like.everywhere(x), like.everywhere(y), like.everywhere(z)],
        rotational: [
            like.everywhere(xx),
            like.everywhere(xy),
            like.everywhere(xz),
            like.everywhere(yy),
            like.everywhere(yz),
            like.everywhere(zz),
        ],
    }
}

/// phi r phi* across a turn, added to what the parent has: about z, along the lever as in [`BodyInertia::to_parent`], renamed.
#[inline(always)]
fn to_parent<T: Real>(
    body: &LeanBody<T::Parameter>,
    renaming: &Renaming<T::Parameter>,
    turn: Turn<T>,
    composite: &Composite<T>,
    to: &mut Composite<T>,
) {
    let [xx, xy, xz, yy, yz, zz] = composite.rotational;
    let h = turn.rotate(composite.first_moment);
    let (xx, xy, yy) = turn.symmetric((xx, xy, yy));
    let (xz, yz) = turn.pair(xz, yz);
    let (h, rotational) = if body.has_lever {
        let like = xx;
        let ([x, y, z], [mx, my, mz]) = (body.lever, body.composite_lever);
        let (x, y, z) = (like.everywhere(x), like.everywhere(y), like.everywhere(z));
        let s = [h[0] + like.everywhere(mx), h[1] + like.everywhere(my), h[2] + like.everywhere(mz)];
        let (dx, dy, dz) = (x * (h[0] + s[0]), y * (h[1] + s[1]), z * (h[2] + s[2]));
        let rotational = [
            xx + (dy + dz),
            xy.minus_product(h[0], y).minus_product(x, s[1]),
            xz.minus_product(h[0], z).minus_product(x, s[2]),
            yy + (dx + dz),
            yz.minus_product(h[1], z).minus_product(y, s[2]),
            zz + (dx + dy),
        ];
        (s, rotational)
    } else {
        (h, [xx, xy, xz, yy, yz, zz])
    };
    renaming.add::<T, BRANCH>(h, &mut to.first_moment);
    renaming.add_symmetric(&rotational, &mut to.rotational);
}
