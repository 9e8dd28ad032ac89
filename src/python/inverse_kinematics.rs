//! The methods `Scene.inverse_kinematics` and `Scene.inverse_kinematics_rates`.

use super::choice::choose;
use super::counts::{count, count_or, number};
use super::errors::{refuse, warn_as};
use super::input::Input;
use super::keywords::Keywords;
use super::object::{Object, imported};
use super::output::{self, Output};
use super::scene::PyScene;
use crate::api::TaskFrame;
use crate::batch::shape_text;
use crate::error::{Error, check_finite};
use crate::inverse_kinematics::{Goal, Metric, Options, RateOptions, Task};
use crate::joints::JointKind;
use crate::scene::Scene;
use crate::spatial::RigidShift;
use nalgebra::{Matrix3, Vector3};
use pyo3::prelude::*;

/// Approximate time per state, ns: a few tens of steps.
const COST: usize = 50_000;

/// The same for inverse_kinematics_rates.
const COST_OF_RATES: usize = 3_000;

/// Metrics of the damping, by name.
const METRICS: [(&str, Metric); 2] = [("coordinates", Metric::Coordinates), ("mass", Metric::Mass)];

/// Number of results in addition to q: reached, errors, starts, steps.
const BESIDE: usize = 5;

/// A task from phipsi.tasks: kind, name, link or joint, point, axis, deviations, target, number of its entries, and the
/// link to which it is relative. A
/// distance has the names of its colliders instead of the links, and none for all pairs.
type Given<'py> = (String, String, String, [f64; 3], [f64; 3], f64, f64, Object<'py>, usize, Option<String>);

