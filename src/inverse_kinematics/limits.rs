//! The limits of joints, by degree of freedom.

use crate::error::Error;
use crate::scene::Scene;

/// How far each degree of freedom may go; joints of several coordinates have no limits.
#[derive(Debug, Clone)]
pub struct Bounds {
    /// The coordinate of each degree of freedom; none where a joint has several.
    pub coordinate: Vec<Option<usize>>,
    /// Smallest and largest value, rad or m; infinite where there is none.
    pub lower: Vec<f64>,
    pub upper: Vec<f64>,
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
