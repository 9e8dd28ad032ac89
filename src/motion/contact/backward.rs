//! Adjoint of one step with contacts: from gradients of a scalar by the end state to those by the initial state, by the
//! quantities that act during the step, and by the contacts.
//!
//! The lines of the step are differentiated in reverse order, each exactly: the rotation of the axes of free joints,
//! the Newton steps of the projection, the displacement, the solves of the contact law in their modes
//! (`contact::implicit`), and the implicit Euler step. Each solve of the law has
//! velocities u = J(q) w and impulses p that act on the velocities as y = M(q)^-1 J(q)* p. With the cotangents `u_bar`
//! and `y_bar`, and m = M^-1 `y_bar`, the gradients by q are those of
//!
//! ```text
//! u_bar* J(q) w + p* J(q) m - m* M(q) y
//! ```
//!
//! The cost is O(N) per solve of the law, and one dense factorization of its few rows.

use super::super::backward::{BackwardSolver, StepGradients, backward, gradients_at_accelerations};
use super::super::limit_rows::least_slopes;
use super::super::scratch::{Scratch, clear};
use super::super::step_settings::StepSettings;
use super::faults::factorised;
use super::free_axes::{free_joints, rotation};
use super::laws::{Chain, Response};
use super::project::Push;
use super::record::StepRecord;
use super::step::ContactStep;
use crate::batch::accelerations::KernelArguments;
use crate::contact::Limits;
use crate::dynamics;
use crate::dynamics::contacts::ContactScratch;
use crate::dynamics::contacts::derivatives::RowDerivatives;
use crate::dynamics::derivatives::{self, Constants, Parameters, ProductScratch};
use crate::error::Error;
use crate::joints::vectors::triple;
use crate::model::Model;
use crate::scene::Scene;
use crate::scene::contact_point::ContactPoint;
use crate::workspace::Workspace;
use nalgebra::{DVector, Vector3};

/// Gradients by one contact.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(in crate::motion) struct ContactGradient {
    pub friction: f64,
    pub restitution: f64,
    /// By the offset of the plane, and by a rotation of the plane about the base origin, in the base frame.
    pub offset: f64,
    pub turn: Vector3<f64>,
}

/// Scratch memory for the adjoint of a step, and its results in addition to those of [`StepGradients`].
pub(super) struct ContactAdjoint {
    rows: RowDerivatives,
    products: ProductScratch<f64>,
    /// The model without gravity, for products with M.
    weightless: Model<f64>,
    q: Vec<f64>,
    v: Vec<f64>,
    noise: Vec<f64>,
    of_product: Vec<f64>,
    parameters: Vec<Parameters<f64>>,
    of_parameters: Vec<Parameters<f64>>,
    pub contacts: Vec<ContactGradient>,
    turns: Vec<Vector3<f64>>,
}

/// The model, the contacts and the scratch of a step.
pub(super) struct At<'a> {
    pub model: &'a Model<f64>,
    pub points: &'a [ContactPoint],
    pub workspace: &'a mut Workspace<f64>,
    pub rows: &'a mut ContactScratch,
}

impl At<'_> {
    /// J x of the contacts `near`.
    pub fn velocities(&mut self, near: &[usize], x: &[f64]) -> DVector<f64> {
        let all = self.rows.velocities(self.model, self.points, x);
        DVector::from_fn(3 * near.len(), |i, _| all[3 * near[i / 3] + i % 3])
    }

    /// M^-1 (torque + J* p).
    pub fn respond(&mut self, near: &[usize], torque: &[f64], p: &DVector<f64>) -> Vec<f64> {
        self.rows.respond_to(self.model, self.points, self.workspace, torque, (near, p));
        self.rows.response.clone()
    }

    /// M^-1 torque.
    pub fn solve(&mut self, torque: &[f64]) -> Vec<f64> {
        let mut x = vec![f64::NAN; torque.len()];
        dynamics::solve(self.model, self.workspace, torque, &mut x);
        x
    }

    /// out += J* p.
    pub fn add_torques(&mut self, near: &[usize], p: &DVector<f64>, out: &mut [f64]) {
        self.rows.add_torques(self.model, self.points, (near, p), out);
    }

    /// Rows and factor of M at `q`.
    fn place(&mut self, scene: &Scene, q: &[f64]) -> Result<(), (String, Error)> {
        self.rows.place(self.model, self.points, q);
        factorised(scene, (self.model, q), self.workspace)
    }
}