typed_methods! {
    in PyScene;

    /// Most probable joint positions that reach tasks, within joint limits and with closed connections.
    #[doc = section!(Parameters)]
    /// tasks : task or list of tasks
    ///     Tasks of phipsi.tasks: Pose, Position, Orientation, Direction, LookAt, CenterOfMass, JointPosition, Distance.
    ///     Leading axes of their targets are a batch, which broadcasts with that of q0.
    /// q0 : (..., nq) array_like, optional
    ///     First start; the neutral configuration by default. A start outside of the limits begins at them.
    /// follow : bool, default False
    ///     If true, the last batch axis of the targets is a path, (..., k, 4, 4) for Pose, and each search starts from
    ///     the solution before, the first from q0, which has one configuration per path. Solutions of neighboring
    ///     targets are then near each other, and a target that no start reaches has the local minimum next to the
    ///     solution before. Axes before that of the path are a batch of paths.
    /// starts : int, optional
    ///     Largest number of starts; None: 100, or 20 with a posture, and with follow 3 after a target that was not
    ///     reached, until one is reached. Those after the first are drawn within the
    ///     limits, of several draws the one nearest to the tasks. The search ends early when the tasks are reached, or
    ///     when 40 starts have found the same least minimum, because the target is then probably out of reach.
    /// posture : float, optional
    ///     Standard deviation of the joints from q0, rad or m, for robots with more freedom than the tasks; with follow
    ///     from the solution before. None: no posture.
    /// limits : bool, default True
    ///     If true, joints, and joints coupled to them, stay within their limits.
    /// tolerance : float, default 1e-9
    ///     A task is reached if its error is at most this, m and rad.
    /// iterations : int, default 100
    ///     Largest number of steps from each start.
    /// metric : {"coordinates", "mass"}, default "coordinates"
    ///     Metric of the damping: coordinates, or kinetic energy, so that joints that carry more mass move less.
    #[doc = entries!(models)]
    /// covariance : bool, default False
    ///     If true, compute the covariance of q.
    /// seed : int, default 0
    ///     Seed of the starts.
    /// errors : {"raise", "nan"}, default "raise"
    ///     As in forward_dynamics. An invalid state has NaN for q and errors, and reached False.
    #[doc = section!(Returns)]
    /// solution : phipsi.tasks.InverseKinematics
    ///     q, reached, position_error, rotation_error, starts, iterations and covariance. If reached is False, q is the
    ///     best local minimum.
    #[doc = section!(Raises)]
    /// ConstraintError
    ///     No start leads to closed connections.
    #[doc = entries!(arguments)]
    #[doc = section!(Warns)]
    /// UnitsWarning
    ///     A target position is 20 times as far as the robot reaches, as one in millimeters is.
    #[doc = section!(Notes)]
    /// Minimizes half the sum of all squared errors divided by their variances, by Levenberg-Marquardt steps on the
    /// manifold, each the exact minimum of its model within the limits; no step increases the cost. Connections are
    /// hard constraints. O(tasks depth + nv^3) per step. Results are bit-identical for any number of threads.
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    /// >>> goal = scene.placement([0.3, -0.6, 0.9, 0.1, 0.4, 0.0], "flange")
    /// >>> found = scene.inverse_kinematics(phipsi.tasks.Pose("flange", goal))
    /// >>> found.reached, np.allclose(scene.placement(found.q, "flange"), goal)
    /// (True, True)
    fn inverse_kinematics[&self, py: Python<'py>](
        tasks: &Object<'py>, q0: Option<&Object<'py>> = None; follow: bool = false, starts: Option<&Object<'py>> = None,
        posture: Option<f64> = None, limits: bool = true, tolerance: f64 = 1e-9,
        iterations: Option<&Object<'py>> = None => "100", metric: &str = "coordinates",
        inertias: Option<&Object<'py>> = None, armature: Option<&Object<'py>> = None, covariance: bool = false,
        seed: Option<&Object<'py>> = None => "0", errors: &str = "raise"
    ) -> PyResult<Object<'py>> {
        let metric = choose("metric", metric, &METRICS)?;
        let usual = Options::default();
        let starts = starts.map(|starts| count("starts", starts, 1)).transpose()?;
        let iterations = count_or("iterations", iterations, 0, usual.iterations)?;
        let seed = seed.map_or(Ok(usual.seed), |seed| number("seed", seed))?;
        let options = Options { starts, iterations, tolerance, limits, posture, metric, seed };
        // Checks the options before any other argument.
        self.scene.inverse_kinematics(&options)?;
        let neutral = output::from_numbers(py, &self.scene.neutral(), &[self.scene.nq()])?;
        let (fixed, mut inputs) = self.tasks(tasks, ("q0", q0.unwrap_or(&neutral)))?;
        let far = self.far_target(&fixed, &inputs[1..])?;
        if follow {
            inputs = on_paths(inputs)?;
        }
        let (nq, nv) = (self.scene.nq(), self.scene.nv());
        let width = nq + BESIDE + if covariance { nv * nv } else { 0 };
        let call = self.call_by(inputs, COST, &Keywords { errors, inertias, armature, ..Keywords::none() })?;
        let mut results = call.output(py, &[width], None, Output::new)?;
        let numbers = results.numbers()?;
        let length = call.batch.last().copied().filter(|_| follow).unwrap_or(1);
        call.along_paths(py, numbers, length, |scene, scratch, of, previous, out| {
            let tasks = all_aimed(&fixed, of)?;
            let (q, rest) = out.split_at_mut(nq);
            let (beside, room) = rest.split_at_mut(BESIDE);
            let room = covariance.then_some(room);
            let missed = previous.is_some_and(|previous| previous[nq] < 0.5);
            let mut solver = scene.inverse_kinematics(&options)?.resuming(missed);
            let found = if follow {
                q.copy_from_slice(previous.map_or_else(|| of(0), |previous| &previous[..nq]));
                solver.follow(&mut scratch.workspace, &tasks, room, q)?
            } else {
                solver.solve(&mut scratch.workspace, &tasks, of(0), room, q)?
            };
            #[allow(clippy::cast_precision_loss)] // counts
            beside.copy_from_slice(&[
                f64::from(u8::from(found.reached)),
                found.position_error,
                found.rotation_error,
                found.starts as f64,
                found.iterations as f64,
            ]);
            Ok(())
        })?;
        far.map_or(Ok(()), |text| warn_as(py, "UnitsWarning", &text))?;
        imported!(py, "phipsi.tasks", "gathered")?.call1((results.finish(), nq, nv, covariance))
    }

    /// Joint velocities that reduce the errors of tasks within joint limits: one step of a control loop.
    #[doc = section!(Parameters)]
    /// tasks : task or list of tasks
    ///     As in inverse_kinematics.
    #[doc = entries!(q)]
    /// dt : float
    ///     Time for which the velocities are held, s.
    /// gain : float, default 1
    ///     Share of the errors that is removed in dt; below 1, errors decay exponentially.
    /// damping : float, default 1e-6
    ///     Damping of each joint relative to its diagonal entry of J^T J over the variances, or to a thousandth of the
    ///     largest entry; more keeps velocities small near singularities.
    /// limits : bool, default True
    ///     If true, joints, and joints coupled to them, stay within their limits. A joint outside of its limits
    ///     returns as fast as its velocity limit allows.
    /// velocity : float or (..., nv) array_like, optional
    ///     Velocity limits instead of those of the joints, rad/s or m/s; inf: none. A floating base has limits only
    ///     here.
    #[doc = entries!(inertias errors)]
    #[doc = section!(Returns)]
    /// qd : (..., nv) ndarray
    ///     Joint velocities, rad/s or m/s.
    #[doc = section!(Raises)]
    /// ArgumentError
    ///     dt, gain or damping that is not positive, and as inverse_kinematics.
    #[doc = entries!(arguments)]
    #[doc = section!(Notes)]
    /// Minimizes half the squares of J qd dt + gain e divided by the standard deviations, plus damping, over the
    /// velocities that limits and connections allow, by a projected Newton method. Connections are hard constraints
    /// whose errors are removed as far as the limits allow. If the step would increase the cost or pass its minimum, it
    /// is recomputed with more damping, so joints come to rest if a target is out of reach. O(tasks depth + nv^3).
    #[doc = section!(Examples)]
    /// >>> scene = phipsi.load(phipsi.BUNDLED_ARM)
    /// >>> q, task = np.array([0.3, -0.6, 0.9, 0.1, 0.4, 0.0]), phipsi.tasks.Position("flange", (0.5, 0.1, 0.4))
    /// >>> for step in range(200):
    /// ...     q += 0.01 * scene.inverse_kinematics_rates(task, q, dt=0.01, gain=0.2)
    /// >>> scene.placement(q, "flange")[:3, 3].round(3)
    /// array([0.5, 0.1, 0.4])
    fn inverse_kinematics_rates[&self, py: Python<'py>](
        tasks: &Object<'py>, q: &Object<'py>; dt: f64, gain: f64 = 1.0, damping: f64 = 1e-6, limits: bool = true,
        velocity: Option<&Object<'py>> = None, inertias: Option<&Object<'py>> = None, errors: &str = "raise"
    ) -> PyResult<Object<'py>> {
        let options = RateOptions { dt, gain, damping, limits, velocity: None };
        options.check(&self.scene)?;
        if velocity.is_some() && !limits {
            return refuse("velocity", "velocity limits with limits=False", "limits=True, or no velocity");
        }
        let (fixed, mut inputs) = self.tasks(tasks, ("q", q))?;
        let is_limited = velocity.is_some();
        let far = self.far_target(&fixed, &inputs[1..])?;
        inputs.extend(velocity.map(|given| Input::spread("velocity", given, self.rates())).transpose()?);
        let call = self.call_by(inputs, COST_OF_RATES, &Keywords { errors, inertias, ..Keywords::none() })?;
        let mut results = call.output(py, &[self.scene.nv()], None, Output::new)?;
        let numbers = results.numbers()?;
        call.each_state(py, numbers, |scene, scratch, of, out| {
            let tasks = all_aimed(&fixed, of)?;
            let options = RateOptions { velocity: is_limited.then(|| of(fixed.len() + 1)), ..options };
            let mut solver = scene.inverse_kinematics(&Options { limits: false, ..Options::default() })?;
            solver.rates(&mut scratch.workspace, &tasks, of(0), &options, out)
        })?;
        far.map_or(Ok(()), |text| warn_as(py, "UnitsWarning", &text))?;
        results.finish_or_scalar()
    }
}

