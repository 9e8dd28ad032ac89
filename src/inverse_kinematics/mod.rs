//! Joint positions that bring links where they should be: inverse kinematics as the most probable configuration.
//!
//! A task is a measurement of where something is, with a standard deviation; a posture is what was expected before it. With the errors e of the tasks, in
//! m and rad, their standard deviations s, the posture's p, and limits lower <= q <= upper, what is minimized is
//!
//! F(q) = 1/2 sum (e / s)^2 + 1/2 |q (-) posture|^2 / p^2
//!
//! by the steps of Levenberg and Marquardt, each the exact minimum of its model within the limits. Where one start ends in a local minimum,
//! others follow, drawn within the limits, of a few draws the most probable. The inverse of the second derivative at the end is the covariance of the answer.
//! Connections of the scene are hard constraints: each step satisfies them, and so does the answer.
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
mod starts;
mod step;
mod task;

use crate::error::{Error, check_length, number};
use crate::scene::Scene;
use crate::workspace::Workspace;
use descent::{Descent, Ending, Until};
use limits::{Bounds, RateBounds};
use task::Tasks;
pub use task::{Goal, Task};

/// How inverse kinematics looks for an answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// How many configurations it starts from at the most, the one that is given first.
    pub starts: usize,
    /// How many steps it makes from each at the most.
    pub iterations: usize,
    /// A task is reached where its error is no larger, m and rad.
    pub tolerance: f64,
    /// Whether joints stay within their limits; a start beyond them begins at them.
    pub limits: bool,
    /// Standard deviation of the posture, rad and m: how far joints are expected from it; none for no posture.
    pub posture: Option<f64>,
    /// What steps are damped by.
    pub metric: Metric,
    /// Of the starts after the first.
    pub seed: u64,
}

/// How the size of a step is measured, by which Levenberg and Marquardt's steps are damped: which of many answers is found, and by which way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Metric {
    /// By the joints' coordinates, each scaled by how much it does for the tasks.
    #[default]
    Coordinates,
    /// By kinetic energy, dq M dq: joints that carry much mass move less. One mass matrix more a step.
    Mass,
}

/// How fast joints go to where tasks want them: a step of a control loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RateOptions<'a> {
    /// The time that the rates are held, s.
    pub dt: f64,
    /// The share of the errors that is to be gone after it.
    pub gain: f64,
    /// Damping beside the tasks, of the largest entry of their second derivative: what keeps rates small near singular configurations.
    pub damping: f64,
    /// Whether joints stay within their limits of position and velocity.
    pub limits: bool,
    /// Velocity limits (nv), rad/s and m/s, instead of those of the joints; those of a floating base too, which has
    /// none of its own.
    pub velocity: Option<&'a [f64]>,
}

impl RateOptions<'_> {
    /// Refuses times, gains and damping that are not above zero, limits that leave a joint no room, and negative
    /// velocity limits.
    pub(crate) fn check(&self, scene: &Scene) -> Result<(), Error> {
        for (name, value) in [("dt", self.dt), ("gain", self.gain), ("damping", self.damping)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::argument(name, number(value), "a finite number above zero"));
            }
        }
        if self.limits { RateBounds::of(scene, self.velocity).map(drop) } else { Ok(()) }
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            starts: 20,
            iterations: 100,
            tolerance: 1e-9,
            limits: true,
            posture: None,
            metric: Metric::default(),
            seed: 0,
        }
    }
}

/// What became of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// Whether every task's error is within the tolerance.
    pub reached: bool,
    /// The largest distance of a task, m.
    pub position_error: f64,
    /// The largest angle of a task, rad.
    pub rotation_error: f64,
    /// How many starts were used.
    pub starts: usize,
    /// Steps over all starts.
    pub iterations: usize,
}

/// Inverse kinematics of a scene, with its scratch; allocates nothing once the tasks have been as many before.
#[derive(Debug)]
pub struct Solver<'a> {
    scene: &'a Scene,
    options: Options,
    descent: Descent,
    /// The tasks, with targets that are rotations to rounding.
    tasks: Vec<Task>,
    start: Vec<f64>,
    drawn: Vec<f64>,
    best: Vec<f64>,
}

/// A start after the first is the most probable of so many draws: fewer of them end at limits where no answer is.
const DRAWS: u64 = 4;
/// So many starts stay within the limits all the way. Most of their ends that are no answer are minima at limits; so
/// later ones first go down without limits, and begin with some joints at limits, where answers are that they do not
/// find. They are of so many draws.
const WITHIN: usize = 3;
const LATER_DRAWS: u64 = 16;

impl Scene {
    /// A solver of inverse kinematics.
    ///
    /// # Errors
    ///
    /// No start, a tolerance or posture that is not a positive number, and limits that leave a joint no room, by name.
    pub fn inverse_kinematics(&self, options: &Options) -> Result<Solver<'_>, Error> {
        let positive = |name: &str, value: f64| {
            let expected = "a finite number above zero";
            if value.is_finite() && value > 0.0 {
                Ok(())
            } else {
                Err(Error::argument(name, value.to_string(), expected))
            }
        };
        if options.starts == 0 {
            return Err(Error::argument("starts", "0", "at least one"));
        }
        positive("tolerance", options.tolerance)?;
        options.posture.map_or(Ok(()), |posture| positive("posture", posture))?;
        let limits = if options.limits { Bounds::of(self)? } else { Bounds::without(self) };
        Ok(Solver {
            scene: self,
            options: *options,
            descent: Descent::new(self, limits),
            tasks: Vec::new(),
            start: vec![f64::NAN; self.nq()],
            drawn: vec![f64::NAN; self.nq()],
            best: vec![f64::NAN; self.nq()],
        })
    }
}