impl ContactAdjoint {
    pub fn new(scene: &Scene, model: &Model<f64>, parameters: bool) -> Self {
        let nv = model.nv();
        let zeros = || vec![0.0; nv];
        let bodies = if parameters { model.bodies.len() } else { 0 };
        let mut weightless = model.clone();
        weightless.gravity = Vector3::zeros();
        Self {
            rows: RowDerivatives::new(model),
            products: ProductScratch::new(model),
            weightless,
            q: zeros(),
            v: zeros(),
            noise: zeros(),
            of_product: vec![0.0; 3 * nv],
            parameters: vec![[0.0; 10]; bodies],
            of_parameters: vec![[0.0; 10]; bodies],
            contacts: vec![ContactGradient::default(); scene.contacts().len()],
            turns: vec![Vector3::zeros(); scene.contacts().len()],
        }
    }

    /// From `gradients.end` to all results of [`StepGradients`] and the gradients by the contacts, for the step that
    /// `step` made and recorded. Returns the joint and the error if a pivot is singular.
    pub fn step(
        &mut self,
        scene: &Scene,
        settings: &StepSettings,
        (step, s): (&mut ContactStep, &mut Scratch<f64>),
        gradients: &mut StepGradients<f64>,
    ) -> Result<(), (String, Error)> {
        let nv = s.v.len();
        for numbers in [&mut self.q, &mut self.v, &mut self.noise] {
            clear(numbers);
        }
        clear(self.parameters.as_flattened_mut());
        self.contacts.fill(ContactGradient::default());
        self.turns.fill(Vector3::zeros());
        let ContactStep { solver, rows, record, .. } = step;
        let (points, workspace) = (scene.contact_points(), &mut solver.workspace);
        let Some(record) = record else { return Ok(()) };
        let mut at = At { model: &s.model, points, workspace, rows };

        let (mut of_q, mut of_last) = (gradients.end[0].clone(), gradients.end[1].clone());
        self.turned_axes(at.model, (&s.q, &s.q_next), &s.v_next, (&mut of_q, &mut of_last));
        for push in record.pushes.iter().rev() {
            of_q = self.through_push(scene, &mut at, push, &of_q)?;
        }
        let moved = record.pushes.first().map_or(&s.q_next, |push| &push.q);
        let mut of_moving = vec![0.0; nv];
        self.displaced(at.model, settings.step, (&s.q, moved, &record.moving), &of_q, &mut of_moving);

        // Without a projection, the factor of the solves is still in the workspace.
        if record.near.is_empty() || !record.pushes.is_empty() {
            at.place(scene, &s.q)?;
        } else {
            at.rows.place(at.model, at.points, &s.q);
        }
        let slowed = record.laws.as_ref().is_some_and(|laws| laws.slower.is_some());
        if !slowed {
            of_moving.iter_mut().zip(&of_last).for_each(|(sum, more)| *sum += more);
            clear(&mut of_last);
        }
        let mut of_free: Vec<f64> = of_moving.iter().zip(&of_last).map(|(a, b)| a + b).collect();
        if record.laws.is_some() {
            self.through_laws(settings, &mut at, (s, record), (&of_moving, &of_last), &mut of_free)
                .map_err(|found| (String::new(), Error::argument("q, qd", found, "rows that simulate recorded")))?;
        }
        for (_, row) in free_joints(at.model) {
            // v_free = v + h w x v in the rows of the origin.
            let (linear, angular) = (triple(&s.v[row..]), triple(&s.v[row + 3..]));
            let bar = triple(&of_free[row..]) * settings.step;
            add(&mut self.v[row..], &bar.cross(&angular));
            add(&mut self.v[row + 3..], &linear.cross(&bar));
        }
        clear(&mut gradients.end[0]);
        gradients.end[1].copy_from_slice(&of_free);
        let mut known = KnownAccelerations { workspace: &mut solver.workspace, products: &mut self.products };
        backward((settings, &settings.scheme), s, gradients, &mut known, None);
        for (start, more) in gradients.start.iter_mut().zip([&self.q, &self.v]) {
            start.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        }
        gradients.add_noise((settings, &settings.scheme), s, &self.noise);
        let sums = gradients.parameters.as_flattened_mut().iter_mut();
        sums.zip(self.parameters.as_flattened()).for_each(|(sum, more)| *sum += more);
        for (contact, turn) in self.contacts.iter_mut().zip(&self.turns) {
            contact.turn += turn;
        }
        Ok(())
    }

