//! Tip to base, open loop: the torques that forces need.

use super::joint::{self, with_joint};
use super::model::SweepModel;
use super::rows::Measures;
use super::scratch::{BodyState, SweepScratch};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::transform::Transform;

/// The torque H z of every row, z carried inward (1.5).
#[inline(always)]
pub(super) fn tip_to_base<T: Real>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    torques: &mut [T],
) {
    let SweepScratch { own, shifts, .. } = scratch;
    let bodies = sweeps.swept();
    let own = &mut own[..bodies.len()];
    for (place, body) in bodies.iter().enumerate().rev() {
        let BodyState { turn, force } = own[place];
        with_joint!(body, turn, (model, sweeps, shifts), transform, rows, {
            rows.project(&force, torques);
            if let Some(parent) = body.places.parent.checked_sub(1) {
                transform.send_force(&force, false, &mut own[parent].force);
            }
        });
    }
}
