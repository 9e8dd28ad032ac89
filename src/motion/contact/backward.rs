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
//! With connections or coupled joints, whose rows are `J_k`, M y = J* p + `J_k`* lambda and `J_k` y = 0, and the
//! adjoint is the same system, M m = `y_bar` + `J_k`* mu and `J_k` m = 0. The gradients by q have two more terms,
//! lambda* `J_k`(q) m + mu* `J_k`(q) y. The projections onto the connections at both ends of a step are systems of this
//! kind.
//!
//! The cost is O(N) per solve of the law, and one dense factorization of its few rows.

use super::super::backward::{ARMATURE, KnownAccelerations, StepGradients, backward};
use super::super::limit_rows::least_slopes;
use super::super::manifold::advance_cotangents;
use super::super::scratch::{Scratch, add_scaled, clear};
use super::super::step_settings::StepSettings;
use super::at::{At, Connections};
use super::free_axes::{free_joints, rotation};
use super::laws::{Chain, Response};
use super::moves::{Move, Pulled, Push};
use super::record::StepRecord;
use super::step::ContactStep;
use crate::batch::instruction_set::Baseline;
use crate::contact::Limits;
use crate::dynamics::constraints::Pushed;
use crate::dynamics::contacts::derivatives::RowDerivatives;
use crate::dynamics::derivatives::ProductScratch;
use crate::error::Error;
use crate::joints::vectors::triple;
use crate::model::Model;
use crate::scene::Scene;
use nalgebra::{DVector, Vector3};

/// Gradients by one contact.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(in crate::motion) struct ContactGradient {
    pub friction: f64,
    pub restitution: f64,
    /// By the offset of the plane, and by its normal at a fixed distance from the origin of the body that carries it,
    /// in the frame of that body.
    pub offset: f64,
    pub normal: Vector3<f64>,
}

/// Scratch memory for the adjoint of a step, and its results in addition to those of [`StepGradients`].
pub(super) struct ContactAdjoint {
    rows: RowDerivatives,
    products: ProductScratch<f64>,
    q: Vec<f64>,
    v: Vec<f64>,
    pub contacts: Vec<ContactGradient>,
    normals: Vec<Vector3<f64>>,
}

impl ContactAdjoint {
    pub fn new(model: &Model<f64>) -> Self {
        let zeros = || vec![0.0; model.nv()];
        Self {
            rows: RowDerivatives::new(model),
            products: ProductScratch::new(model),
            q: zeros(),
            v: zeros(),
            contacts: Vec::new(),
            normals: Vec::new(),
        }
    }

