//! Steps of scenes with connections: accelerations through them, and positions and velocities that stay on them.

use super::scratch::Scratch;
use super::solver::Solver;
use super::step_settings::StepSettings;
use crate::dynamics::constraints::{
    ConstraintScratch, NoDirection, Outcome, RowsAre, constrained_dynamics, errors_of_rows, project_positions,
    project_velocities, rates_of_rows,
};
use crate::dynamics::sweeps::{SweepModel, SweepScratch};
use crate::error::Error;
use crate::filter::Form;
use crate::filter::pivots::LostPivot;
use crate::model::Model;
use crate::scene::Scene;
use crate::workspace::Workspace;

/// A state may begin so far from the connections, m or rad, and m/s or rad/s.
const AT_START: f64 = 1e-6;

/// One state, its accelerations through the connections.
pub(super) struct Constrained<'a> {
    pub scene: &'a Scene,
    pub scratch: &'a mut Closed,
    pub alpha: Option<f64>,
}

/// Scratch of one state.
pub(super) struct Closed {
    workspace: Workspace<f64>,
    rows: ConstraintScratch,
    /// The first fault since it was last taken.
    fault: Option<Fault>,
}

/// What went wrong.
enum Fault {
    Lost(LostPivot),
    Error(Error),
}

impl Closed {
    pub fn new(scene: &Scene, law: &StepSettings, form: Form) -> Self {
        let workspace = Workspace { tolerance: law.tolerance, ..Workspace::new(scene.model()) };
        Self {
            workspace: workspace.in_form(form),
            rows: ConstraintScratch::new(scene.model(), scene.constraints()),
            fault: None,
        }
    }

    fn note(&mut self, scene: &Scene, outcome: Result<Outcome, NoDirection>, model: &Model<f64>, is_finite: bool) {
        if self.fault.is_some() {
            return;
        }
        self.fault = match outcome {
            Err(at) => Some(Fault::Error(scene.no_direction(at))),
            Ok(outcome) => match self.workspace.lost_pivot(model, &outcome.pivots) {
                Some(lost) => Some(Fault::Lost(lost)),
                // What runs away is told as that.
                None if is_finite => scene.check_agreement(&outcome).err().map(Fault::Error),
                None => None,
            },
        };
    }
}

impl Solver<f64> for Constrained<'_> {
    fn solve(
        &mut self,
        _estimates: bool,
        (model, _): (&Model<f64>, &SweepModel<f64>),
        _scratch: &mut SweepScratch<f64>,
        (q, v, u): (&[f64], &[f64], &[f64]),
        qdd: &mut [f64],
    ) -> u64 {
        let Closed { workspace, rows, .. } = &mut *self.scratch;
        let (system, wanted) = ((model, self.scene.constraints()), RowsAre { alpha: self.alpha, ..RowsAre::default() });
        let outcome = constrained_dynamics(system, workspace, rows, (q, v, u), (&[], wanted), qdd);
        let is_finite = qdd.iter().chain(q).chain(v).all(|x| x.is_finite());
        self.scratch.note(self.scene, outcome, model, is_finite);
        0
    }
}

impl Constrained<'_> {
    /// The end of a step: `q_next` and `v_next` onto the connections, unless accelerations do that; what went wrong in the step.
    pub fn finish(&mut self, s: &mut Scratch<f64>) -> Result<(), (Option<LostPivot>, Option<Error>)> {
        let Closed { workspace, rows, fault } = &mut *self.scratch;
        match fault.take() {
            Some(Fault::Lost(lost)) => return Err((Some(lost), None)),
            Some(Fault::Error(error)) => return Err((None, Some(error))),
            None => {}
        }
        // What has run away is told as that.
        if self.alpha.is_some() || !s.q_next.iter().chain(&s.v_next).all(|x| x.is_finite()) {
            return Ok(());
        }
        let scene = self.scene;
        let system = (scene.model(), scene.constraints());
        let told = |at| (None, Some(scene.no_direction(at)));
        let positions = project_positions(system, workspace, rows, &mut s.q_next).map_err(told)?;
        if let Some(lost) = workspace.lost_pivot(scene.model(), &positions.pivots) {
            return Err((Some(lost), None));
        }
        let smaller = "a step after which small moves meet the connections: take a smaller dt";
        if let Some(row) = positions.stays {
            return Err((None, Some(scene.open_at("the end of a step", row, positions.left, "m or rad", smaller))));
        }
        let velocities = project_velocities(system, workspace, rows, (&s.q_next, &mut s.v_next)).map_err(told)?;
        if let Some(row) = velocities.stays {
            return Err((
                None,
                Some(scene.open_at("the end of a step", row, velocities.left, "m/s or rad/s", smaller)),
            ));
        }
        Ok(())
    }
}

/// Whether a state meets the connections, so that a motion can begin there.
pub(super) fn check_start(scene: &Scene, q: &[f64], qd: &[f64]) -> Result<(), Error> {
    let constraints = scene.constraints();
    if constraints.is_empty() {
        return Ok(());
    }
    let (model, mut rows) = (scene.model(), vec![0.0; constraints.rows]);
    let remedy = "a start that meets the connections: q, qd = scene.project(q, qd)";
    let worst = |rows: &[f64]| (0..rows.len()).max_by(|&i, &j| rows[i].abs().total_cmp(&rows[j].abs())).unwrap_or(0);
    errors_of_rows(model, constraints, q, &mut rows).map_err(|at| scene.no_direction(at))?;
    let row = worst(&rows);
    if !(rows[row].abs() <= AT_START) {
        return Err(scene.open_at("q", row, rows[row].abs(), "m or rad", remedy));
    }
    rates_of_rows(model, constraints, (q, qd), &mut rows).map_err(|at| scene.no_direction(at))?;
    let row = worst(&rows);
    let speed = qd.iter().fold(1.0, |most: f64, v| most.max(v.abs()));
    if !(rows[row].abs() <= AT_START * speed) {
        return Err(scene.open_at("qd", row, rows[row].abs(), "m/s or rad/s", remedy));
    }
    Ok(())
}