impl PyScene {
    /// Reads the tasks without their targets, and the arguments: the configuration, then the targets.
    pub(super) fn tasks<'py>(
        &self,
        tasks: &Object<'py>,
        (name, q): (&'static str, &Object<'py>),
    ) -> PyResult<(Vec<Task>, Vec<Input<'py>>)> {
        let given = imported!(tasks.py(), "phipsi.tasks", "unpacked")?.call1((tasks,))?.extract::<Vec<Given<'py>>>()?;
        if given.is_empty() && self.scene.constraints().is_empty() {
            return refuse("tasks", "no task", "at least one task of phipsi.tasks");
        }
        let mut inputs = vec![self.configuration(name, q)?];
        let (mut all, mut rest) = (Vec::with_capacity(given.len()), Vec::new());
        for (kind, name, on, point, axis, position, rotation, target, width, relative_to) in given {
            if kind == "distance" {
                let pair = relative_to.map(|second| [on, second]);
                let pairs = self.collider_pairs(&format!("{name}.pair"), pair.as_ref().map(std::slice::from_ref))?;
                for (at, pair) in pairs.into_iter().enumerate() {
                    self.scene.check_collider_pair(&format!("{name}.pair"), pair)?;
                    let goal = Goal::Distance { pair, lower: f64::NAN };
                    let task = Task { goal, position, rotation, relative_to: None };
                    task.check_deviations(all.len())?;
                    // The index of every other task is that of the caller.
                    let to = if at == 0 { &mut all } else { &mut rest };
                    to.push((task, Input::new(format!("{name}.lower"), &target, width)?));
                }
                continue;
            }
            let mut task = aimless(&self.scene, &kind, &name, &on, point, axis, position, rotation)?;
            if let Some(link) = relative_to {
                let frame = self.scene.frame(&link.as_str().into());
                task.relative_to = Some(frame.map_err(|error| error.of_argument(&format!("{name}.relative_to")))?);
            }
            task.check_deviations(all.len())?;
            all.push((task, Input::new(format!("{name}.target"), &target, width)?));
        }
        let (fixed, targets): (_, Vec<_>) = all.into_iter().chain(rest).unzip();
        inputs.extend(targets);
        Ok((fixed, inputs))
    }

    /// Warning about a target position that is beyond the reach of the scene by far, as those in millimeters are.
    fn far_target(&self, tasks: &[Task], targets: &[Input<'_>]) -> PyResult<Option<String>> {
        /// Smallest ratio of the distance of such a target to the reach.
        const FAR: f64 = 20.0;
        let Some(reach) = reach(&self.scene) else { return Ok(None) };
        for (task, target) in tasks.iter().zip(targets) {
            let (frame, at) = match task.goal {
                Goal::Pose { frame, .. } => (frame, [3, 7, 11]),
                Goal::Position { frame, .. } => (frame, [0, 1, 2]),
                _ => continue,
            };
            let reach = reach + frame.placement.lever.norm();
            let rows = target.data()?.chunks_exact(if at[0] == 0 { 3 } else { 16 });
            let distance = rows.map(|row| Vector3::from(at.map(|i| row[i])).norm()).fold(0.0, f64::max);
            if distance > FAR * reach && reach > 0.0 {
                let name = &target.name;
                return Ok(Some(format!(
                    "{name}: found a position {distance:.1e} m away, beyond the reach of the robot, {reach:.3} m at \
                     most; expected a position in m (millimeters / 1000)"
                )));
            }
        }
        Ok(None)
    }
}

