//! Joint limits per degree of freedom.

use super::task::{Goal, Tasks};
use crate::error::{Error, check_length, in_language, number};
use crate::scene::{Coupling, JointKind, Scene};
use std::f64::consts::TAU;

/// Limits count as a whole turn if they are short of it by at most this, rad, because files round them to six digits.
const ROUNDED: f64 = 1e-5;

/// Position limits of each degree of freedom; joints with a quaternion have none.
#[derive(Debug, Clone)]
pub struct Bounds {
    /// Index in q for each degree of freedom whose velocity is the derivative of one coordinate.
    pub coordinate: Vec<Option<usize>>,
    /// Smallest and largest value, rad or m; infinite for no limit.
    pub lower: Vec<f64>,
    pub upper: Vec<f64>,
}

/// Limits during the search. They exclude joints whose range is at least a whole turn, if the tasks do not depend on
/// the number of turns.
///
/// Any angle of such a joint is within its limits up to whole turns: the search ignores the limits, and the result is
/// moved back by whole turns.
#[derive(Debug, Clone)]
pub struct SearchLimits {
    pub bounds: Bounds,
    /// Degrees of freedom whose search limits differ from the joint limits.
    open: Vec<usize>,
}

/// Velocity and position limits of each degree of freedom of one scene.
#[derive(Debug, Clone, Default)]
pub struct RateBounds {
    places: Option<Bounds>,
    /// The velocity limits of the joints, once they are in use.
    of_joints: Option<Vec<f64>>,
    velocity: Vec<f64>,
}

impl RateBounds {
    /// Sets the position limits of the joints, with their velocity limits or those of the caller. Allocates once.
    pub fn set(&mut self, scene: &Scene, velocity: Option<&[f64]>) -> Result<(), Error> {
        if self.places.is_none() {
            self.places = Some(Bounds::of(scene)?);
        }
        if velocity.is_none() && self.of_joints.is_none() {
            self.of_joints = Some(velocities_of(scene)?);
        }
        let Some(given) = velocity.or(self.of_joints.as_deref()) else { return Ok(()) };
        check_length("velocity", given.len(), scene.nv())?;
        for joint in scene.joints() {
            if let Some(bad) = given[joint.v.clone()].iter().find(|value| !(**value >= 0.0)) {
                let found = format!("{} for joint {:?}", number(*bad), joint.name);
                return Err(Error::argument("velocity", found, "zero or positive; infinity for no limit"));
            }
        }
        self.velocity.clear();
        self.velocity.extend_from_slice(given);
        Ok(())
    }

    /// Writes to `step` the smallest displacement within `dt` from `q` that satisfies the limits: zero, except for
    /// joints beyond their position limits, which return.
    pub fn returning(&self, q: &[f64], dt: f64, step: &mut [f64]) {
        for (row, step) in step.iter_mut().enumerate() {
            let (lower, upper) = self.place(row, q);
            let most = self.velocity[row] * dt;
            *step = 0.0_f64.max(lower).min(upper).max(-most).min(most);
        }
    }

    fn place(&self, row: usize, q: &[f64]) -> (f64, f64) {
        self.places.as_ref().map_or((f64::NEG_INFINITY, f64::INFINITY), |places| places.room(row, q))
    }

    /// The least and the largest displacement of a degree of freedom from `q` in addition to the displacement
    /// `returning`.
    pub fn room(&self, row: usize, q: &[f64], dt: f64, returning: f64) -> (f64, f64) {
        let most = self.velocity[row] * dt;
        let (lower, upper) = self.place(row, q);
        ((lower - returning).max(-most - returning).min(0.0), (upper - returning).min(most - returning).max(0.0))
    }
}

/// Velocity limit of each degree of freedom: the smallest of that of its joint and those of the joints that follow it,
/// divided by their multipliers.
fn velocities_of(scene: &Scene) -> Result<Vec<f64>, Error> {
    let tree = scene.tree();
    let mut velocity = vec![f64::INFINITY; tree.nv()];
    for joint in tree.joints() {
        if !(joint.limits.velocity >= 0.0) {
            let found = format!("velocity {}", joint.limits.velocity);
            return Err(Error::scene(format!("limits of joint {:?}", joint.name), found, "zero or positive"));
        }
        velocity[joint.v.clone()].fill(joint.limits.velocity);
    }
    Ok(scene.coupling().map_or_else(|| velocity.clone(), |coupling| coupling.velocity_limits(&velocity)))
}

impl SearchLimits {
    /// Within all limits.
    pub fn of(limits: &Bounds) -> Self {
        Self { bounds: limits.clone(), open: Vec::with_capacity(limits.lower.len()) }
    }

