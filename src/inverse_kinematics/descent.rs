//! Minimization of F from one start, by Levenberg-Marquardt steps within limits and on the connections.
//!
//! A step minimizes the quadratic model of F with A = J^T W J + posture + mu D, where D is the largest diagonal so far.
//! It is accepted if F decreases by a fraction of what the undamped model predicts; then mu decreases, else it
//! increases. F therefore never increases, and the steps become Newton steps for vanishing errors.
//!
//! Most failed descents end in minima at limits. A start is therefore abandoned if its progress is slow and other
//! starts follow; at the end, the best of them continues to its minimum.

use super::closure::Closure;
use super::limits::{Bounds, RateBounds, SearchLimits};
use super::options::{Metric, Options, RateOptions};
use super::step::{BoxStep, add_squares, quadratic};
use super::task::{Rows, Tasks};
use crate::error::Error;
use crate::interrupt;
use crate::scene::{JointKind, Scene};
use crate::workspace::Workspace;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Initial damping, and the least diagonal entry of D relative to its largest.
const DAMPING: f64 = 1e-2;
const FLOOR: f64 = 1e-3;
/// A step is accepted if F decreases by this fraction of the predicted decrease.
const ENOUGH: f64 = 1e-4;
/// Damping is at most this fraction of the errors, m and rad, so that it vanishes with them. With a posture it has the
/// size of the errors, because the set of configurations that satisfy the tasks is curved, and steps with little
/// damping would leave it.
const SHARE: f64 = 0.03;
/// A start is abandoned if F has not halved in this number of steps, or if a step with at most the initial damping
/// predicts a decrease below this fraction of F.
const HALVING_STEPS: usize = 15;
const LEAST_PROGRESS: f64 = 1e-3;
/// No step can decrease F if the model predicts less than this fraction of it.
const NOTHING: f64 = 1e-16;
/// Least damping with connections: the penalty on their rows would absorb the digits of a smaller one.
const LEAST: f64 = 1e-7;
/// Joint velocities may exceed the minimum of the cost along the step by this fraction of the initial slope, times the
/// gain.
const OVERSHOOT: f64 = 0.5;
/// Joint velocities are zero beyond this damping.
const STILL: f64 = 1e12;

/// Result of a descent.
#[derive(Debug, Clone, Copy)]
pub struct DescentResult {
    pub value: f64,
    pub position_error: f64,
    pub rotation_error: f64,
    pub iterations: usize,
    /// True if the descent was abandoned, so that F could decrease further.
    pub is_abandoned: bool,
    /// The row of the connections with the largest error, and that error, m or rad; `None` if they are closed.
    pub open: Option<(usize, f64)>,
}

/// Condition that ends a descent, in addition to reaching all tasks and to the number of steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopCondition {
    /// Ends when convergence to F = 0 is unlikely.
    NoProgress,
    /// Ends at a minimum of F.
    Minimum,
}

impl DescentResult {
    pub fn reached(&self, tolerance: f64) -> bool {
        self.position_error <= tolerance && self.rotation_error <= tolerance
    }
}

/// A descent with its scratch memory.
#[derive(Debug, Clone)]
pub struct Descent {
    pub limits: Bounds,
    search_limits: SearchLimits,
    closure: Option<Closure>,
    rows: Rows,
    trial_rows: Rows,
    trial: Vec<f64>,
    /// The configuration from which joint velocities are computed.
    from: Vec<f64>,
    off_posture: Vec<f64>,
    hessian: Vec<f64>,
    damped: Vec<f64>,
    mass: Vec<f64>,
    gradient: Vec<f64>,
    scale: Vec<f64>,
    step: Vec<f64>,
    boxed: BoxStep,
}

impl Descent {
    pub fn new(scene: &Scene, limits: Bounds) -> Self {
        let (nv, nan) = (scene.nv(), f64::NAN);
        Self {
            search_limits: SearchLimits::of(&limits),
            limits,
            closure: Closure::of(scene),
            rows: Rows::default(),
            trial_rows: Rows::default(),
            trial: vec![nan; scene.nq()],
            from: vec![nan; scene.nq()],
            off_posture: vec![nan; nv],
            hessian: vec![nan; nv * nv],
            damped: vec![nan; nv * nv],
            mass: Vec::new(),
            gradient: vec![nan; nv],
            scale: vec![nan; nv],
            step: vec![nan; nv],
            boxed: BoxStep::new(nv),
        }
    }

