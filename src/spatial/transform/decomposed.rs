//! What a rotation of the tree leaves of a joint that turns about z.

use super::axes::Axis;
use super::constant_rotation::ConstantRotation;
use nalgebra::{Matrix3, Vector3};

/// How far an entry of a rotation may be from what it is taken for. A right angle in radians has no double, and the nearest leaves 6e-17 or
/// 1.2e-16 where zero is meant; a rotation of the tree is a product of a few, each off by a unit of rounding.
const ROUNDING: f64 = 4.0 * f64::EPSILON;

/// A rotation that brings z to an axis of its parent's frame, or to one that is tilted from there.
pub(crate) struct AboutAxis {
    pub axis: Axis,
    /// From that axis, where it is tilted, to the parent's frame.
    pub tilt: Option<ConstantRotation<f64>>,
    /// From the frame that is turned to the one that the [turn](super::AxialRotation) is in: zeros and ones.
    pub frame: Matrix3<f64>,
    /// Sine and cosine of the turn's angle, where that is no renaming of axes.
    pub offset: Option<[f64; 2]>,
}

impl AboutAxis {
    /// What a rotation is, to rounding; none where it is no such.
    pub fn of(rotation: &Matrix3<f64>) -> Option<Self> {
        let axis = Axis::new(rotation.column(2).iamax());
        let (frame, offset) = about_z(&(axis.rotation().transpose() * rotation), ROUNDING)?;
        Some(Self { axis, tilt: None, frame, offset })
    }

    /// The same of a rotation that brings z anywhere: first the joint's own turn, then about x, and where its axis is in no plane of two of its parent's,
    /// about z.
    pub fn tilted(rotation: &Matrix3<f64>) -> Option<Self> {
        let z: Vector3<f64> = rotation.column(2).into();
        let in_plane = (z.iamin() + 2) % 3;
        // From z it is two angles to anywhere.
        [(in_plane, true), (2, false)].into_iter().find_map(|(axis, is_in_plane)| {
            let axis = Axis::new(axis);
            let tilt = ConstantRotation::to(&z, axis, is_in_plane);
            let untilted = tilt.matrix().transpose() * rotation;
            // Of three products, which round as often.
            let (frame, offset) = about_z(&untilted, 2.0 * ROUNDING)?;
            Some(Self { axis, tilt: Some(tilt), frame, offset })
        })
    }

    /// The same for a joint that slides along z, which has no other sense: where z points against an axis, it is tilted by half a turn. To any direction if it may be
    /// `tilted`.
    pub fn sliding(rotation: &Matrix3<f64>, tilted: bool) -> Option<Self> {
        let Some(about) = Self::of(rotation) else {
            return if tilted { Self::tilted(rotation) } else { None };
        };
        if about.frame[(2, 2)] > 0.0 {
            return Some(about);
        }
        let tilt = ConstantRotation::against(about.axis);
        let (frame, offset) = about_z(&(tilt.matrix().transpose() * rotation), ROUNDING)?;
        Some(Self { axis: about.axis, tilt: Some(tilt), frame, offset })
    }
}

/// Renaming and angle of a rotation about z, to the one side or the other.
fn about_z(rotation: &Matrix3<f64>, tolerance: f64) -> Option<(Matrix3<f64>, Option<[f64; 2]>)> {
    let is_near = |other: &Matrix3<f64>| (rotation - other).iter().all(|x| x.abs() <= tolerance);
    // No negative zeros.
    let renamed = rotation.map(|x| x.round() + 0.0);
    if is_near(&renamed) {
        return Some((renamed, None));
    }
    let sense = rotation[(2, 2)].signum();
    let frame = Matrix3::from_diagonal(&[1.0, sense, sense].into());
    let length = rotation[(0, 0)].hypot(rotation[(1, 0)]);
    let [s, c] = [rotation[(1, 0)] / length, rotation[(0, 0)] / length];
    let exactly = Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0) * frame;
    is_near(&exactly).then_some((frame, Some([s, c])))
}

/// Whether a rotation brings z to an axis, or against it, to rounding.
pub(crate) fn turns_about_an_axis(rotation: &Matrix3<f64>) -> bool {
    AboutAxis::of(rotation).is_some()
}

/// Whether it brings z to a tilted one.
pub(crate) fn turns_about_a_tilted_axis(rotation: &Matrix3<f64>) -> bool {
    !turns_about_an_axis(rotation) && AboutAxis::tilted(rotation).is_some()
}
