//! Tip to base: composite inertias (3.5), and from each joint the column of M inward of it (3.4), vectorized (SIMD)
//! over the columns of a body.
//!
//! All columns outboard of a body pass its joint in the same way: the transform is read once, and the columns are
//! independent.

use super::body::SweepBody;
use super::inverse_columns::Block;
use super::joint::{self, Joint, with_axial};
use super::mass_columns::{MassColumns, Measurement};
use super::model::SweepModel;
use super::motion::carriers;
use super::rows::{ABOUT_Z, PICKED, picked};
use super::scratch::SweepScratch;
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
        let composite = body.with_inertia(&arrived);
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
