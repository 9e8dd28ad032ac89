//! Inverse kinematics: joint positions that bring links to target poses, computed as the most probable configuration.
//!
//! A task is a measurement of a pose, position or direction with a standard deviation; a posture is the prior. With the
//! task errors e (m and rad), their standard deviations s, the standard deviation p of the posture, and limits lower <=
//! q <= upper, the solver minimizes
//!
//! F(q) = 1/2 sum (e / s)^2 + 1/2 |q (-) posture|^2 / p^2
//!
//! by Levenberg-Marquardt steps, each of which is the exact minimum of its model within the limits. If one start ends
//! in a local minimum, others follow: random configurations within the limits, each the most probable of a few draws.
//! For a path of targets, [`Solver::follow`] starts each search at the solution before.
//! The inverse of the second derivative at the minimum is the covariance of the result. Connections of the scene are
//! hard constraints, which each step and the result satisfy.
//!
//! ```
//! use phipsi::inverse_kinematics::{Goal, Options, Task};
//!
//! let scene = phipsi::scenes::chain(7)?;
//! let frame = scene.frame(&"link6".into())?;
//! let target = scene.placement(&[0.3, -0.4, 0.5, 0.2, -0.1, 0.6, 0.2], frame)?;
//! let tasks = [Task::new(Goal::Pose { frame, target })];
//! let mut solver = scene.inverse_kinematics(&Options::default())?;
//! let mut q = [0.0; 7];
//! let outcome = solver.solve(&mut scene.workspace(), &tasks, &[0.0; 7], None, &mut q)?;
//! assert!(outcome.reached && outcome.position_error < 1e-9);
//! # Ok::<(), phipsi::Error>(())
//! ```

mod closure;
mod descent;
mod direction;
mod limits;
mod options;
mod rotation;
mod starts;
mod step;
mod task;

use crate::error::{Error, check_length, check_positive, in_language};
use crate::memory;
use crate::scene::Scene;
use crate::workspace::Workspace;
use descent::{Descent, DescentResult, StopCondition};
use limits::{Bounds, RateBounds};
pub use options::{Metric, Options, RateOptions};
use std::borrow::Borrow;
pub(crate) use step::BoxStep;
pub use task::{Goal, Task};
pub(crate) use task::{Rows as TaskRows, Tasks};

/// Result of inverse kinematics.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Outcome {
    /// True if the error of every task is within the tolerance.
    pub reached: bool,
    /// Largest position error of a task, m.
    pub position_error: f64,
    /// Largest rotation error of a task, rad.
    pub rotation_error: f64,
    /// Number of starts used.
    pub starts: usize,
    /// Number of steps over all starts.
    pub iterations: usize,
}

/// Inverse kinematics of a scene, with its scratch memory. `S` holds the scene: `&Scene`, `Arc<Scene>` or `Scene`.
///
/// The first [`solve`](Self::solve) and the first [`rates`](Self::rates) allocate scratch memory; later calls with the
/// same or fewer tasks do not allocate, except for scenes with coupled joints and for the covariance of scenes with
/// connections.
#[derive(Debug, Clone)]
pub struct Solver<S> {
    scene: S,
    search: Search,
}

/// The scratch memory of a [`Solver`], and its recursion.
#[derive(Debug, Clone)]
struct Search {
    options: Options,
    descent: Descent,
    /// The limits of [`Solver::rates`].
    rate_bounds: RateBounds,
    /// The tasks with orthonormalized target rotations.
    tasks: Vec<Task>,
    start: Vec<f64>,
    drawn: Vec<f64>,
    best: Vec<f64>,
    /// The solution before the one that is sought, in [`Solver::follow`].
    previous: Vec<f64>,
    /// True if no start reached the target before, in [`Solver::follow`].
    missed: bool,
    moved: Vec<f64>,
}

/// A random start is the most probable of this number of draws, because such starts end less often at limits far from a
/// solution.
const DRAWS: u64 = 4;
/// The first starts, of this number, stay within the limits. Most of their failures are minima at limits. Later starts
/// first minimize without limits, and begin with some joints at limits, where the first ones miss solutions; they are
/// the most probable of a larger number of draws.
const WITHIN: usize = 3;
const LATER_DRAWS: u64 = 16;
/// On a path, the first starts are moved from the solution before by this fraction of the way to a random one.
const NEAR: f64 = 0.05;

/// Largest number of starts by default: 20 starts miss 3 of 1,000 reachable poses of an arm, 100 none. With a posture
/// F does not vanish, so that every start is used; 20 then find its minimum.
const STARTS: usize = 100;
const STARTS_WITH_POSTURE: usize = 20;
/// The search ends when this number of starts has found the least minimum, up to a factor, because abandoned starts are
/// not at their minima. The tasks are then probably out of reach: of 5,000 reachable poses, none is lost.
const REPEATS: usize = 40;
const SAME_MINIMUM: f64 = 1.05;
/// Matrices of nv x nv numbers in the scratch memory.
const MATRICES: usize = 5;