/// Bound on the distance of the body frames from the base; None if a joint can translate without limit.
fn reach(scene: &Scene) -> Option<f64> {
    let travel = scene.joints().iter().map(|joint| match joint.kind {
        JointKind::Revolute | JointKind::Continuous | JointKind::Universal | JointKind::Spherical => 0.0,
        JointKind::Prismatic => joint.limits.lower.abs().max(joint.limits.upper.abs()),
        _ => f64::INFINITY,
    });
    let levers = scene.model().bodies.iter().map(|body| body.tree.lever.norm());
    let sum: f64 = travel.chain(levers).sum();
    sum.is_finite().then_some(sum)
}

/// The arguments, a configuration and targets, with the axis of the path also for the configuration.
fn on_paths(mut inputs: Vec<Input<'_>>) -> PyResult<Vec<Input<'_>>> {
    let axes = inputs.iter().skip(1).map(|target| target.leading().len()).max().unwrap_or(0);
    if axes == 0 {
        let expected = "targets with an axis of the path, (k, 4, 4) for Pose, or follow=False";
        return refuse("follow", "True with a single target per task", expected);
    }
    let start = inputs.remove(0);
    if start.leading().len() >= axes {
        let found = shape_text(&[start.leading(), &[start.width()]].concat());
        let expected =
            "one configuration per path, without an axis of the path; each target starts from the solution before";
        return Err(Error::shape(&start.name, found, expected).into());
    }
    inputs.insert(0, start.for_paths()?);
    Ok(inputs)
}

/// Creates a task without its target, which differs between states.
fn aimless(
    scene: &Scene,
    kind: &str,
    name: &str,
    on: &str,
    point: [f64; 3],
    axis: [f64; 3],
    position: f64,
    rotation: f64,
) -> Result<Task, Error> {
    let frame = || {
        let offset = RigidShift { rotation: Matrix3::identity(), lever: point.into() };
        scene.frame(&TaskFrame { link: on, offset }).map_err(|error| error.of_argument(&format!("{name}.link")))
    };
    let (axis, nowhere) = (axis.into(), Vector3::from_element(f64::NAN));
    let goal = match kind {
        "pose" => Goal::Pose { frame: frame()?, target: RigidShift::filled(f64::NAN) },
        "position" => Goal::Position { frame: frame()?, target: nowhere },
        "orientation" => Goal::Orientation { frame: frame()?, target: Matrix3::from_element(f64::NAN) },
        "direction" => Goal::Direction { frame: frame()?, axis, target: nowhere },
        "look-at" => Goal::LookAt { frame: frame()?, axis, target: nowhere },
        "joint" => {
            scene.joint(on).map_err(|error| error.of_argument(&format!("{name}.joint")))?;
            let joint = scene.joints().iter().position(|one| one.name == on).unwrap_or(0);
            Goal::Joint { joint, target: f64::NAN }
        }
        _ => Goal::CenterOfMass(nowhere),
    };
    Ok(Task { goal, position, rotation, relative_to: None })
}

/// Last row of a pose, and the largest accepted deviation of its entries.
const LAST_ROW: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
const SLACK: f64 = 1e-6;

/// Tasks with the targets of one state, which are its arguments from the second on.
pub(super) fn all_aimed<'a>(tasks: &[Task], of: &dyn Fn(usize) -> &'a [f64]) -> Result<Vec<Task>, Error> {
    tasks.iter().enumerate().map(|(at, task)| aimed(task, at, of(at + 1))).collect()
}

