//! Settings of an observer, and the checked form that its steps read.

use crate::error::{Error, check_length};
use crate::kinematics::Frame;
use crate::memory::{bytes_of, room};
use crate::scene::{Joint, Scene};
use crate::setters::setters;
use crate::spatial::RigidShift;
use nalgebra::Matrix6;
use std::ops::Range;

/// Number of steps of a window of innovations, for tests of divergence.
pub const WINDOW: usize = 100;

/// Largest delay of a sensor, in steps: each step filters all times again whose readings may be incomplete.
const LONGEST_DELAY: usize = 10_000;

/// Numbers in a register of the widest instruction set: columns of matrices are padded to multiples of it.
pub(super) const LANES: usize = 8;

/// A frame on a link that carries a sensor.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Mount {
    /// Name of the link.
    pub link: String,
    /// Pose of the sensor in the link frame: rotation from sensor axes to link axes, and position in m.
    pub offset: RigidShift<f64>,
}

impl<N: Into<String>> From<N> for Mount {
    fn from(link: N) -> Self {
        Self { link: link.into(), offset: RigidShift::identity() }
    }
}

setters!(Mount { with_offset: offset: RigidShift<f64> });

/// The quantity that a sensor measures.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Quantity {
    /// Positions of joints of one axis, rad or m; `None`: of all joints of one axis.
    Encoder(Option<Vec<String>>),
    /// Torques of joints of one axis, N m or N: the commanded torque and the torque noise of the step; `None`: of all
    /// joints of one axis.
    JointTorque(Option<Vec<String>>),
    /// Angular velocity in the sensor frame, rad/s.
    Gyro(Mount),
    /// Proper acceleration (acceleration minus gravity) of the origin of the sensor frame, in that frame, m/s^2.
    Accelerometer(Mount),
    /// Velocity of the origin of the sensor frame, in that frame, m/s. The readings of a point in contact with the
    /// ground are zeros, and those of a point without contact are NaN.
    Contact(Mount),
    /// Pose of the sensor frame in the base frame: its rotation vector, rad, and the position of its origin, m. The
    /// matrix is the covariance of the error (rotation, position) in the axes of the sensor; the noise of the sensor is
    /// a factor of its standard deviations.
    Pose(Mount, Box<[[f64; 6]; 6]>),
}

/// A sensor of an observer.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Sensor {
    /// Name in error messages.
    pub name: String,
    /// The quantity that it measures.
    pub quantity: Quantity,
    /// Standard deviation of a reading: one number, or one per component.
    pub noise: Vec<f64>,
    /// Number of steps between the time of a reading and the step that receives it, at most 10,000.
    pub delay: usize,
    /// Initial standard deviation of the bias of a gyro or accelerometer, rad/s or m/s^2.
    pub bias: f64,
    /// Growth of the standard deviation of the bias per square root of a second. With `bias` zero too, there is no
    /// bias.
    pub bias_walk: f64,
    /// Largest difference from the prediction in its standard deviations; a component beyond is an outlier and is not
    /// processed. Infinite: all are.
    pub gate: f64,
}

impl Sensor {
    /// A sensor without delay and bias, with one standard deviation for all components.
    #[must_use]
    pub fn new(name: impl Into<String>, quantity: Quantity, noise: f64) -> Self {
        Self {
            name: name.into(),
            quantity,
            noise: vec![noise],
            delay: 0,
            bias: 0.0,
            bias_walk: 0.0,
            gate: f64::INFINITY,
        }
    }
}

setters!(Sensor {
    with_noise: noise => Vec<f64>,
    with_delay: delay: usize,
    with_bias: bias: f64,
    with_bias_walk: bias_walk: f64,
    with_gate: gate: f64,
});

/// An external wrench (moment, force) on a link, at the link origin in the link frame: a random walk, or an
/// Ornstein-Uhlenbeck process.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ExternalWrench {
    /// Name of the link.
    pub link: String,
    /// Density of the driving white noise, (N m)^2/s and N^2/s.
    pub density: [f64; 6],
    /// Correlation time, s; infinite for a random walk. The stationary variance is density `correlation_time` / 2.
    pub correlation_time: f64,
    /// Initial standard deviations; `None`: zero for a random walk, otherwise the stationary ones.
    pub deviation: Option<[f64; 6]>,
}