    /// The rotation of velocities of free joints from the axes at `q` to those at `next`: `of_v` becomes the cotangent
    /// of the velocities before it.
    fn turned_axes(
        &mut self,
        model: &Model<f64>,
        (q, next): (&[f64], &[f64]),
        v_next: &[f64],
        (of_next, of_v): (&mut [f64], &mut [f64]),
    ) {
        for (k, row) in free_joints(model) {
            let at = model.bodies[k].q;
            let turn = rotation(&next[at..]).transpose() * rotation(&q[at..]);
            let (v, bar) = (triple(&v_next[row..]), triple(&of_v[row..]));
            add(&mut of_next[row + 3..], &bar.cross(&v));
            let (v, bar) = (turn.tr_mul(&v), turn.tr_mul(&bar));
            add(&mut self.q[row + 3..], &v.cross(&bar));
            of_v[row..row + 3].copy_from_slice(bar.as_slice());
        }
    }

    /// The displacement from `q` with velocities v; adds to their cotangents.
    fn displaced(
        &mut self,
        model: &Model<f64>,
        h: f64,
        (q, next, v): (&[f64], &[f64], &[f64]),
        of_next: &[f64],
        of_v: &mut [f64],
    ) {
        for (body, stage) in model.bodies.iter().zip(&model.system.stages) {
            let (row, count) = (stage.first_row, stage.rows.count());
            let (mut x, mut bar, mut of_x) = ([0.0; 6], [0.0; 6], [0.0; 6]);
            let rows = row..row + count;
            x.iter_mut().zip(&v[rows.clone()]).for_each(|(x, v)| *x = h * v);
            bar[..count].copy_from_slice(&of_next[rows.clone()]);
            if body.motion.is_free() {
                // The origin moves on a straight line, h R v.
                let turn = rotation(&next[body.q..]).transpose() * rotation(&q[body.q..]);
                let along = turn.tr_mul(&triple(&bar));
                add(&mut self.q[row..], &along);
                add(&mut self.q[row + 3..], &triple(&v[row..]).cross(&(along * h)));
                add(&mut of_v[row..], &(along * h));
                x[..3].fill(0.0);
                bar[..3].fill(0.0);
            }
            body.motion.advance_cotangents(&x, &bar, &mut self.q[row..], &mut of_x);
            of_v[rows].iter_mut().zip(of_x).for_each(|(sum, more)| *sum += h * more);
        }
    }

    /// One Newton step of the projection: from the cotangent of its result to that of its start.
    fn through_push(
        &mut self,
        scene: &Scene,
        at: &mut At<'_>,
        push: &Push,
        of_next: &[f64],
    ) -> Result<Vec<f64>, (String, Error)> {
        at.place(scene, &push.q)?;
        let nv = of_next.len();
        let (mut of_q, mut of_x) = (vec![0.0; nv], vec![0.0; nv]);
        for (body, stage) in at.model.bodies.iter().zip(&at.model.system.stages) {
            let row = stage.first_row;
            let along = (&push.moved[row..], &of_next[row..]);
            body.motion.advance_cotangents(along.0, along.1, &mut of_q[row..], &mut of_x[row..]);
        }
        let Push { near, gaps, cone, impulses, moved, .. } = push;
        let limits = Limits::beside(gaps);
        let p = cone.polished(impulses, gaps, &limits).map_or_else(|| impulses.clone(), |(p, _)| p);
        let z = at.solve(&of_x);
        let bar = at.velocities(near, &z);
        let of = cone.linearized(&cone.modes(&p, gaps, &limits), &p, gaps).cotangents(&bar);
        let Some(of) = of else { return Ok(of_q) };
        let m = at.respond(near, &of_x, &of.velocities);
        std::mem::swap(&mut self.q, &mut of_q);
        self.add_rows(at, (near, &of.velocities, moved));
        let response = Response { p, y: moved.clone(), m };
        self.add_response(at, near, &push.q, &response);
        // Gaps of joint limits that are violated count as zero.
        let at_gap = |i: usize| push.near[i] < at.points.len() || gaps[3 * i + 2] > 0.0;
        let of_gaps: Vec<f64> =
            (0..near.len()).map(|i| if at_gap(i) { of.velocities[3 * i + 2] } else { 0.0 }).collect();
        self.add_gaps(at, near, &of_gaps);
        std::mem::swap(&mut self.q, &mut of_q);
        Ok(of_q)
    }