    /// F at `q`.
    pub fn value(&mut self, workspace: &mut Workspace<f64>, tasks: &Tasks<'_>, q: &[f64]) -> Result<f64, Error> {
        tasks.evaluate(workspace, q, &mut self.rows)?;
        Ok(value_of(tasks, &self.rows, q, &mut self.off_posture))
    }

    /// Minimizes F from `q`, in place, in at most the given number of steps. First moves `q` into the limits and onto
    /// the connections.
    ///
    /// With `free`, first minimizes without limits, then moves joints by whole turns toward their limits, and continues
    /// within the limits.
    pub fn run(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &Tasks<'_>,
        options: &Options,
        (until, steps, free): (StopCondition, usize, bool),
        q: &mut [f64],
    ) -> Result<DescentResult, Error> {
        self.search_limits.choose(&self.limits, tasks);
        let mut iterations = 0;
        // Coupled joints, connections and a posture depend on the number of turns.
        if free && self.search_limits.is_limited() && tasks.is_same_after_turns() {
            self.search_limits.lift();
            iterations = self.descend(workspace, tasks, options, (until, steps), q)?.iterations;
            self.search_limits.choose(&self.limits, tasks);
            self.limits.wrap(tasks.scene, q);
        }
        let ending = self.descend(workspace, tasks, options, (until, steps - iterations), q)?;
        Ok(DescentResult { iterations: iterations + ending.iterations, ..ending })
    }

    /// Minimizes F within the current search limits.
    fn descend(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &Tasks<'_>,
        options: &Options,
        (until, steps): (StopCondition, usize),
        q: &mut [f64],
    ) -> Result<DescentResult, Error> {
        let (scene, nv) = (tasks.scene, tasks.scene.nv());
        self.search_limits.bounds.hold(q);
        if !self.close(workspace, scene, q)? {
            let far = f64::INFINITY;
            return Ok(DescentResult { position_error: far, rotation_error: far, ..self.ending(far) });
        }
        let mut value = self.value(workspace, tasks, q)?;
        let (mut damping, mut growth) = (DAMPING, 2.0);
        let (mut halved, mut since) = (value, 0);
        self.scale.fill(0.0);
        let (mut iterations, mut is_abandoned) = (0, false);
        while iterations < steps && !is_abandoned {
            // With a posture, F does not vanish at the solution.
            if tasks.posture.is_none() && self.ending(value).reached(options.tolerance) {
                break;
            }
            self.model(tasks, q);
            if let Some(closure) = &mut self.closure {
                closure.evaluate(workspace, scene, q)?;
                damping = damping.max(LEAST);
            }
            let largest = (0..nv).fold(0.0_f64, |largest, i| largest.max(self.scale[i].max(self.hessian[i * nv + i])));
            if !(largest > 0.0) {
                break;
            }
            for i in 0..nv {
                self.scale[i] = self.scale[i].max(self.hessian[i * nv + i]).max(FLOOR * largest);
            }
            let heaviest = self.weigh(options.metric, workspace, scene, q)?;
            iterations += 1;
            since += 1;
            // Increases damping until a step is accepted; ends if no step can be accepted.
            let accepted = loop {
                interrupt::check()?;
                self.damped.copy_from_slice(&self.hessian);
                match options.metric {
                    Metric::Coordinates => {
                        (0..nv).for_each(|i| self.damped[i * nv + i] += damping * self.scale[i]);
                    }
                    Metric::Mass => {
                        let by = damping * largest / heaviest;
                        self.damped.iter_mut().zip(&self.mass).for_each(|(entry, m)| *entry += by * m);
                    }
                }
                let bounds = &self.search_limits.bounds;
                let room = |row| bounds.room(row, q);
                let (damped, boxed) = ((&self.damped[..], &self.gradient[..]), &mut self.boxed);
                let has_step = match &mut self.closure {
                    None => boxed.minimize(damped.0, damped.1, room, &mut self.step),
                    Some(closure) => closure.minimize(boxed, damped, 0.0, room, &mut self.step),
                };
                // Decrease predicted by the undamped model.
                let expected = if has_step { -quadratic(&self.hessian, &self.gradient, &self.step) } else { 0.0 };
                if has_step && !(expected > NOTHING * value) {
                    break None;
                }
                if has_step {
                    scene.integrate(q, &self.step, &mut self.trial)?;
                    self.search_limits.bounds.hold(&mut self.trial);
                    let mut trial = std::mem::take(&mut self.trial);
                    let is_closed = self.close(workspace, scene, &mut trial);
                    self.trial = trial;
                    let is_closed = is_closed?;
                    std::mem::swap(&mut self.rows, &mut self.trial_rows);
                    tasks.evaluate(workspace, &self.trial, &mut self.rows)?;
                    let next = value_of(tasks, &self.rows, &self.trial, &mut self.off_posture);
                    let share = (value - next) / expected;
                    if is_closed && share > ENOUGH {
                        is_abandoned = damping <= DAMPING && expected < LEAST_PROGRESS * value;
                        damping *= (1.0 - (2.0 * share - 1.0).powi(3)).max(1.0 / 3.0);
                        growth = 2.0;
                        break Some(next);
                    }
                    std::mem::swap(&mut self.rows, &mut self.trial_rows);
                    if let Some(closure) = &mut self.closure {
                        closure.evaluate(workspace, scene, q)?;
                    }
                }
                damping *= growth;
                growth *= 2.0;
                if !(damping < 1e30) {
                    break None;
                }
            };
            let Some(next) = accepted else { break };
            q.copy_from_slice(&self.trial);
            value = next;
            let errors = self.rows.position_error + self.rows.rotation_error;
            let share = if tasks.posture.is_none() { SHARE } else { 1.0 };
            damping = damping.min(share * errors + f64::MIN_POSITIVE);
            if value <= 0.5 * halved {
                (halved, since, is_abandoned) = (value, 0, false);
            }
            is_abandoned |= since >= HALVING_STEPS;
            is_abandoned &= until == StopCondition::NoProgress && tasks.posture.is_none();
        }
        if self.search_limits.bring_back(&self.limits, q) {
            value = self.value(workspace, tasks, q)?;
        }
        Ok(DescentResult { iterations, is_abandoned, open: None, ..self.ending(value) })
    }