impl ExternalWrench {
    /// A random walk that begins at zero.
    #[must_use]
    pub fn new(link: impl Into<String>, density: [f64; 6]) -> Self {
        Self { link: link.into(), density, correlation_time: f64::INFINITY, deviation: None }
    }
}

setters!(ExternalWrench {
    with_correlation_time: correlation_time: f64,
    with_deviation: deviation => Option<[f64; 6]>,
});

/// Settings of an observer.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ObserverSettings {
    /// Time between two steps, s.
    pub dt: f64,
    /// Sensors with different names.
    pub sensors: Vec<Sensor>,
    /// Density of the torque noise of each degree of freedom, (N m)^2 s or N^2 s. It includes friction that is not
    /// modeled.
    pub torque_noise: Vec<f64>,
    /// External wrenches to estimate, on different links.
    pub wrenches: Vec<ExternalWrench>,
    /// Initial standard deviations of q in its tangent space, then of qd, (2 nv).
    pub initial: Vec<f64>,
    /// Number of past steps that are stored for the smoother.
    pub history: usize,
}

impl ObserverSettings {
    /// Settings without torque noise, external wrenches and history, for initial estimates that are exact.
    #[must_use]
    pub fn new(scene: &Scene, dt: f64, sensors: Vec<Sensor>) -> Self {
        let nv = scene.nv();
        Self { dt, sensors, torque_noise: vec![0.0; nv], wrenches: Vec::new(), initial: vec![0.0; 2 * nv], history: 0 }
    }
}

setters!(ObserverSettings {
    with_dt: dt: f64,
    with_sensors: sensors => Vec<Sensor>,
    with_torque_noise: torque_noise => Vec<f64>,
    with_wrenches: wrenches => Vec<ExternalWrench>,
    with_initial: initial => Vec<f64>,
    with_history: history: usize,
});

/// The source of the readings of a sensor.
#[derive(Debug, Clone)]
pub(super) enum Source {
    /// Indices in q and in qd.
    Encoder(Vec<(usize, usize)>),
    /// Indices in tau.
    JointTorque(Vec<usize>),
    Gyro(Frame<f64>),
    Accelerometer(Frame<f64>),
    Contact(Frame<f64>),
    /// With the inverse of a root of the covariance.
    Pose(Frame<f64>, Box<Matrix6<f64>>),
}

/// A checked sensor.
#[derive(Debug, Clone)]
pub(crate) struct Reader {
    pub name: String,
    pub(super) source: Source,
    /// Standard deviation of each component.
    pub(super) deviations: Vec<f64>,
    pub(super) delay: usize,
    /// Square of the largest normalized innovation of a component.
    pub(super) gate: f64,
    /// Index of its bias among wrenches and biases.
    pub(super) bias: Option<usize>,
    /// Its components among the readings of all sensors.
    pub range: Range<usize>,
}

impl Reader {
    /// True if the readings depend on the joint accelerations.
    pub(super) fn needs_acceleration(&self) -> bool {
        matches!(self.source, Source::Accelerometer(..))
    }

    /// True if the readings are processed together or not at all.
    pub(super) fn is_whole(&self) -> bool {
        matches!(self.source, Source::Pose(..))
    }

    /// The sensor without its noise and its place among others.
    pub(crate) fn unplaced(scene: &Scene, sensor: &Sensor) -> Result<Self, Error> {
        let one_axis = |names: &Option<Vec<String>>| one_axis(scene, sensor, names.as_deref());
        let frame = |mount: &Mount| scene.frame(&mount.into());
        let (source, size) = match &sensor.quantity {
            Quantity::Encoder(names) => {
                let joints = one_axis(names)?;
                let size = joints.len();
                (Source::Encoder(joints.iter().map(|joint| (joint.q.start, joint.v.start)).collect()), size)
            }
            Quantity::JointTorque(names) => {
                let joints = one_axis(names)?;
                let size = joints.len();
                (Source::JointTorque(joints.iter().map(|joint| joint.v.start).collect()), size)
            }
            Quantity::Gyro(at) => (Source::Gyro(frame(at)?), 3),
            Quantity::Accelerometer(at) => (Source::Accelerometer(frame(at)?), 3),
            Quantity::Contact(at) => (Source::Contact(frame(at)?), 3),
            Quantity::Pose(at, covariance) => {
                let given = Matrix6::from_fn(|i, j| covariance[i][j]);
                let root = Some(given).filter(|given| (given - given.transpose()).amax() <= 1e-9 * given.amax());
                let inverse = root.and_then(Matrix6::cholesky).and_then(|root| root.l().try_inverse());
                let inverse = inverse.filter(|inverse| inverse.iter().all(|entry| entry.is_finite()));
                let expected = "a symmetric, positive definite matrix (6 x 6), rad^2 and m^2";
                let refused =
                    || Error::argument(format!("covariance of '{}'", sensor.name), "another matrix", expected);
                (Source::Pose(frame(at)?, Box::new(inverse.ok_or_else(refused)?)), 6)
            }
        };
        let name = sensor.name.clone();
        let (delay, gate) = (sensor.delay, sensor.gate * sensor.gate);
        Ok(Self { name, source, deviations: Vec::new(), delay, gate, bias: None, range: 0..size })
    }
}

