//! Options of inverse kinematics, and of joint velocities for a step of a control loop.

#[cfg(feature = "python")]
use super::limits::RateBounds;
use crate::error::{Error, check_positive};
#[cfg(feature = "python")]
use crate::scene::Scene;
use crate::setters::setters;

/// Options of inverse kinematics.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Options {
    /// Largest number of starting configurations; the given one is the first. `None`: 100, or 20 with a posture. The
    /// search ends early when the tasks are reached, or when 40 starts have found the same least minimum.
    pub starts: Option<usize>,
    /// Largest number of steps from each start.
    pub iterations: usize,
    /// A task is reached if its error is at most this, m and rad.
    pub tolerance: f64,
    /// True if joints stay within their limits; a start beyond them is moved to the limits.
    pub limits: bool,
    /// Standard deviation of the posture, rad and m; `None` for no posture.
    pub posture: Option<f64>,
    /// The metric of damping.
    pub metric: Metric,
    /// Seed of the random starts.
    pub seed: u64,
}

/// The metric of step size for the damping of Levenberg-Marquardt steps, which influences which of several solutions is
/// found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Metric {
    /// Joint coordinates, each scaled by its effect on the tasks.
    #[default]
    Coordinates,
    /// Kinetic energy, dq M dq: joints that move large masses move less. Requires one mass matrix per step.
    Mass,
}

/// Options of differential inverse kinematics: joint velocities for one step of a control loop.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct RateOptions<'a> {
    /// Time for which the joint velocities are constant, s.
    pub dt: f64,
    /// Fraction of the errors to be removed in this time.
    pub gain: f64,
    /// Damping of each joint relative to its diagonal entry of the second derivative of the tasks, or to a thousandth
    /// of the largest entry; it keeps joint velocities small near singularities.
    pub damping: f64,
    /// True if joints stay within their position and velocity limits.
    pub limits: bool,
    /// Velocity limits (nv), rad/s and m/s, which replace those of the joints, also for a floating base, which has
    /// none.
    pub velocity: Option<&'a [f64]>,
}

impl RateOptions<'_> {
    /// Checks that time, gain and damping are positive, that position limits do not exclude each other, and that
    /// velocity limits are not negative.
    #[cfg(feature = "python")]
    pub(crate) fn check(&self, scene: &Scene) -> Result<(), Error> {
        self.check_numbers()?;
        if self.limits { RateBounds::default().set(scene, self.velocity) } else { Ok(()) }
    }

    pub(super) fn check_numbers(&self) -> Result<(), Error> {
        check_positive("dt", self.dt)?;
        check_positive("gain", self.gain)?;
        check_positive("damping", self.damping)
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            starts: None,
            iterations: 100,
            tolerance: 1e-9,
            limits: true,
            posture: None,
            metric: Metric::default(),
            seed: 0,
        }
    }
}

setters!(Options {
    with_starts: starts => Option<usize>,
    with_iterations: iterations: usize,
    with_tolerance: tolerance: f64,
    with_limits: limits: bool,
    with_posture: posture => Option<f64>,
    with_metric: metric: Metric,
    with_seed: seed: u64,
});

impl RateOptions<'_> {
    /// Joint velocities for a step of `dt` seconds: gain 1, damping 1e-6, within the limits of the joints.
    #[must_use]
    pub fn new(dt: f64) -> Self {
        Self { dt, gain: 1.0, damping: 1e-6, limits: true, velocity: None }
    }
}

setters!(RateOptions<'a> {
    with_dt: dt: f64,
    with_gain: gain: f64,
    with_damping: damping: f64,
    with_limits: limits: bool,
    with_velocity: velocity => Option<&'a [f64]>,
});
