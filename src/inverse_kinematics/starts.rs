//! Configurations to start from: spread evenly within the limits, the same for the same seed.

use super::limits::Bounds;
use super::task::turns;
use crate::scene::Scene;
use nalgebra::{UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// Draws start `number` into `q`: joints within their limits, or a whole turn where they have none; slides without limits and free joints stay where
/// `start` has them, spherical joints get any rotation.
pub fn draw(scene: &Scene, limits: &Bounds, start: &[f64], seed: u64, number: u64, q: &mut [f64]) {
    q.copy_from_slice(start);
    let mut state = seed ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    for joint in scene.joints() {
        let (row, at) = (joint.v.start, joint.q.start);
        if limits.coordinate[row].is_some() {
            let (lower, upper) = (limits.lower[row], limits.upper[row]);
            let share = uniform(&mut state);
            if lower.is_finite() && upper.is_finite() {
                q[at] = lower + share * (upper - lower);
            } else if turns(joint.kind) {
                q[at] = ((2.0 * share - 1.0) * PI).max(lower).min(upper);
            }
        } else if joint.v.len() == 3 && joint.q.len() == 4 {
            // A direction of any length up to half a turn: every rotation is near one of them.
            let axis = Vector3::from_fn(|_, _| 2.0 * uniform(&mut state) - 1.0);
            let turn = UnitQuaternion::from_scaled_axis(axis * PI);
            q[joint.q.clone()].copy_from_slice(turn.coords.as_slice());
        }
    }
}

/// A number in [0, 1): `SplitMix64` (Steele, Lea and Flood, 2014).
#[allow(clippy::cast_precision_loss)] // 53 bits
fn uniform(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}
