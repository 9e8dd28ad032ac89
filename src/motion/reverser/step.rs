//! One step of all lanes, compiled for one instruction set.

use super::super::backward::{StepGradients, backward};
use super::super::torque::Torque;
use super::{Compiled, Job};
use crate::batch::instruction_set::{Target, Vectorized, Work, take_states};
use crate::scalar::lanes_but;

/// One step of all lanes, to be compiled for an instruction set. Returns as bits the lanes that need the fallback.
pub(super) struct Step<'a, T: Vectorized, I> {
    pub compiled: &'a mut Compiled<T, I>,
    pub job: &'a Job<'a>,
    pub n: usize,
    pub start: &'a [f64],
}

impl<T: Vectorized, I: Target> Step<'_, T, I> {
    /// The start of the step, and its torques.
    #[inline(always)]
    fn begin(&mut self) {
        let Self { compiled: Compiled { scratch: s, .. }, job, n, start } = self;
        let (count, nq, nv) = (job.states.len(), job.scene.nq(), job.scene.nv());
        take_states(&mut s.q, count, |lane| &start[lane * (nq + nv)..][..nq]);
        take_states(&mut s.v, count, |lane| &start[lane * (nq + nv) + nq..][..nv]);
        if let Torque::Steps { torque, first } = job.torque {
            let at = (*n - first) * nv;
            take_states(&mut s.torque, count, |lane| &torque.state(job.states.start + lane)[at..at + nv]);
        }
        s.take_targets(job.settings, (*n, count), |lane| job.states.start + lane);
    }

    /// The lanes whose gradients are not finite.
    #[allow(clippy::eq_op)] // x - x is zero for finite x, else NaN
    #[inline(always)]
    fn not_finite(&self) -> u64 {
        let mut worst = T::one();
        let StepGradients { start, acting, wrenches, .. } = &self.compiled.gradients;
        for numbers in start.iter().chain(acting).chain([wrenches]) {
            for &x in numbers {
                worst += x - x;
            }
        }
        lanes_but::<T>(|lane| worst.lane(lane) >= 0.0)
    }
}

impl<T: Vectorized, I: Target> Work for Step<'_, T, I> {
    type Output = u64;

    #[inline(always)]
    fn call(mut self) -> u64 {
        self.begin();
        let Self { compiled: Compiled { scratch: s, gradients, solver, .. }, job, .. } = &mut self;
        if !job.settings.has_vectorized_adjoint() {
            return u64::MAX;
        }
        let fallback = backward((job.settings, &job.settings.scheme), s, gradients, solver, None);
        fallback | self.not_finite()
    }
}

/// As [`Step`], of a scene with connections.
pub(super) struct ConnectedStep<'a, T: Vectorized, I>(pub Step<'a, T, I>);

impl<T: Vectorized, I: Target> Work for ConnectedStep<'_, T, I> {
    type Output = u64;

    #[inline(always)]
    fn call(mut self) -> u64 {
        self.0.begin();
        let Step { compiled: Compiled { scratch: s, gradients, connected, form, target, .. }, job, .. } = &mut self.0;
        let Some(connected) = connected else { return u64::MAX };
        let fallback = connected.step((*target, *form), (job.settings, job.states.len()), s, gradients);
        if fallback == u64::MAX { fallback } else { fallback | self.0.not_finite() }
    }
}
