//! One step of all lanes, compiled for one instruction set.

use super::super::backward::{StepGradients, VectorizedBackward, backward};
use super::super::connected::ConnectedReverse;
use super::super::scratch::Scratch;
use super::super::torque::Torque;
use super::job::Job;
use crate::batch::instruction_set::{Vectorized, take_states, within_target};
use crate::filter::Form;
use crate::scalar::lanes_but;

/// Scratch memory of the states of a job, one per lane.
pub(super) struct Lanes<T: Vectorized, I> {
    pub scratch: Scratch<T>,
    pub gradients: StepGradients<T>,
    pub solver: VectorizedBackward<T, I>,
    pub form: Form,
    /// For a scene with connections.
    pub connected: Option<Box<ConnectedReverse<T>>>,
}

within_target! {
    /// Step `n` of all lanes from their states at its start, with connections if the scene has any. Returns as bits the
    /// lanes that need the fallback.
    pub(super) fn step<'a, T, I>(
        target;
        lanes: &'a mut Lanes<T, I>,
        job: &'a Job<'a>,
        n: usize,
        start: &'a [f64],
    ) -> u64 {
        let Lanes { scratch: s, gradients, solver, connected, form } = lanes;
        let (settings, count, nq, nv) = (job.settings, job.states.len(), job.scene.nq(), job.scene.nv());
        take_states(&mut s.q, count, |lane| &start[lane * (nq + nv)..][..nq]);
        take_states(&mut s.v, count, |lane| &start[lane * (nq + nv) + nq..][..nv]);
        if let Torque::Steps { torque, first } = job.torque {
            let at = (n - first) * nv;
            take_states(&mut s.torque, count, |lane| &torque.state(job.states.start + lane)[at..at + nv]);
        }
        s.take_targets(settings, (n, count), |lane| job.states.start + lane);
        if !settings.has_vectorized_adjoint() {
            return u64::MAX;
        }
        let fallback = match connected {
            Some(connected) => connected.step((target, *form), (settings, count), s, gradients),
            None => backward(target, (settings, &settings.scheme), s, gradients, solver, None),
        };
        if fallback == u64::MAX { fallback } else { fallback | not_finite(gradients) }
    }
}

/// The lanes whose gradients are not finite.
#[allow(clippy::eq_op)] // x - x is zero for finite x, else NaN
#[inline(always)]
fn not_finite<T: Vectorized>(StepGradients { start, acting, wrenches, .. }: &StepGradients<T>) -> u64 {
    let mut worst = T::one();
    for numbers in start.iter().chain(acting).chain([wrenches]) {
        for &x in numbers {
            worst += x - x;
        }
    }
    lanes_but::<T>(|lane| worst.lane(lane) >= 0.0)
}
