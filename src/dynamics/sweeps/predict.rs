//! Tip to base, open loop: the torques that forces need.

use super::joint::{Joint, JointAxis, with_axial, with_joint};
use super::model::SweepModel;
use super::rows::{AboutZ, AlongZ, AnyRows, Measures, Six};
use super::scratch::{BodyState, SweepScratch};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::transform::{Axial, Base, ObliqueRotation, Order, Prismatic, Transform, about};

/// The torque H z of every row, z carried inward (1.5).
#[inline(always)]
pub(super) fn tip_to_base<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    torques: &mut [T],
) {
    let SweepScratch { own, shifts, .. } = scratch;
    let bodies = &sweeps.segments[..];
    let own = &mut own[..bodies.len()];
    for (place, body) in bodies.iter().enumerate().rev() {
        let BodyState { turn, force } = own[place];
        with_joint!(body, turn, (model, sweeps, shifts), (X, Y, Z), body.arm.in_axes::<X, Y, Z>(), transform, rows, {
            rows.project(&force, torques);
            if let Some(parent) = body.parent.checked_sub(1) {
                transform.send_force(&force, false, &mut own[parent].force);
            }
        });
    }
}
