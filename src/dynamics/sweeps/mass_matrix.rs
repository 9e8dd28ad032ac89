//! Tip to base: composite inertias (3.5), and from each joint the column of M inward of it (3.4), all columns of a body side by side.
//!
//! At a body every column of what hangs on it goes the same way: what the way is made of is read once, and no column waits for another.

use super::axial_rotation::ABOUT_Z;
use super::axial_rotation::{Axis, about, symmetric_to_parent, to_parent};
use super::body::{CompositeBody, SweepBody};
use super::carrier::Carrier;
use super::constant_rotation::JointAxis;
use super::free_joint;
use super::inverse_columns::Block;
use super::lever::Lever;
use super::mass_columns::{MassColumns, Measurement};
use super::model::SweepModel;
use super::motion::carriers;
use super::rotation::{ObliqueRotation, Rotates, rotated};
use super::scratch::{Composite, SweepScratch, accumulate};
use crate::dynamics::columns::{spread_hinge, spread_shift};
use crate::filter::{HingeMap, Rows};
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::{BodyInertia, Symmetric3};
use nalgebra::{Vector3, Vector6};

/// M at `q` into `out`, as [`Entries`](super::Entries) has it and [`mass_matrix`](crate::dynamics::mass_matrix) gives it to rounding, after the
/// columns were [made](MassColumns::prepare); with CHECK it is seen whether all of it is finite.
#[inline(always)]
pub(crate) fn mass_matrix<T: Real, C: ColumnsOf<T>, const CHECK: bool>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    (scratch, columns): (&mut SweepScratch<T>, &mut MassColumns<T, C>),
    q: &[T],
    out: &mut [C::Entry],
) {
    let like = T::zero();
    columns.begin(out);
    carriers(sweeps, scratch, columns.like(), q);
    let none = columns.like();
    let SweepScratch { own, shifts, composites, .. } = scratch;
    for ((body, own), constants) in sweeps.swept().iter().zip(own).zip(&sweeps.composites).rev() {
        let composite = composite_of(body, &composites[body.places.inward]);
        let carried = match body.carrier {
            Carrier::Axial(axle) => {
                let (of_body, noise) = ((body, constants), model.system.noise[body.row]);
                rotated!(axle, own.turn, sweeps.tilts, rotation, X, Y, Z, {
                    let to = (&mut *columns, &mut *out);
                    through_turn::<T, C, _, CHECK, X, Y, Z>(of_body, &rotation, noise, &composite, to)
                })
            }
            Carrier::Shift(at) => {
                let inertia = BodyInertia {
                    mass: like.splat(constants.mass),
                    first_moment: Vector3::from(composite.first_moment),
                    rotational: Symmetric3::new(composite.rotational),
                };
                let stage = &model.system.stages[body.index];
                if body.parent.is_none() && matches!(stage.rows, Rows::Six) {
                    let (whole, noise) = (inertia.to_symmetric(), &model.system.noise[free_joint::rows(body.row)]);
                    columns.put_free_joint::<CHECK>(out, (body.row, body.end_row), |i| {
                        let mut row = free_joint::picked(&Rows::Six.row(i).covariance_column(&whole).into());
                        row[i] += noise[i];
                        row
                    });
                    continue;
                }
                for i in (0..stage.rows.count()).rev() {
                    let (row, hinge) = (body.row + i, stage.rows.row(i));
                    let force = hinge.covariance_column(&inertia.to_symmetric()).into();
                    columns.put_row::<CHECK>(out, (row, body.end_row), &force, &spread_hinge(none, hinge));
                    columns.add_to_diagonal::<CHECK>(out, row, model.system.noise[row]);
                }
                if body.parent.is_none() {
                    continue;
                }
                let shift = spread_shift(none, &shifts[at]);
                for force in columns.blocks(body.row, body.end_row) {
                    *force = shift.force_to_parent(&Vector6::from(*force)).into();
                }
                let carried = inertia.to_parent(&shifts[at]);
                Composite { first_moment: carried.first_moment.into(), rotational: carried.rotational.entries }
            }
        };
        if body.parent.is_some() {
            let to = &mut composites[body.places.parent_inward];
            accumulate(body, &carried.first_moment, &mut to.first_moment);
            accumulate(body, &carried.rotational, &mut to.rotational);
        }
    }
}

/// The row of a revolute joint, and the way from there to the parent, of whose axes its own x, y and z are X, Y and Z.
#[inline(always)]
fn through_turn<
    T: Real,
    C: ColumnsOf<T>,
    R: Rotates<T>,
    const CHECK: bool,
    const X: usize,
    const Y: usize,
    const Z: usize,
