//! From one start down to where F is least: the steps of Levenberg and Marquardt, within limits and on the connections.
//!
//! A step minimizes the quadratic model of F with A = J^T W J + posture + mu D, D the largest diagonal so far. It is taken where F falls by a share of what
//! the undamped model says; then mu falls too, else it grows. So F never rises, and the steps become Newton's where the errors vanish.
//!
//! Most ends that are no answer are minima at limits. So a start is given up as soon as it promises nothing, if others can follow; the best of them then goes on
//! to its minimum.

use super::closure::Closure;
use super::limits::{Bounds, RateBounds, Way};
use super::step::{BoxStep, add_squares, quadratic};
use super::task::{Rows, Tasks};
use super::{Metric, Options, RateOptions};
use crate::error::Error;
use crate::interrupt;
use crate::scene::{JointKind, Scene};
use crate::workspace::Workspace;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Damping to begin with, and the least diagonal of D, of its largest.
const DAMPING: f64 = 1e-2;
const FLOOR: f64 = 1e-3;
/// A step is taken where F falls by this share of what was expected.
const ENOUGH: f64 = 1e-4;
/// Damping is no more than this share of the errors, m and rad: so it vanishes with them. With a posture it is as large as they are: the way along a motion that
/// the tasks leave free is curved, and steps that are damped little would leave it.
const SHARE: f64 = 0.03;
/// A start is given up where F has not halved in so many steps, or where a step that is damped no more than the first promises less than this share of F.
const PATIENCE: usize = 15;
const PROMISE: f64 = 1e-3;
/// No step can lower F where the model expects less than this share of it.
const NOTHING: f64 = 1e-16;
/// With connections damping is no less: the penalty on their rows takes the digits of less.
const LEAST: f64 = 1e-7;
/// Joint velocities may pass the lowest cost along their way by this share of the slope that they begin with, times the
/// gain.
const OVERSHOOT: f64 = 0.5;
/// Damping of joint velocities beyond which they are zero.
const STILL: f64 = 1e12;

/// Where a descent ended.
#[derive(Debug, Clone, Copy)]
pub struct Ending {
    pub value: f64,
    pub position_error: f64,
    pub rotation_error: f64,
    pub iterations: usize,
    /// Whether it was given up: F could fall further.
    pub is_given_up: bool,
    /// The row of the connections that stays open, and its error, m or rad; none where they are closed.
    pub open: Option<(usize, f64)>,
}

/// When a descent ends, beside at an answer and after all steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Until {
    /// It promises no answer: F is not zero in the end.
    Hopeless,
    /// F falls no further.
    Lowest,
}

impl Ending {
    pub fn reached(&self, tolerance: f64) -> bool {
        self.position_error <= tolerance && self.rotation_error <= tolerance
    }
}

/// A descent, with its scratch.
#[derive(Debug)]
pub struct Descent {
    pub limits: Bounds,
    way: Way,
    closure: Option<Closure>,
    rows: Rows,
    trial_rows: Rows,
    trial: Vec<f64>,
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
            way: Way::of(&limits),
            limits,
            closure: Closure::of(scene),
            rows: Rows::default(),
            trial_rows: Rows::default(),
            trial: vec![nan; scene.nq()],
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

    /// Goes down from `q`, which it moves, by so many steps at the most; first to its limits, where it is beyond, and
    /// onto the connections.
    ///
    /// With `free` it first goes down without limits; then joints move to the nearest angle within theirs, and it goes
    /// on from there.
    pub fn run(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &Tasks<'_>,
        options: &Options,
        (until, steps, free): (Until, usize, bool),
        q: &mut [f64],
    ) -> Result<Ending, Error> {
        self.way.choose(&self.limits, tasks);
        let mut iterations = 0;
        // Joints that follow another, connections and a posture tell whole turns apart.
        if free && self.way.is_limited() && tasks.is_same_after_turns() {
            self.way.lift();
            iterations = self.descend(workspace, tasks, options, (until, steps), q)?.iterations;
            self.way.choose(&self.limits, tasks);
            self.limits.wrap(tasks.scene, q);
        }
        let ending = self.descend(workspace, tasks, options, (until, steps - iterations), q)?;
        Ok(Ending { iterations: iterations + ending.iterations, ..ending })
    }

