//! Products with the derivatives of forward dynamics through connections, and adjoints of the projections onto
//! connections, in O(N + m^2 depth + m^3).
//!
//! All of them solve linear systems with M, J and the compliance c of the rows:
//!
//! ```text
//! M x - J* p = f,    J x + c p = g
//! ```
//!
//! For cotangents `x_bar` and `p_bar` of the solution, with y and r such that
//!
//! ```text
//! M y + J* r = x_bar,    J y - c r = -p_bar
//! x_bar* dx + p_bar* dp = y* (df - dM x + dJ* p) + r* (dg - dJ x)
//! ```
//!
//! so that a gradient costs one more solution of such a system, one reverse product of inverse dynamics, and the
//! [gradients of the rows](super::products). If rows are dependent, p and r are those of the pseudoinverse; x and its
//! gradients do not depend on that choice. Combinations of rows that count as dependent by the tolerance of the scene
//! are differentiated as constant.

use super::RowFault;
use super::products::RowGradients;
use super::projection::{ProjectionStep, share};
use super::rows::rates_of_rows;
use super::scratch::ConstraintScratch;
use crate::dynamics;
use crate::dynamics::derivatives::{
    Constants, Directions, Parameters, ProductScratch, inverse_dynamics_jvp, inverse_dynamics_vjp,
};
use crate::kinematics::propagation::tip_to_base;
use crate::model::Model;
use crate::scene::constraint::Constraints;
use crate::workspace::Workspace;
use nalgebra::{Vector3, Vector6};

/// Scratch of the adjoints, for one model, and the sums of the gradients by its constants.
#[derive(Debug)]
pub(crate) struct ConstraintAdjoint {
    rows: RowGradients,
    products: ProductScratch<f64>,
    /// The model without gravity, for products with M.
    weightless: Model<f64>,
    rest: Vec<f64>,
    /// y and r of the last adjoint.
    pub y: Vec<f64>,
    pub r: Vec<f64>,
    of_product: Vec<f64>,
    of_parameters: Vec<Parameters<f64>>,
    /// Sums of the projections since [`ConstraintAdjoint::begin`]: by the noise of the rows of M, (nv), and by the
    /// inertial parameters; empty if they are not requested.
    pub noise: Vec<f64>,
    pub parameters: Vec<Parameters<f64>>,
}

/// A solution of a projection: M x = J* p.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pushed<'a> {
    pub x: &'a [f64],
    pub p: &'a [f64],
}

impl ConstraintAdjoint {
    pub fn new(model: &Model<f64>, constraints: &Constraints, parameters: bool) -> Self {
        let zeros = || vec![0.0; model.nv()];
        let bodies = if parameters { model.bodies.len() } else { 0 };
        let mut weightless = model.clone();
        weightless.gravity = Vector3::zeros();
        Self {
            rows: RowGradients::new(model),
            products: ProductScratch::new(model),
            weightless,
            rest: zeros(),
            y: zeros(),
            r: vec![0.0; constraints.rows],
            of_product: vec![0.0; 3 * model.nv()],
            of_parameters: vec![[0.0; 10]; bodies],
            noise: zeros(),
            parameters: vec![[0.0; 10]; bodies],
        }
    }

    /// Sets the sums to zero.
    pub fn begin(&mut self) {
        self.noise.fill(0.0);
        self.parameters.as_flattened_mut().fill(0.0);
    }

