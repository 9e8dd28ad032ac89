//! Joint accelerations at a state and in the middle of a step, and their derivatives by error and torque noise.
//!
//! A step of order 2 has the acceleration a of its middle:
//!
//! ```text
//! a0 = FD(q, qd, tau, w),  a = FD(q (+) h qd/2, qd + h a0/2, tau, (w + w1)/2)
//! da = A_q (Ad dq + h/2 Jr dqd) + A_v (dqd + h/2 da0) + A_w (1 + decay)/2 dw + M^-1 dn
//! ```
//!
//! with the derivatives `A_q`, `A_v`, `A_w` and M^-1 in the middle, and the Jacobians Ad and Jr of the step h qd/2 on
//! the manifold. The wrench w1 = decay w + growth at the end of the step is part of the middle, because a wrench that
//! changes continuously has its mean effect.

use super::closure::Closure;
use super::rotate::combine;
use super::settings::{LANES, Plan, Timing};
use crate::batch::instruction_set::within_widest;
use crate::error::Error;
use crate::kinematics::local_jacobian;
use crate::kinematics::manifold::step_jacobians;
use crate::scene::Scene;
use crate::spatial::SpatialVector;
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// Accelerations at the last state, and scratch; one per thread.
#[derive(Debug)]
pub(super) struct Acceleration {
    pub workspace: Workspace<f64>,
    /// Joint accelerations.
    pub value: Vec<f64>,
    wrenches: Vec<SpatialVector<f64>>,
    derivatives: Vec<f64>,
    jacobian: Vec<f64>,
    /// The state in the middle of a step, and the derivatives `A_q` and `A_v` there by columns.
    q: Vec<f64>,
    qd: Vec<f64>,
    by_state: Vec<f64>,
    /// Wrenches in the middle of a step.
    rest: Vec<f64>,
    step: Vec<f64>,
}

impl Acceleration {
    pub fn new(plan: &Plan, scene: &Scene) -> Self {
        let nv = plan.nv;
        let bodies = if plan.wrenches.is_empty() { 0 } else { scene.model().bodies.len() };
        Self {
            workspace: scene.workspace(),
            value: vec![f64::NAN; nv],
            wrenches: vec![Vector6::zeros(); bodies],
            derivatives: vec![f64::NAN; 3 * nv * nv],
            jacobian: vec![f64::NAN; 6 * nv],
            q: vec![f64::NAN; plan.nq],
            qd: vec![f64::NAN; nv],
            by_state: vec![0.0; 2 * nv * plan.flow_stride()],
            rest: vec![f64::NAN; 6 * plan.wrenches.len()],
            step: vec![f64::NAN; nv],
        }
    }

    /// Accelerations at a state, and their derivatives by error and torque noise by columns, into `value` and `flow`.
    pub fn at(
        &mut self,
        (plan, scene): (&Plan, &Scene),
        (q, qd, rest): (&[f64], &[f64], &[f64]),
        tau: &[f64],
        flow: &mut [f64],
    ) -> Result<(), Error> {
        let Self { workspace, wrenches, value, derivatives, jacobian, .. } = self;
        let (nv, model) = (plan.nv, scene.model());
        wrenches.fill(Vector6::zeros());
        for (frame, wrench) in plan.wrenches.iter().zip(rest.as_chunks::<6>().0) {
            if let Some(body) = frame.body {
                wrenches[body] += frame.placement.force_to_parent(&Vector6::from(*wrench));
            }
        }
        scene.forward_dynamics(workspace, q, qd, tau, wrenches, value)?;
        scene.forward_dynamics_derivatives(workspace, q, qd, tau, wrenches, derivatives)?;
        let stride = plan.flow_stride();
        let (by_q, others) = derivatives.split_at(nv * nv);
        let (by_qd, inverse) = others.split_at(nv * nv);
        for (first, matrix) in [(plan.q(), by_q), (plan.qd(), by_qd), (plan.states, inverse)] {
            for (row, entries) in matrix.chunks_exact(nv).enumerate() {
                for (column, &entry) in entries.iter().enumerate() {
                    flow[(first + column) * stride + row] = entry;
                }
            }
        }
        let q = scene.tree_configuration("q", q)?;
        for (w, frame) in plan.wrenches.iter().enumerate() {
            scene.tree_columns(6, jacobian, |out| {
                local_jacobian(model, &q, frame, out);
            })?;
            for (i, by_wrench) in jacobian.chunks_exact(nv).enumerate() {
                let column = &mut flow[(6 * w + i) * stride..][..nv];
                for (entry, row) in column.iter_mut().zip(inverse.chunks_exact(nv)) {
                    *entry = row.iter().zip(by_wrench).map(|(a, b)| a * b).sum();
                }
            }
        }
        Ok(())
    }