    /// Closes the connections from `q`, within the search limits; returns whether they are closed.
    fn close(&mut self, workspace: &mut Workspace<f64>, scene: &Scene, q: &mut [f64]) -> Result<bool, Error> {
        let Some(closure) = &mut self.closure else { return Ok(true) };
        closure.close(workspace, scene, &self.search_limits.bounds, q)?;
        Ok(closure.is_closed())
    }

    /// M at `q` for damping, and its largest diagonal entry. Joints without inertia get a small entry, because they
    /// would not be damped otherwise.
    fn weigh(
        &mut self,
        metric: Metric,
        workspace: &mut Workspace<f64>,
        scene: &Scene,
        q: &[f64],
    ) -> Result<f64, Error> {
        let nv = scene.nv();
        if metric == Metric::Coordinates || nv == 0 {
            return Ok(1.0);
        }
        self.mass.resize(nv * nv, f64::NAN);
        scene.mass_matrix(workspace, q, &mut self.mass)?;
        let heaviest = (0..nv).fold(f64::MIN_POSITIVE, |most, i| most.max(self.mass[i * nv + i]));
        (0..nv).for_each(|i| self.mass[i * nv + i] += FLOOR * heaviest);
        Ok(heaviest)
    }

    /// The joint velocities at `q` that [`Solver::rates`](super::Solver::rates) documents.
    pub fn rates(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &Tasks<'_>,
        q: &[f64],
        options: &RateOptions<'_>,
        limits: Option<&RateBounds>,
        qd: &mut [f64],
    ) -> Result<(), Error> {
        let (scene, nv, dt) = (tasks.scene, tasks.scene.nv(), options.dt);
        // Joints beyond their limits return with priority; the tasks use the remaining velocity range.
        qd.fill(0.0);
        if let Some(limits) = limits {
            limits.returning(q, dt, qd);
        }
        // Moved out and back because it is read while the rest of the scratch is written.
        let mut from = std::mem::take(&mut self.from);
        from.resize(scene.nq(), f64::NAN);
        scene.integrate(q, qd, &mut from)?;
        tasks.evaluate(workspace, &from, &mut self.rows)?;
        self.model(tasks, &from);
        // Check for overflow here, because the sums and comparisons below would turn it into zeros.
        for derivative in [&self.gradient, &self.hessian] {
            scene.check_result("derivatives of the tasks", derivative)?;
        }
        if let Some(closure) = &mut self.closure {
            closure.evaluate(workspace, scene, &from)?;
        }
        let value = value_of(tasks, &self.rows, &from, &mut self.off_posture);
        let largest = (0..nv).fold(0.0_f64, |largest, i| largest.max(self.hessian[i * nv + i]));
        // Connections reduce their errors also if no task depends on the joints.
        let largest = if largest > 0.0 { largest } else { 1.0 };
        for i in 0..nv {
            self.gradient[i] *= options.gain;
            self.scale[i] = self.hessian[i * nv + i].max(FLOOR * largest);
        }
        let mut damping = options.damping;
        loop {
            self.damped.copy_from_slice(&self.hessian);
            (0..nv).for_each(|i| self.damped[i * nv + i] += damping * self.scale[i]);
            let room = |row: usize| {
                limits.map_or((f64::NEG_INFINITY, f64::INFINITY), |limits| limits.room(row, q, dt, qd[row]))
            };
            let (damped, boxed) = ((&self.damped[..], &self.gradient[..]), &mut self.boxed);
            let has_step = match &mut self.closure {
                None => boxed.minimize(damped.0, damped.1, room, &mut self.step),
                Some(closure) => closure.minimize(boxed, damped, 1.0, room, &mut self.step),
            };
            if !has_step {
                let expected = "more damping: the tasks leave some motions undetermined to within rounding";
                return Err(Error::argument("damping", options.damping.to_string(), expected));
            }
            let Some(stiffness) = self.overshoot(workspace, tasks, &from, (value, options.gain))? else { break };
            damping = stiffness.max(10.0 * damping);
            if !(damping < STILL) {
                break;
            }
        }
        for (qd, step) in qd.iter_mut().zip(&self.step) {
            *qd = (*qd + step) / dt;
        }
        self.from = from;
        tasks.scene.check_result("qd", qd)
    }

