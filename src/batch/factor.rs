//! The factor of M, and further right-hand sides with it, for one state per lane of a scalar. Each is compiled once for
//! all callers.

use super::accelerations;
use super::instruction_set::{Entry, Target, Vectorized, Work};
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

/// The factor of M at q in covariance form; the lanes that need the fallback.
#[inline(never)]
pub(crate) fn unwatched<T: Vectorized, I: Target>(
    target: I,
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    q: &[T],
) -> u64 {
    target.within(Unwatched(scene, scratch, q))
}

struct Unwatched<'a, T: Vectorized>(Scene<'a, T>, &'a mut SweepScratch<T>, &'a [T]);

impl<T: Vectorized> Work for Unwatched<'_, T> {
    type Output = u64;

    #[inline(always)]
    fn call(self) -> u64 {
        let Self(scene, scratch, q) = self;
        let pivots = sweeps::factor::<T, T::Columns>(scene, scratch, q);
        lanes_but::<T>(|lane| pivots.clear(lane))
    }
}

/// The factor of M at q with an error estimate; the second of `state` is scratch, (nv). Returns the lanes that need
/// the fallback.
#[inline(never)]
pub(crate) fn watched<T: Vectorized, I: Target>(
    target: I,
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    state: (&[T], &mut [T]),
) -> u64 {
    target.within(FactorWithErrorEstimate(scene, scratch, state))
}

struct FactorWithErrorEstimate<'a, T: Vectorized>(Scene<'a, T>, &'a mut SweepScratch<T>, (&'a [T], &'a mut [T]));

impl<T: Vectorized> Work for FactorWithErrorEstimate<'_, T> {
    type Output = u64;

    #[inline(always)]
    fn call(self) -> u64 {
        let Self(scene, scratch, (q, estimates)) = self;
        let watched = auto::factor_with_estimate_in_lanes::<T, T::Columns>(scene, scratch, q, estimates);
        lanes_but::<T>(|lane| watched.is_accepted(lane))
    }
}

/// The factor of M at q in covariance form and e^- of a state (q, qd, tau), in one pass; the lanes that need the
/// fallback.
#[inline(never)]
pub(crate) fn with_innovations<T: Vectorized, I: Target>(
    target: I,
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    state: (&[T], &[T], &[T]),
    out: &mut [T],
) -> u64 {
    target.within(WithInnovations(scene, scratch, state, out))
}

struct WithInnovations<'a, T: Vectorized>(
    Scene<'a, T>,
    &'a mut SweepScratch<T>,
    (&'a [T], &'a [T], &'a [T]),
    &'a mut [T],
);

impl<T: Vectorized> Work for WithInnovations<'_, T> {
    type Output = u64;

    #[inline(always)]
    fn call(self) -> u64 {
        let Self(scene, scratch, state, out) = self;
        let pivots = sweeps::innovations_and_factor::<T, T::Columns>(scene, scratch, state, &[], out);
        lanes_but::<T>(|lane| pivots.clear(lane))
    }
}

/// e^- of a state (q, qd, tau), with the existing factor, which is that at q.
#[inline(never)]
pub(crate) fn innovations<T: Vectorized, I: Target>(
    target: I,
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    state: (&[T], &[T], &[T]),
    forces: (&[Vector6<T>], &mut [T]),
) {
    target.within(Innovations(scene, scratch, state, forces));
}

struct Innovations<'a, T: Vectorized>(
    Scene<'a, T>,
    &'a mut SweepScratch<T>,
    (&'a [T], &'a [T], &'a [T]),
    (&'a [Vector6<T>], &'a mut [T]),
);

impl<T: Vectorized> Work for Innovations<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self(scene, scratch, state, (wrenches, out)) = self;
        sweeps::innovations_of_factor(scene, scratch, state, wrenches, out);
    }
}

/// Replaces e^- by the accelerations, with the existing factor.
#[inline(never)]
pub(crate) fn smooth<T: Vectorized, I: Target>(
    target: I,
    scene: Scene<'_, T>,
    scratch: &mut SweepScratch<T>,
    estimates: &mut [T],
) {
    target.within(Smooth(scene, scratch, estimates));
}

struct Smooth<'a, T: Vectorized>(Scene<'a, T>, &'a mut SweepScratch<T>, &'a mut [T]);

impl<T: Vectorized> Work for Smooth<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self(scene, scratch, estimates) = self;
        sweeps::smooth(scene, scratch, estimates);
    }
}

/// M^-1 of the factor in the scratch; compiled once for all callers.
#[inline(never)]
pub(super) fn multiplied_out<T: Vectorized, I: Target>(
    target: I,
    scene: (&Model<T>, &SweepModel<T>),
    scratch: (&SweepScratch<T>, &mut InverseColumns<T, T::Columns>),
    out: &mut [Entry<T>],
) {
    target.within(MultipliedOut(scene, scratch, out));
}

struct MultipliedOut<'a, T: Vectorized>(
    (&'a Model<T>, &'a SweepModel<T>),
    (&'a SweepScratch<T>, &'a mut InverseColumns<T, T::Columns>),
    &'a mut [Entry<T>],
);

impl<T: Vectorized> Work for MultipliedOut<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self(scene, (scratch, columns), out) = self;
        sweeps::multiplied_out::<T, T::Columns, true>(scene, scratch, columns, out);
    }
}
