//! The estimate of one robot, its stored steps, and the window of its divergence test.

use super::settings::{Plan, Timing, WINDOW};
use crate::error::Error;
use crate::memory;
use std::collections::VecDeque;

/// An estimate before the readings of its time, and the lower triangular root of its covariance, column by column.
#[derive(Debug, Clone)]
pub(crate) struct Belief {
    pub q: Vec<f64>,
    pub qd: Vec<f64>,
    /// Wrenches, then biases.
    pub rest: Vec<f64>,
    /// One for each wrench that acted in the last step, otherwise zero.
    pub(super) acting: Vec<f64>,
    pub(super) root: Vec<f64>,
}

impl Belief {
    pub fn new(plan: &Plan, q: &[f64], qd: &[f64]) -> Self {
        let [column, _] = plan.strides();
        let mut root = vec![0.0; plan.states * column];
        for (i, &deviation) in plan.initial.iter().enumerate() {
            root[i * column + i] = deviation;
        }
        Self {
            q: q.to_vec(),
            qd: qd.to_vec(),
            rest: vec![0.0; plan.rest],
            acting: vec![1.0; plan.wrenches.len()],
            root,
        }
    }

    /// The root, row by row in the order (q, qd, wrenches, biases).
    #[cfg(feature = "python")]
    pub fn root_by_rows(&self, plan: &Plan, out: &mut [f64]) {
        let [column, _] = plan.strides();
        for (to, i) in out.chunks_exact_mut(plan.states).zip(plan.public_order()) {
            for (to, own) in to.iter_mut().zip(self.root.chunks_exact(column)) {
                *to = own[i];
            }
        }
    }

    pub fn copy_from(&mut self, other: &Self) {
        self.q.copy_from_slice(&other.q);
        self.qd.copy_from_slice(&other.qd);
        self.rest.copy_from_slice(&other.rest);
        self.acting.copy_from_slice(&other.acting);
        self.root.copy_from_slice(&other.root);
    }
}

/// Torques and readings of one time, and the results of its latest filter pass.
#[derive(Debug, Clone)]
pub(crate) struct Record {
    pub tau: Vec<f64>,
    /// Time since the first step, s, and the duration of the step with its noise.
    pub time: f64,
    pub(super) timing: Timing,
    /// One for each wrench that acts, otherwise zero.
    pub(super) acting: Vec<f64>,
    /// Readings of all sensors; NaN for missing ones.
    pub readings: Vec<f64>,
    /// One for each reading that was rejected as an outlier, otherwise zero.
    pub rejected: Vec<f64>,
    /// The estimate after the readings.
    pub q: Vec<f64>,
    pub qd: Vec<f64>,
    pub rest: Vec<f64>,
    /// Estimate of the torque noise of the step.
    pub(super) noise: Vec<f64>,
    /// Root of the covariance of (error, torque noise) after the readings.
    pub(super) root: Vec<f64>,
    /// Derivatives of the accelerations by the error and the torque noise, by columns.
    pub(super) flow: Vec<f64>,
    /// Derivatives of the accelerations by the wrenches in the middle of the step, by columns.
    pub(super) by_wrench: Vec<f64>,
    /// The prediction of the next time.
    pub(super) next_q: Vec<f64>,
    pub(super) next_qd: Vec<f64>,
    pub(super) next_rest: Vec<f64>,
    /// Normalized innovation squared, and number of readings.
    pub nis: f64,
    pub count: usize,
    /// The same of each sensor.
    pub(super) by_sensor: Vec<(f64, usize)>,
}

impl Record {
    pub fn new(plan: &Plan) -> Result<Self, Error> {
        // Records accumulate over the steps of the history, and over those of the largest delay.
        let argument = if plan.history > 0 { "history" } else { "sensors" };
        let filled = |length, value: f64| memory::filled(argument, length, value);
        let nan = |length| filled(length, f64::NAN);
        let [_, column] = plan.strides();
        Ok(Self {
            tau: nan(plan.nv)?,
            time: f64::NAN,
            timing: plan.timing.clone(),
            acting: filled(plan.wrenches.len(), 1.0)?,
            readings: nan(plan.readings)?,
            rejected: filled(plan.readings, 0.0)?,
            q: nan(plan.nq)?,
            qd: nan(plan.nv)?,
            rest: nan(plan.rest)?,
            noise: nan(plan.nv)?,
            root: filled(plan.width * column, 0.0)?,
            flow: filled(plan.width * plan.flow_stride(), 0.0)?,
            by_wrench: filled(6 * plan.wrenches.len() * plan.flow_stride(), 0.0)?,
            next_q: nan(plan.nq)?,
            next_qd: nan(plan.nv)?,
            next_rest: nan(plan.rest)?,
            nis: f64::NAN,
            count: 0,
            by_sensor: memory::filled(argument, plan.sensors.len(), (0.0, 0))?,
        })
    }
}

impl Record {
    /// Takes the noise of a step, in which wrenches that do not act do not grow.
    pub(super) fn time_steps(&mut self, timing: &Timing, acting: &[f64]) {
        self.timing.copy_from(timing);
        self.acting.copy_from_slice(acting);
        for (growth, acting) in self.timing.walk.as_chunks_mut::<6>().0.iter_mut().zip(acting) {
            for growth in growth {
                *growth *= acting;
            }
        }
    }
}

