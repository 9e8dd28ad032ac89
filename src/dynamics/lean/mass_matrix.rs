//! Tip to base: composite inertias (3.5), and from each joint the column of M inward of it (3.4), all columns of a body side by side.
//!
//! At a body every column of what hangs on it goes the same way: what the way is made of is read once, and no column waits for another.

use super::aligned::{Aligned, AlignedBody};
use super::body::{Carrier, LeanBody, LeanModel};
use super::columns::Block;
use super::mass_columns::{MassColumns, Measurement};
use super::motion::cross;
use super::scratch::{Composite, LeanScratch};
use super::turn::{PACKED, Turn};
use crate::dynamics::columns::{spread_hinge, spread_shift};
use crate::filter::HingeMap;
use crate::kinematics::joint_shift;
use crate::scalar::{ColumnsOf, Real};
use crate::scene::Model;
use crate::spatial::{BodyInertia, Symmetric3};
use nalgebra::{Vector3, Vector6};

/// M at `q` into the columns' entries, as [`mass_matrix`](crate::dynamics::mass_matrix) gives it to rounding.
#[inline(always)]
pub(crate) fn mass_matrix<T: Real, C: ColumnsOf<T>, const CHECK: bool>(
    (model, lean): (&Model<T>, &LeanModel<T>),
    (scratch, columns): (&mut LeanScratch<T>, &mut MassColumns<T, C>),
    q: &[T],
) {
    let like = T::zero();
    columns.prepare(model, lean);
    carriers(lean, scratch, columns.like(), q);
    let aligned = &lean.aligned.bodies;
    let none = columns.like();
    for ((k, body), at) in lean.bodies.iter().enumerate().zip(aligned).rev() {
        let composite = if body.is_leaf { own(at, like) } else { scratch.composites[body.inward] };
        let carried = match body.carrier {
            Carrier::Turn(_) => {
                let (of_body, turn, noise) = ((body, at), scratch.turns[k], model.system.noise[body.row]);
                match at.axis {
                    0 => through_turn::<T, C, CHECK, 1, 2, 0>(of_body, turn, noise, &composite, columns),
                    1 => through_turn::<T, C, CHECK, 2, 0, 1>(of_body, turn, noise, &composite, columns),
                    _ => through_turn::<T, C, CHECK, 0, 1, 2>(of_body, turn, noise, &composite, columns),
                }
            }
            Carrier::Shift(at) => {
                let inertia = BodyInertia {
                    mass: like.everywhere(body.composite_mass),
                    first_moment: Vector3::from(composite.first_moment),
                    rotational: Symmetric3::new(composite.rotational),
                };
                let stage = &model.system.stages[k];
                for i in (0..stage.rows.count()).rev() {
                    let (row, hinge) = (body.row + i, stage.rows.row(i));
                    columns.insert(row, &hinge.covariance_column(&inertia.to_symmetric()).into());
                    columns.put_row::<CHECK>(row, body.end_row, &spread_hinge(none, hinge));
                    columns.add_to_diagonal::<CHECK>(row, model.system.noise[row]);
                }
                if body.parent.is_none() {
                    continue;
                }
                let shift = spread_shift(none, &scratch.shifts[at]);
                for force in columns.blocks(body.row, body.end_row) {
                    *force = shift.force_to_parent(&Vector6::from(*force)).into();
                }
                let carried = inertia.to_parent(&scratch.shifts[at]);
                Composite { first_moment: carried.first_moment.into(), rotational: carried.rotational.entries }
            }
        };
        if let Some(parent) = body.parent {
            // Not by way of the slot where nothing is in it yet: it would be read before it is well written.
            let to = &mut scratch.composites[body.parent_inward];
            *to = sum(&if body.arrives_first { own(&aligned[parent], like) } else { *to }, &carried);
        }
    }
}

/// Of two bodies that move as one.
#[inline(always)]
fn sum<T: Real>(a: &Composite<T>, b: &Composite<T>) -> Composite<T> {
    let (h, i) = (&a.first_moment, &a.rotational);
    let (g, j) = (&b.first_moment, &b.rotational);
    Composite {
        first_moment: [h[0] + g[0], h[1] + g[1], h[2] + g[2]],
        rotational: [i[0] + j[0], i[1] + j[1], i[2] + j[2], i[3] + j[3], i[4] + j[4], i[5] + j[5]],
    }
}

/// The turn or shift of every body at `q`, in the aligned frames.
#[inline(always)]
fn carriers<T: Real, C: ColumnsOf<T>>(lean: &LeanModel<T>, scratch: &mut LeanScratch<T>, like: C, q: &[T]) {
    let Aligned { bodies, shifts, turning } = &lean.aligned;
    for some in turning.chunks(C::COLUMNS) {
        let mut angles = like;
        for (lane, &(at, _)) in some.iter().enumerate().take(C::COLUMNS) {
            angles.set_column(lane, q[at]);
        }
        let (s, c) = angles.sin_cos();
        for (lane, &(_, k)) in some.iter().enumerate().take(C::COLUMNS) {
            let s = s.column(lane);
            scratch.turns[k] = Turn { s: s * s.everywhere(bodies[k].sense), c: c.column(lane) };
        }
    }
    for (shift, body) in scratch.shifts.iter_mut().zip(shifts) {
        *shift = joint_shift(body, q);
    }
}

