//! The factor of M, and further right-hand sides with it, for one state per lane of a scalar. Each is compiled once for
//! all callers.

use super::accelerations;
use super::instruction_set::{Entry, Target, Vectorized, within_target};
use crate::dynamics::auto;
use crate::dynamics::sweeps::{self, InverseColumns, SweepModel, SweepScratch};
use crate::filter::Form;
use crate::model::Model;
use crate::scalar::lanes_but;
use nalgebra::Vector6;

/// The arguments of all of them.
type Scene<'a, T> = (&'a Model<T>, &'a SweepModel<T>);

/// Computes the accelerations of a state and the factor of M for further right-hand sides. Returns the lanes that need
/// the fallback as bits.
#[inline(always)]
pub(crate) fn with_factor<T: Vectorized, I: Target>(
    target: I,
    form: Form,
    call: accelerations::KernelArguments<'_, T>,
) -> u64 {
    if form != Form::Auto {
        return accelerations::by_covariance(target, call);
    }
    // The error is estimated by test vectors, because more right-hand sides follow: an estimate for the torques alone
    // would accept more factors.
    let accelerations::KernelArguments { scene, scratch, state, wrenches, qdd } = call;
    let doubt = watched(target, scene, scratch, (state.0, qdd));
    innovations(target, scene, scratch, state, (wrenches, qdd));
    smooth(target, scene, scratch, qdd);
    doubt
}

within_target! {
    /// The factor of M at q in covariance form; the lanes that need the fallback.
    #[inline(never)]
    pub(crate) fn unwatched<'a, T>(scene: Scene<'a, T>, scratch: &'a mut SweepScratch<T>, q: &'a [T]) -> u64 {
        let pivots = sweeps::factor::<T, T::Columns>(scene, scratch, q);
        lanes_but::<T>(|lane| pivots.clear(lane))
    }

    /// The factor of M at q with an error estimate; the second of `state` is scratch, (nv). Returns the lanes that need
    /// the fallback.
    #[inline(never)]
    pub(crate) fn watched<'a, T>(
        scene: Scene<'a, T>,
        scratch: &'a mut SweepScratch<T>,
        state: (&'a [T], &'a mut [T]),
    ) -> u64 {
        let watched = auto::factor_with_estimate_in_lanes::<T, T::Columns>(scene, scratch, state.0, state.1);
        lanes_but::<T>(|lane| watched.is_accepted(lane))
    }

    /// The factor of M at q in covariance form and e^- of a state (q, qd, tau), in one pass; the lanes that need the
    /// fallback.
    #[inline(never)]
    pub(crate) fn with_innovations<'a, T>(
        scene: Scene<'a, T>,
        scratch: &'a mut SweepScratch<T>,
        state: (&'a [T], &'a [T], &'a [T]),
        out: &'a mut [T],
    ) -> u64 {
        let pivots = sweeps::innovations_and_factor::<T, T::Columns>(scene, scratch, state, &[], out);
        lanes_but::<T>(|lane| pivots.clear(lane))
    }

    /// e^- of a state (q, qd, tau), with the existing factor, which is that at q.
    #[inline(never)]
    pub(crate) fn innovations<'a, T>(
        scene: Scene<'a, T>,
        scratch: &'a mut SweepScratch<T>,
        state: (&'a [T], &'a [T], &'a [T]),
        forces: (&'a [Vector6<T>], &'a mut [T]),
    ) -> () {
        sweeps::innovations_of_factor(scene, scratch, state, forces.0, forces.1);
    }

    /// Replaces e^- by the accelerations, with the existing factor.
    #[inline(never)]
    pub(crate) fn smooth<'a, T>(scene: Scene<'a, T>, scratch: &'a mut SweepScratch<T>, estimates: &'a mut [T]) -> () {
        sweeps::smooth(scene, scratch, estimates);
    }

    /// M^-1 of the factor in the scratch; compiled once for all callers.
    #[inline(never)]
    pub(super) fn multiplied_out<'a, T>(
        scene: Scene<'a, T>,
        scratch: (&'a SweepScratch<T>, &'a mut InverseColumns<T, T::Columns>),
        out: &'a mut [Entry<T>],
    ) -> () {
        sweeps::multiplied_out::<T, T::Columns, true>(scene, scratch.0, scratch.1, out);
    }
}