>(
    (body, constants): (&SweepBody<T::Parameter>, &CompositeBody<T::Parameter>),
    rotation: &R,
    noise: T,
    composite: &Composite<T>,
    (columns, out): (&mut MassColumns<T, C>, &mut [C::Entry]),
) -> Composite<T> {
    let Composite { first_moment: h, rotational: i } = composite;
    let like = h[0];
    let sense = like.splat(body.sense);
    // r(k) H*(k), H picking the rotation about z, in its sense.
    let force = [sense * i[2], sense * i[4], sense * i[5], -(sense * h[1]), sense * h[0], like.constant(0.0)];
    let none = columns.like();
    let about = About::<C, R::Spread<C>, X, Y, Z> {
        sense: none.spread(sense),
        rotation: rotation.spread(none),
        lever: Lever {
            entries: [
                none.spread(like.splat(body.lever.entries[0])),
                none.spread(like.splat(body.lever.entries[1])),
                none.spread(like.splat(body.lever.entries[2])),
            ],
            along: body.lever.along,
        },
        ends: body.parent.is_none(),
    };
    columns.put_row::<CHECK>(out, (body.row, body.end_row), &force, &about);
    columns.add_to_diagonal::<CHECK>(out, body.row, noise);
    // At the base nobody reads it.
    if about.ends { *composite } else { carried::<T, _, X, Y, Z>((body, constants), rotation, composite) }
}

/// A turn's row, and phi across it.
struct About<C, R, const X: usize, const Y: usize, const Z: usize> {
    sense: C,
    rotation: R,
    lever: Lever<C>,
    /// Whether there is no parent to carry anything to.
    ends: bool,
}

impl<C: Real, R: Rotates<C>, const X: usize, const Y: usize, const Z: usize> Measurement<C> for About<C, R, X, Y, Z> {
    #[inline(always)]
    fn entry(&self, force: &Block<C>) -> C {
        self.sense * force[ABOUT_Z]
    }

    #[inline(always)]
    fn carry(&self, force: &mut Block<C>) {
        if self.ends {
            return;
        }
        let moment = self.rotation.rotate([force[0], force[1], force[2]]);
        let line = self.rotation.rotate([force[3], force[4], force[5]]);
        let [a, b, c] = self.lever.moment_in_lanes(line, moment);
        *force = to_parent::<C, X, Y, Z>(&[a, b, c, line[0], line[1], line[2]]);
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

/// A body with what arrived at it.
#[inline(always)]
fn composite_of<T: Real>(body: &SweepBody<T::Parameter>, arrived: &Composite<T>) -> Composite<T> {
    let ([x, y, z], [xx, xy, xz, yy, yz, zz]) = (body.first_moment, body.rotational);
    let (h, i) = (&arrived.first_moment, &arrived.rotational);
    Composite {
        first_moment: [h[0] + h[0].splat(x), h[1] + h[0].splat(y), h[2] + h[0].splat(z)],
        rotational: [
            i[0] + h[0].splat(xx),
            i[1] + h[0].splat(xy),
            i[2] + h[0].splat(xz),
            i[3] + h[0].splat(yy),
            i[4] + h[0].splat(yz),
            i[5] + h[0].splat(zz),
        ],
    }
}

/// phi r phi* across a revolute joint: about z, then along the lever as in [`BodyInertia::to_parent`], in the parent's frame.
#[inline(always)]
fn carried<T: Real, R: Rotates<T>, const X: usize, const Y: usize, const Z: usize>(
    (body, constants): (&SweepBody<T::Parameter>, &CompositeBody<T::Parameter>),
    rotation: &R,
    composite: &Composite<T>,
) -> Composite<T> {
    let mut h = rotation.rotate(composite.first_moment);
    let mut i = rotation.symmetric(composite.rotational);
    // Along z, y and x of the lever, one after another: of l (h + s), s = h + m l, the constant part is known.
    let like = h[0];
    let Lever { entries: [x, y, z], along: [along_x, along_y, along_z] } = body.lever;
    let ([mx, my, mz], [tx, ty, tz], [xx, yy, zz]) = (constants.lever, constants.twice_lever, constants.lever_moment);
    if along_z {
        let (z, twice) = (like.splat(z), h[2].mul_add(like.splat(tz), like.splat(zz)));
        i = [i[0] + twice, i[1], i[2].minus_product(h[0], z), i[3] + twice, i[4].minus_product(h[1], z), i[5]];
        h[2] += like.splat(mz);
    }
    if along_y {
        let (y, twice) = (like.splat(y), h[1].mul_add(like.splat(ty), like.splat(yy)));
        i = [i[0] + twice, i[1].minus_product(h[0], y), i[2], i[3], i[4].minus_product(y, h[2]), i[5] + twice];
        h[1] += like.splat(my);
    }
    if along_x {
        let (x, twice) = (like.splat(x), h[0].mul_add(like.splat(tx), like.splat(xx)));
        i = [i[0], i[1].minus_product(x, h[1]), i[2].minus_product(x, h[2]), i[3] + twice, i[4], i[5] + twice];
        h[0] += like.splat(mx);
    }
    let mut there = h;
    (there[X], there[Y], there[Z]) = (h[0], h[1], h[2]);
    Composite { first_moment: there, rotational: symmetric_to_parent::<T, X, Y, Z>(&i) }
}
