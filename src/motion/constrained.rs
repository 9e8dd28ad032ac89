//! Steps of scenes with connections: constrained accelerations, and positions and velocities projected onto the
//! connections.

use super::faults::pivot_fault;
use super::scratch::Scratch;
use super::solver::Solver;
use super::step_settings::StepSettings;
use crate::batch::accelerations::KernelArguments;
use crate::dynamics;
use crate::dynamics::constraints::{
    ConstraintScratch, Outcome, Projected, ProjectionStep, RowFault, constrained_dynamics, project_positions,
    project_with_factors,
};
use crate::error::Error;
use crate::filter::Form;
use crate::filter::pivots::{LostPivot, PivotMonitor};
use crate::model::Model;
use crate::scene::Scene;
use crate::workspace::Workspace;
use nalgebra::{DMatrix, DVector};

/// The fix that the error of a step suggests.
const SMALLER: &str = "a step that ends near a configuration that satisfies the connections: take a smaller dt";

/// Compliance of the stuck rows, relative to the diagonal of their matrix and to its largest entry, which makes the
/// torques of dependent rows unique; and the number of steps that remove it from the velocities.
const COMPLIANCE: [f64; 2] = [1e-9, 1e-13];
const REFINEMENTS: usize = 4;

/// The singular pivot, or the error, that ends a step.
pub(super) type Failure = (Option<LostPivot>, Option<Error>);

/// One state with its constrained accelerations.
pub(super) struct Constrained<'a> {
    pub scene: &'a Scene,
    pub scratch: &'a mut ConstrainedScratch,
    /// Compliance per row; empty if all rows are rigid.
    pub compliance: &'a [f64],
}

/// Scratch memory for one state.
pub(super) struct ConstrainedScratch {
    pub workspace: Workspace<f64>,
    pub rows: ConstraintScratch,
    /// The first fault, until it is taken.
    fault: Option<Fault>,
}

/// The reason why a step fails.
enum Fault {
    Lost(LostPivot),
    Error(Error),
}

impl ConstrainedScratch {
    pub fn new(scene: &Scene, settings: &StepSettings, form: Form) -> Self {
        let workspace = Workspace { tolerance: settings.given.tolerance, ..Workspace::new(scene.model()) };
        Self {
            workspace: workspace.in_form(form),
            rows: ConstraintScratch::new(scene.model(), scene.constraints()),
            fault: None,
        }
    }

    /// Returns the first fault.
    pub fn take_fault(&mut self) -> Result<(), Failure> {
        match self.fault.take() {
            Some(Fault::Lost(lost)) => Err((Some(lost), None)),
            Some(Fault::Error(error)) => Err((None, Some(error))),
            None => Ok(()),
        }
    }

    pub fn note_error(&mut self, error: Error) {
        self.fault.get_or_insert(Fault::Error(error));
    }

    fn note(&mut self, scene: &Scene, outcome: Result<Outcome, RowFault>, model: &Model<f64>, is_finite: bool) {
        if self.fault.is_some() {
            return;
        }
        self.fault = match outcome {
            Err(at) => Some(Fault::Error(scene.row_fault(at))),
            Ok(outcome) => match self.workspace.lost_pivot(model, &outcome.pivots) {
                Some(lost) => Some(Fault::Lost(lost)),
                // A diverging motion is reported as such.
                None if is_finite => scene.check_agreement(&outcome).err().map(Fault::Error),
                None => None,
            },
        };
    }
}

impl Solver<f64> for Constrained<'_> {
    fn solve(&mut self, _estimates: bool, call: KernelArguments<'_, f64>) -> u64 {
        let KernelArguments { scene: (model, _), state: (q, v, u), qdd, .. } = call;
        let ConstrainedScratch { workspace, rows, .. } = &mut *self.scratch;
        let system = (model, self.scene.constraints());
        let outcome = constrained_dynamics(system, workspace, rows, (q, v, u), (&[], self.compliance), qdd);
        let is_finite = qdd.iter().chain(q).chain(v).all(|x| x.is_finite());
        self.scratch.note(self.scene, outcome, model, is_finite);
        0
    }
}

