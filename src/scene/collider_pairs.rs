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
    /// Whether i touches j, at i n + j.
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
        let (a, b) = (&self.all[i], &self.all[j]);
        let mixed = || PairValues {
            friction: a.friction.max(b.friction),
            restitution: a.restitution.max(b.restitution),
            margin: 0.0,
        };
        if self.given.is_empty() {
            mixed()
        } else {
            self.given.get(&(i.min(j), i.max(j))).copied().unwrap_or_else(mixed)
        }
    }
}
