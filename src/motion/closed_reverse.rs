//! Adjoint of one step of a scene with connections: the projections of velocities and positions at its end, each by
//! implicit functions, then the stages with their constrained accelerations.
//!
//! Every Newton step of the projection of positions is differentiated: its result is that of least kinetic energy to
//! first order only, and depends on the steps beyond.

use super::backward::{ARMATURE, BackwardSolver, StepGradients, backward};
use super::closed_steps::{ClosedScratch, ClosedSteps};
use super::closed_stops::is_past;
use super::constrained::{Constrained, ConstrainedScratch, Failure};
use super::division::{Substeps, Visitor};
use super::method::Scheme;
use super::properties::joint_of_row;
use super::scratch::{Scratch, add_scaled};
use super::solver::Solver;
use super::step::step;
use super::step_settings::StepSettings;
use crate::batch::accelerations::KernelArguments;
use crate::dynamics::constraints::{ConstraintAdjoint, ProjectionStep, Pushed, subtract_products};
use crate::dynamics::derivatives::{Constants, Parameters};
use crate::dynamics::sweeps::{SweepModel, SweepScratch};
use crate::error::{Error, in_language};
use crate::filter::Form;
use crate::model::Model;
use crate::scene::Scene;

/// One state.
pub(super) struct ClosedReverse {
    pub scratch: Scratch<f64>,
    pub gradients: StepGradients<f64>,
    closed: ClosedScratch,
    adjoint: ConstraintAdjoint,
    divided: Substeps,
    newton: Vec<ProjectionStep>,
    /// Forces of the connections in each stage.
    forces: Vec<Vec<f64>>,
}

/// The accelerations of the stages, with their forces.
struct Recorded<'a, 'b> {
    forward: &'b mut Constrained<'a>,
    forces: &'b mut Vec<Vec<f64>>,
}

impl Solver<f64> for Recorded<'_, '_> {
    fn solve(
        &mut self,
        estimates: bool,
        scene: (&Model<f64>, &SweepModel<f64>),
        scratch: &mut SweepScratch<f64>,
        state: (&[f64], &[f64], &[f64]),
        qdd: &mut [f64],
    ) -> u64 {
        let lanes = self.forward.solve(estimates, scene, scratch, state, qdd);
        self.forces.push(self.forward.scratch.rows.forces.clone());
        lanes
    }
}

/// The adjoint of the accelerations of the stages, from the last to the first. The step has set them.
struct ClosedBackward<'a> {
    forward: Constrained<'a>,
    adjoint: &'a mut ConstraintAdjoint,
    forces: &'a mut Vec<Vec<f64>>,
}

impl BackwardSolver<f64> for ClosedBackward<'_> {
    fn factor(&mut self, _: KernelArguments<'_, f64>) -> u64 {
        0
    }

    fn gradients(
        &mut self,
        call: KernelArguments<'_, f64>,
        cotangent: &[f64],
        parameters: &mut [Parameters<f64>],
        out: &mut [f64],
    ) -> u64 {
        let KernelArguments { scene: (model, _), state: (q, qd, _), qdd, .. } = call;
        let Constrained { scene, scratch, compliance } = &mut self.forward;
        let ConstrainedScratch { workspace, rows, .. } = &mut **scratch;
        if let Some(forces) = self.forces.pop() {
            rows.forces = forces;
        }
        let (system, room) = ((model, scene.constraints()), (workspace, rows));
        let constants = &mut Constants { parameters, ..Constants::default() };
        let found =
            self.adjoint.of_dynamics(system, room, (q, qd, qdd), (&[], cotangent, *compliance), (constants, out));
        if let Err(at) = found {
            scratch.note_error(scene.row_fault(at));
        }
        0
    }
}

impl ClosedReverse {
    pub fn new(scene: &Scene, settings: &StepSettings, form: Form, parameters: bool) -> Self {
        let scratch = Scratch::new(scene.model(), settings);
        Self {
            gradients: StepGradients::new(&scratch.model, parameters),
            closed: ClosedScratch::new(scene, settings, form),
            adjoint: ConstraintAdjoint::new(scene.model(), scene.constraints(), parameters),
            divided: Substeps::new(&scratch),
            newton: Vec::new(),
            forces: Vec::new(),
            scratch,
        }
    }

    /// The step forward, in substeps.
    pub fn substeps(
        &mut self,
        scene: &Scene,
        settings: &StepSettings,
        visit: &mut Visitor<'_>,
    ) -> Result<(), (String, Error)> {
        let mut steps = ClosedSteps::new(scene, &mut self.closed);
        self.divided.advance(settings, &mut self.scratch, &mut steps, visit);
        steps.failure.map_or(Ok(()), |failure| Err(named(scene, failure)))
    }

