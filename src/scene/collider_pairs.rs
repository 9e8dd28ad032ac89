//! Colliders in the form that steps read: shapes on bodies by index, and the pairs that can touch.

use crate::collision::Geometry;
use crate::spatial::RigidShift;
use std::collections::HashMap;
use std::sync::Arc;

/// A collider of a scene.
#[derive(Debug, Clone)]
pub(crate) struct Placed {
    pub name: Arc<str>,
    /// The body that carries it; `None` for the base or for a link that cannot move.
    pub body: Option<usize>,
    /// Pose in the frame of that body.
    pub frame: RigidShift<f64>,
    pub geometry: Geometry,
    pub friction: f64,
    pub restitution: f64,
}

/// Friction, restitution and margin of a pair.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PairValues {
    pub friction: f64,
    pub restitution: f64,
    pub margin: f64,
}

/// The colliders of a scene by index, and the pairs that can touch.
#[derive(Debug, Clone)]
pub(crate) struct Colliders {
    pub all: Vec<Placed>,
    /// True if collider i can touch collider j, at index i n + j.
    pub(super) touch: Vec<bool>,
    pub(super) given: HashMap<(usize, usize), PairValues>,
    /// The largest margin, m.
    pub margin: f64,
    /// True if a pair can touch.
    pub(super) touches: bool,
}

impl Colliders {
    /// True if these can touch.
    pub fn can_touch(&self, i: usize, j: usize) -> bool {
        self.touch[i * self.all.len() + j]
    }

    /// The values of a pair.
    pub fn values(&self, i: usize, j: usize) -> PairValues {
        let given = if self.given.is_empty() { None } else { self.given.get(&(i.min(j), i.max(j))) };
        given.copied().unwrap_or_else(|| self.mixed(i, j))
    }

    /// The values of a pair that has none of its own.
    pub fn mixed(&self, i: usize, j: usize) -> PairValues {
        let (a, b) = (&self.all[i], &self.all[j]);
        let (friction, restitution) = (a.friction.max(b.friction), a.restitution.max(b.restitution));
        PairValues { friction, restitution, margin: 0.0 }
    }

    /// Lets a pair touch in any case, with values of its own.
    pub(super) fn give(&mut self, i: usize, j: usize, values: PairValues) {
        let n = self.all.len();
        (self.touch[i * n + j], self.touch[j * n + i]) = (true, true);
        self.given.insert((i.min(j), i.max(j)), values);
        self.margin = self.margin.max(values.margin);
    }
}