/// Task with the target of one state.
fn aimed(task: &Task, at: usize, numbers: &[f64]) -> Result<Task, Error> {
    let mut task = *task;
    let what = if matches!(task.goal, Goal::Distance { .. }) { "lower" } else { "target" };
    let name = || format!("{what} of task {at}");
    check_finite(&name(), numbers)?;
    match &mut task.goal {
        Goal::Pose { target, .. } => {
            target.rotation = Matrix3::from_fn(|i, j| numbers[4 * i + j]);
            target.lever = Vector3::new(numbers[3], numbers[7], numbers[11]);
            if numbers[12..].iter().zip(LAST_ROW).any(|(found, expected)| !((found - expected).abs() <= SLACK)) {
                let found = format!("a matrix with the last row {:?}", &numbers[12..]);
                return Err(Error::argument(name(), found, "a homogeneous matrix, whose last row is [0, 0, 0, 1]"));
            }
        }
        Goal::Orientation { target, .. } => *target = Matrix3::from_row_slice(numbers),
        Goal::Direction { target, .. } => {
            // The axis is scaled first, because squares of very small or large numbers underflow or overflow.
            let given = Vector3::from_column_slice(numbers);
            let given = given / given.amax();
            *target = given.normalize();
            if !target.iter().all(|entry| entry.is_finite()) {
                return Err(Error::argument(name(), "an axis without direction", "one of any length above zero"));
            }
        }
        Goal::Position { target, .. } | Goal::LookAt { target, .. } | Goal::CenterOfMass(target) => {
            *target = Vector3::from_column_slice(numbers);
        }
        Goal::Joint { target, .. } | Goal::Distance { lower: target, .. } => *target = numbers[0],
    }
    Ok(task)
}
