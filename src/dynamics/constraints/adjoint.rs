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
use super::scratch::ConstraintScratch;
use crate::dynamics;
use crate::dynamics::derivatives::{
    Constants, Directions, Parameters, ProductScratch, inverse_dynamics_jvp, inverse_dynamics_vjp,
};
use crate::dynamics::forces::Motion;
use crate::kinematics::manifold::advance_cotangents;
use crate::model::Model;
use crate::scalar::Real;
use crate::scene::constraint::Constraints;
use crate::spatial::RigidShift;
use crate::workspace::Workspace;
use nalgebra::{Vector3, Vector6};
use std::ops::{Deref, DerefMut};

/// Destinations of gradients: by constants, and by (q, qd, qdd), (3 nv).
pub(crate) type Results<'a, 'c, T> = (&'a mut Constants<'c, T>, &'a mut [T]);

/// Products with the derivatives of inverse dynamics and of the rows at one configuration.
pub(crate) trait RowProducts<T: Real> {
    /// Gradients of cotangent* tau of inverse dynamics.
    fn gradients_of_torques(&mut self, motion: Motion<'_, T>, cotangent: &[T], results: Results<'_, '_, T>);

    /// The same of M x, for the motion (0, x), without gravity.
    fn gradients_of_inertia(&mut self, motion: [&[T]; 2], cotangent: &[T], results: Results<'_, '_, T>);

    /// [`RowGradients::add_acceleration_gradient`] at the motion (qd, qdd).
    fn add_row_gradients(
        &mut self,
        rows: &mut RowGradients<T>,
        motion: [&[T]; 2],
        multipliers: &[T],
        by: [&mut [T]; 2],
    ) -> Result<(), RowFault>;
}

/// The gradients through a solution of M x - J* p = f, J x + c p = g, from y and r of its adjoint.
#[derive(Debug)]
pub(crate) struct SolutionGradients<T: Real> {
    rows: RowGradients<T>,
    rest: Vec<T>,
    unused: Vec<T>,
    /// y and r of the last adjoint.
    pub y: Vec<T>,
    pub r: Vec<T>,
    negative: [Vec<T>; 2],
    of_product: Vec<T>,
    of_parameters: Vec<Parameters<T>>,
    /// Sums of the projections since [`SolutionGradients::begin`]: by the noise of the rows of M, (nv), and by the
    /// inertial parameters; empty if they are not requested.
    pub noise: Vec<T>,
    pub parameters: Vec<Parameters<T>>,
}

/// A solution of a projection: M x = J* p.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pushed<'a, T = f64> {
    pub x: &'a [T],
    pub p: &'a [T],
}

impl<T: Real> SolutionGradients<T> {
    pub fn new(model: &Model<T>, constraints: &Constraints, parameters: bool) -> Self {
        let (zeros, of_rows) = (|| vec![T::zero(); model.nv()], || vec![T::zero(); constraints.rows]);
        let bodies = if parameters { model.bodies.len() } else { 0 };
        Self {
            rows: RowGradients::new((model, constraints)),
            rest: zeros(),
            unused: zeros(),
            y: zeros(),
            r: of_rows(),
            negative: [zeros(), of_rows()],
            of_product: vec![T::zero(); 3 * model.nv()],
            of_parameters: vec![[T::zero(); 10]; bodies],
            noise: zeros(),
            parameters: vec![[T::zero(); 10]; bodies],
        }
    }

    /// Sets the sums to zero.
    pub fn begin(&mut self) {
        self.noise.fill(T::zero());
        self.parameters.as_flattened_mut().fill(T::zero());
    }

    /// -y and -r.
    #[inline(always)]
    fn negate(&mut self) {
        let [y, r] = &mut self.negative;
        for (to, from) in y.iter_mut().zip(&self.y).chain(r.iter_mut().zip(&self.r)) {
            *to = -*from;
        }
    }

    /// Of accelerations at a motion with these forces of the rows: gradients by q, qd and tau, (3 nv) into `out`, and
    /// the requested ones by constants.
    #[inline(always)]
    pub fn of_accelerations(
        &mut self,
        at: &mut impl RowProducts<T>,
        (motion, forces): (Motion<'_, T>, &[T]),
        (constants, out): (&mut Constants<'_, T>, &mut [T]),
    ) -> Result<(), RowFault> {
        self.negate();
        let Self { rows, rest, unused, y, negative: [minus_y, minus_r], .. } = self;
        at.gradients_of_torques(motion, minus_y, (constants, out));
        let (by_q, others) = out.split_at_mut(y.len());
        let (by_qd, by_tau) = others.split_at_mut(y.len());
        by_tau.copy_from_slice(y);
        at.add_row_gradients(rows, [rest, y], forces, [by_q, unused])?;
        at.add_row_gradients(rows, [motion.qd, motion.qdd.unwrap_or(rest)], minus_r, [by_q, by_qd])
    }

    /// Of accelerations along a direction: the change of J qdd + J' qd, and from the change dID of inverse dynamics at
    /// constant accelerations to dtau - dID + dJ* p, in place.
    #[inline(always)]
    pub fn change_along(
        &mut self,
        (shifts, motion): (&[RigidShift<T>], Motion<'_, T>),
        (direction, forces): (&Directions<'_, T>, &[T]),
        [of_rows, of_torques]: [&mut [T]; 2],
    ) -> Result<(), RowFault> {
        let Self { rows, rest, of_product, .. } = self;
        let (state, added) = ((motion.q, motion.qd, motion.qdd.unwrap_or(rest)), &mut of_product[..of_torques.len()]);
        rows.along(shifts, state, ([direction.q, direction.qd], forces), [of_rows, &mut *added])?;
        for ((of_torque, &dtau), &more) in of_torques.iter_mut().zip(direction.u).zip(&*added) {
            *of_torque = dtau - *of_torque + more;
        }
        Ok(())
    }

    /// Adds the gradients of -y* M(q) x + p* J(q) y - r* J(q) along.
    #[inline(always)]
    pub fn add_solution(
        &mut self,
        at: &mut impl RowProducts<T>,
        Pushed { x, p }: Pushed<'_, T>,
        along: &[T],
        by_q: &mut [T],
    ) -> Result<(), RowFault> {
        self.negate();
        let Self { rows, rest, unused, y, negative, of_product, of_parameters, noise, parameters, .. } = self;
        let constants = &mut Constants { parameters: of_parameters, ..Constants::default() };
        at.gradients_of_inertia([rest, x], y, (constants, of_product));
        by_q.iter_mut().zip(&*of_product).for_each(|(sum, &more)| *sum -= more);
        let sums = parameters.as_flattened_mut().iter_mut();
        sums.zip(of_parameters.as_flattened()).for_each(|(sum, &more)| *sum -= more);
        for ((noise, &y), &x) in noise.iter_mut().zip(&*y).zip(x) {
            *noise = noise.minus_product(y, x);
        }
        at.add_row_gradients(rows, [rest, y], p, [by_q, &mut *unused])?;
        at.add_row_gradients(rows, [rest, along], &negative[1], [by_q, unused])
    }

    /// Of the projection of velocities, v + x: from the cotangent of its result to that of v, `x_bar` - J* r = M y, in
    /// place. Adds the gradient by q to `by_q`.
    #[inline(always)]
    pub fn of_projection(
        &mut self,
        at: &mut impl RowProducts<T>,
        (projected, change): (&[T], Pushed<'_, T>),
        of_v: &mut [T],
        by_q: &mut [T],
    ) -> Result<(), RowFault> {
        self.add_solution(at, change, projected, by_q)?;
        of_v.copy_from_slice(&self.of_product[2 * of_v.len()..]);
        Ok(())
    }

    /// Of a Newton step from a configuration that satisfies the connections: from the cotangent of its result to that
    /// of its start, in place.
    #[inline(always)]
    pub fn of_last_step(&mut self, at: &mut impl RowProducts<T>, of_q: &mut [T]) {
        let Self { rest, y, of_product, .. } = self;
        at.gradients_of_inertia([rest, y], y, (&mut Constants::default(), of_product));
        of_q.copy_from_slice(&of_product[2 * of_q.len()..]);
    }

    /// Of one Newton step x = M^-1 J* p, p = -(G + c)^+ (error + c sum of the steps before): adds the gradient by q to
    /// `by_q`, with the cotangent of x. That of the sum is -c r.
    #[inline(always)]
    pub fn of_position_step(
        &mut self,
        at: &mut impl RowProducts<T>,
        step: Pushed<'_, T>,
        of_x: &[T],
        by_q: &mut [T],
    ) -> Result<(), RowFault> {
        self.add_solution(at, step, step.x, by_q)?;
        let taken = self.of_product[2 * of_x.len()..].iter().zip(of_x);
        for (sum, (&more, &of_x)) in by_q.iter_mut().zip(taken) {
            *sum += more - of_x;
        }
        Ok(())
    }
}

/// A state with all checks, for one model.
#[derive(Debug)]
pub(crate) struct ConstraintAdjoint {
    gradients: SolutionGradients<f64>,
    products: ProductScratch<f64>,
    /// The model without gravity, for products with M.
    weightless: Model<f64>,
}

impl Deref for ConstraintAdjoint {
    type Target = SolutionGradients<f64>;

    fn deref(&self) -> &Self::Target {
        &self.gradients
    }
}

impl DerefMut for ConstraintAdjoint {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.gradients
    }
}

/// The general passes, at a configuration at which the workspace has phi of every body.
struct General<'a> {
    system: (&'a Model<f64>, &'a Constraints),
    workspace: &'a mut Workspace<f64>,
    products: &'a mut ProductScratch<f64>,
    weightless: &'a mut Model<f64>,
    q: &'a [f64],
}

impl RowProducts<f64> for General<'_> {
    fn gradients_of_torques(&mut self, motion: Motion<'_, f64>, cotangent: &[f64], results: Results<'_, '_, f64>) {
        let Motion { q, qd, qdd, wrenches } = motion;
        let state = (q, qd, qdd.unwrap_or_default());
        inverse_dynamics_vjp(self.system.0, self.workspace, self.products, state, wrenches, cotangent, results);
    }

    fn gradients_of_inertia(&mut self, [rest, x]: [&[f64]; 2], cotangent: &[f64], results: Results<'_, '_, f64>) {
        let Self { system, workspace, products, weightless, q } = self;
        weightless.system.noise.copy_from_slice(&system.0.system.noise);
        inverse_dynamics_vjp(weightless, workspace, products, (q, rest, x), &[], cotangent, results);
    }

    fn add_row_gradients(
        &mut self,
        rows: &mut RowGradients<f64>,
        [qd, qdd]: [&[f64]; 2],
        multipliers: &[f64],
        by: [&mut [f64]; 2],
    ) -> Result<(), RowFault> {
        let shifts = &self.workspace.store.shifts;
        rows.add_acceleration_gradient(shifts, (self.q, qd, qdd), multipliers, by)
    }
}

impl ConstraintAdjoint {
    pub fn new(model: &Model<f64>, constraints: &Constraints, parameters: bool) -> Self {
        let mut weightless = model.clone();
        weightless.gravity = Vector3::zeros();
        let gradients = SolutionGradients::new(model, constraints, parameters);
        Self { gradients, products: ProductScratch::new(model), weightless }
    }

    /// The gradients, and the passes that they need at `q`.
    fn parts<'a>(
        &'a mut self,
        system: (&'a Model<f64>, &'a Constraints),
        workspace: &'a mut Workspace<f64>,
        q: &'a [f64],
    ) -> (&'a mut SolutionGradients<f64>, General<'a>) {
        let Self { gradients, products, weightless } = self;
        (gradients, General { system, workspace, products, weightless, q })
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
        self.solve(system.0, (&mut *workspace, &mut *scratch), (cotangent, &[]), compliance);
        let (gradients, mut at) = self.parts(system, workspace, q);
        let motion = Motion { q, qd, qdd: Some(qdd), wrenches };
        gradients.of_accelerations(&mut at, (motion, &scratch.forces), (constants, out))
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
        let Self { gradients, products, .. } = self;
        let unaccelerated = Directions { u: &gradients.rest, ..*along };
        inverse_dynamics_jvp(system.0, workspace, products, state, wrenches, &unaccelerated, out);
        dynamics::factorise(system.0, workspace, state.0);
        scratch.factorise(system, workspace, state.0, &[])?;
        let (mut of_rows, (q, qd, qdd)) = (vec![0.0; system.1.rows], state);
        let at = (&workspace.store.shifts[..], Motion { q, qd, qdd: Some(qdd), wrenches });
        gradients.change_along(at, (along, &scratch.forces), [&mut of_rows, &mut *out])?;
        self.solve(system.0, (workspace, scratch), (out, &of_rows), &[]);
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
        self.solve(system.0, (workspace, scratch), (cotangent, &[]), &[]);
        let solution = [self.y.clone(), self.r.clone()];
        let Self { gradients: SolutionGradients { rows, rest, y, r, .. }, products, weightless } = self;
        let (mut right, mut of_rows, mut of_torques) = (vec![0.0; y.len()], vec![0.0; r.len()], vec![0.0; y.len()]);
        let along = Directions { q: dq, qd: rest, u: rest, ..Directions::default() };
        inverse_dynamics_jvp(weightless, workspace, products, (q, rest, y), &[], &along, &mut right);
        let (shifts, directions) = (&workspace.store.shifts, ([dq, &rest[..]], &r[..]));
        rows.along(shifts, (q, rest, y), directions, [&mut of_rows, &mut of_torques])?;
        right.iter_mut().zip(&of_torques).for_each(|(right, more)| *right = -(*right + more));
        self.solve(system.0, (workspace, scratch), (&right, &of_rows), &[]);
        Ok((solution, [self.y.clone(), self.r.clone()]))
    }

    /// One Newton step with its displacement, as [`project_positions`](super::project_positions) makes it: from the
    /// cotangents of its end and of the sum of forces after it (empty for zero) to those before it, in place.
    pub fn of_displacement(
        &mut self,
        system: (&Model<f64>, &Constraints),
        (workspace, scratch): (&mut Workspace<f64>, &mut ConstraintScratch),
        step: &ProjectionStep,
        (of_q, of_sum, compliance): (&mut [f64], &mut [f64], &[f64]),
    ) -> Result<(), RowFault> {
        let ProjectionStep { q, x, p } = step;
        let (share, step) = (share(x), Pushed { x, p });
        let moved: Vec<f64> = x.iter().map(|x| share * x).collect();
        let (mut of_start, mut of_x) = (vec![0.0; x.len()], vec![0.0; x.len()]);
        advance_cotangents(system.0, &moved, of_q, (&mut of_start, &mut of_x));
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
        dynamics::factorise(system.0, workspace, q);
        scratch.factorise(system, workspace, q, compliance)?;
        self.solve(system.0, (&mut *workspace, scratch), (&of_x, &of_p), compliance);
        let (gradients, mut at) = self.parts(system, workspace, q);
        gradients.of_position_step(&mut at, step, &of_x, &mut of_start)?;
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
        self.solve(system.0, (&mut *workspace, scratch), (of_v, &[]), compliance);
        self.of_solved_velocities(system, workspace, (q, projected, change), of_v, by_q)
    }

    /// As [`ConstraintAdjoint::of_velocities`], with y and r of [`ConstraintAdjoint::solve`].
    pub fn of_solved_velocities(
        &mut self,
        system: (&Model<f64>, &Constraints),
        workspace: &mut Workspace<f64>,
        (q, projected, change): (&[f64], &[f64], Pushed<'_>),
        of_v: &mut [f64],
        by_q: &mut [f64],
    ) -> Result<(), RowFault> {
        let (gradients, mut at) = self.parts(system, workspace, q);
        gradients.of_projection(&mut at, (projected, change), of_v, by_q)
    }

    /// A Newton step from a configuration that satisfies the connections, with the factors of M and of the rows at `q`:
    /// from the cotangent of its result to that of `q`, in place. The cotangent of the sum of forces is -c r.
    pub fn of_last_step(
        &mut self,
        system: (&Model<f64>, &Constraints),
        (workspace, scratch): (&mut Workspace<f64>, &mut ConstraintScratch),
        q: &[f64],
        (of_q, compliance): (&mut [f64], &[f64]),
    ) {
        self.solve(system.0, (&mut *workspace, scratch), (of_q, &[]), compliance);
        let (gradients, mut at) = self.parts(system, workspace, q);
        gradients.of_last_step(&mut at, of_q);
    }

    /// y and r for the cotangents of x and of p (empty for zero), with the factors of M and of the rows at one
    /// configuration.
    pub fn solve(
        &mut self,
        model: &Model<f64>,
        (workspace, scratch): (&mut Workspace<f64>, &mut ConstraintScratch),
        (of_x, of_p): (&[f64], &[f64]),
        compliance: &[f64],
    ) {
        let SolutionGradients { y, r, .. } = &mut self.gradients;
        dynamics::solve(model, workspace, of_x, y);
        if r.is_empty() {
            return;
        }
        r.fill(0.0);
        let (mut left, mut step) = (vec![0.0; r.len()], vec![0.0; r.len()]);
        // The second solution removes the rounding errors of the first.
        for _ in 0..2 {
            scratch.rates_of(model, workspace, y);
            left.copy_from_slice(&scratch.rates);
            left.iter_mut().zip(of_p).for_each(|(left, of_p)| *left += of_p);
            for ((left, c), r) in left.iter_mut().zip(compliance).zip(&*r) {
                *left -= c * r;
            }
            scratch.inverse.apply(&left, &mut step);
            r.iter_mut().zip(&step).for_each(|(r, step)| *r += step);
            scratch.respond(model, workspace, &step);
            y.iter_mut().zip(&scratch.estimates).for_each(|(y, change)| *y -= change);
        }
    }

    /// Adds the gradients of -y* M(q) x + p* J(q) y - r* J(q) along.
    pub fn add_response(
        &mut self,
        system: (&Model<f64>, &Constraints),
        workspace: &mut Workspace<f64>,
        q: &[f64],
        change: Pushed<'_>,
        along: &[f64],
        by_q: &mut [f64],
    ) -> Result<(), RowFault> {
        let (gradients, mut at) = self.parts(system, workspace, q);
        gradients.add_solution(&mut at, change, along, by_q)
    }
}

/// sum -= c r, entry by entry; an empty c is zero.
pub(crate) fn subtract_products(sum: &mut [f64], c: &[f64], r: &[f64]) {
    for ((sum, c), r) in sum.iter_mut().zip(c).zip(r) {
        *sum -= c * r;
    }
}