/// Innovations of the complete steps since the start of a window, for a test of divergence.
#[derive(Debug, Clone)]
pub(crate) struct Window {
    /// Number of steps, at most [`WINDOW`].
    pub steps: usize,
    /// For each sensor, the sum of its normalized innovations squared, and the number of readings in it.
    pub sums: Vec<(f64, usize)>,
    /// The estimate at the start.
    pub(super) prior: Belief,
    /// Torques, readings, duration and acting wrenches of each step.
    pub(super) inputs: Vec<f64>,
}

/// One robot.
#[derive(Debug, Clone)]
pub(crate) struct Robot {
    /// The estimate of the earliest time whose readings may be incomplete.
    pub prior: Belief,
    /// The estimate of the running pass, and `prior` after this step.
    pub(super) running: Belief,
    pub(super) next: Belief,
    /// Times whose readings may be incomplete, and complete ones for the smoother.
    pub(super) pending: VecDeque<Box<Record>>,
    pub(super) history: VecDeque<Box<Record>>,
    /// The latest complete record if there is no history, and a record that is not in use.
    pub(super) last: Option<Box<Record>>,
    spare: Option<Box<Record>>,
    pub steps: usize,
    /// Time of the next step since the first, s.
    pub(super) time: f64,
    pub window: Window,
}

impl Robot {
    pub fn new(plan: &Plan, prior: Belief) -> Self {
        let window = Window {
            steps: 0,
            sums: vec![(0.0, 0); plan.sensors.len()],
            prior: prior.clone(),
            inputs: vec![0.0; WINDOW * plan.inputs()],
        };
        let (running, next) = (prior.clone(), prior.clone());
        let (pending, history) = (VecDeque::new(), VecDeque::new());
        Self { prior, running, next, pending, history, last: None, spare: None, steps: 0, time: 0.0, window }
    }

    /// Adds a time with its torques and the duration of its step. Readings with a delay belong to the time that many
    /// steps ago; those of times before the first step are dropped.
    pub(super) fn begin(
        &mut self,
        plan: &Plan,
        timing: &Timing,
        (tau, readings, acting): (&[f64], &[f64], &[f64]),
    ) -> Result<(), Error> {
        let mut record = match self.spare.take() {
            Some(spare) => spare,
            None => Box::new(Record::new(plan)?),
        };
        record.tau.copy_from_slice(tau);
        record.time = self.time;
        record.time_steps(timing, acting);
        record.readings.fill(f64::NAN);
        self.pending.push_back(record);
        for sensor in &plan.sensors {
            if let Some(at) = self.pending.len().checked_sub(1 + sensor.delay) {
                let range = sensor.range.clone();
                self.pending[at].readings[range.clone()].copy_from_slice(&readings[range]);
            }
        }
        Ok(())
    }

    /// Removes the time that was added, after an error.
    pub(super) fn undo(&mut self, plan: &Plan) {
        for sensor in &plan.sensors {
            if let Some(at) = self.pending.len().checked_sub(1 + sensor.delay) {
                self.pending[at].readings[sensor.range.clone()].fill(f64::NAN);
            }
        }
        self.spare = self.pending.pop_back();
    }

    /// Ends a step: the earliest time is complete if no sensor delivers readings of it later.
    pub(super) fn commit(&mut self, plan: &Plan) {
        self.steps += 1;
        self.time = self.pending.back().map_or(self.time, |record| record.time + record.timing.dt);
        if self.pending.len() <= plan.lag {
            return;
        }
        let Some(record) = self.pending.pop_front() else { return };
        self.watch(plan, &record);
        std::mem::swap(&mut self.prior, &mut self.next);
        if plan.history == 0 {
            self.spare = self.last.replace(record);
        } else {
            self.history.push_back(record);
            if self.history.len() > plan.history {
                self.spare = self.history.pop_front();
            }
        }
    }

    /// Adds the innovations of a complete step to the window, which begins again after [`WINDOW`] steps.
    fn watch(&mut self, plan: &Plan, record: &Record) {
        let window = &mut self.window;
        if window.steps == WINDOW {
            window.steps = 0;
            window.sums.fill((0.0, 0));
            window.prior.copy_from(&self.prior);
        }
        let width = plan.inputs();
        let (tau, others) = window.inputs[window.steps * width..][..width].split_at_mut(plan.nv);
        let (readings, dt) = others.split_at_mut(plan.readings);
        tau.copy_from_slice(&record.tau);
        readings.copy_from_slice(&record.readings);
        dt[0] = record.timing.dt;
        dt[1..].copy_from_slice(&record.acting);
        add_innovations(&mut window.sums, record);
        window.steps += 1;
    }

    /// The latest time; None before the first step.
    pub fn latest(&self) -> Option<&Record> {
        self.pending.back().or_else(|| self.history.back()).or(self.last.as_ref()).map(|record| &**record)
    }

    /// The latest time with complete readings, if this step completed it.
    pub fn completed(&self, plan: &Plan) -> Option<&Record> {
        let record = self.history.back().or(self.last.as_ref())?;
        (self.steps > plan.lag).then_some(&**record)
    }
}

/// Adds the innovations of each sensor.
pub(super) fn add_innovations(sums: &mut [(f64, usize)], record: &Record) {
    for ((sum, count), (nis, readings)) in sums.iter_mut().zip(&record.by_sensor) {
        *sum += nis;
        *count += readings;
    }
}
