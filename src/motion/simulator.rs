//! States that go on step by step: a rollout that can be taken up again after an error, and whose states can begin anew one by one.

use super::conserve::Correction;
use super::contact::ContactReport;
use super::method::Method;
use super::rollout::Rollout;
use super::settings::Settings;
use super::substeps::StopImpact;
use super::torque::{StepFault, Torque};
use super::totals::Totals;
use crate::batch::{Broadcast, Fault};
use crate::error::Error;
use crate::scene::Scene;
use crate::{interrupt, memory};
use std::borrow::Borrow;

/// States that are advanced call by call; `S`: what the scene is held by, as `&Scene`, `Arc<Scene>` or `Scene`.
///
/// A step has the bits that it has in a [`Rollout`], however steps are cut into calls, for any number of threads and of states beside it. Scratch is
/// made by the first step and kept: later ones allocate nothing on the caller's thread.
///
/// ```
/// use phipsi::batch::Broadcast;
/// use phipsi::motion::{Settings, Simulator, Torque};
/// # fn main() -> Result<(), phipsi::Error> {
/// let scene = phipsi::scenes::chain(7)?;
/// let mut simulator = Simulator::new(&scene, Settings::new(&scene, 1e-3), &[0.3; 7], &[0.0; 7])?;
/// let torque = Torque::Constant(Broadcast::new("tau", &[0.1; 7], 7, &[], &[])?);
/// for _ in 0..100 {
///     simulator.step(&torque, 1).map_err(|fault| fault.error)?;
/// }
/// let (q, qd) = simulator.state(0);
/// assert!(q.len() == 7 && qd.len() == 7 && (simulator.time(0) - 0.1).abs() < 1e-12);
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Simulator<S> {
    pub(super) rollout: Rollout<S>,
    /// What the rollout had before the call at hand.
    before: Vec<f64>,
}

impl<S: Borrow<Scene>> Simulator<S> {
    /// States to start from, one after another: `q` (states, nq), `qd` (states, nv).
    ///
    /// # Errors
    ///
    /// As [`Rollout::new`].
    pub fn new(scene: S, settings: Settings, q: &[f64], qd: &[f64]) -> Result<Self, Error> {
        let rollout = Rollout::new(scene, settings, q, qd)?;
        let before = memory::copied("q, qd", rollout.numbers().0)?;
        Ok(Self { rollout, before })
    }

    /// Makes `steps` steps in every state, `torque` held over them: O(N) a step, by as many evaluations as the method has stages.
    ///
    /// # Errors
    ///
    /// [`StepFault`] where a joint runs away or its pivot is lost: all states, and their times, are then after the last step that every state finished,
    /// which is the one before [`StepFault::step`]. After torques of the wrong size, and where a [`interrupt`] ended the work, they are as they
    /// were before the call.
    pub fn step(&mut self, torque: &Torque<'_>, steps: usize) -> Result<(), StepFault> {
        let Self { rollout, before } = self;
        let first = rollout.steps();
        before.copy_from_slice(rollout.numbers().0);
        let Err(fault) = rollout.advance(steps, torque, None) else { return Ok(()) };
        rollout.put_back(before, first);
        // Those before it once more: in the call they went on past it, each as far as it could.
        let again = rollout.advance(fault.step - first, torque, None);
        if again.is_err() {
            rollout.put_back(before, first);
        }
        again.and(Err(fault))
    }

    /// Begins some of the states anew: state `states[i]` at state i of `q` and `qd`, at time zero. The others stay as they are.
    ///
    /// # Errors
    ///
    /// A state that there is not, or more states than `q` and `qd` have; numbers that are not finite, quaternions that are not unit, with the index of
    /// the state in the batch. All states are then as they were.
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

    /// Configuration and rates of one state now.
    ///
    /// # Panics
    ///
    /// If there is no such state, as a slice does: see [`Simulator::states`].
    #[must_use]
    pub fn state(&self, index: usize) -> (&[f64], &[f64]) {
        self.rollout.state(index)
    }

    /// How many states there are.
    #[must_use]
    pub fn states(&self) -> usize {
        self.rollout.states()
    }

    /// How many steps were made, resets or not.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.rollout.steps()
    }

    /// How long one state has moved, s: dt for every step since it began or was reset.
    ///
    /// # Panics
    ///
    /// If there is no such state, as a slice does: see [`Simulator::states`].
    #[must_use]
    pub fn time(&self, index: usize) -> f64 {
        self.rollout.time(index)
    }

    /// The largest corrections that one state had to keep its momentum since it began or was reset; none where that was not asked for.
    ///
    /// # Panics
    ///
    /// If there is no such state, as a slice does: see [`Simulator::states`].
    #[must_use]
    pub fn correction(&self, index: usize) -> Option<Correction> {
        self.rollout.correction(index)
    }

    /// As [`Rollout::chosen_method`].
    #[must_use]
    pub fn chosen_method(&self) -> Method {
        self.rollout.chosen_method()
    }

    /// As [`Rollout::has_stops`].
    #[must_use]
    pub fn has_stops(&self) -> bool {
        self.rollout.has_stops()
    }

    /// As [`Rollout::totals`].
    ///
    /// # Panics
    ///
    /// If there is no such state, as a slice does: see [`Simulator::states`].
    #[must_use]
    pub fn totals(&self, index: usize) -> Totals {
        self.rollout.totals(index)
    }

    /// As [`Rollout::take_impacts`].
    pub fn take_impacts(&mut self) -> Vec<StopImpact> {
        self.rollout.take_impacts()
    }

    /// What the steps of one state told of its contacts since it began or was reset; none for a scene without.
    ///
    /// # Panics
    ///
    /// If there is no such state, as a slice does: see [`Simulator::states`].
    #[must_use]
    pub fn contact_report(&self, index: usize) -> Option<ContactReport> {
        self.rollout.contact_report(index)
    }

    /// As [`Rollout::contacts_now`].
    ///
    /// # Panics
    ///
    /// If there is no such state, as a slice does: see [`Simulator::states`].
    #[must_use]
    pub fn contacts_now(&self, index: usize) -> Vec<f64> {
        self.rollout.contacts_now(index)
    }

    /// The scene whose states these are.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        self.rollout.scene()
    }

    /// What it was made with; a copy.
    #[must_use]
    pub fn settings(&self) -> Settings {
        self.rollout.settings()
    }

    /// Rough time of one step of one state on one thread, ns.
    #[must_use]
    #[doc(hidden)]
    pub fn cost(&self) -> usize {
        self.rollout.cost()
    }

    /// Whether `torque` serves the next `steps` steps; [`Simulator::step`] asks too.
    ///
    /// # Errors
    ///
    /// As [`Rollout::check_torque`].
    #[doc(hidden)]
    pub fn check_torque(&self, torque: &Torque<'_>, steps: usize) -> Result<(), Fault> {
        self.rollout.check_torque(torque, steps)
    }

    /// What a copy is made of, beside scene, settings and any states: the numbers of every state, the step that it began at, and how many were made.
    #[cfg(feature = "python")]
    pub(crate) fn numbers(&self) -> (&[f64], &[usize], usize) {
        let (numbers, begun) = self.rollout.numbers();
        (numbers, begun, self.steps())
    }

    /// Goes on from the numbers of another of as many states, made with the same settings; false where they do not fit.
    #[cfg(feature = "python")]
    pub(crate) fn take_up(&mut self, numbers: &[f64], begun: &[usize], done: usize) -> bool {
        self.rollout.take_up(numbers, begun, done)
    }
}