    /// From `gradients.end` to all results of [`StepGradients`] and the gradients by the contacts, for the step that
    /// `step` made and recorded; for a flight, only to the cotangents of its end. `of_gap` is the cotangent of the gap
    /// of a row at the end of the displacement. Returns the joint and the error if a pivot is singular.
    pub fn step(
        &mut self,
        scene: &Scene,
        settings: &StepSettings,
        (step, s): (&mut ContactStep, &mut Scratch<f64>),
        connections: &mut Connections,
        gradients: &mut StepGradients<f64>,
        of_gap: Option<(usize, f64)>,
    ) -> Result<(), (String, Error)> {
        let nv = s.v.len();
        clear(&mut self.q);
        clear(&mut self.v);
        let contacts = scene.contact_points().len();
        self.contacts.clear();
        self.contacts.resize(contacts, ContactGradient::default());
        self.normals.clear();
        self.normals.resize(contacts, Vector3::zeros());
        connections.adjoint.begin();
        let ContactStep { solver, rows, record, .. } = step;
        let Some(record) = record else { return Ok(()) };
        if record.flies {
            let mut at = At { scene, model: &s.model, workspace: &mut solver.workspace, rows, connections };
            at.place_rows(&s.q_next);
            if let Some((row, bar)) = of_gap {
                self.add_gaps(&mut at, &[row], &[bar]);
            }
            add_scaled(&mut gradients.end[0], 1.0, &self.q);
            self.end_normals();
            return Ok(());
        }

        let (mut of_q, mut of_last) = (gradients.end[0].clone(), gradients.end[1].clone());
        let mut turned = s.v_next.clone();
        if rows.closed.is_some() {
            let noise = std::mem::replace(&mut s.model.system.noise, settings.properties.armature.clone());
            let ends = (&s.q_next[..], &s.v_next[..]);
            let mut at = At { scene, model: &s.model, workspace: &mut solver.workspace, rows, connections };
            let through = through_pull(&mut at, ends, &record.end, (&mut of_last, &mut of_q));
            s.model.system.noise = noise;
            through?;
            turned.iter_mut().zip(&record.end.change).for_each(|(v, change)| *v -= change);
        }
        // M at the end has the armature only.
        let by_armature = connections.adjoint.noise.clone();
        connections.adjoint.noise.fill(0.0);
        let mut at = At { scene, model: &s.model, workspace: &mut solver.workspace, rows, connections };
        self.turned_axes(at.model, (&s.q, &s.q_next), &turned, (&mut of_q, &mut of_last));
        for made in record.moves.iter().rev() {
            match made {
                Move::Push(push) => of_q = self.through_push(&mut at, push, &of_q)?,
                Move::Pull(step) => {
                    let (system, room, adjoint) = at.of_connections();
                    let through = adjoint.of_displacement(system, room, step, (&mut of_q, &mut [], &[]));
                    through.map_err(|row| at.row_fault(row))?;
                }
            }
        }
        let moved = record.moves.first().map_or(&s.q_next, Move::start);
        let mut of_moving = vec![0.0; nv];
        if let Some((row, bar)) = of_gap {
            at.place_rows(moved);
            std::mem::swap(&mut self.q, &mut of_q);
            self.add_gaps(&mut at, &[row], &[bar]);
            std::mem::swap(&mut self.q, &mut of_q);
        }
        self.displaced(at.model, settings.step, (&s.q, moved, &record.moving), &of_q, &mut of_moving);

        // Without a projection, the factor of the solves is still in the workspace.
        if record.near.is_empty() || !record.moves.is_empty() || at.rows.closed.is_some() {
            at.place(&s.q)?;
        } else {
            at.place_rows(&s.q);
        }
        let slowed = record.laws.as_ref().is_some_and(|laws| laws.slower.is_some());
        if !slowed {
            of_moving.iter_mut().zip(&of_last).for_each(|(sum, more)| *sum += more);
            clear(&mut of_last);
        }
        let mut of_free: Vec<f64> = of_moving.iter().zip(&of_last).map(|(a, b)| a + b).collect();
        if record.laws.is_some() {
            self.through_laws(settings, &mut at, (s, record), (&of_moving, &of_last), &mut of_free)?;
        }
        if at.rows.closed.is_some() {
            through_pull(&mut at, (&s.q, &record.v_free), &record.free, (&mut of_free, &mut self.q))?;
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
        // The accelerations of the implicit Euler step are in the scratch.
        let mut known = KnownAccelerations { solver, products: &mut self.products, accelerations: None };
        backward(Baseline, (settings, &settings.scheme), s, gradients, &mut known, None);
        for (start, more) in gradients.start.iter_mut().zip([&self.q, &self.v]) {
            start.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        }
        gradients.add_noise((settings, &settings.scheme), s, &connections.adjoint.noise);
        add_scaled(&mut gradients.acting[ARMATURE], 1.0, &by_armature);
        let sums = gradients.parameters.as_flattened_mut().iter_mut();
        sums.zip(connections.adjoint.parameters.as_flattened()).for_each(|(sum, more)| *sum += more);
        self.end_normals();
        Ok(())
    }

    fn end_normals(&mut self) {
        self.contacts.iter_mut().zip(&self.normals).for_each(|(contact, normal)| contact.normal += normal);
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

    /// One Newton step of the projection out of the surfaces: from the cotangent of its result to that of its start.
    fn through_push(&mut self, at: &mut At<'_>, push: &Push, of_next: &[f64]) -> Result<Vec<f64>, (String, Error)> {
        at.place(&push.q)?;
        let Push { near, gaps, cone, impulses, moved, .. } = push;
        let (mut of_q, of_x) = displacement_cotangents(at.model, moved, of_next);
        let limits = Limits::beside(gaps);
        let p = cone.polished(impulses, gaps, &limits).map_or_else(|| impulses.clone(), |(p, _)| p);
        let z = at.solve(&of_x);
        let bar = at.velocities(near, &z.v);
        let of = cone.linearized(&cone.modes(&p, gaps, &limits), &p, gaps).cotangents(&bar);
        let Some(of) = of else { return Ok(of_q) };
        let m = at.respond(near, &of_x, &of.velocities);
        let y = at.respond(near, &vec![0.0; of_x.len()], &p);
        std::mem::swap(&mut self.q, &mut of_q);
        self.add_rows(at, (near, &of.velocities, moved));
        let added = self.add_response(at, near, &Response { p, y, m });
        // Gaps of joint limits that are violated count as zero.
        let at_gap = |i: usize| near[i] < at.points().len() || gaps[3 * i + 2] > 0.0;
        let of_gaps: Vec<f64> =
            (0..near.len()).map(|i| if at_gap(i) { of.velocities[3 * i + 2] } else { 0.0 }).collect();
        self.add_gaps(at, near, &of_gaps);
        std::mem::swap(&mut self.q, &mut of_q);
        added.map(|()| of_q)
    }

    /// All solves of the law in the step. Adds the cotangents of the free velocities to `of_free`.
    fn through_laws(
        &mut self,
        settings: &StepSettings,
        at: &mut At<'_>,
        (s, record): (&Scratch<f64>, &StepRecord),
        of_velocities: (&[f64], &[f64]),
        of_free: &mut [f64],
    ) -> Result<(), (String, Error)> {
        let (near, h) = (&record.near[..], settings.step);
        let contacts = at.points().len();
        let Some(chain) = Chain::new(at, (s, record), of_velocities)? else { return Ok(()) };
        for (u_bar, w) in &chain.evaluations {
            self.add_rows(at, (near, u_bar, w));
        }
        for response in &chain.responses {
            self.add_response(at, near, response)?;
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
            } else if !record.laws.as_ref().is_some_and(|laws| laws.dropped.contains(&i)) {
                let [by_gap, by_start] = least_slopes(gap, record.before.start[3 * i + 2], h);
                of_gaps[k] = -chain.of_target[k] * by_gap;
                of_start[3 * k + 2] -= chain.of_target[k] * by_start;
            }
        }
        if let Some(smoothing) = &settings.smoothing {
            smoothing.add_masses(&chain.energy, &mut at.connections.adjoint.parameters);
        }
        self.add_gaps(at, near, &of_gaps);
        at.add_torques(near, &of_start, &mut self.v);
        Ok(())
    }

    /// Gradients of `u_bar`* J(q) w.
    fn add_rows(&mut self, at: &mut At<'_>, (near, u_bar, w): (&[usize], &DVector<f64>, &[f64])) {
        let scene = (at.model, at.points());
        at.rows.add_gradient(scene, &mut self.rows, (near, u_bar, w), (&mut self.q, &mut self.normals));
    }

    /// Gradients of p* J(q) m - m* M(q) y, and of the connections.
    fn add_response(&mut self, at: &mut At<'_>, near: &[usize], response: &Response) -> Result<(), (String, Error)> {
        let Response { p, y, m } = response;
        self.add_rows(at, (near, p, &m.v));
        at.add_gradient((y, m), &y.v, &mut self.q)
    }

    /// Gradients through the gaps.
    fn add_gaps(&mut self, at: &mut At<'_>, near: &[usize], of_gaps: &[f64]) {
        let along = DVector::from_fn(3 * near.len(), |i, _| if i % 3 == 2 { of_gaps[i / 3] } else { 0.0 });
        at.add_torques(near, &along, &mut self.q);
        for (&i, &bar) in near.iter().zip(of_gaps) {
            let Some(point) = at.points().get(i).filter(|point| point.is_plane()) else { continue };
            self.contacts[i].offset -= bar;
            self.normals[i] += at.rows.center_at_surface(point) * bar;
        }
    }
}

/// Cotangents of the start of a displacement by x, and of x.
fn displacement_cotangents(model: &Model<f64>, x: &[f64], of_next: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let (mut of_q, mut of_x) = (vec![0.0; x.len()], vec![0.0; x.len()]);
    advance_cotangents(model, x, of_next, (&mut of_q, &mut of_x));
    (of_q, of_x)
}

/// The projection of velocities onto the connections at `q`, to v: `of_v` becomes the cotangent of the velocities
/// before it.
fn through_pull(
    at: &mut At<'_>,
    (q, v): (&[f64], &[f64]),
    Pulled { change, impulses }: &Pulled,
    (of_v, of_q): (&mut [f64], &mut [f64]),
) -> Result<(), (String, Error)> {
    let (system, room, adjoint) = at.of_connections();
    let found = adjoint.of_velocities(system, room, (q, v, Pushed { x: change, p: impulses }), (of_v, &[]), of_q);
    found.map_err(|row| at.row_fault(row))
}

/// Penetrations up to this depth count as rounding errors of a contact at its plane, m.
const ROUNDING: f64 = 1e-14;

/// Adds x to the first three entries.
fn add(sum: &mut [f64], x: &Vector3<f64>) {
    sum.iter_mut().zip(x.iter()).for_each(|(sum, more)| *sum += more);
}
