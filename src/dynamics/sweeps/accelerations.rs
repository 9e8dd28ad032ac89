//! Base to tip: the smoother.

use super::joint::{self, with_joint};
use super::model::SweepModel;
use super::rows::Measures;
use super::scratch::SweepScratch;
use crate::filter::rounding::Outward;
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::transform::Transform;
use nalgebra::Vector6;

/// Co-states and estimates (4.9 to 4.11); `estimates` holds e^- on entry and a on return. With `SEEN` it returns the
/// largest estimate and the largest co-states that are propagated outward.
#[inline(always)]
pub(super) fn base_to_tip<T: Real, const SEEN: bool>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    estimates: &mut [T],
) -> Outward<T> {
    let mut seen = Outward::new();
    let SweepScratch { own, shifts, measured, co_states, .. } = scratch;
    // Slices of equal length, which lets the compiler omit bounds checks.
    let estimates = &mut estimates[..measured.len()];
    for (body, own) in sweeps.swept().iter().zip(own) {
        let outer = &co_states[body.places.parent_outward];
        let mut lambda = [outer[0].constant(0.0); 6];
        with_joint!(body, own.turn, (model, sweeps, shifts), transform, rows, {
            if body.parent.is_some() {
                lambda = transform.carry_motion(outer);
                if SEEN {
                    seen.observe_carried(&Vector6::from(*outer), transform.offset_square());
                }
            }
            rows.smooth(measured, &mut lambda, estimates);
            if SEEN {
                rows.observe_estimates(estimates, &mut seen);
            }
        });
        if !body.is_leaf {
            co_states[body.places.outward] = lambda;
        }
    }
    seen
}
