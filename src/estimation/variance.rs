//! Variances of accelerations and torques in O(N): the covariance analysis of a filter and smoother whose gains were
//! made for other noise.
//!
//! At the true acceleration a parameter error d pi(k) is a force Y(k) d pi(k) on body k, Y the body's regressor, so the
//! process noise is C(k) = Y Sigma Y* in place of M(k), and the measurement noise is the variance t of a torque in
//! place of the armature. Tip to base, Pi is the covariance of the filter's error; base to tip, U is that of the part
//! of the co-state that does not depend on the noise outboard. Nothing is subtracted from a covariance that was added
//! to it before: congruences and sums only.

use super::parameter_roots::ParameterRoots;
use crate::dynamics::forward_dynamics;
use crate::filter::pivots::PivotMonitor;
use crate::filter::riccati::Measured;
use crate::filter::{HingeMap, covariance};
use crate::kinematics::propagation::sum_tip_to_base;
use crate::kinematics::{accelerations_base_to_tip, base_acceleration, placements_base_to_tip, velocities_base_to_tip};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{RigidShift, Symmetric6, dot, scaled, scaled_add, zero};
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// The covariance of the parameters of one degree of freedom that act as a torque: armature, damping, dry friction and
/// offset, row by row.
pub type JointCovariance<T> = [[T; 4]; 4];

/// The variance of the torque error of each degree of freedom.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct TorqueVariance<'a, T> {
    /// Variance of the torque itself, (nv), (N m)^2 or N^2.
    pub noise: &'a [T],
    /// Empty, or the covariance of each degree of freedom's own parameters, (nv).
    pub joints: &'a [JointCovariance<T>],
    /// The speed below which dry friction is viscous, rad/s or m/s.
    pub friction_speed: T,
}

impl<'a, T: Real> TorqueVariance<'a, T> {
    /// Torques with the variances `noise` (nv), and exact parameters of the joints.
    #[must_use]
    pub fn new(noise: &'a [T]) -> Self {
        Self { noise, joints: &[], friction_speed: T::zero() }
    }

    /// The same with another covariance of each degree of freedom's own parameters, (nv), whose dry friction is
    /// viscous below the speed `friction_speed`, rad/s or m/s.
    #[must_use]
    pub fn with_joints(mut self, joints: &'a [JointCovariance<T>], friction_speed: T) -> Self {
        (self.joints, self.friction_speed) = (joints, friction_speed);
        self
    }

    /// t = noise + y* Sigma y with y = (qdd, qd, qd / sqrt(qd^2 + speed^2), 1), of every degree of freedom.
    #[inline(always)]
    pub(super) fn evaluate(&self, qd: &[T], qdd: &[T], t: &mut [T]) {
        t.copy_from_slice(self.noise);
        for (row, covariance) in self.joints.iter().enumerate() {
            let speed = qd[row].mul_add(qd[row], self.friction_speed * self.friction_speed).sqrt();
            let y = [qdd[row], qd[row], qd[row] / speed, T::one()];
            for (e, &weight) in covariance.iter().zip(&y) {
                let inner = e[0].mul_add(y[0], e[1].mul_add(y[1], e[2].mul_add(y[2], e[3] * y[3])));
                t[row] = weight.mul_add(inner, t[row]);
            }
        }
    }
}

/// Where the results go.
#[derive(Debug)]
pub struct Variances<'a, T: Real> {
    /// The variance of each acceleration, (nv).
    pub joints: &'a mut [T],
    /// Empty, or for each body the covariance of its acceleration (angular, linear), (6 x 6), in its frame.
    pub bodies: &'a mut [Symmetric6<T>],
}

/// phi, velocity and acceleration of every body in its frame, weight included.
#[derive(Debug, Clone)]
pub(super) struct BodyMotions<T: Real> {
    pub shift: Vec<RigidShift<T>>,
    pub velocity: Vec<Vector6<T>>,
    pub acceleration: Vec<Vector6<T>>,
}

impl<T: Real> BodyMotions<T> {
    fn new(bodies: usize) -> Self {
        let nan = T::from_f64(f64::NAN);
        let vectors = vec![Vector6::from_element(nan); bodies];
        Self { shift: vec![RigidShift::filled(nan); bodies], velocity: vectors.clone(), acceleration: vectors }
    }

    /// Base to tip: the motion of a state (2.9).
    #[inline(always)]
    pub fn base_to_tip(&mut self, model: &Model<T>, (q, qd, qdd): (&[T], &[T], &[T])) {
        let Self { shift, velocity, acceleration } = self;
        placements_base_to_tip(model, q, shift);
        velocities_base_to_tip(model, shift, qd, velocity);
        let base = base_acceleration(model);
        accelerations_base_to_tip(model, (shift, velocity), (qd, qdd), Some(&base), acceleration);
    }
}

