//! The torques of a rollout, and the step of it that failed.

use crate::batch::Broadcast;
use crate::error::Error;

/// The torques that are given, (nv), held over each step; springs, damping, friction and control law come to them.
#[derive(Debug, Clone)]
pub enum Torque<'a> {
    /// None.
    Zero,
    /// The same in every step: (nv) a state.
    Constant(Broadcast<'a>),
    /// Their own in every step: (steps, nv) a state.
    Steps {
        /// The torques.
        torque: Broadcast<'a>,
        /// The step of the run that the first are for.
        first: usize,
    },
}

/// The earliest step that failed, and in it the lowest state of those that are known to have.
#[derive(Debug, Clone, PartialEq)]
pub struct StepFault {
    /// Index of the step, from zero: so many were finished in every state.
    pub step: usize,
    /// Index of the state in the batch.
    pub state: usize,
    /// The joint at fault.
    pub joint: String,
    /// What was wrong.
    pub error: Error,
}
