//! A simulator: time integration call by call, which can continue after an error, and whose states can be reset.

use super::events::StopImpact;
#[cfg(feature = "python")]
use super::method::Method;
use super::rollout::Rollout;
use super::settings::Settings;
use super::torque::{StepFault, Torque};
use super::touches::ShapeContact;
use crate::batch::{Broadcast, Fault};
use crate::error::Error;
use crate::scene::Scene;
use crate::{interrupt, memory};
use std::borrow::Borrow;
use std::ops::Deref;

/// States that are advanced call by call. `S` holds the scene: `&Scene`, `Arc<Scene>` or `Scene`.
///
/// Results are bit-identical to those of a [`Rollout`], for any division of the steps into calls and any number of
/// threads and states. The first step allocates scratch memory. Later steps allocate nothing on the calling thread, but
/// for temporary arrays of steps with contacts, coupled joints or error control ([`Settings::accuracy`]), and of those
/// in which a joint reaches a stop or begins or ceases to stick. A clone continues independently from the same states.
///
/// States, times, settings and diagnostics are read by the methods of the [`Rollout`], to which it dereferences; a
/// reset state begins at time zero.
///
/// ```
/// use phipsi::motion::{Settings, Simulator, Torque};
/// # fn main() -> Result<(), phipsi::Error> {
/// let scene = phipsi::scenes::chain(7)?;
/// let mut simulator = Simulator::new(&scene, Settings::new(&scene, 1e-3), &[0.3; 7], &[0.0; 7])?;
/// for _ in 0..100 {
///     simulator.step(&Torque::constant(&[0.1; 7]), 1)?;
/// }
/// let (q, qd) = simulator.state(0);
/// assert!(q.len() == 7 && qd.len() == 7 && (simulator.time(0) - 0.1).abs() < 1e-12);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Simulator<S> {
    pub(super) rollout: Rollout<S>,
    /// The values of the rollout before the current call.
    before: Vec<f64>,
}

impl<S> Deref for Simulator<S> {
    type Target = Rollout<S>;

    fn deref(&self) -> &Rollout<S> {
        &self.rollout
    }
}

impl<S: Borrow<Scene>> Simulator<S> {
    /// Creates a simulator from initial states, one after another: `q` (states, nq), `qd` (states, nv).
    ///
    /// # Errors
    ///
    /// As [`Rollout::new`].
    pub fn new(scene: S, settings: Settings, q: &[f64], qd: &[f64]) -> Result<Self, Error> {
        Self::of(Rollout::new(scene, settings, q, qd)?)
    }

    /// Continues a rollout call by call.
    pub(crate) fn of(rollout: Rollout<S>) -> Result<Self, Error> {
        let before = memory::copied("q, qd", rollout.numbers().0)?;
        Ok(Self { rollout, before })
    }

    /// Advances all states by `steps` steps with constant `torque`. O(N) per step and stage of the method.
    ///
    /// # Errors
    ///
    /// [`StepFault`] if a motion diverges or a pivot is singular. All states, and their times, are then those after the
    /// last step that every state completed, which precedes [`StepFault::step`]. After torques of a wrong size or an
    /// [`interrupt`], they are those before the call.
    pub fn step(&mut self, torque: &Torque<'_>, steps: usize) -> Result<(), StepFault> {
        let Self { rollout, before } = self;
        let first = rollout.steps();
        before.copy_from_slice(rollout.numbers().0);
        let Err(fault) = rollout.advance(steps, torque, None) else { return Ok(()) };
        rollout.restore(before, first);
        // Repeats the steps before the fault, because in the failed call other states continued beyond it.
        let again = rollout.advance(fault.step - first, torque, None);
        if again.is_err() {
            rollout.restore(before, first);
        }
        again.and(Err(fault))
    }

    /// Resets some states: state `states[i]` becomes state i of `q` and `qd`, at time zero. The others are unchanged.
    ///
    /// # Errors
    ///
    /// An index that is not a state; more indices than states in `q` and `qd`; values that are not finite and
    /// quaternions that are not of unit norm, with the index of the state in the batch. All states are then unchanged.
    pub fn reset(&mut self, states: &[usize], q: &Broadcast<'_>, qd: &Broadcast<'_>) -> Result<(), Fault> {
        let count = self.states();
        for (name, given) in [("q", q), ("qd", qd)] {
            given.check_states(name, states.len()).map_err(|error| Fault { state: 0, error })?;
        }
        for (i, &state) in states.iter().enumerate() {
            interrupt::check_at(i, 1_024).map_err(|error| Fault { state, error })?;
            if state >= count {
                let error = Error::argument("states", state.to_string(), format!("indices below {count}"));
                return Err(Fault { state, error });
            }
            self.rollout.check_state(q.state(i), qd.state(i)).map_err(|error| Fault { state, error })?;
        }
        for (i, &state) in states.iter().enumerate() {
            self.rollout.begin(state, q.state(i), qd.state(i));
        }
        Ok(())
    }

    /// As [`Rollout::take_impacts`].
    pub fn take_impacts(&mut self) -> Vec<StopImpact> {
        self.rollout.take_impacts()
    }

    /// Where shapes touched in the last step.
    #[must_use]
    pub fn shape_contacts(&self) -> Vec<ShapeContact> {
        let last = self.steps();
        self.rollout.shape_contacts().into_iter().filter(|of| of.step == last).collect()
    }

    /// The values of every state, the step at which it began, and the number of steps made: the data of a copy, in
    /// addition to scene, settings and initial states.
    #[cfg(feature = "python")]
    pub(crate) fn numbers(&self) -> (&[f64], &[usize], usize) {
        let (numbers, begun) = self.rollout.numbers();
        (numbers, begun, self.steps())
    }

    /// Resumes from the values of another simulator with the same settings and number of states, with the method that
    /// it chose. Returns false if they do not match.
    #[cfg(feature = "python")]
    pub(crate) fn resume(&mut self, chosen: Method, values: (&[f64], &[usize]), done: usize) -> bool {
        self.rollout.resume(chosen, values, done)
    }
}
