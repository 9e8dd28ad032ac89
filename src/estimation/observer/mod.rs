//! Observer: error-state extended Kalman filter of the motion of robots, of external wrenches and of sensor biases, in
//! array form on the manifold, and its fixed-interval smoother.
//!
//! The state is (q, qd, wrenches, biases). Its error e is a tangent vector, truth = estimate (+) e, where (+) on q is
//! [`Scene::integrate`]. The filter rotates a root L of the covariance, P = L L*; it never subtracts covariances. The
//! torque noise n of a step is part of the state during the update, because accelerometers measure its effect. The
//! prediction removes it from the state.
//!
//! ```
//! use phipsi::estimation::{Observer, ObserverSettings, Quantity, Sensor};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(3)?;
//! let sensors = vec![
//!     Sensor::new("encoder", Quantity::Encoder(None), 1e-4),
//!     Sensor::new("gyro", Quantity::Gyro("link2".into()), 1e-3).with_bias(0.01),
//! ];
//! let settings = ObserverSettings::new(&scene, 1e-3, sensors)
//!     .with_torque_noise([0.01; 3])
//!     .with_initial([[1e-3; 3], [1e-2; 3]].concat()); // standard deviations of q and qd
//! let (q, mut held) = ([0.3, 0.2, 0.1], [0.0; 3]);
//! scene.gravity_torque(&mut scene.workspace(), &q, &mut held)?;
//! let mut observer = Observer::new(&scene, &settings, &q, &[0.0; 3])?;
//!
//! // Readings in the order of the sensors; the gyro delivers none at this time.
//! observer.step(&held, &[0.3001, 0.2, 0.1, f64::NAN, f64::NAN, f64::NAN])?;
//! let estimate = observer.estimate(0).expect("a step was made");
//! let mut covariance = [f64::NAN; 81]; // of (q, qd, bias)
//! estimate.covariance(&mut covariance)?;
//! assert!((estimate.q()[0] - 0.3001).abs() < 1e-5 && covariance[0].sqrt() < 1e-4);
//! assert!(observer.innovation(0).is_some_and(|(nis, readings)| nis > 0.0 && readings == 3));
//! # Ok(())
//! # }
//! ```

mod acceleration;
mod closure;
mod filter;
mod robot;
mod rotate;
mod sensor_rows;
mod settings;
mod smoother;
#[cfg(feature = "python")]
mod stored;
#[cfg(test)]
mod tests;

pub use settings::{ExternalWrench, Mount, ObserverSettings, Quantity, Sensor, WINDOW};
pub use smoother::SmoothedMotion;
#[cfg(feature = "python")]
pub(crate) use {filter::Transition, sensor_rows::SensorRows};

use crate::batch::{Batch, Pool};
use crate::error::{Error, Fault, check_length};
use crate::interrupt;
use crate::memory;
use crate::scene::Scene;
use filter::Scratch;
pub(crate) use robot::Belief;
use robot::{Record, Robot, add_innovations};
use settings::{Plan, Timing};
use std::borrow::Borrow;

/// Approximate time of a step on one thread, ns: constant, and per cube of the number of error components.
const COST: [usize; 2] = [10_000, 1];

/// Observer of one or several robots of one scene.
///
/// Each step processes the readings of the present time, then predicts the next time by a step of order 2, with the
/// acceleration a in its middle: qd1 = qd + dt a and q (+) dt (qd + qd1)/2, where a = FD(q (+) dt qd/2, qd + dt a0/2,
/// tau + n, (w + w1)/2) and a0 = FD(q, qd, tau + n, w), with the wrenches w1 at the end of the step. Readings are
/// linearized at the prediction. Damping, friction and springs of the scene are not part of the model: add their
/// torques to tau, and their uncertainty to the torque noise.
///
/// `S` is a [`Scene`], `&Scene` or `Arc<Scene>`. Scenes with connections, contacts or joints that follow others are not
/// supported. A clone is an independent observer with the same estimates.
#[derive(Debug, Clone)]
pub struct Observer<S> {
    scene: S,
    plan: Plan,
    /// The noise of the last step.
    timing: Timing,
    /// One for each wrench of each robot.
    ones: Vec<f64>,
    robots: Vec<Robot>,
    pool: Pool<Scratch>,
}

