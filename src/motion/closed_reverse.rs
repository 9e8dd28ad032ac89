//! Adjoint of one step of a scene with connections: the projections of velocities and positions at its end, each by
//! implicit functions, then the stages with their constrained accelerations.
//!
//! Every Newton step of the projection of positions is differentiated: its result is that of least kinetic energy to
//! first order only, and depends on the steps beyond.

use super::backward::{
    ARMATURE, BackwardSolver, FRICTION, RATE, StageGradients, StepGradients, TARGET, TORQUE, backward,
};
use super::checked::CheckedState;
use super::closed_steps::ClosedScratch;
use super::closed_stop_reverse::StopReverse;
use super::closed_stops::{StopRecord, is_past};
use super::constrained::{Constrained, ConstrainedScratch, named};
use super::events::Reversal;
use super::method::Scheme;
use super::scratch::{Scratch, add_scaled, clear};
use super::solver::Solver;
use super::step::step;
use super::step_settings::StepSettings;
use crate::batch::accelerations::KernelArguments;
use crate::batch::instruction_set::Baseline;
use crate::dynamics::constraints::{ConstraintAdjoint, ProjectionStep, Pushed, RowFault, subtract_products};
use crate::dynamics::derivatives::Constants;
use crate::error::Error;
use crate::filter::Form;
use crate::scene::Scene;

