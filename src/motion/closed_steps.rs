//! The elementary steps of one state of a scene with connections: the stages with their constrained accelerations, then
//! the projection onto the connections; in events, friction and stops at the end.

use super::choice::closed_rows;
use super::closed_stops::{StopRecord, is_past};
use super::constrained::{Constrained, ConstrainedScratch, Failure};
use super::division::Steps;
use super::events::{Ending, Event, Rebound};
use super::method::Scheme;
use super::scratch::{Scratch, clear};
use super::solver::{RowKernels, Solver};
use super::step::step;
use super::step_settings::{StepArguments, StepSettings};
use super::stops::SetValued;
use super::works::add_work;
use crate::batch::accelerations::KernelArguments;
use crate::batch::instruction_set::Baseline;
use crate::filter::Form;
use crate::scene::Scene;
use crate::workspace::Workspace;

/// Scratch memory for the steps of one state.
pub(super) struct ClosedScratch {
    pub rows_of_connections: ConstrainedScratch,
    /// The joints with friction, stops or limits of effort, and the settings of steps without friction and these
    /// limits.
    pub rows: Vec<SetValued>,
    pub without: StepSettings,
    kernels: RowKernels,
}

impl ClosedScratch {
    pub fn new(scene: &Scene, settings: &StepSettings, form: Form) -> Self {
        Self {
            rows_of_connections: ConstrainedScratch::new(scene, settings, form),
            rows: closed_rows(scene, settings),
            without: StepSettings { set_valued: Vec::new(), limited: Vec::new(), ..settings.clone() },
            kernels: RowKernels::default(),
        }
    }
}

/// The accelerations of a stage by the kernels, or with all checks if these need them.
struct KernelsFirst<'a>(&'a mut RowKernels, Constrained<'a>);

impl Solver<f64> for KernelsFirst<'_> {
    fn solve(&mut self, estimates: bool, mut call: KernelArguments<'_, f64>) -> u64 {
        let Self(kernels, checked) = self;
        let (rows, form) = (checked.scene.constraints(), checked.scratch.workspace.form);
        if checked.compliance.is_empty() && kernels.solve(rows, (form, estimates), call.again()) {
            return 0;
        }
        checked.solve(estimates, call)
    }
}

/// The elementary steps of one state.
pub(super) struct ClosedSteps<'a> {
    scene: &'a Scene,
    scratch: &'a mut ClosedScratch,
    /// The first failure.
    pub failure: Option<Failure>,
    rebound: Option<Rebound>,
}

impl<'a> ClosedSteps<'a> {
    pub fn new(scene: &'a Scene, scratch: &'a mut ClosedScratch) -> Self {
        Self { scene, scratch, failure: None, rebound: None }
    }

    fn solver<'b>(&'b mut self, settings: &'b StepSettings) -> KernelsFirst<'b> {
        let ClosedScratch { rows_of_connections: scratch, kernels, .. } = &mut *self.scratch;
        KernelsFirst(kernels, Constrained { scene: self.scene, scratch, compliance: &settings.given.compliance })
    }
}

impl Steps for ClosedSteps<'_> {
    fn step(&mut self, by: StepArguments<'_>, s: &mut Scratch<f64>) {
        // That of a step that was too long.
        self.scratch.rows_of_connections.take_fault().ok();
        step(Baseline, by, s, &mut self.solver(by.0));
    }

    fn finish(&mut self, settings: &StepSettings, s: &mut Scratch<f64>) {
        self.failure = self.failure.take().or(self.solver(settings).1.finish(settings, s, None).err());
        if self.scratch.rows.iter().any(|of| is_past(of, s)) {
            s.consistent = -1.0;
        }
    }

    fn repeat(&mut self, by: StepArguments<'_>, s: &mut Scratch<f64>) {
        self.step(by, s);
        self.finish(by.0, s);
    }

    fn event(&mut self, settings: &StepSettings, s: &mut Scratch<f64>, ending: Ending<'_>) -> f64 {
        let ClosedScratch { rows_of_connections: scratch, rows, without, kernels } = &mut *self.scratch;
        let checked = Constrained { scene: self.scene, scratch, compliance: &settings.given.compliance };
        let mut solver = KernelsFirst(kernels, checked);
        let mut found = self.failure.take().map_or(Ok(()), Err);
        if found.is_ok() && !settings.set_valued.is_empty() {
            clear(&mut s.dry);
            let scheme = Scheme::new(settings.method, ending.0);
            s.release_drives(settings, scheme.implicit_step());
            step(Baseline, (without, &scheme), s, &mut solver);
            found = solver.1.finish(settings, s, None);
        }
        let (h, mut record) = (ending.0, StopRecord::default());
        let error = found.and_then(|()| solver.1.stop(settings, rows, (s, ending), &mut record));
        self.rebound = record.rebound(s, h);
        add_work(settings, s);
        error.unwrap_or_else(|failure| {
            self.failure = Some(failure);
            f64::NAN
        })
    }

    fn solution(&self) -> Event<'_> {
        Event { solutions: &[], reached: &[], rebound: self.rebound.as_ref(), reversals: &[] }
    }

    fn has_failed(&self) -> bool {
        self.failure.is_some()
    }

    fn recovers(&mut self) -> bool {
        self.failure.take_if(|(lost, _)| lost.is_none()).is_some()
    }

    fn rows<'a>(&'a self, _: &'a StepSettings) -> &'a [SetValued] {
        &self.scratch.rows
    }

    fn holds(&self, s: &Scratch<f64>) -> bool {
        self.scratch.rows.iter().any(|of| of.holds(&s.q, &s.v))
    }

    fn workspace(&mut self) -> &mut Workspace<f64> {
        &mut self.scratch.rows_of_connections.workspace
    }
}