    /// Accelerations in the middle of the step from a state, and their derivatives by the error at its start and by the
    /// torque noise, into `value` and `flow`; by the wrenches in the middle, into `by_wrench`. `start` is scratch with
    /// the length of `flow`.
    pub fn in_the_middle(
        &mut self,
        (plan, scene, closure): (&Plan, &Scene, Option<&mut Closure>),
        timing: &Timing,
        (q, qd, rest): (&[f64], &[f64], &[f64]),
        tau: &[f64],
        (start, flow, by_wrench): (&mut [f64], &mut [f64], &mut [f64]),
    ) -> Result<(), Error> {
        let half = 0.5 * timing.dt;
        self.at((plan, scene), (q, qd, rest), tau, start)?;
        for (step, qd) in self.step.iter_mut().zip(qd) {
            *step = half * qd;
        }
        let [mut middle_q, mut middle_qd, mut wrenches] =
            [&mut self.q, &mut self.qd, &mut self.rest].map(std::mem::take);
        for (middle, (wrench, decay)) in wrenches.iter_mut().zip(rest.iter().zip(&timing.decay)) {
            *middle = 0.5 * (1.0 + decay) * wrench;
        }
        for (middle, (qd, qdd)) in middle_qd.iter_mut().zip(qd.iter().zip(&self.value)) {
            *middle = qd + half * qdd;
        }
        let done = scene
            .integrate(q, &self.step, &mut middle_q)
            .and_then(|()| {
                // Accelerations exist on the connections, which the middle leaves to second order. The derivatives of
                // this projection differ from those of none to second order too.
                let state = (&mut *middle_q, &mut *middle_qd);
                closure.map_or(Ok(()), |closure| closure.project(scene, &mut self.workspace, state))
            })
            .and_then(|()| self.at((plan, scene), (&middle_q, &middle_qd, &wrenches), tau, flow));
        [self.q, self.qd, self.rest] = [middle_q, middle_qd, wrenches];
        done?;
        by_wrench.copy_from_slice(&flow[..by_wrench.len()]);
        chain(self, plan, timing, start, flow);
        Ok(())
    }

    /// Derivatives in the middle by those at the start: `[A_q, A_v]` times the derivatives of the state in the middle.
    #[inline(always)]
    fn chain(&mut self, plan: &Plan, timing: &Timing, start: &[f64], flow: &mut [f64]) {
        let (nv, stride, half) = (plan.nv, plan.flow_stride(), 0.5 * timing.dt);
        self.by_state.copy_from_slice(&flow[plan.q() * stride..plan.states * stride]);
        let (by_q, by_qd) = self.by_state.split_at(nv * stride);
        for (to, by_q) in flow[plan.qd() * stride..plan.states * stride].iter_mut().zip(by_q) {
            *to = half.mul_add(*by_q, *to);
        }
        for &(first, size) in &plan.groups {
            let [back, right] = step_jacobians(&self.step[first..first + size]);
            for (j, row) in (0..size).flat_map(|j| (0..nv).map(move |row| (j, row))) {
                let along = |matrix: &[f64; 36]| -> f64 {
                    (0..size).map(|i| by_q[(first + i) * stride + row] * matrix[size * i + j]).sum()
                };
                flow[(plan.q() + first + j) * stride + row] = along(&back);
                flow[(plan.qd() + first + j) * stride + row] =
                    half.mul_add(along(&right), by_qd[(first + j) * stride + row]);
            }
        }
        for (column, decay) in flow.chunks_exact_mut(stride).zip(&timing.decay[..self.rest.len()]) {
            for entry in column {
                *entry *= 0.5 * (1.0 + decay);
            }
        }
        for (to, from) in flow.chunks_exact_mut(stride).zip(start.chunks_exact(stride)) {
            for block in (0..nv).step_by(LANES) {
                let sums = combine(&from[..nv], (by_qd, stride, block));
                for (to, sum) in to[block..block + LANES].iter_mut().zip(sums) {
                    *to = half.mul_add(sum, *to);
                }
            }
        }
    }
}

within_widest! {
    fn chain<'a>(
        acceleration: &'a mut Acceleration,
        plan: &'a Plan,
        timing: &'a Timing,
        start: &'a [f64],
        flow: &'a mut [f64],
    ) {
        acceleration.chain(plan, timing, start, flow);
    }
}
