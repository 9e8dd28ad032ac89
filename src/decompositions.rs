//! Iterative matrix decompositions that end: matrices with a NaN or an infinity, on which those of nalgebra iterate
//! without end or panic, have none. clippy.toml disallows the methods of nalgebra elsewhere.

#![expect(clippy::disallowed_methods, reason = "the only place that calls them, with checked matrices")]

use nalgebra::allocator::Allocator;
use nalgebra::{Const, DMatrix, DefaultAllocator, Dim, DimDiff, DimSub, Dyn, OMatrix, SVD, SymmetricEigen};

/// Sweeps per singular value or eigenvalue. About three are usual.
const SWEEPS: usize = 100;

/// The singular values in descending order, with the singular vectors that are requested. None if the matrix is empty
/// or not finite.
pub(crate) fn singular_values(matrix: DMatrix<f64>, left: bool, right: bool) -> Option<SVD<f64, Dyn, Dyn>> {
    if matrix.is_empty() || !is_finite(matrix.as_slice()) {
        return None;
    }
    let most = SWEEPS * matrix.nrows().min(matrix.ncols());
    let is_whole = |found: &SVD<f64, Dyn, Dyn>| {
        let vectors = found.u.iter().chain(&found.v_t);
        is_finite(found.singular_values.as_slice()) && vectors.into_iter().all(|of| is_finite(of.as_slice()))
    };
    matrix.try_svd(left, right, 5.0 * f64::EPSILON, most).filter(is_whole)
}

/// The eigenvalues of a symmetric matrix, in no order, with the eigenvectors. None if the matrix is empty or not
/// finite.
pub(crate) fn eigenvalues<D>(matrix: OMatrix<f64, D, D>) -> Option<SymmetricEigen<f64, D>>
where
    D: Dim + DimSub<Const<1>>,
    DefaultAllocator: Allocator<D, D> + Allocator<D> + Allocator<DimDiff<D, Const<1>>>,
{
    if matrix.is_empty() || !matrix.is_square() || !matrix.iter().all(|entry| entry.is_finite()) {
        return None;
    }
    let most = SWEEPS * matrix.nrows();
    matrix.try_symmetric_eigen(f64::EPSILON, most).filter(|found| found.eigenvalues.iter().all(|x| x.is_finite()))
}

/// An orthonormal basis Q of the columns of a matrix, (rows x rank): Householder reflections with column pivoting, up
/// to the first pivot that is at most `lost`. None if the matrix is not finite.
pub(crate) fn column_basis(matrix: DMatrix<f64>, lost: f64) -> Option<DMatrix<f64>> {
    if !is_finite(matrix.as_slice()) {
        return None;
    }
    let factor = matrix.col_piv_qr();
    let triangle = factor.r();
    let most = triangle.nrows().min(triangle.ncols());
    let rank = (0..most).take_while(|&i| triangle[(i, i)].abs() > lost).count();
    Some(factor.q().columns(0, rank).into_owned())
}

fn is_finite(entries: &[f64]) -> bool {
    entries.iter().all(|entry| entry.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    /// A matrix of a rank, with entries of either sign.
    fn product(rows: usize, columns: usize, rank: usize) -> DMatrix<f64> {
        let wave = |i: usize, j: usize| f64::from(u16::try_from((1 + i) * (1 + i + 3 * j)).expect("small")).sin();
        DMatrix::from_fn(rows, rank, wave) * DMatrix::from_fn(rank, columns, |i, j| wave(j, i + 1))
    }

    #[test]
    fn matrices_that_are_not_finite_have_no_decomposition() {
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for at in 0..9 {
                let mut square = Matrix3::from_diagonal_element(1.0);
                square[at] = wrong;
                assert!(eigenvalues(square).is_none());
                let square = DMatrix::from_column_slice(3, 3, square.as_slice());
                assert!(eigenvalues(square.clone()).is_none());
                assert!(singular_values(square.clone(), true, true).is_none());
                assert!(column_basis(square, 1e-9).is_none());
            }
        }
    }

    #[test]
    fn the_rank_of_wide_tall_and_empty_matrices() {
        for (rows, columns, rank) in [(3, 8, 2), (3, 8, 3), (8, 3, 2), (5, 5, 4), (1, 6, 1), (4, 4, 0)] {
            let matrix = product(rows, columns, rank);
            let basis = column_basis(matrix.clone(), 1e-9).expect("finite");
            assert_eq!(basis.shape(), (rows, rank));
            let outside = &matrix - &basis * basis.tr_mul(&matrix);
            assert!(outside.norm() <= 1e-12 * (1.0 + matrix.norm()));
            let values = singular_values(matrix, false, false).expect("finite").singular_values;
            assert_eq!(values.iter().filter(|&&value| value > 1e-9).count(), rank);
        }
        for (rows, columns) in [(0, 0), (3, 0), (0, 3)] {
            let empty = DMatrix::zeros(rows, columns);
            assert!(singular_values(empty.clone(), true, true).is_none());
            assert!(column_basis(empty, 1e-9).is_some_and(|basis| basis.ncols() == 0));
        }
    }

    #[test]
    fn the_largest_and_the_smallest_numbers_are_decomposed() {
        for size in [f64::MAX / 4.0, f64::MIN_POSITIVE] {
            let matrix = DMatrix::from_row_slice(2, 2, &[2.0 * size, size, size, 2.0 * size]);
            let values = singular_values(matrix.clone(), true, true).expect("finite").singular_values / size;
            assert!((values[0] - 3.0).abs() <= 1e-12 && (values[1] - 1.0).abs() <= 1e-12, "{values}");
            let mut values = (eigenvalues(matrix).expect("finite").eigenvalues / size).as_slice().to_vec();
            values.sort_by(f64::total_cmp);
            assert!((values[0] - 1.0).abs() <= 1e-12 && (values[1] - 3.0).abs() <= 1e-12, "{values:?}");
        }
    }
}