    /// The same within the limits of the way.
    fn descend(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &Tasks<'_>,
        options: &Options,
        (until, steps): (Until, usize),
        q: &mut [f64],
    ) -> Result<Ending, Error> {
        let (scene, nv) = (tasks.scene, tasks.scene.nv());
        self.way.bounds.hold(q);
        if !self.close(workspace, scene, q)? {
            let far = f64::INFINITY;
            return Ok(Ending { position_error: far, rotation_error: far, ..self.ending(far) });
        }
        let mut value = self.value(workspace, tasks, q)?;
        let (mut damping, mut growth) = (DAMPING, 2.0);
        let (mut halved, mut since) = (value, 0);
        self.scale.fill(0.0);
        let (mut iterations, mut is_given_up) = (0, false);
        while iterations < steps && !is_given_up {
            // With a posture F is not zero at the answer.
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
            // Damping that grows until a step is taken; without end only where none is left to take.
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
                let bounds = &self.way.bounds;
                let room = |row| bounds.room(row, q);
                let (damped, boxed) = ((&self.damped[..], &self.gradient[..]), &mut self.boxed);
                let has_step = match &mut self.closure {
                    None => boxed.minimize(damped.0, damped.1, room, &mut self.step),
                    Some(closure) => closure.minimize(boxed, damped, 0.0, room, &mut self.step),
                };
                // By how much the undamped model falls along the step.
                let expected = if has_step { -quadratic(&self.hessian, &self.gradient, &self.step) } else { 0.0 };
                if has_step && !(expected > NOTHING * value) {
                    break None;
                }
                if has_step {
                    scene.integrate(q, &self.step, &mut self.trial)?;
                    self.way.bounds.hold(&mut self.trial);
                    let mut trial = std::mem::take(&mut self.trial);
                    let is_closed = self.close(workspace, scene, &mut trial);
                    self.trial = trial;
                    let is_closed = is_closed?;
                    std::mem::swap(&mut self.rows, &mut self.trial_rows);
                    tasks.evaluate(workspace, &self.trial, &mut self.rows)?;
                    let next = value_of(tasks, &self.rows, &self.trial, &mut self.off_posture);
                    let share = (value - next) / expected;
                    if is_closed && share > ENOUGH {
                        is_given_up = damping <= DAMPING && expected < PROMISE * value;
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
                (halved, since, is_given_up) = (value, 0, false);
            }
            is_given_up |= since >= PATIENCE;
            is_given_up &= until == Until::Hopeless && tasks.posture.is_none();
        }
        if self.way.bring_back(&self.limits, q) {
            value = self.value(workspace, tasks, q)?;
        }
        Ok(Ending { iterations, is_given_up, open: None, ..self.ending(value) })
    }

    /// Closes the connections from `q`, within the limits of the way; whether they are closed.
    fn close(&mut self, workspace: &mut Workspace<f64>, scene: &Scene, q: &mut [f64]) -> Result<bool, Error> {
        let Some(closure) = &mut self.closure else { return Ok(true) };
        closure.close(workspace, scene, &self.way.bounds, q)?;
        Ok(closure.is_closed())
    }

    /// M at `q` for steps that it damps, and its largest diagonal entry. Joints that carry nothing get a little of it, or nothing would hold them.
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
        // Joints beyond their limits return, whatever the tasks want; the tasks have what is left.
        qd.fill(0.0);
        if let Some(limits) = limits {
            limits.returning(q, dt, qd);
        }
        let mut from = vec![f64::NAN; scene.nq()];
        scene.integrate(q, qd, &mut from)?;
        tasks.evaluate(workspace, &from, &mut self.rows)?;
        self.model(tasks, &from);
        // Sums and comparisons below would make zeros of what overflows.
        for derivative in [&self.gradient, &self.hessian] {
            scene.check_result("derivatives of the tasks", derivative)?;
        }
        if let Some(closure) = &mut self.closure {
            closure.evaluate(workspace, scene, &from)?;
        }
        let value = value_of(tasks, &self.rows, &from, &mut self.off_posture);
        let largest = (0..nv).fold(0.0_f64, |largest, i| largest.max(self.hessian[i * nv + i]));
        // Without a task that joints move, connections still take their errors away.
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
                let expected = "more damping: the tasks leave motions undetermined beyond what rounding tells";
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
        tasks.scene.check_result("qd", qd)
    }

    /// Whether the step from `from`, whose rows are there, raises the cost or passes its minimum along the way: then
    /// the curvature found, as damping; none for a step to be taken.
    ///
    /// Where targets are out of reach, errors stay, and the cost is curved more than the model knows: without this,
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

    /// The covariance at `q`: the inverse of the second derivative, without what is at its limits.
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
        // Rounding does not tell a singular matrix from a positive definite one: a motion that the tasks leave undetermined is one whose pivot is lost.
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

    /// Where it is now.
    fn ending(&self, value: f64) -> Ending {
        let Rows { position_error, rotation_error, .. } = self.rows;
        let open = self.closure.as_ref().filter(|closure| !closure.is_closed()).map(Closure::largest);
        Ending { value, position_error, rotation_error, iterations: 0, is_given_up: false, open }
    }

    /// Gradient and second derivative (of Gauss and Newton) of F at `q`, whose rows are there.
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

/// The derivative of F along a step, and the sum of its terms by size.
fn along(rows: &Rows, step: &[f64]) -> (f64, f64) {
    let mut found = (0.0, 0.0);
    for (row, error) in rows.jacobian.chunks_exact(step.len().max(1)).zip(&rows.errors) {
        let moved: f64 = row.iter().zip(step).map(|(of, step)| of * step).sum();
        found = (found.0 + error * moved, found.1 + (error * moved).abs());
    }
    found
}

/// F at `q`, whose rows are there.
fn value_of(tasks: &Tasks<'_>, rows: &Rows, q: &[f64], off: &mut [f64]) -> f64 {
    let own: f64 = rows.errors.iter().map(|error| error * error).sum();
    let mut posture = 0.0;
    if let Some((expected, deviation)) = tasks.posture {
        off_posture(tasks.scene, expected, q, off);
        posture = off.iter().map(|off| (off / deviation).powi(2)).sum();
    }
    0.5 * (own + posture)
}

/// How far `q` is from a posture, in the tangent space at `q`: its square's gradient is twice itself.
///
/// Rotations have their rotation vector t, for which Jr^-1(t)^T t = t. A free joint has its translation and its rotation apart, in its own axes: the
/// screw between two places would not do.
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