/// The joints of one axis with the given names; without names, all of them.
fn one_axis<'a>(scene: &'a Scene, sensor: &Sensor, names: Option<&[String]>) -> Result<Vec<&'a Joint>, Error> {
    let Some(names) = names else {
        return Ok(scene.joints().iter().filter(|joint| joint.q.len() == 1).collect());
    };
    let check = |name: &String| {
        let joint = scene.joint(name)?;
        if joint.q.len() == 1 {
            return Ok(joint);
        }
        let found = format!("the joint {name:?}, which has {} coordinates", joint.q.len());
        Err(Error::argument(format!("joints of '{}'", sensor.name), found, "joints of one"))
    };
    names.iter().map(check).collect()
}

/// Duration of a step, and what follows from it.
#[derive(Debug, Clone)]
pub(crate) struct Timing {
    pub dt: f64,
    /// Standard deviation of the torque noise, held constant over a step.
    pub(super) torque_deviations: Vec<f64>,
    /// Factor of wrenches and biases per step, and standard deviation of their growth.
    pub decay: Vec<f64>,
    pub walk: Vec<f64>,
}

impl Timing {
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.dt = other.dt;
        self.torque_deviations.copy_from_slice(&other.torque_deviations);
        self.decay.copy_from_slice(&other.decay);
        self.walk.copy_from_slice(&other.walk);
    }
}

/// Checks the duration of a step.
pub(super) fn check_duration(dt: f64) -> Result<(), Error> {
    if dt.is_finite() && dt > 0.0 {
        return Ok(());
    }
    Err(Error::argument("dt", dt.to_string(), "a time in s, finite and positive"))
}

/// The checked settings. The error is ordered (wrenches, biases, q, qd, torque noise of the step), so that the rows of
/// the random walks come first in triangular roots.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    pub nv: usize,
    pub nq: usize,
    /// Number of components of wrenches and biases.
    pub rest: usize,
    /// Number of components of the error without the torque noise.
    pub states: usize,
    /// Number of components with the torque noise.
    pub width: usize,
    /// Number of readings of all sensors.
    pub readings: usize,
    /// The noise of a step of the usual duration.
    pub timing: Timing,
    /// Density of the torque noise.
    torque_noise: Vec<f64>,
    /// Densities of the growth of wrenches and biases, and their correlation times.
    densities: Vec<f64>,
    times: Vec<f64>,
    /// The components with growth, ascending, then for each wrench component with growth the number of components, as
    /// the first row of the columns of its growth within a step.
    pub(super) walks: Vec<usize>,
    /// The number of components with growth.
    pub(super) grown: usize,
    /// Initial standard deviations, in the order of the error.
    pub(super) initial: Vec<f64>,
    pub(super) wrenches: Vec<Frame<f64>>,
    pub sensors: Vec<Reader>,
    /// First degree of freedom and number of degrees of freedom of each spherical and free joint.
    pub(super) groups: Vec<(usize, usize)>,
    /// The largest delay.
    pub(super) lag: usize,
    pub(super) history: usize,
}