impl<S: Borrow<Scene> + Sync> Observer<S> {
    /// An observer with the initial estimates `q` (robots, nq) and `qd` (robots, nv), one robot after another.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for an invalid setting, an unknown link or joint, and two sensors with the same name;
    /// [`Error::Constraint`] for an initial estimate that violates the connections; [`Error::Shape`] and
    /// [`Error::NotFinite`]; [`Error::Memory`] if the covariances do not fit in memory.
    pub fn new(scene: S, settings: &ObserverSettings, q: &[f64], qd: &[f64]) -> Result<Self, Error> {
        let own = scene.borrow();
        let plan = Plan::new(own, settings)?;
        if plan.nv == 0 {
            return Err(Error::argument("scene", "no degrees of freedom", "at least one joint that moves"));
        }
        let count = q.len() / plan.nq;
        check_length("q", q.len(), count.max(1) * plan.nq)?;
        check_length("qd", qd.len(), count * plan.nv)?;
        plan.check_room(count, crate::batch::threads().min(count))?;
        let pool = Pool::default();
        let mut robots = memory::with_capacity("q", count)?;
        for (q, qd) in q.chunks_exact(plan.nq).zip(qd.chunks_exact(plan.nv)) {
            own.check_coordinates("q", q)?;
            own.check_rates("qd", qd)?;
            let mut prior = Belief::new(&plan, q, qd);
            pool.with(|| Scratch::new(&plan, own), |scratch| scratch.condition((&plan, own), &mut prior))?;
            robots.push(Robot::new(&plan, prior));
        }
        // The kernels allocate at their first call. An error of the scene at this state is reported by the first step.
        pool.with(
            || Scratch::new(&plan, own),
            |scratch| {
                let (tau, mut flow) = (vec![0.0; plan.nv], vec![0.0; plan.width * plan.flow_stride()]);
                let prior = &robots[0].prior;
                let state = (&*prior.q, &*prior.qd, &*prior.rest);
                let _ = scratch.acceleration.at((&plan, own), state, &tau, &mut flow);
            },
        );
        let (timing, ones) = (plan.timing.clone(), vec![1.0; robots.len() * plan.wrenches.len()]);
        Ok(Self { scene, plan, timing, ones, robots, pool })
    }

