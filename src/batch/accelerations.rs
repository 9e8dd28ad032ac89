//! Joint accelerations for one state per lane of a scalar. Each form is compiled once per scalar and instruction set,
//! and called by batches and by simulation.

use super::instruction_set::{Target, Vectorized, Work};
use crate::dynamics::auto::{self, Errors};
use crate::dynamics::sweeps::{self, SweepModel, SweepScratch};
use crate::model::Model;
use crate::scalar::{Real, lanes_but};
use nalgebra::Vector6;

/// The arguments and results of the kernels.
pub(crate) struct KernelArguments<'a, T: Real> {
    pub scene: (&'a Model<T>, &'a SweepModel<T>),
    pub scratch: &'a mut SweepScratch<T>,
    /// (q, qd, tau).
    pub state: (&'a [T], &'a [T], &'a [T]),
    /// Forces on the bodies; empty without forces.
    pub wrenches: &'a [Vector6<T>],
    pub qdd: &'a mut [T],
}

/// In covariance form. Returns the lanes that need the fallback as bits, as the other kernels do.
#[inline(never)]
pub(crate) fn by_covariance<T: Vectorized, I: Target>(target: I, call: KernelArguments<'_, T>) -> u64 {
    target.within(ByCovariance(call))
}

/// Covariance form with an error estimate: the first form of `auto`. Writes the estimated errors.
#[inline(never)]
pub(crate) fn watched<T: Vectorized, I: Target>(
    target: I,
    call: KernelArguments<'_, T>,
    errors: &mut Errors<T>,
) -> u64 {
    target.within(WithErrorEstimate(call, errors))
}

/// In square-root form.
#[inline(never)]
pub(crate) fn by_roots<T: Vectorized, I: Target>(target: I, call: KernelArguments<'_, T>) -> u64 {
    target.within(ByRoots(call))
}

struct ByCovariance<'a, T: Real>(KernelArguments<'a, T>);

impl<T: Vectorized> Work for ByCovariance<'_, T> {
    type Output = u64;

    #[inline(always)]
    fn call(self) -> u64 {
        let KernelArguments { scene, scratch, state, wrenches, qdd } = self.0;
        let pivots = sweeps::forward_dynamics::<T, T::Columns>(scene, scratch, state, wrenches, qdd);
        lanes_but::<T>(|lane| pivots.clear(lane))
    }
}

struct WithErrorEstimate<'a, T: Real>(KernelArguments<'a, T>, &'a mut Errors<T>);

impl<T: Vectorized> Work for WithErrorEstimate<'_, T> {
    type Output = u64;

    #[inline(always)]
    fn call(self) -> u64 {
        let KernelArguments { scene, scratch, state, wrenches, qdd } = self.0;
        let watched = auto::estimated_in_lanes::<T, T::Columns>(scene, scratch, state, wrenches, qdd);
        *self.1 = watched.errors();
        lanes_but::<T>(|lane| watched.is_accepted(lane))
    }
}

struct ByRoots<'a, T: Real>(KernelArguments<'a, T>);

impl<T: Vectorized> Work for ByRoots<'_, T> {
    type Output = u64;

    #[inline(always)]
    fn call(self) -> u64 {
        let KernelArguments { scene, scratch, state, wrenches, qdd } = self.0;
        let (pivots, reach) = sweeps::forward_dynamics_by_roots::<T, T::Columns>(scene, scratch, state, wrenches, qdd);
        lanes_but::<T>(|lane| pivots.clear(lane) && reach.clear(lane))
    }
}
