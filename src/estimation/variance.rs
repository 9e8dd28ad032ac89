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
use crate::filter::{HingeMap, Stage, covariance};
use crate::kinematics::propagation::sum_tip_to_base;
use crate::kinematics::{accelerations_base_to_tip, base_acceleration, placements_base_to_tip, velocities_base_to_tip};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{RigidShift, Symmetric3, Symmetric6, dot, from_rows, scaled, scaled_add};
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

/// The place of a body among its relatives.
#[derive(Debug, Clone, Copy)]
struct Kin {
    /// The number of its children.
    children: usize,
    /// True if its parent has no other child.
    is_only: bool,
    /// True if it is the last child of its parent: the first on the way inward.
    is_last: bool,
}

impl Kin {
    fn of_all<T: Real>(stages: &[Stage<T>]) -> Vec<Self> {
        let mut all = vec![Self { children: 0, is_only: false, is_last: false }; stages.len()];
        for (k, stage) in stages.iter().enumerate().rev() {
            let Some(parent) = stage.parent else { continue };
            all[k].is_last = all[parent].children == 0;
            all[parent].children += 1;
        }
        for (k, stage) in stages.iter().enumerate() {
            all[k].is_only = stage.parent.is_some_and(|parent| all[parent].children == 1);
        }
        all
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
    /// The place of each body among its relatives.
    kin: Vec<Kin>,
    /// C(k).
    pub(super) own: Vec<Symmetric6<T>>,
    /// Pi^-(k), complete, of bodies that have children; that of others is C(k).
    predicted: Vec<Symmetric6<T>>,
    /// Pi before the measurement of each row.
    pub(super) before_row: Vec<Symmetric6<T>>,
    /// phi Pi^+ phi* of each body with siblings at its parent.
    carried: Vec<Symmetric6<T>>,
    /// Of each body with siblings: C of its parent plus the sum over the parent's later children.
    later: Vec<Symmetric6<T>>,
    /// Of each body with several children: the sum over those that were passed already on the way outward.
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
            kin: Kin::of_all(&model.system.stages),
            own: of_bodies(),
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
    parameters.force_covariances(velocity, acceleration, &mut scratch.own);
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
    let VarianceScratch { torque, kin, own, predicted, before_row, carried, later, .. } = scratch;
    for (k, stage) in model.system.stages.iter().enumerate().rev() {
        let mut pi = if kin[k].children == 0 { own[k] } else { predicted[k] };
        for i in (0..stage.rows.count()).rev() {
            let row = stage.first_row + i;
            before_row[row] = pi;
            if i > 0 || stage.parent.is_some() {
                let noise_free = model.system.is_noise_free(row);
                pi = past_measurement(&pi, &stage.rows.row(i), &factor.measured[row], torque[row], noise_free);
            }
        }
        if let Some(parent) = stage.parent {
            let sent = factor.shift[k].inertia_to_parent(&pi);
            let others = if kin[k].is_last { own[parent] } else { predicted[parent] };
            predicted[parent] = others.add(&sent);
            if !kin[k].is_only {
                (later[k], carried[k]) = (others, sent);
            }
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
    let VarianceScratch {
        torque, kin, own, predicted, before_row, carried, later, earlier, independent, co_state, ..
    } = scratch;
    for (k, stage) in model.system.stages.iter().enumerate() {
        let Kin { children, is_only, .. } = kin[k];
        let (mut lambda, mut u) = (Symmetric6::zero(), Symmetric6::zero());
        if let Some(parent) = stage.parent {
            // The noise of the parent and of its other children.
            let others = if is_only { own[parent] } else { later[k].add(&earlier[parent]) };
            let felt = independent[parent].add(&congruence(&co_state[parent], &others));
            lambda = factor.shift[k].co_covariance_to_child(&co_state[parent]);
            u = factor.shift[k].co_covariance_to_child(&felt);
            if !is_only {
                earlier[parent] = earlier[parent].add(&carried[k]);
            }
        }
        // The joints of a body without children need no co-state outboard of them.
        let is_tip = children == 0 && out.bodies.is_empty();
        let count = stage.rows.count();
        for i in 0..count {
            let row = stage.first_row + i;
            let (hinge, measured, t) = (stage.rows.row(i), &factor.measured[row], torque[row]);
            let (next, sent) = covariance::row_update(&lambda, &hinge, measured);
            let w = dot(&measured.gain, &sent) + measured.pivot_inverse;
            let v = hinge.spread_onto(&scaled(&sent, w.constant(-1.0)), w);
            // A* U A: the same update without the term of 1/D.
            let closed = Measured { pivot_inverse: w.constant(0.0), ..*measured };
            let (passed, spread) = covariance::row_update(&u, &hinge, &closed);
            let own = dot(&v, &before_row[row].mul_vector(&v)) + dot(&measured.gain, &spread);
            out.joints[row] = (w * w).mul_add(t, own);
            if is_tip && i + 1 == count {
                break;
            }
            u = passed.add_rank_one(&scaled(&v, t), &v);
            lambda = next;
        }
        if let Some(body) = out.bodies.get_mut(k) {
            let whole = if children == 0 { &own[k] } else { &predicted[k] };
            *body = u.add(&congruence(&lambda, whole));
        }
        if children > 1 {
            earlier[k] = Symmetric6::zero();
        }
        (independent[k], co_state[k]) = (u, lambda);
    }
}

/// Lambda X Lambda. One product with X at a time, and every index a constant: six numbers in registers.
#[inline(always)]
fn congruence<T: Real>(lambda: &Symmetric6<T>, x: &Symmetric6<T>) -> Symmetric6<T> {
    let [a, b, c] = [lambda.column(0), lambda.column(1), lambda.column(2)];
    let [d, e, f] = [lambda.column(3), lambda.column(4), lambda.column(5)];
    let y = x.mul_vector(&a);
    let xx = dot(&a, &y);
    let y = x.mul_vector(&b);
    let (xy, yy) = (dot(&a, &y), dot(&b, &y));
    let y = x.mul_vector(&c);
    let (xz, yz, zz) = (dot(&a, &y), dot(&b, &y), dot(&c, &y));
    let angular = Symmetric3::new([xx, xy, xz, yy, yz, zz]);
    let y = x.mul_vector(&d);
    let (first, xx) = ([dot(&a, &y), dot(&b, &y), dot(&c, &y)], dot(&d, &y));
    let y = x.mul_vector(&e);
    let (second, xy, yy) = ([dot(&a, &y), dot(&b, &y), dot(&c, &y)], dot(&d, &y), dot(&e, &y));
    let y = x.mul_vector(&f);
    let (third, xz, yz, zz) = ([dot(&a, &y), dot(&b, &y), dot(&c, &y)], dot(&d, &y), dot(&e, &y), dot(&f, &y));
    let [p, q, r] = [first, second, third];
    let coupling = from_rows([p[0], q[0], r[0]], [p[1], q[1], r[1]], [p[2], q[2], r[2]]);
    Symmetric6 { angular, coupling, linear: Symmetric3::new([xx, xy, xz, yy, yz, zz]) }
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
    let VarianceScratch { motions, own, .. } = scratch;
    motions.base_to_tip(model, (q, qd, qdd));
    parameters.force_covariances(&motions.velocity, &motions.acceleration, own);
    torques_tip_to_base(model, &motions.shift, own, out);
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
