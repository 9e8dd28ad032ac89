//! The gap with which a contact touches.

use crate::model::Model;
use crate::scalar::Real;

/// Gap of a contact at rest from rounding, m.
pub(super) const ROUNDING: f64 = 1e-9;

/// A contact with at most this gap touches: the distance of a fall in a step of `h`, m, so that contacts at rest are
/// not released by rounding.
pub(super) fn touching_gap<T: Real>(model: &Model<T>, h: f64) -> f64 {
    model.gravity.map(|g| g.lane(0)).norm() * h * h + ROUNDING
}