    /// The number of robots.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.robots.len()
    }

    /// The number of readings of all sensors of a robot.
    #[must_use]
    pub fn readings(&self) -> usize {
        self.plan.readings
    }

    /// The readings of a sensor among those of all sensors, by its name.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for an unknown name.
    pub fn readings_of(&self, sensor: &str) -> Result<std::ops::Range<usize>, Error> {
        let known = self.plan.sensors.iter().find(|own| own.name == sensor);
        known.map(|own| own.range.clone()).ok_or_else(|| {
            let names: Vec<&str> = self.plan.sensors.iter().map(|own| own.name.as_str()).collect();
            Error::argument("sensor", format!("{sensor:?}"), names.join(", "))
        })
    }

    /// Processes the readings of the present time, and advances by dt under the torques `tau` (robots, nv).
    ///
    /// `readings` (robots, [`readings`](Self::readings)) holds the readings of all sensors in their order; NaN: no
    /// reading. A reading of a sensor with a delay belongs to the time `delay` steps ago; readings of times before the
    /// first step are ignored. Robots run on several threads (feature `parallel`). A step allocates nothing once the
    /// history is full and each thread has its scratch.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`]; [`Error::NotFinite`] for tau, for an infinite reading, and for an estimate that overflows;
    /// [`Error::SingularJoint`]; [`Error::Memory`] if the history does not fit in memory. The observer is then
    /// unchanged.
    pub fn step(&mut self, tau: &[f64], readings: &[f64]) -> Result<(), Fault> {
        self.step_over(self.plan.timing.dt, tau, readings, &[])
    }

    /// [`step`](Self::step) with the time `dt` to the next step, s, for all robots, and for each robot the wrenches
    /// that act from the present time: 1, or 0 for a wrench that is zero, for instance without contact; empty: all act.
    /// Delays remain numbers of steps. A wrench that begins to act has its initial deviation.
    ///
    /// # Errors
    ///
    /// As [`step`](Self::step), and [`Error::Argument`] for a time that is not positive, and other numbers than 0 and
    /// 1.
    pub fn step_over(&mut self, dt: f64, tau: &[f64], readings: &[f64], acting: &[f64]) -> Result<(), Fault> {
        let Self { scene, plan, timing, ones, robots, pool } = self;
        let (scene, plan) = ((*scene).borrow(), &*plan);
        let of_first = |error| Fault { state: 0, error };
        settings::check_duration(dt).map_err(of_first)?;
        check_length("tau", tau.len(), robots.len() * plan.nv).map_err(of_first)?;
        check_length("readings", readings.len(), robots.len() * plan.readings).map_err(of_first)?;
        let wrenches = plan.wrenches.len();
        let acting = if acting.is_empty() { &*ones } else { acting };
        check_length("acting", acting.len(), robots.len() * wrenches).map_err(of_first)?;
        if let Some(wrong) = acting.iter().find(|flag| ![0.0, 1.0].contains(*flag)) {
            return Err(of_first(Error::argument("acting", wrong.to_string(), "0 or 1")));
        }
        let of_robot = |i: usize| &readings[i * plan.readings..(i + 1) * plan.readings];
        for (state, tau) in tau.chunks_exact(plan.nv).enumerate() {
            scene.check_rates("tau", tau).map_err(|error| Fault { state, error })?;
            check_readings(plan, of_robot(state)).map_err(|error| Fault { state, error })?;
        }
        if dt.to_bits() != timing.dt.to_bits() {
            if dt.to_bits() == plan.timing.dt.to_bits() {
                timing.copy_from(&plan.timing);
            } else {
                plan.time(dt, timing);
            }
        }
        for (state, tau) in tau.chunks_exact(plan.nv).enumerate() {
            if let Err(error) = robots[state].begin(
                plan,
                timing,
                (tau, of_robot(state), &acting[state * wrenches..(state + 1) * wrenches]),
            ) {
                robots[..state].iter_mut().for_each(|robot| robot.undo(plan));
                return Err(Fault { state, error });
            }
        }
        let batch = Batch { states: robots.len(), cost: cost(plan), pool, make: || Scratch::new(plan, scene) };
        let outcome = batch.run_pieces(1, robots, |scratch, range, robots| {
            for (state, robot) in range.zip(robots) {
                filter_pending((plan, scene), scratch, robot).map_err(|error| Fault { state, error })?;
            }
            Ok(())
        });
        for robot in robots {
            if outcome.is_ok() {
                robot.commit(plan);
            } else {
                robot.undo(plan);
            }
        }
        outcome
    }

    /// The estimate of a robot at the time of the latest step; `None` before the first step and for an index that is
    /// not a robot.
    #[must_use]
    pub fn estimate(&self, robot: usize) -> Option<MotionEstimate<'_>> {
        let record = self.robots.get(robot)?.latest()?;
        Some(MotionEstimate { plan: &self.plan, record })
    }

    /// The normalized innovation squared of the latest time with complete readings, which without delays is the time of
    /// the latest step, and the number of readings in it; `None` if there is no such time.
    #[must_use]
    pub fn innovation(&self, robot: usize) -> Option<(f64, usize)> {
        let record = self.robots.get(robot)?.completed(&self.plan)?;
        Some((record.nis, record.count))
    }

    /// For each reading of the time of [`innovation`](Self::innovation), one if it was beyond the gate of its sensor
    /// and was not processed, otherwise zero; `None` if there is no such time.
    #[must_use]
    pub fn rejected(&self, robot: usize) -> Option<&[f64]> {
        Some(&self.robots.get(robot)?.completed(&self.plan)?.rejected)
    }

    /// The innovations of the present window of a robot: its number of steps, and for each sensor the sum of its
    /// normalized innovations squared and the number of readings in it.
    ///
    /// In a consistent filter the sum is chi-square with that many degrees of freedom. A window ends after [`WINDOW`]
    /// steps with complete readings; the next step begins a new one.
    ///
    /// # Panics
    ///
    /// If `robot` is not below [`robots`](Self::robots).
    #[must_use]
    pub fn window(&self, robot: usize) -> (usize, &[(f64, usize)]) {
        let window = &self.robots[robot].window;
        (window.steps, &window.sums)
    }

    /// The innovations of the present window in a filter without one of the sensors: a faulty sensor also increases the
    /// innovations of the others.
    ///
    /// # Errors
    ///
    /// As [`step`](Self::step), and [`Error::Argument`] for an index that is not a robot or sensor.
    pub fn window_without(&self, robot: usize, sensor: usize) -> Result<Vec<(f64, usize)>, Error> {
        let (plan, scene) = (&self.plan, self.scene.borrow());
        let index = |what: &str, found: usize, count: usize| {
            Error::argument(what, found.to_string(), format!("an index below {count}"))
        };
        let own = self.robots.get(robot).ok_or_else(|| index("robot", robot, self.robots.len()))?;
        let left_out = plan.sensors.get(sensor).ok_or_else(|| index("sensor", sensor, plan.sensors.len()))?;
        let (mut belief, mut record) = (own.window.prior.clone(), Record::new(plan)?);
        let mut timing = plan.timing.clone();
        let mut sums = vec![(0.0, 0); plan.sensors.len()];
        let inputs = own.window.inputs.chunks_exact(plan.inputs()).take(own.window.steps);
        self.pool.with(
            || Scratch::new(plan, scene),
            |scratch| {
                for input in inputs {
                    interrupt::check()?;
                    let (tau, others) = input.split_at(plan.nv);
                    let (readings, dt) = others.split_at(plan.readings);
                    record.tau.copy_from_slice(tau);
                    plan.time(dt[0], &mut timing);
                    record.time_steps(&timing, &dt[1..]);
                    record.readings.copy_from_slice(readings);
                    record.readings[left_out.range.clone()].fill(f64::NAN);
                    scratch.step((plan, scene), &mut belief, &mut record)?;
                    add_innovations(&mut sums, &record);
                }
                Ok(sums)
            },
        )
    }

    /// Smooths the stored steps of a robot: estimates each from the readings of all of them.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] before the first step, without a history, and for an index that is not a robot; an error for
    /// a result that overflows.
    pub fn smooth(&self, robot: usize) -> Result<SmoothedMotion, Error> {
        let (plan, scene) = (&self.plan, self.scene.borrow());
        let own = self.robots.get(robot).ok_or_else(|| {
            Error::argument("robot", robot.to_string(), format!("an index below {}", self.robots.len()))
        })?;
        let records: Vec<&Record> = own.history.iter().chain(&own.pending).map(|record| &**record).collect();
        if records.is_empty() {
            let expected = "step() before smooth(), and history above zero";
            return Err(Error::argument("history", "no step to smooth", expected));
        }
        let first = own.steps - records.len();
        self.pool
            .with(|| Scratch::new(plan, scene), |scratch| smoother::smooth((plan, scene), scratch, (first, &records)))
    }
}