/// Scratch for the variances.
#[derive(Debug, Clone)]
pub struct VarianceScratch<T: Real> {
    /// Accelerations of the state.
    pub(super) qdd: Vec<T>,
    pub(super) motions: BodyMotions<T>,
    /// t, the variance of each torque error.
    pub(super) torque: Vec<T>,
    /// Pi^-(k), complete.
    pub(super) predicted: Vec<Symmetric6<T>>,
    /// Pi before the measurement of each row.
    pub(super) before_row: Vec<Symmetric6<T>>,
    /// phi Pi^+ phi* of each body at its parent.
    carried: Vec<Symmetric6<T>>,
    /// Of each body: C of its parent and what the parent's later children brought.
    later: Vec<Symmetric6<T>>,
    /// Of each body: what those of its children brought that were passed already on the way outward.
    earlier: Vec<Symmetric6<T>>,
    /// U(k) outboard of the joint.
    independent: Vec<Symmetric6<T>>,
    /// Lambda^-(k).
    pub(super) co_state: Vec<Symmetric6<T>>,
    pub(crate) identity: u64,
}

impl<T: Real> VarianceScratch<T> {
    /// Scratch for `model`.
    #[must_use]
    pub fn new(model: &Model<T>) -> Self {
        let nan = T::from_f64(f64::NAN);
        let of_bodies = || vec![Symmetric6::filled(nan); model.bodies.len()];
        Self {
            qdd: vec![nan; model.nv()],
            motions: BodyMotions::new(model.bodies.len()),
            torque: vec![nan; model.nv()],
            predicted: of_bodies(),
            before_row: vec![Symmetric6::filled(nan); model.nv()],
            carried: of_bodies(),
            later: of_bodies(),
            earlier: of_bodies(),
            independent: of_bodies(),
            co_state: of_bodies(),
            identity: model.identity(),
        }
    }
}

/// Variances of the joint accelerations of forward dynamics, in O(N): those of `parameters` and of `torque` together.
///
/// `q` (nq), `qd`, `tau` (nv) are one state; `wrenches` as in [`forward_dynamics`]. First order in the errors. Where
/// [`Workspace::lost_pivot`] finds one with the returned monitor, the results mean nothing.
#[allow(clippy::too_many_arguments)] // a state, what is uncertain, and where results go
pub fn forward_dynamics_variance<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut VarianceScratch<T>,
    (q, qd, tau): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    parameters: &ParameterRoots<T>,
    torque: &TorqueVariance<'_, T>,
    out: &mut Variances<'_, T>,
) -> PivotMonitor<T> {
    let monitor = forward_dynamics(model, workspace, q, qd, tau, wrenches, &mut scratch.qdd);
    // The regressor is taken at the acceleration that was found, not at zero.
    scratch.motions.base_to_tip(model, (q, qd, &scratch.qdd));
    torque.evaluate(qd, &scratch.qdd, &mut scratch.torque);
    let BodyMotions { velocity, acceleration, .. } = &scratch.motions;
    parameters.force_covariances(velocity, acceleration, &mut scratch.predicted);
    let factor = Factored { shift: &workspace.store.shifts, measured: &workspace.store.measured };
    tip_to_base(model, factor, scratch);
    base_to_tip(model, factor, scratch, out);
    monitor
}

/// The factor of M that the variances are propagated with.
#[derive(Clone, Copy)]
pub(super) struct Factored<'a, T: Real> {
    pub shift: &'a [RigidShift<T>],
    pub measured: &'a [Measured<T>],
}

/// Tip to base: Pi^-(k) = C(k) + sum over children of phi Pi^+ phi*, and Pi^+ = A Pi A* + t g g* at each row.
#[inline(always)]
pub(super) fn tip_to_base<T: Real>(model: &Model<T>, factor: Factored<'_, T>, scratch: &mut VarianceScratch<T>) {
    for (k, stage) in model.system.stages.iter().enumerate().rev() {
        let mut pi = scratch.predicted[k];
        for i in (0..stage.rows.count()).rev() {
            let row = stage.first_row + i;
            scratch.before_row[row] = pi;
            let noise_free = model.system.is_noise_free(row);
            let t = scratch.torque[row];
            pi = past_measurement(&pi, &stage.rows.row(i), &factor.measured[row], t, noise_free);
        }
        if let Some(parent) = stage.parent {
            let carried = factor.shift[k].inertia_to_parent(&pi);
            scratch.later[k] = scratch.predicted[parent];
            scratch.predicted[parent] = scratch.predicted[parent].add(&carried);
            scratch.carried[k] = carried;
        }
    }
}

/// A Pi A* + t g g* with A = 1 - g H.
#[inline(always)]
fn past_measurement<T: Real>(
    pi: &Symmetric6<T>,
    hinge: &HingeMap<T>,
    measured: &Measured<T>,
    t: T,
    noise_free: bool,
) -> Symmetric6<T> {
    let gain = &measured.gain;
    let column = hinge.covariance_column(pi);
    let half = (hinge.project(&column) + t) * t.constant(0.5);
    // Pi - g w* - w g* with w = Pi H* - g (H Pi H* + t) / 2.
    let w = scaled_add(gain, -half, &column);
    let minus = scaled(gain, t.constant(-1.0));
    let mut next = pi.add_rank_one(&minus, &w).add_rank_one(&scaled(&w, t.constant(-1.0)), gain);
    if noise_free && let HingeMap::Axis(i) = *hinge {
        // H A = 0: of the noise outboard nothing is left along the axis.
        next.write_column(i, &scaled(gain, t));
    }
    next
}