    /// Tests whether the step from `from`, whose rows are computed, increases the cost or passes its minimum along the
    /// step. Returns the curvature along the step as damping, or `None` if the step is accepted.
    ///
    /// For unreachable targets the errors remain, and the cost has more curvature than the model. Without this test,
    /// joints would oscillate about the minimum.
    fn overshoot(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &Tasks<'_>,
        from: &[f64],
        (value, gain): (f64, f64),
    ) -> Result<Option<f64>, Error> {
        let (slope, _) = along(&self.rows, &self.step);
        tasks.scene.integrate(from, &self.step, &mut self.trial)?;
        tasks.evaluate(workspace, &self.trial, &mut self.trial_rows)?;
        let (after, size) = along(&self.trial_rows, &self.step);
        let next = value_of(tasks, &self.trial_rows, &self.trial, &mut self.off_posture);
        let rounding = 8.0 * f64::EPSILON;
        let falls = next <= value * (1.0 + rounding) && after <= OVERSHOOT * gain * -slope + rounding * size;
        if falls || !(slope < 0.0) {
            return Ok(None);
        }
        let square: f64 = self.step.iter().zip(&self.scale).map(|(step, scale)| scale * step * step).sum();
        Ok(Some((after - slope) / square))
    }

    /// Covariance at `q`: the inverse of the second derivative of F without the joints at their limits.
    pub fn covariance(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &Tasks<'_>,
        q: &[f64],
        out: &mut [f64],
    ) -> Result<(), Error> {
        tasks.evaluate(workspace, q, &mut self.rows)?;
        self.model(tasks, q);
        let nv = tasks.scene.nv();
        let limits = &self.limits;
        let inside = |row: usize| {
            let (lower, upper) = limits.room(row, q);
            lower < 0.0 && upper > 0.0
        };
        // Rounding errors can make a singular matrix look positive definite. A motion that the tasks leave undetermined
        // is recognized by a pivot below rounding error.
        let largest = (0..nv).fold(0.0_f64, |largest, i| largest.max(self.hessian[i * nv + i]));
        let is_definite = match &mut self.closure {
            None => self.boxed.inverse(&self.hessian, inside, out),
            Some(closure) => {
                closure.evaluate(workspace, tasks.scene, q)?;
                closure.inverse(&self.hessian, inside, out)
            }
        };
        let worst = (0..nv).fold(0.0_f64, |worst, i| worst.max(out[i * nv + i]));
        if !is_definite || !(worst * largest < 1e14) {
            out.fill(f64::INFINITY);
        }
        Ok(())
    }