impl Solver<'_> {
    /// The joint velocities `qd` (nv) that take a share of the tasks' errors away within dt, at the configuration `q`
    /// (nq): one step for control loops.
    ///
    /// Minimizes 1/2 sum ((J qd dt + gain e) / s)^2 + damping dq D dq / 2 over the velocities that the velocity limits
    /// allow, and the position limits after dt. A joint that is beyond its limit returns as fast as its velocity limit
    /// allows, whatever the tasks want. Connections are hard constraints: their errors stay zero to first order. Where
    /// the step would raise the cost, or pass its minimum along the way, it is computed again with more damping: so
    /// joints come to rest where a target is out of reach. O(tasks depth + nv^3).
    ///
    /// # Errors
    ///
    /// As [`Solver::solve`]; a time, gain or damping that is not above zero; a limit of velocity that is negative, by name.
    pub fn rates(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &[Task],
        q: &[f64],
        options: &RateOptions<'_>,
        qd: &mut [f64],
    ) -> Result<(), Error> {
        let scene = self.scene;
        options.check(scene)?;
        scene.check_workspace(workspace)?;
        scene.check_coordinates("q", q)?;
        check_length("qd", qd.len(), scene.nv())?;
        self.checked(tasks)?;
        let tasks = Tasks { scene, each: &self.tasks, posture: None };
        let limits = options.limits.then(|| RateBounds::of(scene, options.velocity)).transpose()?;
        self.descent.rates(workspace, &tasks, q, options, limits.as_ref(), qd)?;
        scene.check_result("qd", qd)
    }

    /// Checks the tasks, and keeps them with targets that are rotations to rounding.
    fn checked(&mut self, tasks: &[Task]) -> Result<(), Error> {
        self.tasks.clear();
        for (at, task) in tasks.iter().enumerate() {
            self.tasks.push(task.checked(self.scene, at)?);
        }
        Ok(())
    }

    /// Looks for the most probable configuration into `q` (nq), from `start` (nq), which is the posture too where options ask for one.
    ///
    /// `covariance`: room for that of the answer in its tangent space, (nv x nv) row by row; a joint at a limit has none, and all entries are infinite
    /// where the tasks leave a motion undetermined and there is no posture.
    ///
    /// O(tasks depth + nv^3) a step.
    ///
    /// # Errors
    ///
    /// Wrong lengths, numbers that are not finite, tasks that cannot be (see [`Task`]), a workspace of another scene,
    /// and [`Error::Constraint`] where no start leads to closed connections within the limits.
    pub fn solve(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &[Task],
        start: &[f64],
        covariance: Option<&mut [f64]>,
        q: &mut [f64],
    ) -> Result<Outcome, Error> {
        let scene = self.scene;
        scene.check_workspace(workspace)?;
        scene.check_coordinates("q0", start)?;
        check_length("q", q.len(), scene.nq())?;
        self.checked(tasks)?;
        let own = std::mem::take(&mut self.tasks);
        let tasks = Tasks { scene, each: &own, posture: self.options.posture.map(|deviation| (start, deviation)) };
        let tolerance = self.options.tolerance;
        let mut found: Option<Ending> = None;
        let (mut used, mut iterations) = (0, 0);
        while used < self.options.starts {
            match used {
                0 => self.start.copy_from_slice(start),
                _ => self.draw(workspace, &tasks, start, used as u64)?,
            }
            used += 1;
            let whole = (Until::Hopeless, self.options.iterations, used > WITHIN);
            let ending = self.descent.run(workspace, &tasks, &self.options, whole, &mut self.start)?;
            iterations += ending.iterations;
            let is_reached = ending.reached(tolerance);
            if is_reached || found.as_ref().is_none_or(|best| ending.value < best.value) {
                self.best.copy_from_slice(&self.start);
                found = Some(ending);
            }
            if is_reached || tasks.is_without_rows() && ending.open.is_none() {
                break;
            }
        }
        let Some(mut best) = found else { return Err(Error::argument("starts", "0", "at least one")) };
        if let Some((row, left)) = best.open {
            let expected = "connections that close within the limits of the joints from q0 or from a random start (limits=False ignores limits)";
            return Err(scene.open_at("q", row, left, "m or rad", expected));
        }
        if best.is_given_up && !best.reached(tolerance) {
            // None is an answer: the nearest to one, exactly.
            let rest = (Until::Lowest, self.options.iterations - best.iterations, false);
            best = self.descent.run(workspace, &tasks, &self.options, rest, &mut self.best)?;
            iterations += best.iterations;
        }
        q.copy_from_slice(&self.best);
        if let Some(room) = covariance {
            check_length("covariance", room.len(), scene.nv() * scene.nv())?;
            self.descent.covariance(workspace, &tasks, &self.best, room)?;
        }
        self.tasks = own;
        Ok(Outcome {
            reached: best.reached(tolerance),
            position_error: best.position_error,
            rotation_error: best.rotation_error,
            starts: used,
            iterations,
        })
    }

    /// Draws start `number`: of some draws the most probable.
    fn draw(
        &mut self,
        workspace: &mut Workspace<f64>,
        tasks: &Tasks<'_>,
        start: &[f64],
        number: u64,
    ) -> Result<(), Error> {
        let mut least = f64::INFINITY;
        let is_later = number >= WITHIN as u64;
        for draw in 0..if is_later { LATER_DRAWS } else { DRAWS } {
            let number = number * LATER_DRAWS + draw;
            starts::draw(
                self.scene,
                &self.descent.limits,
                start,
                (self.options.seed, number, is_later),
                &mut self.drawn,
            );
            let value = self.descent.value(workspace, tasks, &self.drawn)?;
            if draw == 0 || value < least {
                least = value;
                self.start.copy_from_slice(&self.drawn);
            }
        }
        Ok(())
    }
}
