//! The applied torques of a rollout, and the fault of a step.

use crate::batch::Broadcast;
use crate::error::{Error, of_step};

/// Applied joint torques, (nv), constant during each step. Springs, damping, friction and control law are added to
/// them.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum Torque<'a> {
    /// Zero torque.
    Zero,
    /// The same torque in every step: (nv) per state.
    Constant(Broadcast<'a>),
    /// A torque for every step: (steps, nv) per state.
    Steps {
        /// The torques.
        torque: Broadcast<'a>,
        /// The step of the run to which the first torque belongs.
        first: usize,
    },
}

impl<'a> Torque<'a> {
    /// The same torque `tau`, (nv), in every step of every state; [`Torque::Constant`] gives each state its own.
    ///
    /// ```
    /// use phipsi::motion::{Settings, Simulator, Torque};
    /// # fn main() -> Result<(), phipsi::Error> {
    /// let scene = phipsi::scenes::chain(2)?;
    /// let mut simulator = Simulator::new(&scene, Settings::new(&scene, 1e-3), &[0.0; 2], &[0.0; 2])?;
    /// simulator.step(&Torque::constant(&[1.0, 0.5]), 10)?;
    /// # Ok(())
    /// # }
    /// ```
    #[must_use]
    pub fn constant(tau: &'a [f64]) -> Self {
        Self::Constant(Broadcast::shared(tau))
    }
}

impl<'a> From<&'a [f64]> for Torque<'a> {
    fn from(tau: &'a [f64]) -> Self {
        Self::constant(tau)
    }
}

/// The earliest step that failed, and the lowest state known to have failed in it. `?` converts it to
/// [`Error::Step`], with the same message, or to [`Error::Interrupted`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{}: {error}", of_step(*step, *state, joint))]
#[non_exhaustive]
pub struct StepFault {
    /// Index of the step, from zero, which equals the number of steps that every state completed.
    pub step: usize,
    /// Index of the state in the batch.
    pub state: usize,
    /// The joint that caused the fault.
    pub joint: String,
    /// The error.
    pub error: Error,
}

impl From<StepFault> for Error {
    fn from(fault: StepFault) -> Self {
        let StepFault { step, state, joint, error } = fault;
        match error {
            Self::Interrupted => error,
            error => Self::Step { step, state, joint, error: Box::new(error) },
        }
    }
}