    /// From `gradients.end` to all results of [`StepGradients`], for a whole step or a substep. Returns false for a
    /// whole step that is divided, and the joint and the error if the step fails.
    pub fn step(
        &mut self,
        (scene, settings): (&Scene, &StepSettings),
        scheme: &Scheme,
        is_whole: bool,
    ) -> Result<bool, (String, Error)> {
        let Self { scratch: s, gradients, closed, adjoint, newton, forces, .. } = self;
        let ClosedScratch { rows_of_connections, rows, .. } = closed;
        let mut forward = Constrained { scene, scratch: rows_of_connections, compliance: &settings.compliance };
        let (by, named) = ((settings, scheme), |failure| named(scene, failure));
        s.adopt(settings, scheme);
        forces.clear();
        step(by, s, &mut Recorded { forward: &mut forward, forces });
        let free = s.v_next.clone();
        newton.clear();
        let finished = forward.finish_recorded(settings, s, Some(newton));
        if is_whole && settings.divides && (!(s.short_enough > 0.0) || finished.is_err()) {
            return Ok(false);
        }
        finished.map_err(named)?;
        if let Some(of) = rows.iter().find(|of| is_past(of, s)) {
            let joint = joint_of_row(scene, of.row);
            let upper = s.q_next[of.coordinate].max(s.q[of.coordinate]) > of.upper;
            let found = format!("joint {joint:?} at its {} limit", if upper { "upper" } else { "lower" });
            let expected = format!(
                "a motion within the limits, or {}: stops of joints in closed loops have no gradients",
                in_language("Limits::Report", "limits=\"report\"")
            );
            return Err((joint, Error::argument("limits", found, expected)));
        }
        if let Some(of) = rows.iter().find(|of| of.friction > 0.0 && !(s.v[of.row] * s.v_next[of.row] > 0.0)) {
            let joint = joint_of_row(scene, of.row);
            let expected = format!(
                "joints that slide, or {} in the simulation: joints of closed loops that exact friction holds or stops \
                 have no gradients",
                in_language("Settings::friction_speed(0.01)", "friction_speed=0.01")
            );
            let found = format!("exact friction at joint {joint:?}, which sticks");
            return Err((joint, Error::argument("friction_speed", found, expected)));
        }
        adjoint.begin();
        let noise = std::mem::replace(&mut s.model.system.noise, settings.properties.armature.clone());
        let through = through_projections((scene, settings), s, forward.scratch, (adjoint, newton, &free), gradients);
        s.model.system.noise = noise;
        through.map_err(|error| (String::new(), error))?;
        // Stages without weight have no adjoint.
        forces.truncate(scheme.tableau.last_stage() + 1);
        let mut solver = ClosedBackward { forward, adjoint, forces };
        backward(by, s, gradients, &mut solver, None);
        if let Err(failure) = solver.forward.scratch.take_fault() {
            return Err(named(failure));
        }
        add_scaled(&mut gradients.acting[ARMATURE], 1.0, &adjoint.noise);
        add_scaled(gradients.parameters.as_flattened_mut(), 1.0, adjoint.parameters.as_flattened());
        let mut results = gradients.results();
        results
            .try_for_each(|numbers| scene.check_result("gradients", numbers))
            .map_err(|error| (String::new(), error))?;
        Ok(true)
    }
}

/// The joint and the error of a failed step.
fn named(scene: &Scene, (lost, error): Failure) -> (String, Error) {
    match (lost, error) {
        (Some(lost), _) => {
            let joint = scene.joint_of_body(lost.stage).map(|joint| joint.name.clone()).unwrap_or_default();
            (joint, scene.singular(lost))
        }
        (None, Some(error)) => (String::new(), error),
        (None, None) => (String::new(), Error::argument("q, qd", "a failed step", "rows that simulate recorded")),
    }
}

/// Propagates `gradients.end` through the projections at the end of a step, in place. `free`: the velocities before
/// their projection, whose forces are in the scratch.
fn through_projections(
    (scene, settings): (&Scene, &StepSettings),
    s: &Scratch<f64>,
    closed: &mut ConstrainedScratch,
    (adjoint, newton, free): (&mut ConstraintAdjoint, &[ProjectionStep], &[f64]),
    gradients: &mut StepGradients<f64>,
) -> Result<(), Error> {
    let (system, compliance) = ((&s.model, scene.constraints()), &settings.compliance[..]);
    let ConstrainedScratch { workspace, rows, .. } = closed;
    let [of_q, of_v] = &mut gradients.end;
    let (p, x): (Vec<f64>, Vec<f64>) = (rows.forces.clone(), s.v_next.iter().zip(free).map(|(v, u)| v - u).collect());
    let (moving, change) = ((&s.q_next[..], &s.v_next[..]), Pushed { x: &x, p: &p });
    adjoint
        .of_velocities(system, (workspace, rows), (moving.0, moving.1, change), (of_v, compliance), of_q)
        .map_err(|at| scene.row_fault(at))?;
    // The steps end where the next one would be rounding. Perturbed configurations are moved by this step too.
    adjoint.of_last_step(system, (workspace, rows), moving.0, (of_q, compliance)).map_err(|at| scene.row_fault(at))?;
    let mut of_sum = vec![0.0; p.len()];
    subtract_products(&mut of_sum, compliance, &adjoint.r);
    for made in newton.iter().rev() {
        adjoint
            .of_displacement(system, (workspace, rows), made, (of_q, &mut of_sum, compliance))
            .map_err(|at| scene.row_fault(at))?;
    }
    Ok(())
}
