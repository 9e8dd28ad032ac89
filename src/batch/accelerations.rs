//! Joint accelerations for one state per lane of a scalar. Each form is compiled once per scalar and instruction set,
//! and called by batches and by simulation.

use super::instruction_set::within_target;
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

#[cfg(feature = "motion")]
impl<T: Real> KernelArguments<'_, T> {
    /// The same arguments for a call before another one.
    #[inline(always)]
    pub fn again(&mut self) -> KernelArguments<'_, T> {
        let Self { scene, scratch, state, wrenches, qdd } = self;
        KernelArguments { scene: *scene, scratch, state: *state, wrenches, qdd }
    }
}

/// The arguments and results of a kernel with scratch of its own.
pub(super) struct KernelCall<'a, T: Real, K> {
    pub scene: (&'a Model<T>, &'a SweepModel<T>),
    pub scratch: &'a mut SweepScratch<T>,
    pub kernel: &'a mut K,
    /// (q, qd, u).
    pub state: (&'a [T], &'a [T], &'a [T]),
    pub wrenches: &'a [Vector6<T>],
    pub out: &'a mut [f64],
}

within_target! {
    /// In covariance form. Returns the lanes that need the fallback as bits, as the other kernels do.
    #[inline(never)]
    pub(crate) fn by_covariance<'a, T>(call: KernelArguments<'a, T>) -> u64 {
        let KernelArguments { scene, scratch, state, wrenches, qdd } = call;
        let pivots = sweeps::forward_dynamics::<T, T::Columns>(scene, scratch, state, wrenches, qdd);
        lanes_but::<T>(|lane| pivots.clear(lane))
    }

    /// Covariance form with an error estimate: the first form of `auto`. Writes the estimated errors.
    #[inline(never)]
    pub(crate) fn watched<'a, T>(call: KernelArguments<'a, T>, errors: &'a mut Errors<T>) -> u64 {
        let KernelArguments { scene, scratch, state, wrenches, qdd } = call;
        let watched = auto::estimated_in_lanes::<T, T::Columns>(scene, scratch, state, wrenches, qdd);
        *errors = watched.errors();
        lanes_but::<T>(|lane| watched.is_accepted(lane))
    }

    /// In square-root form.
    #[inline(never)]
    pub(crate) fn by_roots<'a, T>(call: KernelArguments<'a, T>) -> u64 {
        let KernelArguments { scene, scratch, state, wrenches, qdd } = call;
        let (pivots, reach) = sweeps::forward_dynamics_by_roots::<T, T::Columns>(scene, scratch, state, wrenches, qdd);
        lanes_but::<T>(|lane| pivots.clear(lane) && reach.clear(lane))
    }
}