    /// Removes the limits that the tasks permit to remove. Whole turns matter for a posture, for joint position tasks,
    /// and for joints and connections that depend on the joint.
    pub fn choose(&mut self, limits: &Bounds, tasks: &Tasks<'_>) {
        self.open.clear();
        self.bounds.lower.copy_from_slice(&limits.lower);
        self.bounds.upper.copy_from_slice(&limits.upper);
        if !tasks.is_same_after_turns() {
            return;
        }
        for (at, joint) in tasks.scene.joints().iter().enumerate() {
            let row = joint.v.start;
            let is_asked =
                || tasks.each.iter().any(|task| matches!(task.goal, Goal::Joint { joint, .. } if joint == at));
            let turns = matches!(joint.kind, JointKind::Revolute | JointKind::Continuous);
            let range = if turns { limits.upper[row] - limits.lower[row] } else { 0.0 };
            if range.is_finite() && range > TAU - ROUNDED && !is_asked() {
                (self.bounds.lower[row], self.bounds.upper[row]) = (f64::NEG_INFINITY, f64::INFINITY);
                self.open.push(row);
            }
        }
    }

    /// Removes all limits.
    pub fn lift(&mut self) {
        self.bounds.lower.fill(f64::NEG_INFINITY);
        self.bounds.upper.fill(f64::INFINITY);
    }

    /// True if the search has any limit.
    pub fn is_limited(&self) -> bool {
        let Bounds { lower, upper, .. } = &self.bounds;
        lower.iter().chain(upper).any(|limit| limit.is_finite())
    }

    /// Moves a configuration into all limits by whole turns; returns whether it changed.
    pub fn bring_back(&self, limits: &Bounds, q: &mut [f64]) -> bool {
        let mut moved = false;
        for &row in &self.open {
            let Some(at) = limits.coordinate[row] else { continue };
            let (lower, upper) = (limits.lower[row], limits.upper[row]);
            if !(q[at] >= lower && q[at] <= upper) {
                let turns = ((q[at] - upper) / TAU).ceil().max(0.0) - ((lower - q[at]) / TAU).ceil().max(0.0);
                q[at] = (q[at] - turns * TAU).max(lower).min(upper);
                moved = true;
            }
        }
        moved
    }
}

impl Bounds {
    /// Bounds without limits.
    pub fn without(scene: &Scene) -> Self {
        let mut coordinate = vec![None; scene.nv()];
        for joint in scene.joints() {
            if joint.v.len() == joint.q.len() {
                joint.v.clone().zip(joint.q.clone()).for_each(|(row, at)| coordinate[row] = Some(at));
            }
        }
        Self { coordinate, lower: vec![f64::NEG_INFINITY; scene.nv()], upper: vec![f64::INFINITY; scene.nv()] }
    }

    /// The limits of the joints and of the joints that follow them.
    pub fn of(scene: &Scene) -> Result<Self, Error> {
        let mut limits = Self::without(scene);
        let shared = scene.coupling().map(Coupling::limits);
        for joint in scene.joints() {
            for row in joint.v.clone() {
                let Some(at) = limits.coordinate[row] else { continue };
                let own = (joint.limits.lower, joint.limits.upper);
                let (lower, upper) = shared.as_ref().filter(|_| joint.q.len() == 1).map_or(own, |shared| shared[at]);
                if !(lower <= upper) {
                    let followers = scene.coupling().map(|coupling| coupling.moved_by(joint)).unwrap_or_default();
                    let (of, remedy) = match followers.split_first() {
                        Some((_, rest)) if !rest.is_empty() => (
                            format!(", with those of {} that follow it", rest.join(", ")),
                            format!(
                                "limits that overlap, also for the joints that follow; {} ignores them",
                                in_language("with_limits(false)", "limits=False")
                            ),
                        ),
                        _ => (String::new(), "a lower limit that is not above the upper one".to_owned()),
                    };
                    let found = format!("lower {} above upper {}{of}", number(lower), number(upper));
                    return Err(Error::scene(format!("limits of joint {:?}", joint.name), found, remedy));
                }
                (limits.lower[row], limits.upper[row]) = (lower, upper);
            }
        }
        Ok(limits)
    }

    /// Moves a configuration by whole turns to the nearest one within the limits.
    pub fn wrap(&self, scene: &Scene, q: &mut [f64]) {
        for joint in
            scene.joints().iter().filter(|joint| matches!(joint.kind, JointKind::Revolute | JointKind::Continuous))
        {
            let (row, at) = (joint.v.start, joint.q.start);
            let (lower, upper) = (self.lower[row], self.upper[row]);
            if !(lower.is_finite() && upper.is_finite()) {
                continue;
            }
            let above = (q[at] - lower).rem_euclid(TAU);
            let beyond = above - (upper - lower);
            q[at] = if beyond <= 0.0 {
                lower + above
            } else if beyond < TAU - above {
                upper
            } else {
                lower
            };
        }
        self.hold(q);
    }

    /// Clips a configuration to the limits.
    pub fn hold(&self, q: &mut [f64]) {
        for (row, coordinate) in self.coordinate.iter().enumerate() {
            if let Some(at) = *coordinate {
                q[at] = q[at].max(self.lower[row]).min(self.upper[row]);
            }
        }
    }

    /// The least and the largest displacement of a degree of freedom from `q`.
    pub fn room(&self, row: usize, q: &[f64]) -> (f64, f64) {
        match self.coordinate[row] {
            Some(at) => (self.lower[row] - q[at], self.upper[row] - q[at]),
            None => (f64::NEG_INFINITY, f64::INFINITY),
        }
    }
}
