//! The limits of joints, by degree of freedom.

use super::task::{Goal, Tasks};
use crate::error::Error;
use crate::scene::{JointKind, Scene};
use std::f64::consts::TAU;

/// By how much limits that allow a whole turn may be short of it, rad: files round them to six digits.
const ROUNDED: f64 = 1e-5;

/// How far each degree of freedom may go; joints of several coordinates have no limits.
#[derive(Debug, Clone)]
pub struct Bounds {
    /// The coordinate of each degree of freedom; none where a joint has several.
    pub coordinate: Vec<Option<usize>>,
    /// Smallest and largest value, rad or m; infinite where there is none.
    pub lower: Vec<f64>,
    pub upper: Vec<f64>,
}

/// The limits on the way to an answer: without those of joints that may turn whole turns, where nothing tells one turn from the next.
///
/// Any angle of such a joint is within its limits, whole turns away: at a limit the way goes on, and the answer is brought back in the end.
#[derive(Debug, Clone)]
pub struct Way {
    pub bounds: Bounds,
    /// The degrees of freedom whose limits are not those of the joints.
    open: Vec<usize>,
}

/// How fast each degree of freedom may go, and how far.
#[derive(Debug, Clone)]
pub struct RateBounds {
    places: Bounds,
    velocity: Vec<f64>,
}

impl RateBounds {
    /// Those of the joints.
    pub fn of(scene: &Scene) -> Result<Self, Error> {
        let mut velocity = vec![f64::INFINITY; scene.nv()];
        for joint in scene.joints() {
            if !(joint.limits.velocity >= 0.0) {
                let found = format!("velocity {}", joint.limits.velocity);
                return Err(Error::scene(format!("limits of joint {:?}", joint.name), found, "zero or more"));
            }
            velocity[joint.v.clone()].fill(joint.limits.velocity);
        }
        Ok(Self { places: Bounds::of(scene)?, velocity })
    }

    /// The least and the largest step of a degree of freedom from `q` within dt: that of the velocity, where both cannot be kept.
    pub fn room(&self, row: usize, q: &[f64], dt: f64) -> (f64, f64) {
        let most = self.velocity[row] * dt;
        let (lower, upper) = self.places.room(row, q);
        (lower.max(-most).min(most), upper.min(most).max(-most))
    }
}

impl Way {
    /// Within all limits, of as many degrees of freedom.
    pub fn of(limits: &Bounds) -> Self {
        Self { bounds: limits.clone(), open: Vec::with_capacity(limits.lower.len()) }
    }

    /// What the tasks allow: a posture and the position of a joint tell one turn from the next, and so does what follows a joint.
    pub fn choose(&mut self, limits: &Bounds, tasks: &Tasks<'_>) {
        self.open.clear();
        self.bounds.lower.copy_from_slice(&limits.lower);
        self.bounds.upper.copy_from_slice(&limits.upper);
        if tasks.posture.is_some() || tasks.scene.coupling().is_some() {
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

    /// Brings a configuration within all limits by whole turns; whether anything moved.
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
    /// Without any limit.
    pub fn without(scene: &Scene) -> Self {
        let mut coordinate = vec![None; scene.nv()];
        for joint in scene.joints() {
            if joint.v.len() == 1 && joint.q.len() == 1 {
                coordinate[joint.v.start] = Some(joint.q.start);
            }
        }
        Self { coordinate, lower: vec![f64::NEG_INFINITY; scene.nv()], upper: vec![f64::INFINITY; scene.nv()] }
    }

    /// Those of the joints.
    pub fn of(scene: &Scene) -> Result<Self, Error> {
        let mut limits = Self::without(scene);
        for joint in scene.joints() {
            let row = joint.v.start;
            if limits.coordinate[row].is_none() {
                continue;
            }
            (limits.lower[row], limits.upper[row]) = (joint.limits.lower, joint.limits.upper);
            if !(limits.lower[row] <= limits.upper[row]) {
                let found = format!("lower {} above upper {}", limits.lower[row], limits.upper[row]);
                return Err(Error::scene(format!("limits of joint {:?}", joint.name), found, "lower at most upper"));
            }
        }
        Ok(limits)
    }

    /// Moves a configuration to the limits that it is beyond.
    pub fn hold(&self, q: &mut [f64]) {
        for (row, coordinate) in self.coordinate.iter().enumerate() {
            if let Some(at) = *coordinate {
                q[at] = q[at].max(self.lower[row]).min(self.upper[row]);
            }
        }
    }

    /// The least and the largest step of a degree of freedom from `q`.
    pub fn room(&self, row: usize, q: &[f64]) -> (f64, f64) {
        match self.coordinate[row] {
            Some(at) => (self.lower[row] - q[at], self.upper[row] - q[at]),
            None => (f64::NEG_INFINITY, f64::INFINITY),
        }
    }
}
