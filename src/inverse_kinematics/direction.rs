//! Deviation of an axis from a direction: the rotation vector of the shortest rotation between them, and its
//! derivatives.

use crate::decompositions::eigenvalues;
use nalgebra::{Matrix3, Vector3};

/// Vectors with a sine below this are parallel.
const PARALLEL: f64 = 1e-7;
/// Bound on the derivative perpendicular to the rotation, which diverges for opposite directions. The gradient remains
/// exact.
const STEEPEST: f64 = 10.0;

/// The rotation vector e from a unit target direction t to a unit axis a.
#[derive(Debug, Clone, Copy)]
pub struct DirectionError {
    /// e, perpendicular to both; its norm is the angle, rad.
    pub error: Vector3<f64>,
    /// Derivative of e by the angular displacement of the axis.
    pub by_rotation: Matrix3<f64>,
    /// Derivative of e by a displacement of the target.
    pub by_target: Matrix3<f64>,
}

/// e = angle * n with n = t x a / |t x a|. For opposite directions n is undefined; the direction about which `motions`
/// (angular velocities of the axis) rotate most is used.
pub fn direction_error(
    axis: &Vector3<f64>,
    target: &Vector3<f64>,
    motions: impl Iterator<Item = Vector3<f64>>,
) -> DirectionError {
    let across = target.cross(axis);
    let (sine, cosine) = (across.norm(), target.dot(axis));
    if sine < PARALLEL && cosine > 0.0 {
        let by_rotation = Matrix3::identity() - axis * axis.transpose();
        return DirectionError { error: across, by_rotation, by_target: -axis.cross_matrix() };
    }
    let n = if sine < PARALLEL { most_moved(axis, motions) } else { across / sine };
    let angle = sine.atan2(cosine);
    let steep = if angle < STEEPEST * sine { angle / sine } else { STEEPEST };
    let by_rotation = n * n.transpose() + target.cross(&n) * axis.cross(&n).transpose() * steep;
    let by_target = n.cross(axis) * n.transpose() * steep - n * n.cross(target).transpose();
    DirectionError { error: n * angle, by_rotation, by_target }
}

/// The direction perpendicular to an axis about which the angular velocities are largest; arbitrary if there are none.
fn most_moved(axis: &Vector3<f64>, motions: impl Iterator<Item = Vector3<f64>>) -> Vector3<f64> {
    let across = Matrix3::identity() - axis * axis.transpose();
    // A tiny isotropic term, for joints that do not rotate the axis.
    let mut sum = across * f64::MIN_POSITIVE;
    for motion in motions {
        let motion = across * motion;
        sum += motion * motion.transpose();
    }
    let largest = eigenvalues(sum).map(|eigen| eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned());
    let found = across * largest.unwrap_or_default();
    let length = found.norm();
    if length > 0.5 { found / length } else { axis.cross(&Vector3::ith(axis.iamin(), 1.0)).normalize() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn the_error_is_the_angle_and_opposite_directions_have_one() {
        let (x, z) = (Vector3::x(), Vector3::z());
        for angle in [0.0, 1e-9, 1e-3, 1.0, 3.0, PI - 1e-9, PI] {
            let axis = z * f64::cos(angle) + x * f64::sin(angle);
            let found = direction_error(&axis, &z, [Vector3::y()].into_iter());
            assert!((found.error.norm() - angle).abs() < 1e-9, "{angle}: {}", found.error);
            assert!(found.error.dot(&axis).abs() < 1e-6 && found.by_rotation.iter().all(|entry| entry.is_finite()));
            // Rotation about y changes the angle by the same amount.
            if angle > 0.0 {
                let slope = found.error.dot(&(found.by_rotation * Vector3::y()));
                assert!((slope.abs() - angle).abs() < 1e-6, "{angle}: {slope}");
            }
        }
    }
}
