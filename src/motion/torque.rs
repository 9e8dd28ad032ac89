//! The applied torques of a rollout, and the fault of a step.

use crate::batch::Broadcast;
use crate::error::Error;

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

/// The earliest step that failed, and the lowest state known to have failed in it. `?` converts it to an [`Error`] that
/// names the state.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("step {step}, state {state}{}: {error}", of_joint(joint))]
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

/// Text that names the joint, if there is one.
fn of_joint(joint: &str) -> String {
    if joint.is_empty() { String::new() } else { format!(", joint {joint:?}") }
}

impl From<StepFault> for Error {
    fn from(fault: StepFault) -> Self {
        fault.error.in_state(fault.state)
    }
}
