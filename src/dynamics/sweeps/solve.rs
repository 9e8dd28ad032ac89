//! Further right-hand sides with the factor of M in the scratch: the filter tip to base, and the smoother base to tip.

use super::joint::{self, with_joint};
use super::model::SweepModel;
use super::motion;
use super::rows::Measures;
use super::scratch::SweepScratch;
use crate::dynamics::forces::Motion;
use crate::filter::rounding::Outward;
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::transform::Transform;
use nalgebra::Vector6;

/// e^- of a state (4.2), with the factor at its q in the scratch; [`smooth`] computes the accelerations from them.
#[inline(always)]
pub(crate) fn innovations_of_factor<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    innovations: &mut [T],
) {
    motion::base_to_tip_placed::<T, false>(scene, scratch, Motion { q, qd, qdd: None, wrenches });
    tip_to_base::<T, true, false>(scene, scratch, tau, innovations);
}

/// M^-1 tau (4.1), with the factor in the scratch.
#[inline(always)]
pub(crate) fn solve<T: Real>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    tau: &[T],
    estimates: &mut [T],
) {
    tip_to_base::<T, false, false>(scene, scratch, tau, estimates);
    base_to_tip::<T, false>(scene, scratch, estimates);
}

/// The smoother alone: `estimates` holds e^- on entry and a on return.
#[inline(always)]
pub(crate) fn smooth<T: Real>(scene: (&Model<T>, &SweepModel<T>), scratch: &mut SweepScratch<T>, estimates: &mut [T]) {
    base_to_tip::<T, false>(scene, scratch, estimates);
}

/// The filter alone (4.2, 4.4, 4.5); with `BIASED` with the force b(k) of each body. With `KEEP` z^+(k) is stored in
/// the place of b(k).
#[inline(always)]
pub(super) fn tip_to_base<T: Real, const BIASED: bool, const KEEP: bool>(
    (model, sweeps): (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    tau: &[T],
    innovations: &mut [T],
) {
    let SweepScratch { own, accumulated, shifts, measured, .. } = scratch;
    for (body, own) in sweeps.swept().iter().zip(own).rev() {
        let mut z = accumulated[body.places.inward].force;
        if BIASED {
            for (z, &bias) in z.iter_mut().zip(&own.force) {
                *z += bias;
            }
        }
        with_joint!(body, own.turn, (model, sweeps, shifts), transform, rows, {
            rows.filter(measured, tau, &mut z, innovations);
            if body.parent.is_some() {
                transform.send_force(
                    &z,
                    body.places.accumulates_first,
                    &mut accumulated[body.places.parent_inward].force,
                );
            }
        });
        if KEEP {
            own.force = z;
        }
    }
}

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
