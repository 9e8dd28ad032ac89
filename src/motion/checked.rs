//! Steps of one state with all checks, in substeps, and with the set-valued law.

use super::closed_steps::{ClosedScratch, ClosedSteps};
use super::division::{Substeps, TreeSteps, Visitor};
use super::events::Events;
use super::faults::fault_of;
use super::scratch::Scratch;
use super::solver::Checked;
use super::step_settings::StepSettings;
use crate::error::Error;
use crate::filter::Form;
use crate::scene::Scene;

/// One state, for steps that the vectorized step rejected.
pub(super) struct CheckedState {
    pub scratch: Scratch<f64>,
    pub solver: Checked,
    pub events: Events,
    pub substeps: Substeps,
    /// For a scene with connections.
    pub closed: Option<ClosedScratch>,
}

impl CheckedState {
    #[cold]
    pub fn new(scene: &Scene, settings: &StepSettings, form: Form) -> Self {
        let model = scene.model();
        let closed = settings.connected.then(|| ClosedScratch::new(scene, settings, form));
        let scratch = Scratch::new(model, settings);
        let (events, substeps) = (Events::new(settings, &scratch), Substeps::new(&scratch));
        let mut solver = Checked::new(model, settings.coupling.clone(), form).accepting(settings.given.tolerance);
        if closed.is_none() {
            solver = solver.with_kernels(model, settings.given.arm);
        }
        Self { scratch, solver, events, substeps, closed }
    }

    /// One step of one state, as [`Substeps::advance`]. Returns the joint and the error if it fails.
    #[inline(never)]
    pub fn step(
        &mut self,
        scene: &Scene,
        settings: &StepSettings,
        visit: &mut Visitor<'_>,
    ) -> Result<(), (String, Error)> {
        let Self { scratch, solver, events, substeps, closed } = self;
        let lost = if let Some(closed) = closed {
            let mut steps = ClosedSteps::new(scene, closed);
            substeps.advance(settings, scratch, &mut steps, visit);
            let (lost, error) = steps.failure.unwrap_or_default();
            if let Some(error) = error {
                return Err((String::new(), error));
            }
            lost
        } else {
            substeps.advance(settings, scratch, &mut TreeSteps { solver, events }, visit);
            solver.lost.take()
        };
        if let Some(coupling) = &settings.coupling {
            coupling.restore(&mut self.scratch.q_next, &mut self.scratch.v_next);
        }
        fault_of(scene, settings, &self.scratch, lost).map_or(Ok(()), Err)
    }
}
