//! Adjoint of steps of scenes with connections in which joints stick or are at their stops, in the pieces of the step.
//!
//! With the velocities w of the rows S on vertical pieces, and constant torques r of the others, a solution of the law
//! is
//!
//! ```text
//! M (v - v_free) = J* p + s h r,   J v = 0,   v_S = w
//! M y + J* rho + sigma_S = v_bar,   J y = 0,   y_S = 0
//! v_bar* dv = y* (M dv_free - dM (v - v_free) + dJ* p + s h dr) - rho* dJ v + sigma* dw
//! ```
//!
//! with s = 1/2 for mean velocities, so that the rows S, which are constant, are further rows of the [adjoint of the
//! connections](crate::dynamics::constraints). A row on the slope b of its control law is one with the compliance 1/(s
//! h b): r = c - b v, so that `y_S` = sigma/(s h b).

use super::backward::{ACTING, FRICTION, RATE, TARGET, TORQUE};
use super::closed_stops::{Displacement, LawSolution, StopRecord};
use super::constrained::{ConstrainedScratch, solution_of_stuck};
use super::manifold::advance_cotangents;
use super::modes::STUCK_NOISE;
use super::scratch::{KD, KP, Scratch};
use super::step_settings::StepSettings;
use crate::dynamics::constraints::{ConstraintAdjoint, Pushed, RowFault, project_velocities};
use crate::dynamics::{factorise, solve};
use crate::scene::Scene;
use nalgebra::{DMatrix, DVector};

/// The scratch of the step, and the gradients by its start and by the velocities without friction and stops, those at
/// the end and the mean ones.
pub(super) struct StopReverse<'a> {
    pub scene: &'a Scene,
    pub settings: &'a StepSettings,
    /// Length of the step, s.
    pub h: f64,
    pub closed: &'a mut ConstrainedScratch,
    pub adjoint: &'a mut ConstraintAdjoint,
    pub by_q: Vec<f64>,
    pub by_v: Vec<f64>,
    pub by_free: Vec<f64>,
    pub by_mean: Vec<f64>,
    /// As in [`StepGradients`](super::backward::StepGradients).
    pub acting: [Vec<f64>; ACTING],
}