    /// All solves of the law in the step. Adds the cotangents of the free velocities to `of_free`.
    fn through_laws(
        &mut self,
        settings: &StepSettings,
        at: &mut At<'_>,
        (s, record): (&Scratch<f64>, &StepRecord),
        of_velocities: (&[f64], &[f64]),
        of_free: &mut [f64],
    ) -> Result<(), String> {
        let (near, h) = (&record.near[..], settings.step);
        let contacts = at.points.len();
        let Some(chain) = Chain::new(at, (s, record), of_velocities)? else { return Ok(()) };
        for (u_bar, w) in &chain.evaluations {
            self.add_rows(at, (near, u_bar, w));
        }
        for response in &chain.responses {
            self.add_response(at, near, &s.q, response);
        }
        at.add_torques(near, &chain.of_free, of_free);
        let mut of_start = chain.of_start.clone();
        let mut of_gaps = vec![0.0; near.len()];
        for (k, &i) in near.iter().enumerate() {
            let gap = record.before.gaps[i];
            // A contact at its plane counts as separated: the derivative is that of the free side.
            if i < contacts {
                let by_gap = match &settings.smoothing {
                    Some(smoothing) => smoothing.by_gap(gap, h),
                    None if gap > -ROUNDING => 1.0 / h,
                    None => 0.0,
                };
                of_gaps[k] = chain.of_target[k] * by_gap;
                self.contacts[i].friction += chain.friction[k];
                self.contacts[i].restitution += chain.restitution[k];
            } else {
                let [by_gap, by_start] = least_slopes(gap, record.before.start[3 * i + 2], h);
                of_gaps[k] = -chain.of_target[k] * by_gap;
                of_start[3 * k + 2] -= chain.of_target[k] * by_start;
            }
        }
        if let Some(smoothing) = &settings.smoothing {
            smoothing.add_masses(&chain.energy, &mut self.parameters);
        }
        self.add_gaps(at, near, &of_gaps);
        at.add_torques(near, &of_start, &mut self.v);
        Ok(())
    }

    /// Gradients of `u_bar`* J(q) w.
    fn add_rows(&mut self, at: &mut At<'_>, (near, u_bar, w): (&[usize], &DVector<f64>, &[f64])) {
        let scene = (at.model, at.points);
        at.rows.add_gradient(scene, &mut self.rows, (near, u_bar, w), (&mut self.q, &mut self.turns));
    }

    /// Gradients of p* J(q) m - m* M(q) y.
    fn add_response(&mut self, at: &mut At<'_>, near: &[usize], q: &[f64], response: &Response) {
        let Response { p, y, m } = response;
        self.add_rows(at, (near, p, m));
        let still = vec![0.0; m.len()];
        let constants = &mut Constants { parameters: &mut self.of_parameters, ..Constants::default() };
        derivatives::inverse_dynamics_vjp(
            &self.weightless,
            at.workspace,
            &mut self.products,
            (q, &still, y),
            &[],
            m,
            (constants, &mut self.of_product),
        );
        self.q.iter_mut().zip(&self.of_product).for_each(|(sum, more)| *sum -= more);
        let sums = self.parameters.as_flattened_mut().iter_mut();
        sums.zip(self.of_parameters.as_flattened()).for_each(|(sum, more)| *sum -= more);
        for ((noise, m), y) in self.noise.iter_mut().zip(m).zip(y) {
            *noise -= m * y;
        }
    }

    /// Gradients through the gaps.
    fn add_gaps(&mut self, at: &mut At<'_>, near: &[usize], of_gaps: &[f64]) {
        let along = DVector::from_fn(3 * near.len(), |i, _| if i % 3 == 2 { of_gaps[i / 3] } else { 0.0 });
        at.add_torques(near, &along, &mut self.q);
        for (&i, &bar) in near.iter().zip(of_gaps) {
            let Some(point) = at.points.get(i) else { continue };
            self.contacts[i].offset -= bar;
            self.turns[i] += point.normal().cross(&at.rows.center(point)) * bar;
        }
    }
}

/// Penetrations up to this depth count as rounding errors of a contact at its plane, m.
const ROUNDING: f64 = 1e-14;

/// Solver for the implicit Euler step, whose accelerations are in the scratch and whose factor of M is in the
/// workspace.
struct KnownAccelerations<'a> {
    workspace: &'a mut Workspace<f64>,
    products: &'a mut ProductScratch<f64>,
}

impl BackwardSolver<f64> for KnownAccelerations<'_> {
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
        let room = (&mut *self.workspace, &mut *self.products);
        gradients_at_accelerations(model, room, (q, qd, qdd), cotangent, (parameters, out));
        0
    }
}

/// Adds x to the first three entries.
fn add(sum: &mut [f64], x: &Vector3<f64>) {
    sum.iter_mut().zip(x.iter()).for_each(|(sum, more)| *sum += more);
}