    /// Gradients by q, qd and tau of cotangent* qdd, (3 nv) into `out`, and the requested ones by constants, at a state
    /// of [`constrained_dynamics`](super::constrained_dynamics) with the accelerations `qdd` and the forces in the
    /// scratch.
    pub fn of_dynamics(
        &mut self,
        system: (&Model<f64>, &Constraints),
        (workspace, scratch): (&mut Workspace<f64>, &mut ConstraintScratch),
        (q, qd, qdd): (&[f64], &[f64], &[f64]),
        (wrenches, cotangent, compliance): (&[Vector6<f64>], &[f64], &[f64]),
        (constants, out): (&mut Constants<'_, f64>, &mut [f64]),
    ) -> Result<(), RowFault> {
        dynamics::factorise(system.0, workspace, q);
        scratch.factorise(system, workspace, q, compliance)?;
        self.solve(system, (workspace, scratch), q, (cotangent, &[]), compliance)?;
        let Self { rows, products, y, r, .. } = self;
        let negative: Vec<f64> = y.iter().map(|y| -y).collect();
        inverse_dynamics_vjp(system.0, workspace, products, (q, qd, qdd), wrenches, &negative, (constants, out));
        let (by_q, rest) = out.split_at_mut(y.len());
        let (by_qd, by_tau) = rest.split_at_mut(y.len());
        by_tau.copy_from_slice(y);
        let shifts = &workspace.store.shifts;
        rows.add_row_gradient(system, shifts, (q, y), &scratch.forces, by_q)?;
        let multipliers: Vec<f64> = r.iter().map(|r| -r).collect();
        rows.add_acceleration_gradient(system, shifts, (q, qd, qdd), &multipliers, [by_q, by_qd])
    }

    /// The change of qdd along a direction, (nv) into `out`, at a state of
    /// [`constrained_dynamics`](super::constrained_dynamics) with rigid connections:
    /// M dqdd - J* dp = dtau - dID + dJ* p, J dqdd = -d(J qdd + J' qd), with the change dID of inverse dynamics at
    /// constant qdd.
    pub fn along_dynamics(
        &mut self,
        system: (&Model<f64>, &Constraints),
        (workspace, scratch): (&mut Workspace<f64>, &mut ConstraintScratch),
        state: (&[f64], &[f64], &[f64]),
        (wrenches, along): (&[Vector6<f64>], &Directions<'_, f64>),
        out: &mut [f64],
    ) -> Result<(), RowFault> {
        let Self { rows, products, rest, of_product, .. } = self;
        let unaccelerated = Directions { u: rest, ..*along };
        inverse_dynamics_jvp(system.0, workspace, products, state, wrenches, &unaccelerated, out);
        dynamics::factorise(system.0, workspace, state.0);
        scratch.factorise(system, workspace, state.0, &[])?;
        let (mut of_rows, of_torques) = (vec![0.0; system.1.rows], &mut of_product[..out.len()]);
        let (shifts, directions) = (&workspace.store.shifts, ([along.q, along.qd], &scratch.forces[..]));
        rows.along(system, shifts, state, directions, [&mut of_rows, of_torques])?;
        for ((out, dtau), of_torque) in out.iter_mut().zip(along.u).zip(of_torques) {
            *out = dtau - *out + *of_torque;
        }
        self.solve(system, (workspace, scratch), state.0, (out, &of_rows), &[])?;
        out.copy_from_slice(&self.y);
        Ok(())
    }

    /// y and r of the adjoint of [`ConstraintAdjoint::of_dynamics`] for the cotangent of qdd, and their changes along
    /// dq, with the factors of M and of the rows at `q`.
    #[allow(clippy::type_complexity)] // two vectors and their changes
    pub fn along_adjoint(
        &mut self,
        system: (&Model<f64>, &Constraints),
        (workspace, scratch): (&mut Workspace<f64>, &mut ConstraintScratch),
        (q, dq): (&[f64], &[f64]),
        cotangent: &[f64],
    ) -> Result<([Vec<f64>; 2], [Vec<f64>; 2]), RowFault> {
        self.solve(system, (workspace, scratch), q, (cotangent, &[]), &[])?;
        let solution = [self.y.clone(), self.r.clone()];
        let Self { rows, products, weightless, rest, y, r, .. } = self;
        let (mut right, mut of_rows, mut of_torques) = (vec![0.0; y.len()], vec![0.0; r.len()], vec![0.0; y.len()]);
        let along = Directions { q: dq, qd: rest, u: rest, ..Directions::default() };
        inverse_dynamics_jvp(weightless, workspace, products, (q, rest, y), &[], &along, &mut right);
        let (shifts, directions) = (&workspace.store.shifts, ([dq, &rest[..]], &r[..]));
        rows.along(system, shifts, (q, rest, y), directions, [&mut of_rows, &mut of_torques])?;
        right.iter_mut().zip(&of_torques).for_each(|(right, more)| *right = -(*right + more));
        self.solve(system, (workspace, scratch), q, (&right, &of_rows), &[])?;
        Ok((solution, [self.y.clone(), self.r.clone()]))
    }

    /// One Newton step x = M^-1 J* p, p = -(G + c)^+ (error + c sum of the steps before), at `q`: adds the gradient by
    /// q to `by_q`, from the cotangents of x and of p. That of the sum is -c r.
    fn of_position_step(
        &mut self,
        system: (&Model<f64>, &Constraints),
        (workspace, scratch): (&mut Workspace<f64>, &mut ConstraintScratch),
        (q, step): (&[f64], Pushed<'_>),
        (of_x, of_p, compliance): (&[f64], &[f64], &[f64]),
        by_q: &mut [f64],
    ) -> Result<(), RowFault> {
        dynamics::factorise(system.0, workspace, q);
        scratch.factorise(system, workspace, q, compliance)?;
        self.solve(system, (workspace, scratch), q, (of_x, of_p), compliance)?;
        self.add_response(system, workspace, q, step, step.x, by_q)?;
        let negative: Vec<f64> = self.r.iter().map(|r| -r).collect();
        scratch.add_torques(system.0, workspace, &negative, by_q);
        Ok(())
    }

    /// One Newton step with its displacement, as [`record_projection`](super::record_projection) makes it: from the
    /// cotangents of its end and of the sum of forces after it (empty for zero) to those before it, in place.
    pub fn of_displacement(
        &mut self,
        system: (&Model<f64>, &Constraints),
        room: (&mut Workspace<f64>, &mut ConstraintScratch),
        step: &ProjectionStep,
        (of_q, of_sum, compliance): (&mut [f64], &mut [f64], &[f64]),
    ) -> Result<(), RowFault> {
        let ProjectionStep { q, x, p } = step;
        let (share, step) = (share(x), Pushed { x, p });
        let moved: Vec<f64> = x.iter().map(|x| share * x).collect();
        let (mut of_start, mut of_x) = (vec![0.0; x.len()], vec![0.0; x.len()]);
        for (body, stage) in system.0.bodies.iter().zip(&system.0.system.stages) {
            let row = stage.first_row;
            body.motion.advance_cotangents(&moved[row..], &of_q[row..], &mut of_start[row..], &mut of_x[row..]);
        }
        let of_share: f64 = of_x.iter().zip(x).chain(of_sum.iter().zip(p)).map(|(bar, x)| bar * x).sum();
        for bar in &mut of_x {
            *bar *= share;
        }
        let of_p: Vec<f64> = of_sum.iter().map(|bar| share * bar).collect();
        if share < 1.0
            && let Some(longest) = (0..x.len()).max_by(|&i, &j| x[i].abs().total_cmp(&x[j].abs()))
        {
            of_x[longest] -= of_share * share / x[longest];
        }
        self.of_position_step(system, room, (q, step), (&of_x, &of_p, compliance), &mut of_start)?;
        subtract_products(of_sum, compliance, &self.r);
        of_q.copy_from_slice(&of_start);
        Ok(())
    }

    /// The projection of velocities, v + x with x = M^-1 J* p, at `q`: from the cotangent of its result to that of v,
    /// in place. Adds the gradient by q to `by_q`.
    pub fn of_velocities(
        &mut self,
        system: (&Model<f64>, &Constraints),
        (workspace, scratch): (&mut Workspace<f64>, &mut ConstraintScratch),
        (q, projected, change): (&[f64], &[f64], Pushed<'_>),
        (of_v, compliance): (&mut [f64], &[f64]),
        by_q: &mut [f64],
    ) -> Result<(), RowFault> {
        dynamics::factorise(system.0, workspace, q);
        scratch.factorise(system, workspace, q, compliance)?;
        self.solve(system, (workspace, scratch), q, (of_v, &[]), compliance)?;
        self.add_response(system, workspace, q, change, projected, by_q)?;
        let negative: Vec<f64> = self.r.iter().map(|r| -r).collect();
        scratch.add_torques(system.0, workspace, &negative, of_v);
        Ok(())
    }

    /// A Newton step from a configuration that satisfies the connections, with the factors of M and of the rows at `q`:
    /// from the cotangent of its result to that of `q`, in place. The cotangent of the sum of forces is -c r.
    pub fn of_last_step(
        &mut self,
        system: (&Model<f64>, &Constraints),
        (workspace, scratch): (&mut Workspace<f64>, &mut ConstraintScratch),
        q: &[f64],
        (of_q, compliance): (&mut [f64], &[f64]),
    ) -> Result<(), RowFault> {
        self.solve(system, (workspace, scratch), q, (of_q, &[]), compliance)?;
        let negative: Vec<f64> = self.r.iter().map(|r| -r).collect();
        scratch.add_torques(system.0, workspace, &negative, of_q);
        Ok(())
    }

    /// y and r for the cotangents of x and of p (empty for zero), with the factors of M and of the rows at `q`.
    pub fn solve(
        &mut self,
        (model, constraints): (&Model<f64>, &Constraints),
        (workspace, scratch): (&mut Workspace<f64>, &mut ConstraintScratch),
        q: &[f64],
        (of_x, of_p): (&[f64], &[f64]),
        compliance: &[f64],
    ) -> Result<(), RowFault> {
        let Self { y, r, .. } = self;
        dynamics::solve(model, workspace, of_x, y);
        if r.is_empty() {
            return Ok(());
        }
        r.fill(0.0);
        let (mut left, mut step) = (vec![0.0; r.len()], vec![0.0; r.len()]);
        // The second solution removes the rounding errors of the first.
        for _ in 0..2 {
            rates_of_rows(model, constraints, (q, y), &mut left)?;
            left.iter_mut().zip(of_p).for_each(|(left, of_p)| *left += of_p);
            for ((left, c), r) in left.iter_mut().zip(compliance).zip(&*r) {
                *left -= c * r;
            }
            scratch.inverse.apply(&left, &mut step);
            r.iter_mut().zip(&step).for_each(|(r, step)| *r += step);
            scratch.spread(&step);
            scratch.respond(model, workspace);
            y.iter_mut().zip(&scratch.estimates).for_each(|(y, change)| *y -= change);
        }
        Ok(())
    }

    /// Adds the gradients of -y* M(q) x + p* J(q) y - r* J(q) along.
    pub fn add_response(
        &mut self,
        system: (&Model<f64>, &Constraints),
        workspace: &mut Workspace<f64>,
        q: &[f64],
        Pushed { x, p }: Pushed<'_>,
        along: &[f64],
        by_q: &mut [f64],
    ) -> Result<(), RowFault> {
        let Self { rows, products, weightless, rest, y, r, of_product, of_parameters, noise, parameters } = self;
        let constants = &mut Constants { parameters: of_parameters, ..Constants::default() };
        inverse_dynamics_vjp(weightless, workspace, products, (q, rest, x), &[], y, (constants, of_product));
        by_q.iter_mut().zip(&*of_product).for_each(|(sum, more)| *sum -= more);
        let sums = parameters.as_flattened_mut().iter_mut();
        sums.zip(of_parameters.as_flattened()).for_each(|(sum, more)| *sum -= more);
        for ((noise, y), x) in noise.iter_mut().zip(&*y).zip(x) {
            *noise -= y * x;
        }
        let shifts = &workspace.store.shifts;
        rows.add_row_gradient(system, shifts, (q, y), p, by_q)?;
        let negative: Vec<f64> = r.iter().map(|r| -r).collect();
        rows.add_row_gradient(system, shifts, (q, along), &negative, by_q)
    }
}

/// sum -= c r, entry by entry; an empty c is zero.
pub(crate) fn subtract_products(sum: &mut [f64], c: &[f64], r: &[f64]) {
    for ((sum, c), r) in sum.iter_mut().zip(c).zip(r) {
        *sum -= c * r;
    }
}

impl ConstraintScratch {
    /// Adds J* multipliers to `out`, (nv), with the rows of the last factorization and phi of the workspace. O(N + m).
    fn add_torques(&mut self, model: &Model<f64>, workspace: &Workspace<f64>, multipliers: &[f64], out: &mut [f64]) {
        self.spread(multipliers);
        out.iter_mut().zip(&self.torque).for_each(|(sum, more)| *sum += more);
        let (stages, mut forces) = (&model.system.stages, self.wrenches.clone());
        tip_to_base(stages, &workspace.store.shifts, (0..stages.len()).rev(), &mut forces, |k, force| {
            let stage = &stages[k];
            for entry in 0..stage.rows.count() {
                out[stage.first_row + entry] += stage.rows.row(entry).project(force);
            }
        });
    }
}
