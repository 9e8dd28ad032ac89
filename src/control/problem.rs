//! Optimal control problems, the start of a search, and its results.

use super::costs::{Cost, Limit, Term};
use crate::joints::JointKind;
use crate::scene::Scene;

/// Velocity below which friction is viscous, rad/s or m/s: near to dry friction, plans need many iterations.
const FRICTION_SPEED_OF_PLANS: f64 = 0.2;

/// An optimal control problem of one scene.
#[derive(Debug)]
#[non_exhaustive]
pub struct Problem {
    /// Time step, s.
    pub dt: f64,
    /// Number of steps.
    pub steps: usize,
    /// The terms of the cost, and the inequalities.
    pub costs: Vec<Cost>,
    /// Smallest and largest efforts, (nv) each; a joint for which both are zero has no control.
    pub effort: [Vec<f64>; 2],
    /// Largest number of iterations.
    pub iterations: usize,
    /// The search ends when the model has a decrease of at most this share of the cost.
    pub tolerance: f64,
    /// Largest violation of an inequality, in its unit.
    pub limit_tolerance: f64,
    /// Velocity below which friction is viscous, rad/s or m/s.
    pub friction_speed: f64,
    /// Length by which contacts are relaxed, m, as in [`Settings`](crate::motion::Settings); zero: contacts do not act.
    pub smoothing: f64,
}

impl Problem {
    /// A problem without costs, with the effort limits of the scene. The joint of a floating base has no control.
    #[must_use]
    pub fn new(scene: &Scene, dt: f64, steps: usize) -> Self {
        let mut effort = vec![f64::INFINITY; scene.nv()];
        for joint in scene.joints() {
            let is_base = joint.kind == JointKind::Floating;
            effort[joint.v.clone()].fill(if is_base { 0.0 } else { joint.limits.effort });
        }
        Self {
            dt,
            steps,
            costs: Vec::new(),
            effort: [effort.iter().map(|most| -most).collect(), effort],
            iterations: 100,
            tolerance: 1e-6,
            limit_tolerance: 1e-6,
            friction_speed: FRICTION_SPEED_OF_PLANS,
            smoothing: 0.0,
        }
    }

    /// The position and velocity limits of the joints, as inequalities at all knots but the first; `None` if no joint
    /// has any.
    #[must_use]
    pub fn limits_of(scene: &Scene, steps: usize) -> Option<Cost> {
        let mut limits = Vec::new();
        for joint in scene.joints() {
            let (of, row) = (&joint.limits, joint.v.start);
            let mut add = |is_rate: bool, sign: f64, bound: f64| {
                if bound.is_finite() {
                    limits.push(Limit { is_rate, index: if is_rate { row } else { joint.q.start }, row, sign, bound });
                }
            };
            if joint.q.len() == 1 && joint.v.len() == 1 {
                add(false, -1.0, of.lower);
                add(false, 1.0, of.upper);
                add(true, -1.0, -of.velocity);
                add(true, 1.0, of.velocity);
            }
        }
        let is_any = !limits.is_empty() && steps > 0;
        is_any.then(|| Cost { term: Term::Limits(limits), first: 1, last: steps, is_limit: true })
    }
}

/// The start of a search.
#[derive(Debug, Clone, Copy, Default)]
pub struct Start<'a> {
    /// Initial configuration, (nq), and velocity, (nv).
    pub q: &'a [f64],
    /// Initial joint velocity, (nv).
    pub qd: &'a [f64],
    /// First efforts, (steps x nv); empty for those that hold the robot still.
    pub tau: &'a [f64],
    /// First configurations and velocities of the knots after the start, (steps x nq) and (steps x nv): a motion that
    /// the efforts need not follow. Empty for the motion of the efforts.
    pub states: Option<[&'a [f64]; 2]>,
}

/// An iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Iteration {
    /// The cost after it.
    pub cost: f64,
    /// The decrease of the model for the whole step.
    pub expected: f64,
    /// The step length; zero if no length decreased the cost.
    pub length: f64,
    /// The share of the curvature of the controls that was added to it.
    pub damping: f64,
    /// The sum of the magnitudes of all defects after it.
    pub defects: f64,
    /// The largest violation of an inequality after it.
    pub violation: f64,
    /// The number of stages in array form.
    pub array_stages: usize,
}

/// The result of a search; the motion and the law are those of the optimizer.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Outcome {
    /// True if the model has no further decrease, the defects vanish and the inequalities hold.
    pub converged: bool,
    /// The cost, without that of inequalities.
    pub cost: f64,
    /// Each iteration.
    pub history: Vec<Iteration>,
    /// Why it ended.
    pub reason: &'static str,
}

/// The system and the cost about the motion: for each step A (n x n), B (n x m), and for each knot the second
/// derivatives of the cost by (x, u), without inequalities: their weights are not part of the cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Linearization {
    /// A of each step.
    pub a: Vec<f64>,
    /// B of each step.
    pub b: Vec<f64>,
    /// The derivatives of the next (q, qd) by a torque of every joint, (2 nv x nv), for torque noise.
    pub by_torque: Vec<f64>,
    /// The Hessian of each knot, ((n + m) x (n + m)).
    pub hessian: Vec<f64>,
}
