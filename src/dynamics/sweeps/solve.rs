//! Further right-hand sides with the factor of M in the scratch.

use super::accelerations;
use super::joint::{self, with_joint};
use super::model::SweepModel;
use super::motion;
use super::rows::Measures;
use super::scratch::SweepScratch;
use crate::dynamics::forces::Motion;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real};
use crate::spatial::transform::Transform;
use nalgebra::Vector6;

/// e^- of a state (4.2), with the factor in the scratch; [`smooth`] computes the accelerations from them.
#[inline(always)]
pub(crate) fn innovations_of_factor<T: Real, C: ColumnsOf<T>>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: &mut SweepScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    innovations: &mut [T],
) {
    motion::base_to_tip::<T, C, false>(scene, scratch, Motion { q, qd, qdd: None, wrenches });
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
    accelerations::base_to_tip::<T, false>(scene, scratch, estimates);
}

/// The smoother alone: `estimates` holds e^- on entry and a on return.
#[inline(always)]
pub(crate) fn smooth<T: Real>(scene: (&Model<T>, &SweepModel<T>), scratch: &mut SweepScratch<T>, estimates: &mut [T]) {
    accelerations::base_to_tip::<T, false>(scene, scratch, estimates);
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