impl Plan {
    pub fn new(scene: &Scene, settings: &ObserverSettings) -> Result<Self, Error> {
        let ObserverSettings { dt, history, .. } = *settings;
        check_duration(dt)?;
        let nv = scene.nv();
        check_length("torque_noise", settings.torque_noise.len(), nv)?;
        not_negative("torque_noise", &settings.torque_noise)?;
        check_length("initial", settings.initial.len(), 2 * nv)?;
        not_negative("initial", &settings.initial)?;
        let mut plan = Self {
            nv,
            nq: scene.nq(),
            rest: 0,
            states: 0,
            width: 0,
            readings: 0,
            timing: Timing { dt, torque_deviations: vec![0.0; nv], decay: Vec::new(), walk: Vec::new() },
            torque_noise: settings.torque_noise.clone(),
            densities: Vec::new(),
            times: Vec::new(),
            walks: Vec::new(),
            grown: 0,
            initial: Vec::new(),
            wrenches: Vec::new(),
            sensors: Vec::new(),
            groups: groups(scene),
            lag: 0,
            history,
        };
        for (at, wrench) in settings.wrenches.iter().enumerate() {
            if settings.wrenches[..at].iter().any(|other| other.link == wrench.link) {
                let found = format!("two wrenches on the link '{}'", wrench.link);
                return Err(Error::argument("wrenches", found, "one"));
            }
            plan.add_wrench(scene, wrench)?;
        }
        for sensor in &settings.sensors {
            plan.add_sensor(scene, sensor)?;
        }
        plan.rest = plan.times.len();
        plan.states = plan.rest + 2 * nv;
        plan.width = plan.states + nv;
        plan.initial.extend_from_slice(&settings.initial);
        let mut timing = plan.timing.clone();
        timing.decay.resize(plan.rest, f64::NAN);
        timing.walk.resize(plan.rest, f64::NAN);
        plan.time(dt, &mut timing);
        plan.walks = (0..plan.rest).filter(|&i| timing.walk[i] > 0.0).collect();
        plan.grown = plan.walks.len();
        let of_wrenches = plan.walks.partition_point(|&row| row < 6 * plan.wrenches.len());
        plan.walks.extend(std::iter::repeat_n(plan.rest, of_wrenches));
        plan.timing = timing;
        Ok(plan)
    }

    /// The noise of a step of the duration `dt`.
    pub(super) fn time(&self, dt: f64, timing: &mut Timing) {
        timing.dt = dt;
        for (deviation, density) in timing.torque_deviations.iter_mut().zip(&self.torque_noise) {
            *deviation = (density / dt).sqrt();
        }
        for (i, (&time, density)) in self.times.iter().zip(&self.densities).enumerate() {
            let walks = time.is_infinite();
            let added = if walks { dt } else { -0.5 * time * (-2.0 * dt / time).exp_m1() };
            timing.decay[i] = if walks { 1.0 } else { (-dt / time).exp() };
            timing.walk[i] = (density * added).sqrt();
        }
    }

    fn add_wrench(&mut self, scene: &Scene, wrench: &ExternalWrench) -> Result<(), Error> {
        let link = scene.link(&wrench.link).map_err(|error| error.of_argument("wrenches"))?;
        let time = wrench.correlation_time;
        not_negative(&format!("density of the wrench on '{}'", wrench.link), &wrench.density)?;
        if !(time > 0.0) {
            let expected = "a time in s, positive or infinite";
            return Err(Error::argument("correlation_time", time.to_string(), expected));
        }
        let walks = time.is_infinite();
        self.times.extend([time; 6]);
        self.densities.extend(wrench.density);
        match &wrench.deviation {
            Some(given) => {
                not_negative(&format!("deviation of the wrench on '{}'", wrench.link), given)?;
                self.initial.extend_from_slice(given);
            }
            None if walks => self.initial.extend([0.0; 6]),
            None => self.initial.extend(wrench.density.iter().map(|density| (0.5 * density * time).sqrt())),
        }
        self.wrenches.push(link.into());
        Ok(())
    }