impl Scene {
    /// A solver of inverse kinematics that borrows the scene; [`Solver::new`] can own it.
    ///
    /// # Errors
    ///
    /// As [`Solver::new`].
    pub fn inverse_kinematics(&self, options: &Options) -> Result<Solver<&Self>, Error> {
        Solver::new(self, options)
    }
}

impl<S: Borrow<Scene>> Solver<S> {
    /// A solver of inverse kinematics.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for zero starts or a tolerance or posture that is not positive, and [`Error::Scene`] for
    /// joint limits that exclude each other; [`Error::Memory`] if the matrices of a step do not fit in memory.
    pub fn new(scene: S, options: &Options) -> Result<Self, Error> {
        let own: &Scene = scene.borrow();
        if options.starts == Some(0) {
            return Err(Error::argument("starts", "0", "at least one"));
        }
        check_positive("tolerance", options.tolerance)?;
        options.posture.map_or(Ok(()), |posture| check_positive("posture", posture))?;
        memory::room("scene", memory::bytes_of::<f64>(&[MATRICES, own.nv(), own.nv()]))?;
        let limits = if options.limits { Bounds::of(own)? } else { Bounds::without(own) };
        let room = || vec![f64::NAN; own.nq()];
        let search = Search {
            options: *options,
            descent: Descent::new(own, limits),
            rate_bounds: RateBounds::default(),
            tasks: Vec::new(),
            start: room(),
            drawn: room(),
            best: room(),
            previous: room(),
            missed: false,
            moved: vec![f64::NAN; own.nv()],
        };
        Ok(Self { scene, search })
    }

    /// Differential inverse kinematics: the joint velocities `qd` (nv) at `q` (nq) that remove a fraction of the task
    /// errors within dt.
    ///
    /// Minimizes 1/2 sum ((J qd dt + gain e) / s)^2 + damping dq D dq / 2 over the joint velocities that satisfy the
    /// velocity limits, and the position limits after dt. A joint beyond its limit returns at up to its velocity limit,
    /// with priority over the tasks. Connections are hard constraints: their errors stay zero to first order. If the
    /// step would increase the cost, or pass its minimum along the step, it is recomputed with more damping, so that
    /// joints come to rest for an unreachable target. O(tasks depth + nv^3).
    ///
    /// # Errors
    ///
    /// As [`Solver::solve`], and [`Error::Argument`] for a time, gain or damping that is not positive or a negative
    /// velocity limit.
    pub fn rates(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &[Task],
        q: &[f64],
        options: &RateOptions<'_>,
        qd: &mut [f64],
    ) -> Result<(), Error> {
        let scene: &Scene = self.scene.borrow();
        let search = &mut self.search;
        options.check_numbers()?;
        if options.limits {
            search.rate_bounds.set(scene, options.velocity)?;
        }
        scene.check_workspace(workspace)?;
        scene.check_coordinates("q", q)?;
        check_length("qd", qd.len(), scene.nv())?;
        search.checked(scene, tasks)?;
        let tasks = Tasks { scene, each: &search.tasks, posture: None };
        let limits = options.limits.then_some(&search.rate_bounds);
        search.descent.rates(workspace, &tasks, q, options, limits, qd)?;
        scene.check_result("qd", qd)
    }

    /// Finds the most probable configuration from `start` (nq), and writes it to `q` (nq). `start` is also the posture
    /// if the options request one.
    ///
    /// `covariance`, if given, receives the covariance of the result in its tangent space, (nv x nv), row-major. It is
    /// zero for joints at their limits. All entries are infinite if the tasks leave a motion undetermined and there is
    /// no posture. O(tasks depth + nv^3) per step.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::Argument`] for invalid tasks (see [`Task`]) or a workspace of
    /// another scene, and [`Error::Constraint`] if the connections cannot be closed within the limits from any start.
    pub fn solve(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &[Task],
        start: &[f64],
        covariance: Option<&mut [f64]>,
        q: &mut [f64],
    ) -> Result<Outcome, Error> {
        self.search.solve(self.scene.borrow(), workspace, tasks, (start, false), (covariance, q))
    }

    /// The next solution of a path of targets: as [`Solver::solve`] from `q` (nq), the solution before, which the new
    /// one replaces.
    ///
    /// Other starts, the first two of them near the solution before, serve only to reach the tasks, or to close the
    /// connections. If none does, the result is the local minimum next to the solution before, so that a path that
    /// leaves the reach of the robot does not jump. The targets after it have three starts, unless the options give a
    /// number, until one is reached: the part of a path that is out of reach costs one complete search.
    ///
    /// # Errors
    ///
    /// As [`Solver::solve`]; `q` is then unchanged.
    pub fn follow(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &[Task],
        covariance: Option<&mut [f64]>,
        q: &mut [f64],
    ) -> Result<Outcome, Error> {
        let mut previous = std::mem::take(&mut self.search.previous);
        previous.clear();
        previous.extend_from_slice(q);
        let outcome = self.search.solve(self.scene.borrow(), workspace, tasks, (&previous, true), (covariance, q));
        self.search.previous = previous;
        self.search.missed = outcome.as_ref().is_ok_and(|of| !of.reached);
        outcome
    }