/// One state.
pub(super) struct ClosedReverse {
    pub one: CheckedState,
    pub gradients: StepGradients<f64>,
    adjoint: ConstraintAdjoint,
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
    fn solve(&mut self, estimates: bool, call: KernelArguments<'_, f64>) -> u64 {
        if estimates {
            // The first stage, also of a step that is made again.
            self.forces.clear();
        }
        let lanes = self.forward.solve(estimates, call);
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
    fn gradients(&mut self, call: KernelArguments<'_, f64>, to: StageGradients<'_, f64>) -> u64 {
        let StageGradients { cotangent, parameters, out } = to;
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
        let one = CheckedState::new(scene, settings, form);
        Self {
            gradients: StepGradients::new(&one.scratch.model, settings, parameters),
            adjoint: ConstraintAdjoint::new(scene.model(), scene.constraints(), parameters),
            newton: Vec::new(),
            forces: Vec::new(),
            one,
        }
    }

    /// The accelerations at the end of the step in the scratch, at its last velocities, in a step of h without friction
    /// and stops.
    pub fn accelerations_after(
        &mut self,
        scene: &Scene,
        settings: &StepSettings,
        scheme: &Scheme,
    ) -> Result<Vec<f64>, (String, Error)> {
        let CheckedState { scratch: s, closed: Some(closed), .. } = &mut self.one else { return Ok(Vec::new()) };
        let ClosedScratch { rows_of_connections: scratch, without, .. } = closed;
        let mut solver = Constrained { scene, scratch, compliance: &settings.given.compliance };
        let end = (s.q_next.clone(), s.v_next.clone());
        let (q, v) = (std::mem::replace(&mut s.q, end.0), std::mem::replace(&mut s.v, end.1));
        clear(&mut s.dry);
        step(Baseline, (without, scheme), s, &mut solver);
        let finished = solver.finish(without, s, None);
        let accelerations = s.v_next.iter().zip(&s.v).map(|(next, v)| (next - v) / scheme.step).collect();
        (s.q, s.v) = (q, v);
        finished.map(|()| accelerations).map_err(|failure| named(scene, failure))
    }

    /// From `gradients.end` to all results of [`StepGradients`], for a whole step or a substep. Returns false for a
    /// whole step that is or can be divided, and the joint and the error if the step fails.
    pub fn step(
        &mut self,
        (scene, settings): (&Scene, &StepSettings),
        scheme: &Scheme,
        is_whole: bool,
    ) -> Result<bool, (String, Error)> {
        let Self { one, gradients, adjoint, newton, forces } = self;
        let CheckedState { scratch: s, closed: Some(closed), .. } = one else { return Ok(false) };
        let ClosedScratch { rows_of_connections, rows, without, .. } = closed;
        let mut forward = Constrained { scene, scratch: rows_of_connections, compliance: &settings.given.compliance };
        let (mut by, named) = ((settings, scheme), |failure| named(scene, failure));
        s.adopt(settings, scheme);
        forces.clear();
        step(Baseline, by, s, &mut Recorded { forward: &mut forward, forces });
        let mut free = s.v_next.clone();
        newton.clear();
        let finished = forward.finish(settings, s, Some(newton));
        let acts = !(s.consistent > 0.0) || rows.iter().any(|of| is_past(of, s));
        if is_whole && settings.divides && (acts || !(s.short_enough > 0.0) || finished.is_err()) {
            return Ok(false);
        }
        finished.map_err(named)?;
        if acts && !settings.set_valued.is_empty() {
            by.0 = without;
            clear(&mut s.dry);
            s.release_drives(settings, scheme.implicit_step());
            forces.clear();
            step(Baseline, by, s, &mut Recorded { forward: &mut forward, forces });
            free.copy_from_slice(&s.v_next);
            newton.clear();
            forward.finish(settings, s, Some(newton)).map_err(named)?;
        }
        let end =
            Projected { q: s.q_next.clone(), v: s.v_next.clone(), free, forces: forward.scratch.rows.forces.clone() };
        let mut record = acts.then(StopRecord::default);
        if let Some(record) = &mut record {
            forward.stop(settings, rows, (s, (scheme.step, 0.0, &mut Vec::new())), record).map_err(named)?;
            if !settings.limited.is_empty() && record.rebound(s, scheme.step).is_some() {
                let expected =
                    "restitution 0, or a control law without limits of effort, for gradients in closed loops";
                let error = Error::argument("restitution", settings.given.restitution.to_string(), expected);
                return Err((String::new(), error));
            }
            if record.kept < 1.0 {
                let expected = "rebounds that leave the kinetic energy below that before, or a smaller restitution: a \
                                rebound that the energy limits has no gradient";
                let error = Error::argument("restitution", settings.given.restitution.to_string(), expected);
                return Err((String::new(), error));
            }
        }
        adjoint.begin();
        let noise = std::mem::replace(&mut s.model.system.noise, settings.properties.armature.clone());
        let nv = s.v.len();
        let mut stopped = StopReverse {
            scene,
            settings,
            h: scheme.step,
            closed: forward.scratch,
            adjoint,
            by_q: vec![0.0; nv],
            by_v: vec![0.0; nv],
            by_free: vec![0.0; nv],
            by_mean: vec![0.0; nv],
            acting: std::array::from_fn(|_| vec![0.0; nv]),
        };
        let (mut through, mut of_reversals) = (Ok(()), vec![0.0; nv]);
        gradients.end_increment.clear();
        if let Some(record) = &record {
            Reversal::add(&record.reversals, &gradients.end[1], &mut of_reversals);
            through = stopped.through(s, record, &mut gradients.end);
            clear(&mut gradients.end[0]);
            gradients.end[1].copy_from_slice(&stopped.by_free);
            gradients.end_increment = stopped.by_mean.iter().map(|x| x / scheme.step).collect();
        }
        let StopReverse { by_q, by_v, acting, .. } = stopped;
        let through = through.and_then(|()| {
            through_projections((scene, settings), s, forward.scratch, (adjoint, newton, &end), gradients)
        });
        s.model.system.noise = noise;
        through.map_err(|at| (String::new(), scene.row_fault(at)))?;
        // Stages without weight have no adjoint.
        forces.truncate(scheme.tableau.last_stage() + 1);
        let mut solver = ClosedBackward { forward, adjoint, forces };
        s.are_sides_given = true;
        backward(Baseline, by, s, gradients, &mut solver, None);
        s.are_sides_given = false;
        if let Err(failure) = solver.forward.scratch.take_fault() {
            return Err(named(failure));
        }
        add_scaled(&mut gradients.acting[ARMATURE], 1.0, &adjoint.noise);
        add_scaled(gradients.parameters.as_flattened_mut(), 1.0, adjoint.parameters.as_flattened());
        for which in [FRICTION, TARGET, RATE, TORQUE] {
            add_scaled(&mut gradients.acting[which], 1.0, &acting[which]);
        }
        for (which, more) in [(0, by_q), (1, by_v), (1, of_reversals)] {
            add_scaled(&mut gradients.start[which], 1.0, &more);
        }
        gradients.check(scene).map(|()| true)
    }
}

/// The end of a step without stops: its projection, and the velocities before with the forces that project them.
struct Projected {
    q: Vec<f64>,
    v: Vec<f64>,
    free: Vec<f64>,
    forces: Vec<f64>,
}

/// Propagates `gradients.end` through the projections at the end of a step, in place.
fn through_projections(
    (scene, settings): (&Scene, &StepSettings),
    s: &Scratch<f64>,
    closed: &mut ConstrainedScratch,
    (adjoint, newton, end): (&mut ConstraintAdjoint, &[ProjectionStep], &Projected),
    gradients: &mut StepGradients<f64>,
) -> Result<(), RowFault> {
    let (system, compliance) = ((&s.model, scene.constraints()), &settings.given.compliance[..]);
    let ConstrainedScratch { workspace, rows, .. } = closed;
    let [of_q, of_v] = &mut gradients.end;
    let x: Vec<f64> = end.v.iter().zip(&end.free).map(|(v, u)| v - u).collect();
    let change = Pushed { x: &x, p: &end.forces };
    adjoint.of_velocities(system, (workspace, rows), (&end.q, &end.v, change), (of_v, compliance), of_q)?;
    // The steps end where the next one would be rounding. Perturbed configurations are moved by this step too.
    adjoint.of_last_step(system, (workspace, rows), &end.q, (of_q, compliance));
    let mut of_sum = vec![0.0; end.forces.len()];
    subtract_products(&mut of_sum, compliance, &adjoint.r);
    for made in newton.iter().rev() {
        adjoint.of_displacement(system, (workspace, rows), made, (of_q, &mut of_sum, compliance))?;
    }
    Ok(())
}
