//! Starting configurations, distributed uniformly within the limits and determined by a seed.

use super::limits::Bounds;
use super::task::turns;
use crate::scene::Scene;
use nalgebra::{UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// The increment of `SplitMix64`.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// Draws start `number` into `q`: joints within their limits, or within a whole turn without limits. Prismatic joints
/// without limits and free joints keep their values in `start`; spherical joints get a random rotation. With `corners`,
/// half of the joints with limits are at one of them, to find solutions there.
pub fn draw(scene: &Scene, limits: &Bounds, start: &[f64], (seed, number, corners): (u64, u64, bool), q: &mut [f64]) {
    q.copy_from_slice(start);
    // Mixed twice, because streams whose states differ by one increment would produce the same numbers with an offset.
    let mut state = mixed(seed ^ mixed(number.wrapping_mul(GOLDEN)));
    for joint in scene.joints() {
        if limits.coordinate[joint.v.start].is_some() {
            for (axis, (row, at)) in joint.v.clone().zip(joint.q.clone()).enumerate() {
                let (lower, upper) = (limits.lower[row], limits.upper[row]);
                let share = uniform(&mut state);
                if lower.is_finite() && upper.is_finite() {
                    let share = if corners { (2.0 * share - 0.5).clamp(0.0, 1.0) } else { share };
                    q[at] = lower + share * (upper - lower);
                } else if turns(joint.kind, axis) {
                    q[at] = ((2.0 * share - 1.0) * PI).max(lower).min(upper);
                }
            }
        } else if joint.v.len() == 3 && joint.q.len() == 4 {
            // A random axis with an angle of up to pi or more, so that every rotation is near some draw.
            let axis = Vector3::from_fn(|_, _| 2.0 * uniform(&mut state) - 1.0);
            let turn = UnitQuaternion::from_scaled_axis(axis * PI);
            q[joint.q.clone()].copy_from_slice(turn.coords.as_slice());
        }
    }
}

/// A number in [0, 1): `SplitMix64` (Steele, Lea and Flood, 2014).
#[allow(clippy::cast_precision_loss)] // 53 bits
fn uniform(state: &mut u64) -> f64 {
    *state = state.wrapping_add(GOLDEN);
    (mixed(*state) >> 11) as f64 / (1u64 << 53) as f64
}

/// The output function of `SplitMix64`.
fn mixed(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn starts_share_no_numbers() {
        let scene = crate::scenes::chain(7).unwrap();
        let limits = Bounds::without(&scene);
        let mut all = Vec::new();
        for number in 0..80 {
            let mut q = vec![f64::NAN; 7];
            draw(&scene, &limits, &[0.0; 7], (0, number, false), &mut q);
            all.extend(q);
        }
        all.sort_by(f64::total_cmp);
        assert!(all.windows(2).all(|pair| pair[0] < pair[1]));
    }
}