/// Base to tip: the variance of each acceleration, U and Lambda.
#[inline(always)]
pub(super) fn base_to_tip<T: Real>(
    model: &Model<T>,
    factor: Factored<'_, T>,
    scratch: &mut VarianceScratch<T>,
    out: &mut Variances<'_, T>,
) {
    for (k, stage) in model.system.stages.iter().enumerate() {
        let (mut lambda, mut independent) = (Symmetric6::zero(), Symmetric6::zero());
        if let Some(parent) = stage.parent {
            // The noise of the parent and of the other children; for an only child, `earlier` is zero.
            let others = scratch.later[k].add(&scratch.earlier[parent]);
            let at_parent = &scratch.co_state[parent];
            let felt = scratch.independent[parent].add(&congruence(at_parent, &others));
            lambda = factor.shift[k].co_covariance_to_child(at_parent);
            independent = factor.shift[k].co_covariance_to_child(&felt);
            scratch.earlier[parent] = scratch.earlier[parent].add(&scratch.carried[k]);
        }
        for i in 0..stage.rows.count() {
            let row = stage.first_row + i;
            let (hinge, measured) = (stage.rows.row(i), &factor.measured[row]);
            let (next, u) = covariance::row_update(&lambda, &hinge, measured);
            let w = dot(&measured.gain, &u) + measured.pivot_inverse;
            let v = hinge.spread_onto(&scaled(&u, w.constant(-1.0)), w);
            let t = scratch.torque[row];
            let pi = &scratch.before_row[row];
            // A* U A: the same update without the term of 1/D.
            let closed = Measured { pivot_inverse: w.constant(0.0), ..*measured };
            let (carried, spread) = covariance::row_update(&independent, &hinge, &closed);
            let own = dot(&v, &pi.mul_vector(&v)) + dot(&measured.gain, &spread);
            out.joints[row] = (w * w).mul_add(t, own);
            independent = carried.add_rank_one(&scaled(&v, t), &v);
            lambda = next;
        }
        if let Some(body) = out.bodies.get_mut(k) {
            *body = independent.add(&congruence(&lambda, &scratch.predicted[k]));
        }
        scratch.earlier[k] = Symmetric6::zero();
        scratch.independent[k] = independent;
        scratch.co_state[k] = lambda;
    }
}

/// Lambda X Lambda.
#[inline(always)]
fn congruence<T: Real>(lambda: &Symmetric6<T>, x: &Symmetric6<T>) -> Symmetric6<T> {
    const PACKED: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
    // No closures: in lanes they would be functions without the instructions of the arm.
    let mut columns = [zero(); 6];
    let mut products = columns;
    for (i, (column, product)) in columns.iter_mut().zip(&mut products).enumerate() {
        *column = lambda.column(i);
        *product = x.mul_vector(column);
    }
    let mut out = Symmetric6::zero();
    for (at, (i, j)) in PACKED.into_iter().enumerate() {
        out.angular.entries[at] = dot(&columns[i], &products[j]);
        out.linear.entries[at] = dot(&columns[i + 3], &products[j + 3]);
    }
    for (i, column) in columns[..3].iter().enumerate() {
        for (j, product) in products[3..].iter().enumerate() {
            out.coupling[(i, j)] = dot(column, product);
        }
    }
    out
}

/// Variances of the joint torques of inverse dynamics, in O(N): Pi(k) = C(k) + sum over children of phi Pi phi*,
/// var(tau) = H Pi H* + t.
///
/// `q` (nq), `qd`, `qdd` (nv) are one state. Torques are linear in the parameters: nothing is approximate.
pub fn inverse_dynamics_variance<T: Real>(
    model: &Model<T>,
    scratch: &mut VarianceScratch<T>,
    (q, qd, qdd): (&[T], &[T], &[T]),
    parameters: &ParameterRoots<T>,
    torque: &TorqueVariance<'_, T>,
    out: &mut [T],
) {
    torque.evaluate(qd, qdd, out);
    let VarianceScratch { motions, predicted, .. } = scratch;
    motions.base_to_tip(model, (q, qd, qdd));
    parameters.force_covariances(&motions.velocity, &motions.acceleration, predicted);
    torques_tip_to_base(model, &motions.shift, predicted, out);
}

/// Tip to base: Pi(k), and H Pi H* added to the variance of each torque.
#[inline(always)]
pub(super) fn torques_tip_to_base<T: Real>(
    model: &Model<T>,
    shift: &[RigidShift<T>],
    covariance: &mut [Symmetric6<T>],
    out: &mut [T],
) {
    sum_tip_to_base(&model.system.stages, shift, covariance);
    for (stage, pi) in model.system.stages.iter().zip(&*covariance) {
        for i in 0..stage.rows.count() {
            let hinge = stage.rows.row(i);
            out[stage.first_row + i] += hinge.project(&hinge.covariance_column(pi));
        }
    }
}
