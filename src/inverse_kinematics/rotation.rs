//! Rotation matrices of targets, and derivatives of rotation vectors.

use crate::error::number;
use nalgebra::{Matrix3, Vector3};

/// Largest accepted deviation of the entries of a rotation from those of the nearest rotation, and of quaternions from
/// unit norm: three decimals suffice.
const ROTATION: f64 = 1e-3;
/// Rotations this close to orthonormal, by R^T R, are used unchanged.
const ORTHONORMAL: f64 = 1e-14;

/// The rotation nearest to a matrix, if no entry differs by more than [`ROTATION`]; else a description of the
/// deviation.
pub fn nearest_rotation(matrix: &Matrix3<f64>) -> Result<Matrix3<f64>, String> {
    let apart = |matrix: &Matrix3<f64>| (matrix.transpose() * matrix - Matrix3::identity()).abs().max();
    let before = apart(matrix);
    if before <= ORTHONORMAL && matrix.determinant() > 0.0 {
        return Ok(*matrix);
    }
    if !(before <= 10.0 * ROTATION) {
        return Err(format!("a matrix with R^T R - 1 up to {}", number(before)));
    }
    if matrix.determinant() < 0.0 {
        return Err("a reflection, of determinant -1".to_owned());
    }
    // Newton's iteration for the polar factor, which squares the deviation in each step.
    let mut rotation = *matrix;
    for _ in 0..4 {
        rotation = rotation * (Matrix3::identity() * 3.0 - rotation.transpose() * rotation) * 0.5;
    }
    let moved = (rotation - matrix).abs().max();
    if moved <= ROTATION {
        Ok(rotation)
    } else {
        Err(format!("a matrix that is {} from the nearest rotation", number(moved)))
    }
}

/// Inverse right Jacobian Jr^-1(t) = 1 + t~/2 + (1 - |t|/2 cot(|t|/2)) / |t|^2 t~^2: the derivative of a rotation
/// vector is Jr^-1 w.
pub fn inverse_right_jacobian(t: &Vector3<f64>) -> Matrix3<f64> {
    let square = t.norm_squared();
    let angle = square.sqrt();
    // The series, where the closed form cancels.
    let share = if angle < 1e-2 {
        1.0 / 12.0 + square / 720.0 + square * square / 30240.0
    } else {
        (1.0 - 0.5 * angle / (0.5 * angle).tan()) / square
    };
    let cross = t.cross_matrix();
    Matrix3::identity() + cross * 0.5 + cross * cross * share
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_meets_the_formula() {
        for angle in [0.99e-2_f64, 1.01e-2] {
            let t = Vector3::new(0.6, 0.0, 0.8) * angle;
            // Jr Jr^-1 = 1, with Jr = 1 - (1 - cos)/a^2 t~ + (a - sin)/a^3 t~^2.
            let cross = t.cross_matrix();
            let right = Matrix3::identity() - cross * ((1.0 - angle.cos()) / angle.powi(2))
                + cross * cross * ((angle - angle.sin()) / angle.powi(3));
            assert!((right * inverse_right_jacobian(&t) - Matrix3::identity()).abs().max() < 1e-13);
        }
    }
}