    fn add_sensor(&mut self, scene: &Scene, sensor: &Sensor) -> Result<(), Error> {
        let name = &sensor.name;
        if self.sensors.iter().any(|other| other.name == *name) {
            let found = format!("two sensors with the name '{name}'");
            return Err(Error::argument("sensors", found, "different names"));
        }
        let mut reader = Reader::unplaced(scene, sensor)?;
        let size = reader.range.len();
        // The square is used: a deviation whose square is zero would be a division by zero.
        let valid = |deviation: &f64| *deviation > 0.0 && (deviation * deviation).is_normal();
        if !(matches!(sensor.noise.len(), 1) || sensor.noise.len() == size) || !sensor.noise.iter().all(valid) {
            let expected = format!("a standard deviation, one number or {size}, finite and positive");
            return Err(Error::argument(format!("noise of '{name}'"), format!("{:?}", sensor.noise), expected));
        }
        reader.deviations = if sensor.noise.len() == size { sensor.noise.clone() } else { vec![sensor.noise[0]; size] };
        if !(sensor.gate > 0.0) {
            let expected = "standard deviations, positive or infinite";
            return Err(Error::argument(format!("gate of '{name}'"), sensor.gate.to_string(), expected));
        }
        let (bias, bias_walk) = (sensor.bias, sensor.bias_walk);
        not_negative(&format!("bias of '{name}'"), &[bias, bias_walk])?;
        if bias > 0.0 || bias_walk > 0.0 {
            if !matches!(sensor.quantity, Quantity::Gyro(_) | Quantity::Accelerometer(_)) {
                let found = format!("{bias} with a walk of {bias_walk}");
                return Err(Error::argument(format!("bias of '{name}'"), found, "zero: only gyros and accelerometers"));
            }
            reader.bias = Some(self.times.len());
            self.times.extend([f64::INFINITY; 3]);
            self.densities.extend([bias_walk * bias_walk; 3]);
            self.initial.extend([bias; 3]);
        }
        if sensor.delay > LONGEST_DELAY {
            let expected = format!("at most {LONGEST_DELAY} steps, because each step filters all of them again");
            return Err(Error::argument(format!("delay of '{name}'"), sensor.delay.to_string(), expected));
        }
        reader.range = self.readings..self.readings + size;
        self.readings += size;
        self.lag = self.lag.max(sensor.delay);
        self.sensors.push(reader);
        Ok(())
    }

    /// Checks the memory of the first step of `robots` robots on `threads` threads: of a robot four estimates, a record
    /// and its window, and the scratch of a thread.
    pub(super) fn check_room(&self, robots: usize, threads: usize) -> Result<(), Error> {
        let ([column, wide], stride) = (self.strides(), self.flow_stride());
        let all = |count: usize, matrices: &[[usize; 3]]| {
            let bytes = matrices.iter().map(|[of, rows, columns]| bytes_of::<f64>(&[count, *of, *rows, *columns]));
            bytes.fold(0, u128::saturating_add)
        };
        let window = [1, WINDOW, self.inputs()];
        let robot = [[4, self.states, column], [1, self.width, wide], [1, self.width, stride], window];
        let predicted = [1, self.width + self.walks.len(), column];
        let thread =
            [[3, self.nv, self.nv], [1, self.width, stride], [2, self.width, self.reading_stride()], predicted];
        let bytes = all(robots, &robot).saturating_add(all(threads, &thread));
        room(if robots > 1 { "q" } else { "scene" }, bytes)
    }

    /// The number of torques, readings and others that a window stores of a step.
    pub(super) fn inputs(&self) -> usize {
        self.nv + self.readings + 1 + self.wrenches.len()
    }

    /// Index of the first component of q in the error.
    #[inline(always)]
    pub(super) fn q(&self) -> usize {
        self.rest
    }

    /// Index of the first component of qd in the error.
    #[inline(always)]
    pub(super) fn qd(&self) -> usize {
        self.rest + self.nv
    }

    /// Length of a column of a root, and of one with the torque noise, padded.
    pub(super) fn strides(&self) -> [usize; 2] {
        [self.states.next_multiple_of(LANES), self.width.next_multiple_of(LANES)]
    }

    /// Length of a column of derivatives of accelerations, padded.
    pub(super) fn flow_stride(&self) -> usize {
        self.nv.next_multiple_of(LANES)
    }

    /// Length of a column of derivatives of readings, padded.
    pub(super) fn reading_stride(&self) -> usize {
        self.readings.next_multiple_of(LANES)
    }

    /// For each component in the order (q, qd, wrenches, biases), its index in the error.
    pub fn public_order(&self) -> impl Iterator<Item = usize> + Clone + use<> {
        let rest = self.rest;
        (rest..self.states).chain(0..rest)
    }
}

/// Spherical and free joints, whose degrees of freedom do not commute.
fn groups(scene: &Scene) -> Vec<(usize, usize)> {
    let found = scene.joints().iter().filter(|joint| joint.quaternion().is_some());
    found.map(|joint| (joint.v.start, joint.v.len())).collect()
}

/// Checks standard deviations or densities.
fn not_negative(argument: &str, values: &[f64]) -> Result<(), Error> {
    match values.iter().find(|value| !(value.is_finite() && **value >= 0.0)) {
        None => Ok(()),
        Some(value) => Err(Error::argument(argument, value.to_string(), "finite numbers, zero or positive")),
    }
}