impl StopReverse<'_> {
    /// Propagates the gradients by the end of a step, which is in the scratch with the forces of its last projection.
    pub fn through(
        &mut self,
        s: &mut Scratch<f64>,
        record: &StopRecord,
        [of_q, of_v]: &mut [Vec<f64>; 2],
    ) -> Result<(), RowFault> {
        let (h, compliance, constraints) = (self.h, &self.settings.given.compliance[..], self.scene.constraints());
        let StopRecord { free, mean, displacements, last, .. } = record;
        if displacements.last().is_some_and(|last| last.end.is_some()) {
            let free_rows = lock(s, &last.locked);
            let ConstrainedScratch { workspace, rows, .. } = &mut *self.closed;
            let p = rows.forces.clone();
            let x: Vec<f64> = s.v_next.iter().zip(&last.velocities).map(|(v, u)| v - u).collect();
            let moving = (&s.q_next[..], &s.v_next[..], Pushed { x: &x, p: &p });
            let system = (&s.model, constraints);
            self.adjoint.of_velocities(system, (workspace, rows), moving, (of_v, compliance), of_q)?;
            s.model.system.noise = free_rows;
        }
        self.law(s, (free, last), of_v)?;
        // Cotangents of the end of a displacement, and of the curvature along it.
        let (mut of_end, mut of_bent) = (of_q.clone(), vec![0.0; s.v.len()]);
        for Displacement { solution, newton, end } in displacements.iter().rev() {
            let free_rows = lock(s, &solution.locked);
            let (system, ConstrainedScratch { workspace, rows, .. }) = ((&s.model, constraints), &mut *self.closed);
            if let Some(end) = end {
                factorise(system.0, workspace, end);
                rows.factorise(system, workspace, end, compliance)?;
                self.adjoint.of_last_step(system, (workspace, rows), end, (&mut of_end, compliance));
            }
            let mut of_sum = vec![0.0; constraints.rows];
            for step in newton.iter().rev() {
                self.adjoint.of_displacement(
                    system,
                    (workspace, rows),
                    step,
                    (&mut of_end, &mut of_sum, compliance),
                )?;
            }
            s.model.system.noise = free_rows;
            let x: Vec<f64> = solution.velocities.iter().map(|v| h * v).collect();
            let mut of_x = vec![0.0; x.len()];
            advance_cotangents(&s.model, &x, &of_end, (&mut self.by_q, &mut of_x));
            let of_velocities: Vec<f64> = of_x.iter().zip(&of_bent).map(|(x, bent)| h * x - bent).collect();
            for ((by_q, of_end), bent) in self.by_q.iter_mut().zip(&mut of_end).zip(&of_bent) {
                *by_q -= bent / h;
                *of_end = 0.0;
            }
            of_bent = self.law(s, (mean, solution), &of_velocities)?;
            for (of_end, bent) in of_end.iter_mut().zip(&of_bent) {
                *of_end = bent / h;
            }
        }
        Ok(())
    }

    /// Propagates the cotangent of the velocities of a solution of the law. Returns the gradients by the curvature of
    /// the connections at its rows.
    fn law(
        &mut self,
        s: &Scratch<f64>,
        (free, solution): (&[f64], &LawSolution),
        of_v: &[f64],
    ) -> Result<Vec<f64>, RowFault> {
        let Self { scene, settings, h, closed, adjoint, by_q, by_v, by_free, by_mean, .. } = self;
        let (compliance, system) = (&settings.given.compliance[..], (&s.model, scene.constraints()));
        let (whole, h) = (*h, solution.share * *h);
        let ConstrainedScratch { workspace, rows, .. } = &mut **closed;
        let stuck = &solution.stuck;
        // The forces of the connections.
        factorise(system.0, workspace, &s.q);
        let (torque, mut moved) = (solution.torques.iter().map(|r| h * r).collect::<Vec<_>>(), vec![0.0; of_v.len()]);
        solve(system.0, workspace, &torque, &mut moved);
        moved.iter_mut().zip(free).for_each(|(v, free)| *v += free);
        project_velocities(system, workspace, rows, (&s.q, &mut moved), compliance)?;
        let p = rows.forces.clone();
        let x: Vec<f64> = solution.velocities.iter().zip(free).map(|(v, free)| v - free).collect();

        let mut right = of_v.to_vec();
        let mut solved = |right: &[f64], adjoint: &mut ConstraintAdjoint| {
            adjoint.solve(system.0, (&mut *workspace, &mut *rows), (right, &[]), compliance);
            DVector::from_iterator(stuck.len(), stuck.iter().map(|of| adjoint.y[of.row]))
        };
        let wanted = solved(&right, adjoint);
        let mut g = DMatrix::zeros(stuck.len(), stuck.len());
        let mut unit = vec![0.0; of_v.len()];
        for (a, of) in stuck.iter().enumerate() {
            unit[of.row] = 1.0;
            g.set_column(a, &solved(&unit, adjoint));
            g[(a, a)] += of.compliance;
            unit[of.row] = 0.0;
        }
        let sigma = solution_of_stuck(g.clone(), g.amax(), |sigma| &wanted - &g * sigma);
        for (of, sigma) in stuck.iter().zip(&sigma) {
            right[of.row] -= sigma;
        }
        solved(&right, adjoint);
        let mut of_free = right;
        let (y, velocities) = (adjoint.y.clone(), &solution.velocities[..]);
        let change = Pushed { x: &x, p: &p };
        adjoint.of_solved_velocities(system, workspace, (&s.q, velocities, change), &mut of_free, by_q)?;
        let by_free = if solution.share < 1.0 { by_mean } else { by_free };
        by_free.iter_mut().zip(&of_free).for_each(|(sum, more)| *sum += more);
        let mut of_bent = vec![0.0; y.len()];
        for (of, sigma) in stuck.iter().zip(&sigma) {
            by_q[of.row] += sigma * of.slopes[0];
            by_v[of.row] += sigma * of.slopes[1];
            of_bent[of.row] += sigma * of.by_bent;
        }
        // Constant torques, also those of rows on the slope of a control law.
        for (row, &friction) in settings.properties.friction.iter().enumerate().filter(|(_, f)| **f > 0.0) {
            if stuck.iter().all(|of| of.row != row || of.compliance > 0.0) {
                self.acting[FRICTION][row] += h * y[row] * solution.rubbing[row] / friction;
            }
        }
        let mut of_displaced = vec![0.0; y.len()];
        for of in stuck.iter().filter(|of| of.compliance > 0.0 && !solution.at_limit.contains(&of.row)) {
            of_displaced[of.row] = -h * y[of.row] * s.gains[KP][of.row];
            self.acting[RATE][of.row] += h * y[of.row] * s.gains[KD][of.row];
        }
        // Over the mean velocity u, a law that declines with that at the end, 2 u - v, depends on that at the start.
        for of in stuck.iter().filter(|of| of.compliance > 0.0 && solution.share < 1.0) {
            let by_position = if solution.at_limit.contains(&of.row) { 0.0 } else { whole * s.gains[KP][of.row] };
            self.by_v[of.row] += h * y[of.row] * 0.5 * (1.0 / (h * of.compliance) - by_position);
        }
        for (body, stage) in s.model.bodies.iter().zip(&s.model.system.stages) {
            let (row, ends) = (stage.first_row, (&s.target[body.q..], &s.q[body.q..]));
            if of_displaced[row..row + stage.rows.count()].iter().any(|x| *x != 0.0) {
                body.motion.displacement_cotangent(ends, &of_displaced[row..], &mut by_q[row..]);
                body.motion.rest_cotangent(ends, &of_displaced[row..], &mut self.acting[TARGET][row..]);
            }
        }
        // At a limit of the sum, the applied torque has no effect.
        for &row in solution.at_limit.iter().filter(|_| settings.limits_sum) {
            self.acting[TORQUE][row] -= h * y[row];
        }
        Ok(of_bent)
    }
}

/// Locks joints, so that projections do not move them. Returns the noise before.
fn lock(s: &mut Scratch<f64>, rows: &[usize]) -> Vec<f64> {
    let before = s.model.system.noise.clone();
    for &row in rows {
        s.model.system.noise[row] = STUCK_NOISE;
    }
    before
}