#[cfg(feature = "python")]
impl<S: Borrow<Scene> + Sync> Observer<S> {
    /// Approximate time of a step of all robots on one thread, ns.
    pub(crate) fn cost(&self) -> usize {
        cost(&self.plan).saturating_mul(self.robots.len())
    }

    /// The state as numbers, for an observer with the same settings.
    pub(crate) fn numbers(&self) -> Result<Vec<f64>, Error> {
        let mut found = Vec::new();
        for robot in &self.robots {
            robot.clone().visit(&self.plan, &mut |part| {
                found
                    .try_reserve(part.len())
                    .map_err(|_| Error::memory("observer", size_of_val(part) as u128, None))?;
                found.extend_from_slice(part);
                Ok(())
            })?;
        }
        Ok(found)
    }

    /// Resumes from the numbers of an observer with the same settings and number of robots.
    pub(crate) fn resume(&mut self, mut numbers: &[f64]) -> Result<(), Error> {
        for robot in &mut self.robots {
            robot.visit(&self.plan, &mut |part| {
                let (own, rest) = numbers.split_at_checked(part.len()).ok_or_else(stored::another)?;
                part.copy_from_slice(own);
                numbers = rest;
                Ok(())
            })?;
        }
        if numbers.is_empty() { Ok(()) } else { Err(stored::another()) }
    }

    /// Number of components of the error, and of wrenches and biases.
    pub(crate) fn sizes(&self) -> (usize, usize) {
        (self.plan.states, self.plan.rest)
    }

    /// Factor of wrenches and biases per step, and standard deviation of their growth.
    pub(crate) fn process(&self) -> (&[f64], &[f64]) {
        (&self.plan.timing.decay, &self.plan.timing.walk)
    }