impl Constrained<'_> {
    /// Ends a step: projects `q_next` and `v_next` onto the connections. Returns the fault of the step; adds the steps
    /// of the projection of positions to `steps`, as [`project_positions`].
    pub fn finish(
        &mut self,
        settings: &StepSettings,
        s: &mut Scratch<f64>,
        steps: Option<&mut Vec<ProjectionStep>>,
    ) -> Result<(), Failure> {
        self.scratch.take_fault()?;
        // A diverging motion is reported as such.
        if !s.q_next.iter().chain(&s.v_next).all(|x| x.is_finite()) {
            return Ok(());
        }
        // The implicit terms of the step are not part of the kinetic energy.
        let noise = std::mem::replace(&mut s.model.system.noise, settings.properties.armature.clone());
        let mut finished = self.positions_onto_connections(&s.model, &mut s.q_next, steps);
        if finished.is_ok() {
            finished = self.velocities_onto_connections(&s.model, &s.q_next, &mut s.v_next);
        }
        s.model.system.noise = noise;
        finished
    }

    /// Projects `q` onto the connections; adds the steps to `steps`.
    pub(super) fn positions_onto_connections(
        &mut self,
        model: &Model<f64>,
        q: &mut [f64],
        steps: Option<&mut Vec<ProjectionStep>>,
    ) -> Result<(), Failure> {
        let (scene, ConstrainedScratch { workspace, rows, .. }) = (self.scene, &mut *self.scratch);
        let system = (model, scene.constraints());
        let positions = project_positions(system, workspace, rows, (q, self.compliance), steps);
        check_projection(scene, (model, workspace), positions, "m or rad")
    }

    /// Projects `v` onto the velocities that satisfy the connections at `q`. The workspace then has the factor of M at
    /// `q`.
    pub(super) fn velocities_onto_connections(
        &mut self,
        model: &Model<f64>,
        q: &[f64],
        v: &mut [f64],
    ) -> Result<(), Failure> {
        let pivots = self.factorise(model, q)?;
        self.velocities_with_factors(model, pivots, v)
    }

    /// Factors M and the rows at `q`.
    pub(super) fn factorise(&mut self, model: &Model<f64>, q: &[f64]) -> Result<PivotMonitor<f64>, Failure> {
        let (scene, ConstrainedScratch { workspace, rows, .. }) = (self.scene, &mut *self.scratch);
        let pivots = dynamics::factorise(model, workspace, q);
        if let Some(lost) = workspace.lost_pivot(model, &pivots) {
            return Err((Some(lost), None));
        }
        rows.factorise((model, scene.constraints()), workspace, q, self.compliance)
            .map_err(|at| (None, Some(scene.row_fault(at))))?;
        Ok(pivots)
    }

    /// As [`Constrained::velocities_onto_connections`], with the last factors.
    pub(super) fn velocities_with_factors(
        &mut self,
        model: &Model<f64>,
        pivots: PivotMonitor<f64>,
        v: &mut [f64],
    ) -> Result<(), Failure> {
        let (scene, ConstrainedScratch { workspace, rows, .. }) = (self.scene, &mut *self.scratch);
        let velocities = project_with_factors(model, (&mut *workspace, pivots), rows, v, self.compliance);
        check_projection(scene, (model, workspace), Ok(velocities), "m/s or rad/s")
    }
}

/// The fault of a projection, whose rows have this unit.
pub(super) fn check_projection(
    scene: &Scene,
    (model, workspace): (&Model<f64>, &mut Workspace<f64>),
    projected: Result<Projected, RowFault>,
    unit: &str,
) -> Result<(), Failure> {
    let Projected { pivots, stays, left, .. } = projected.map_err(|at| (None, Some(scene.row_fault(at))))?;
    if let Some(lost) = workspace.lost_pivot(model, &pivots) {
        return Err((Some(lost), None));
    }
    let Some(row) = stays else { return Ok(()) };
    Err((None, Some(scene.open_at("the end of a step", row, left, unit, SMALLER))))
}

/// The joint and the error of a failed step.
pub(super) fn named(scene: &Scene, failure: Failure) -> (String, Error) {
    match failure {
        (Some(lost), _) => pivot_fault(scene, lost),
        (None, Some(error)) => (String::new(), error),
        (None, None) => (String::new(), Error::argument("q, qd", "a failed step", "rows that simulate recorded")),
    }
}

/// The solution of a system with the matrix `g` of the stuck rows, whose `residual` vanishes at it; unique also if rows
/// are dependent. Calls `residual` with the solution at last. `largest` entry of the matrix of all rows.
pub(super) fn solution_of_stuck(
    mut g: DMatrix<f64>,
    largest: f64,
    mut residual: impl FnMut(&DVector<f64>) -> DVector<f64>,
) -> DVector<f64> {
    let mut found = DVector::zeros(g.nrows());
    let [own, beside] = COMPLIANCE;
    for a in 0..g.nrows() {
        g[(a, a)] += own * g[(a, a)] + beside * largest;
    }
    let mut left = residual(&found);
    if let Some(factor) = g.cholesky() {
        for _ in 0..REFINEMENTS {
            found += factor.solve(&left);
            left = residual(&found);
        }
    }
    found
}
