//! Decomposition of the constant rotation of a joint about z.

use super::axes::Axis;
use super::constant_rotation::ConstantRotation;
use nalgebra::{Matrix3, Vector3};

/// Tolerance for entries of a rotation. pi/2 has no exact f64, so that its cosine is 6e-17 or 1.2e-16 instead of zero;
/// a constant rotation is a product of a few rotations, each with rounding errors.
const ROUNDING: f64 = 4.0 * f64::EPSILON;

/// A decomposed rotation that maps z to an axis of the parent frame, or to an oblique axis.
pub(crate) struct AboutAxis {
    pub axis: Axis,
    /// For an oblique axis, the rotation from `axis` to the parent frame.
    pub tilt: Option<ConstantRotation<f64>>,
    /// Rotation from the original frame to that of the [joint rotation](super::AxialRotation), with entries 0 and 1.
    pub frame: Matrix3<f64>,
    /// Sine and cosine of the constant angle about the axis, if it is not a multiple of pi/2.
    pub offset: Option<[f64; 2]>,
}

impl AboutAxis {
    /// Decomposes a rotation, to rounding; `None` if it does not map z to an axis of the parent.
    pub fn of(rotation: &Matrix3<f64>) -> Option<Self> {
        let axis = Axis::new(rotation.column(2).iamax());
        let (frame, offset) = about_z(&(axis.rotation().transpose() * rotation), ROUNDING)?;
        Some(Self { axis, tilt: None, frame, offset })
    }

    /// Decomposes any rotation: first the rotation about the joint axis, then about x, and, if the axis is not in a
    /// plane of two parent axes, about z.
    pub fn tilted(rotation: &Matrix3<f64>) -> Option<Self> {
        let z: Vector3<f64> = rotation.column(2).into();
        let in_plane = (z.iamin() + 2) % 3;
        // Two angles suffice for any direction, starting from z.
        [(in_plane, true), (2, false)].into_iter().find_map(|(axis, is_in_plane)| {
            let axis = Axis::new(axis);
            let tilt = ConstantRotation::to(&z, axis, is_in_plane);
            let untilted = tilt.matrix().transpose() * rotation;
            // A product of three rotations, with correspondingly larger rounding errors.
            let (frame, offset) = about_z(&untilted, 2.0 * ROUNDING)?;
            Some(Self { axis, tilt: Some(tilt), frame, offset })
        })
    }

    /// Decomposes the rotation of a prismatic joint along z, whose sign matters: if z maps to a negative axis, a
    /// rotation by pi is added. Other directions are decomposed if `tilted`.
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

/// Axis permutation and angle of a rotation about z or -z.
fn about_z(rotation: &Matrix3<f64>, tolerance: f64) -> Option<(Matrix3<f64>, Option<[f64; 2]>)> {
    let is_near = |other: &Matrix3<f64>| (rotation - other).iter().all(|x| x.abs() <= tolerance);
    // Adding 0.0 removes negative zeros.
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

/// True if a rotation maps z to an axis or a negative axis, to rounding.
pub(crate) fn rotates_about_a_parent_axis(rotation: &Matrix3<f64>) -> bool {
    AboutAxis::of(rotation).is_some()
}

/// True if a rotation maps z to an oblique axis that can be decomposed.
pub(crate) fn rotates_about_an_oblique_axis(rotation: &Matrix3<f64>) -> bool {
    !rotates_about_a_parent_axis(rotation) && AboutAxis::tilted(rotation).is_some()
}
