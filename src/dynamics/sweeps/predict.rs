//! Tip to base, open loop: the torques of given forces.

use super::joint::{self, with_joint};
use super::model::SweepModel;
use super::rows::Measures;
use super::scratch::{BodyState, SweepScratch};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::transform::Transform;

/// The torque H z of every row, z propagated inward (1.5). With `KEEP` the whole force z(k) that each body transmits is
/// stored in the place of its own.
#[inline(always)]
pub(super) fn tip_to_base<T: Real, const KEEP: bool>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    torques: &mut [T],
) {
    let SweepScratch { own, shifts, .. } = scratch;
    let bodies = sweeps.swept();
    let own = &mut own[..bodies.len()];
    // The force that is propagated to the next body stays in registers.
    let (mut sent, mut is_next) = ([T::zero(); 6], false);
    for (place, body) in bodies.iter().enumerate().rev() {
        let BodyState { turn, mut force } = own[place];
        if is_next {
            force = added(force, &sent);
        }
        if KEEP {
            own[place].force = force;
        }
        let parent = body.places.parent;
        with_joint!(body, turn, (model, sweeps, shifts), transform, rows, {
            rows.project(&force, torques);
            if parent > 0 {
                transform.send_force(&force, true, &mut sent);
            }
        });
        is_next = parent > 0 && parent == place;
        if parent > 0 && !is_next {
            let to = &mut own[parent - 1].force;
            *to = added(*to, &sent);
        }
    }
}

#[inline(always)]
fn added<T: Real>(mut force: [T; 6], other: &[T; 6]) -> [T; 6] {
    for (f, &other) in force.iter_mut().zip(other) {
        *f += other;
    }
    force
}
