//! The way of several columns outward across a revolute joint.

use super::accelerations::along;
use super::axial_rotation::ABOUT_Z;
use super::axial_rotation::to_turn;
use super::body::SweepBody;
use super::inverse_columns::Block;
use super::lever::Lever;
use super::rotation::Rotates;
use crate::scalar::{ColumnsOf, Real};
use nalgebra::Vector6;

/// phi* across a revolute joint, of whose parent's axes its own x, y and z are X, Y and Z, and the row there.
pub(super) struct MotionTransform<C, R, const X: usize, const Y: usize, const Z: usize> {
    rotation: R,
    lever: Lever<C>,
    /// 1 or -1: H is this along z.
    sense: C,
    /// Of the row in its sense.
    gain: [C; 6],
}

impl<C: Real, R: Rotates<C>, const X: usize, const Y: usize, const Z: usize> MotionTransform<C, R, X, Y, Z> {
    #[inline(always)]
    pub fn new<T: Real>(body: &SweepBody<T::Parameter>, rotation: R, gain: &Vector6<T>, like: C) -> Self
    where
        C: ColumnsOf<T>,
    {
        let sense = gain[0].splat(body.sense);
        let Lever { entries: [x, y, z], along } = body.lever;
        Self {
            rotation,
            lever: Lever {
                entries: [like.spread(sense.splat(x)), like.spread(sense.splat(y)), like.spread(sense.splat(z))],
                along,
            },
            sense: like.spread(sense),
            gain: [
                like.spread(gain[0] * sense),
                like.spread(gain[1] * sense),
                like.spread(gain[2] * sense),
                like.spread(gain[3] * sense),
                like.spread(gain[4] * sense),
                like.spread(gain[5] * sense),
            ],
        }
    }

    /// phi* y.
    #[inline(always)]
    pub fn carried(&self, y: &Block<C>) -> Block<C> {
        let [a, b, c, d, e, f] = to_turn::<C, X, Y, Z>(y);
        let (w, v) = ([a, b, c], [d, e, f]);
        let v = self.lever.velocity_in_lanes(w, v);
        let (w, v) = (self.rotation.rotate_back(w), self.rotation.rotate_back(v));
        [w[0], w[1], w[2], v[0], v[1], v[2]]
    }

    /// y - H* x.
    #[inline(always)]
    pub fn past_row(&self, y: &mut Block<C>, x: C) {
        y[ABOUT_Z] = y[ABOUT_Z].minus_product(self.sense, x);
    }

    /// What stands at [`ABOUT_Z`] of -H* times what `unit` has in one column; in the others it has zero.
    #[inline(always)]
    pub fn begun(&self, unit: C) -> C {
        -(self.sense * unit)
    }

    /// g* y.
    #[inline(always)]
    pub fn entry(&self, y: &Block<C>) -> C {
        along(&self.gain, y)
    }
}