    /// A solver that follows a path from its middle; `missed`: the target before was not reached.
    #[cfg(feature = "python")]
    pub(crate) fn resuming(mut self, missed: bool) -> Self {
        self.search.missed = missed;
        self
    }
}

impl Search {
    /// Checks the tasks and stores them with orthonormalized target rotations.
    fn checked(&mut self, scene: &Scene, tasks: &[Task]) -> Result<(), Error> {
        self.tasks.clear();
        for (at, task) in tasks.iter().enumerate() {
            self.tasks.push(task.checked(scene, at)?);
        }
        Ok(())
    }

    /// [`Solver::solve`] from `start`, and with `follows` [`Solver::follow`].
    fn solve(
        &mut self,
        scene: &Scene,
        workspace: &mut Workspace<f64>,
        tasks: &[Task],
        (start, follows): (&[f64], bool),
        (covariance, q): (Option<&mut [f64]>, &mut [f64]),
    ) -> Result<Outcome, Error> {
        scene.check_workspace(workspace)?;
        scene.check_coordinates("q0", start)?;
        check_length("q", q.len(), scene.nq())?;
        self.checked(scene, tasks)?;
        let own = std::mem::take(&mut self.tasks);
        let tasks = Tasks { scene, each: &own, posture: self.options.posture.map(|deviation| (start, deviation)) };
        let tolerance = self.options.tolerance;
        let mut found: Option<DescentResult> = None;
        let (mut used, mut iterations) = (0, 0);
        let (mut least, mut repeats) = (f64::INFINITY, 0);
        let usual = match tasks.posture {
            _ if follows && self.missed => WITHIN,
            None => STARTS,
            Some(_) => STARTS_WITH_POSTURE,
        };
        while used < self.options.starts.unwrap_or(usual) {
            match used {
                0 => self.start.copy_from_slice(start),
                _ => self.draw(workspace, &tasks, start, (used as u64, follows))?,
            }
            used += 1;
            let whole = (StopCondition::NoProgress, self.options.iterations, used > WITHIN);
            let ending = self.descent.run(workspace, &tasks, &self.options, whole, &mut self.start)?;
            iterations += ending.iterations;
            let is_reached = ending.reached(tolerance);
            let is_better = |best: &DescentResult| ending.value < best.value && !(follows && best.open.is_none());
            if is_reached || found.as_ref().is_none_or(is_better) {
                self.best.copy_from_slice(&self.start);
                found = Some(ending);
            }
            if is_reached || tasks.is_without_rows() && ending.open.is_none() {
                break;
            }
            if SAME_MINIMUM * ending.value < least {
                repeats = 0;
            }
            repeats += usize::from(ending.value <= SAME_MINIMUM * least);
            least = least.min(ending.value);
            if repeats >= REPEATS {
                break;
            }
        }
        let Some(mut best) = found else { return Err(Error::argument("starts", "0", "at least one")) };
        if let Some((row, left)) = best.open {
            let expected = format!(
                "connections that close within the joint limits from q0 or a random start; {} ignores limits",
                in_language("with_limits(false)", "limits=False")
            );
            return Err(scene.open_at("q", row, left, "m or rad", &expected));
        }
        if best.is_abandoned && !best.reached(tolerance) {
            // No start reaches all tasks: continue from the best one to its exact minimum.
            let rest = (StopCondition::Minimum, self.options.iterations - best.iterations, false);
            best = self.descent.run(workspace, &tasks, &self.options, rest, &mut self.best)?;
            iterations += best.iterations;
        }
        q.copy_from_slice(&self.best);
        if let Some(room) = covariance {
            check_length("covariance", room.len(), scene.nv() * scene.nv())?;
            self.descent.covariance(workspace, &tasks, &self.best, room)?;
        }
        self.tasks = own;
        scene.check_result("errors of the tasks", &[best.position_error, best.rotation_error])?;
        Ok(Outcome {
            reached: best.reached(tolerance),
            position_error: best.position_error,
            rotation_error: best.rotation_error,
            starts: used,
            iterations,
        })
    }

    /// Draws start `number`: the most probable of several draws. If the path of `start` is followed, the first starts
    /// are near it, because a search can end at a singular solution before, such as that of a stretched arm.
    fn draw(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &Tasks<'_>,
        start: &[f64],
        (number, follows): (u64, bool),
    ) -> Result<(), Error> {
        let mut least = f64::INFINITY;
        let is_later = number >= WITHIN as u64;
        for draw in 0..if is_later { LATER_DRAWS } else { DRAWS } {
            let number = number * LATER_DRAWS + draw;
            starts::draw(
                tasks.scene,
                &self.descent.limits,
                start,
                (self.options.seed, number, is_later),
                &mut self.drawn,
            );
            if follows && !is_later {
                tasks.scene.difference(start, &self.drawn, &mut self.moved)?;
                self.moved.iter_mut().for_each(|moved| *moved *= NEAR);
                tasks.scene.integrate(start, &self.moved, &mut self.drawn)?;
            }
            let value = self.descent.value(workspace, tasks, &self.drawn)?;
            if draw == 0 || value < least {
                least = value;
                self.start.copy_from_slice(&self.drawn);
            }
        }
        Ok(())
    }
}
