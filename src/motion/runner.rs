//! Time integration of a few states: steps that are all of one method, or those of states whose contacts may act.

use super::contact::Switching;
use super::job::Job;
use super::method::Method;
use super::stepper::Stepper;
use super::torque::StepFault;
use crate::batch::instruction_set::InstructionSet;
use crate::filter::Form;

/// Scratch memory for one rollout on one thread, allocated at first use.
pub(super) struct Runner {
    stepper: Stepper,
    switching: Option<Box<Switching>>,
    of: (Form, InstructionSet),
}

impl std::fmt::Debug for Runner {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Runner").field("lanes", &self.lanes()).finish_non_exhaustive()
    }
}

impl Runner {
    pub fn new(form: Form, arm: InstructionSet) -> Self {
        Self { stepper: Stepper::new(form, arm), switching: None, of: (form, arm) }
    }

    /// Largest number of states of a job.
    pub fn lanes(&self) -> usize {
        self.stepper.lanes()
    }

    /// Runs a job; returns the fault of the earliest step, and of the lowest state in it.
    pub fn run(&mut self, job: Job<'_, '_>) -> Result<(), StepFault> {
        if job.settings.method != Method::Contact {
            return self.stepper.steps(job);
        }
        let (of, lanes) = (self.of, self.lanes());
        self.switching.get_or_insert_with(|| Box::new(Switching::new(job.scene, of, lanes))).run(job)
    }
}