/// The row of a turn about axis Z, and the way from there to the parent; X and Y are the axes that follow it.
#[inline(always)]
fn through_turn<T: Real, C: ColumnsOf<T>, const CHECK: bool, const X: usize, const Y: usize, const Z: usize>(
    (body, at): (&LeanBody<T::Parameter>, &AlignedBody<T::Parameter>),
    turn: Turn<T>,
    noise: T,
    composite: &Composite<T>,
    columns: &mut MassColumns<T, C>,
) -> Composite<T> {
    let Composite { first_moment: h, rotational } = composite;
    let like = h[0];
    let sense = like.everywhere(at.sense);
    let (xz, yz, zz) = (rotational[PACKED[X][Z]], rotational[PACKED[Y][Z]], rotational[PACKED[Z][Z]]);
    // r(k) H*(k), H picking the rotation about the axis, in its sense.
    let mut force = [like.constant(0.0); 6];
    (force[X], force[Y], force[Z]) = (sense * xz, sense * yz, sense * zz);
    (force[3 + X], force[3 + Y]) = (-(sense * h[Y]), sense * h[X]);
    columns.insert(body.row, &force);
    let none = columns.like();
    let about = About::<C, X, Y, Z> {
        sense: none.spread(sense),
        turn: Turn { s: none.spread(turn.s), c: none.spread(turn.c) },
        lever: [
            none.spread(like.everywhere(at.lever[0])),
            none.spread(like.everywhere(at.lever[1])),
            none.spread(like.everywhere(at.lever[2])),
        ],
        has_lever: body.has_lever,
        ends: body.parent.is_none(),
    };
    columns.put_row::<CHECK>(body.row, body.end_row, &about);
    columns.add_to_diagonal::<CHECK>(body.row, noise);
    // At the base nobody reads it.
    if about.ends { *composite } else { to_parent::<T, X, Y, Z>((body, at), turn, composite) }
}

/// A row about axis Z, and phi across its turn.
struct About<C, const X: usize, const Y: usize, const Z: usize> {
    sense: C,
    turn: Turn<C>,
    lever: [C; 3],
    has_lever: bool,
    /// Whether there is no parent to carry anything to.
    ends: bool,
}

impl<C: Real, const X: usize, const Y: usize, const Z: usize> Measurement<C> for About<C, X, Y, Z> {
    #[inline(always)]
    fn entry(&self, force: &Block<C>) -> C {
        self.sense * force[Z]
    }

    #[inline(always)]
    fn carry(&self, force: &mut Block<C>) {
        if self.ends {
            return;
        }
        let mut turned = *force;
        (turned[X], turned[Y]) = self.turn.pair(force[X], force[Y]);
        (turned[3 + X], turned[3 + Y]) = self.turn.pair(force[3 + X], force[3 + Y]);
        if self.has_lever {
            let [a, b, c, d, e, f] = turned;
            let [a, b, c] = cross(self.lever, [d, e, f], [a, b, c]);
            *force = [a, b, c, d, e, f];
        } else {
            *force = turned;
        }
    }
}

/// A row of another joint: all of its rows are read before anything is carried.
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

/// A body by itself.
#[inline(always)]
fn own<T: Real>(body: &AlignedBody<T::Parameter>, like: T) -> Composite<T> {
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

/// phi r phi* across a turn: about the axis, then along the lever as in [`BodyInertia::to_parent`].
#[inline(always)]
fn to_parent<T: Real, const X: usize, const Y: usize, const Z: usize>(
    (body, at): (&LeanBody<T::Parameter>, &AlignedBody<T::Parameter>),
    turn: Turn<T>,
    composite: &Composite<T>,
) -> Composite<T> {
    let (mut h, mut i) = (composite.first_moment, composite.rotational);
    (h[X], h[Y]) = turn.pair(h[X], h[Y]);
    (i[PACKED[X][Z]], i[PACKED[Y][Z]]) = turn.pair(i[PACKED[X][Z]], i[PACKED[Y][Z]]);
    (i[PACKED[X][X]], i[PACKED[X][Y]], i[PACKED[Y][Y]]) =
        turn.symmetric((i[PACKED[X][X]], i[PACKED[X][Y]], i[PACKED[Y][Y]]));
    if body.has_lever {
        let like = h[0];
        let ([x, y, z], [mx, my, mz]) = (at.lever, at.composite_lever);
        let ([tx, ty, tz], [xx, yy, zz]) = (at.twice_lever, at.lever_moment);
        let (x, y, z) = (like.everywhere(x), like.everywhere(y), like.everywhere(z));
        let s = [h[0] + like.everywhere(mx), h[1] + like.everywhere(my), h[2] + like.everywhere(mz)];
        // x (h + s), of which the constant part is known.
        let (dx, dy, dz) = (
            h[0].mul_add(like.everywhere(tx), like.everywhere(xx)),
            h[1].mul_add(like.everywhere(ty), like.everywhere(yy)),
            h[2].mul_add(like.everywhere(tz), like.everywhere(zz)),
        );
        i = [
            i[0] + (dy + dz),
            i[1].minus_product(h[0], y).minus_product(x, s[1]),
            i[2].minus_product(h[0], z).minus_product(x, s[2]),
            i[3] + (dx + dz),
            i[4].minus_product(h[1], z).minus_product(y, s[2]),
            i[5] + (dx + dy),
        ];
        h = s;
    }
    Composite { first_moment: h, rotational: i }
}
