//! From one start down to where F is least: the steps of Levenberg and Marquardt, within limits.
//!
//! A step minimises the quadratic model of F with A = J^T W J + posture + mu D, D the largest diagonal so far. It is taken where F falls by a share of what
//! the undamped model says; then mu falls too, else it grows. So F never rises, and the steps become Newton's where the errors vanish.
//!
//! Most ends that are no answer are minima at limits. So a start is given up as soon as it promises nothing, if others can follow; the best of them then goes on
//! to its minimum.

use super::limits::{Bounds, RateBounds, Way};
use super::step::{BoxStep, quadratic};
use super::task::{Rows, Tasks};
use super::{Metric, Options, RateOptions};
use crate::error::Error;
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

/// Where a descent ended.
#[derive(Debug, Clone, Copy)]
pub struct Ending {
    pub value: f64,
    pub position_error: f64,
    pub rotation_error: f64,
    pub iterations: usize,
    /// Whether it was given up: F could fall further.
    pub is_given_up: bool,
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

    /// Goes down from `q`, which it moves, by so many steps at the most; first to its limits, where it is beyond.
    pub fn run(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &Tasks<'_>,
        options: &Options,
        (until, steps): (Until, usize),
        q: &mut [f64],
    ) -> Result<Ending, Error> {
        let (scene, nv) = (tasks.scene, tasks.scene.nv());
        self.limits.hold(q);
        self.way.choose(&self.limits, tasks);
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
                let limits = &self.way.bounds;
                let has_step =
                    self.boxed.minimise(&self.damped, &self.gradient, |row| limits.room(row, q), &mut self.step);
                // By how much the undamped model falls along the step.
                let expected = if has_step { -quadratic(&self.hessian, &self.gradient, &self.step) } else { 0.0 };
                if has_step && !(expected > NOTHING * value) {
                    break None;
                }
                if has_step {
                    scene.integrate(q, &self.step, &mut self.trial)?;
                    self.way.bounds.hold(&mut self.trial);
                    std::mem::swap(&mut self.rows, &mut self.trial_rows);
                    tasks.evaluate(workspace, &self.trial, &mut self.rows)?;
                    let next = value_of(tasks, &self.rows, &self.trial, &mut self.off_posture);
                    let share = (value - next) / expected;
                    if share > ENOUGH {
                        is_given_up = damping <= DAMPING && expected < PROMISE * value;
                        damping *= (1.0 - (2.0 * share - 1.0).powi(3)).max(1.0 / 3.0);
                        growth = 2.0;
                        break Some(next);
                    }
                    std::mem::swap(&mut self.rows, &mut self.trial_rows);
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
        Ok(Ending { iterations, is_given_up, ..self.ending(value) })
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

    /// The rates at `q` that [`Solver::rates`](super::Solver::rates) tells of.
    pub fn rates(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &Tasks<'_>,
        q: &[f64],
        options: &RateOptions,
        limits: Option<&RateBounds>,
        qd: &mut [f64],
    ) -> Result<(), Error> {
        let nv = tasks.scene.nv();
        tasks.evaluate(workspace, q, &mut self.rows)?;
        self.model(tasks, q);
        // Sums and comparisons below would make zeros of what overflows.
        for derivative in [&self.gradient, &self.hessian] {
            tasks.scene.check_result("derivatives of the tasks", derivative)?;
        }
        let largest = (0..nv).fold(0.0_f64, |largest, i| largest.max(self.hessian[i * nv + i]));
        qd.fill(0.0);
        if !(largest > 0.0) {
            return Ok(());
        }
        for i in 0..nv {
            self.gradient[i] *= options.gain;
            self.hessian[i * nv + i] += options.damping * self.hessian[i * nv + i].max(FLOOR * largest);
        }
        let room =
            |row: usize| limits.map_or((f64::NEG_INFINITY, f64::INFINITY), |limits| limits.room(row, q, options.dt));
        if !self.boxed.minimise(&self.hessian, &self.gradient, room, &mut self.step) {
            let expected = "more damping: the tasks leave motions undetermined beyond what rounding tells";
            return Err(Error::argument("damping", options.damping.to_string(), expected));
        }
        for (qd, step) in qd.iter_mut().zip(&self.step) {
            *qd = step / options.dt;
        }
        tasks.scene.check_result("qd", qd)
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
        let is_definite = self.boxed.inverse(&self.hessian, inside, out);
        let worst = (0..nv).fold(0.0_f64, |worst, i| worst.max(out[i * nv + i]));
        if !is_definite || !(worst * largest < 1e14) {
            out.fill(f64::INFINITY);
        }
        Ok(())
    }

    /// Where it is now.
    fn ending(&self, value: f64) -> Ending {
        let Rows { position_error, rotation_error, .. } = self.rows;
        Ending { value, position_error, rotation_error, iterations: 0, is_given_up: false }
    }

    /// Gradient and second derivative (of Gauss and Newton) of F at `q`, whose rows are there.
    fn model(&mut self, tasks: &Tasks<'_>, q: &[f64]) {
        let nv = tasks.scene.nv();
        self.gradient.fill(0.0);
        self.hessian.fill(0.0);
        for (row, &error) in self.rows.jacobian.chunks_exact(nv.max(1)).zip(&self.rows.errors) {
            for (i, &of_i) in row.iter().enumerate().filter(|(_, of_i)| **of_i != 0.0) {
                self.gradient[i] += of_i * error;
                for (entry, &of_j) in self.hessian[i * nv..=i * nv + i].iter_mut().zip(row) {
                    *entry += of_i * of_j;
                }
            }
        }
        for i in 0..nv {
            for j in 0..i {
                self.hessian[j * nv + i] = self.hessian[i * nv + j];
            }
        }
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