    /// The estimate of a robot that the next step begins with, before its readings, and the root of its covariance, row
    /// by row in the order (q, qd, wrenches, biases).
    pub(crate) fn prior(&self, robot: usize, root: &mut [f64]) -> Option<&Belief> {
        let prior = &self.robots.get(robot)?.prior;
        prior.root_by_rows(&self.plan, root);
        Some(prior)
    }

    /// The linearization of a step at a state.
    pub(crate) fn transition(&self, (q, qd, rest): (&[f64], &[f64], &[f64]), tau: &[f64]) -> Result<Transition, Error> {
        let scene = self.scene.borrow();
        self.pool.with(
            || Scratch::new(&self.plan, scene),
            |scratch| scratch.transition((&self.plan, scene), (q, qd, rest), tau),
        )
    }
}

/// The estimate of a robot at the time of a step, after its readings.
#[derive(Debug, Clone, Copy)]
pub struct MotionEstimate<'a> {
    plan: &'a Plan,
    record: &'a Record,
}

impl<'a> MotionEstimate<'a> {
    /// Configuration, (nq).
    #[must_use]
    pub fn q(&self) -> &'a [f64] {
        &self.record.q
    }

    /// Joint velocities, (nv).
    #[must_use]
    pub fn qd(&self) -> &'a [f64] {
        &self.record.qd
    }

    /// Wrenches in their order, six numbers (moment, force) each, then the biases of the sensors that have one, three
    /// each.
    #[must_use]
    pub fn wrenches_and_biases(&self) -> &'a [f64] {
        &self.record.rest
    }

    /// The wrench (moment, force) number `index`, at the link origin in the link frame; `None` if there is none.
    #[must_use]
    pub fn wrench(&self, index: usize) -> Option<&'a [f64; 6]> {
        let wrenches = &self.record.rest.as_chunks::<6>().0[..self.plan.wrenches.len()];
        wrenches.get(index)
    }

    /// The bias of sensor number `index`; `None` for a sensor without bias.
    #[must_use]
    pub fn bias(&self, index: usize) -> Option<&'a [f64]> {
        let first = self.plan.sensors.get(index)?.bias?;
        self.record.rest.get(first..first + 3)
    }

    /// The number of components of the error: q in its tangent space, qd, wrenches and biases.
    #[must_use]
    pub fn size(&self) -> usize {
        self.plan.states
    }

    /// Covariance of the error (q in its tangent space, qd, wrenches, biases), (n x n), row by row into `out`.
    ///
    /// # Errors
    ///
    /// [`Error::Shape`].
    pub fn covariance(&self, out: &mut [f64]) -> Result<(), Error> {
        let n = self.plan.states;
        check_length("out", out.len(), n * n)?;
        filter::covariance(self.plan, self.record, out);
        Ok(())
    }
}

/// Approximate time of a step of one robot on one thread, ns.
fn cost(plan: &Plan) -> usize {
    (COST[0] + COST[1] * plan.width.saturating_pow(3)).saturating_mul(plan.lag + 1)
}

/// Filters all times whose readings may be incomplete: readings with a delay change estimates of the past.
fn filter_pending((plan, scene): (&Plan, &Scene), scratch: &mut Scratch, robot: &mut Robot) -> Result<(), Error> {
    let Robot { prior, running, next, pending, .. } = robot;
    running.copy_from(prior);
    let is_complete = pending.len() > plan.lag;
    for (k, record) in pending.iter_mut().enumerate() {
        scratch.step((plan, scene), running, record)?;
        if k == 0 && is_complete {
            if plan.lag == 0 {
                std::mem::swap(running, next);
            } else {
                next.copy_from(running);
            }
        }
    }
    Ok(())
}

/// Checks that no reading is infinite.
fn check_readings(plan: &Plan, readings: &[f64]) -> Result<(), Error> {
    let Some(at) = readings.iter().position(|reading| reading.is_infinite()) else { return Ok(()) };
    let of = plan.sensors.iter().find(|sensor| sensor.range.contains(&at));
    let (name, first) = of.map_or(("", 0), |sensor| (sensor.name.as_str(), sensor.range.start));
    let argument = format!("readings of '{name}'");
    Err(Error::NotFinite { argument, index: at - first, value: readings[at], state: None })
}