    /// The result at the current configuration.
    fn ending(&self, value: f64) -> DescentResult {
        let Rows { position_error, rotation_error, .. } = self.rows;
        let open = self.closure.as_ref().filter(|closure| !closure.is_closed()).map(Closure::largest);
        DescentResult { value, position_error, rotation_error, iterations: 0, is_abandoned: false, open }
    }

    /// Gradient and Gauss-Newton approximation of the second derivative of F at `q`, from the computed rows.
    fn model(&mut self, tasks: &Tasks<'_>, q: &[f64]) {
        let nv = tasks.scene.nv();
        self.gradient.fill(0.0);
        self.hessian.fill(0.0);
        add_squares(&self.rows.jacobian, &self.rows.errors, &mut self.hessian, &mut self.gradient);
        if let Some((expected, deviation)) = tasks.posture {
            off_posture(tasks.scene, expected, q, &mut self.off_posture);
            let weight = 1.0 / (deviation * deviation);
            for i in 0..nv {
                self.gradient[i] += weight * self.off_posture[i];
                self.hessian[i * nv + i] += weight;
            }
        }
    }
}

/// Derivative of F along a step, and the sum of the absolute values of its terms.
fn along(rows: &Rows, step: &[f64]) -> (f64, f64) {
    let mut found = (0.0, 0.0);
    for (row, error) in rows.jacobian.chunks_exact(step.len().max(1)).zip(&rows.errors) {
        let moved: f64 = row.iter().zip(step).map(|(of, step)| of * step).sum();
        found = (found.0 + error * moved, found.1 + (error * moved).abs());
    }
    found
}

/// F at `q`, from the computed rows.
fn value_of(tasks: &Tasks<'_>, rows: &Rows, q: &[f64], off: &mut [f64]) -> f64 {
    let own: f64 = rows.errors.iter().map(|error| error * error).sum();
    let mut posture = 0.0;
    if let Some((expected, deviation)) = tasks.posture {
        off_posture(tasks.scene, expected, q, off);
        posture = off.iter().map(|off| (off / deviation).powi(2)).sum();
    }
    0.5 * (own + posture)
}

/// Deviation of `q` from a posture in the tangent space at `q`; the gradient of its square is twice the deviation.
///
/// For rotations this is the rotation vector t, for which Jr^-1(t)^T t = t. A free joint has translation and rotation
/// as separate deviations in its body axes; the screw motion between two poses does not have this property.
fn off_posture(scene: &Scene, posture: &[f64], q: &[f64], out: &mut [f64]) {
    for joint in scene.joints() {
        let (from, to, off) = (&posture[joint.q.clone()], &q[joint.q.clone()], &mut out[joint.v.clone()]);
        if joint.kind != JointKind::Floating {
            joint.kind.difference(from, to, off);
            continue;
        }
        let turn = |q: &[f64]| UnitQuaternion::from_quaternion(Quaternion::new(q[6], q[3], q[4], q[5]));
        let (before, now) = (turn(from), turn(to));
        let moved = now.inverse() * (Vector3::new(to[0], to[1], to[2]) - Vector3::new(from[0], from[1], from[2]));
        off[..3].copy_from_slice(moved.as_slice());
        off[3..].copy_from_slice((before.inverse() * now).scaled_axis().as_slice());
    }
}
