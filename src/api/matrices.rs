//! Named views of the matrices that the methods of derivatives write into one slice.

use crate::error::{Error, check_length};
use crate::scene::Scene;
use nalgebra::{Const, Dyn, MatrixView, U1};

/// A row-major matrix in a slice of results; entry (i, j) is `matrix[(i, j)]`.
pub type RowMajor<'a> = MatrixView<'a, f64, Dyn, Dyn, Dyn, U1>;

/// The three matrices (nv x nv) of [`Scene::forward_dynamics_derivatives`] and [`Scene::inverse_dynamics_derivatives`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct DerivativeMatrices<'a> {
    /// With respect to q, in its tangent space: dqdd/dq or dtau/dq.
    pub by_q: RowMajor<'a>,
    /// With respect to the joint velocities: dqdd/dqd or dtau/dqd.
    pub by_qd: RowMajor<'a>,
    /// With respect to the torques, M^-1, or the accelerations, M.
    pub by_u: RowMajor<'a>,
}

impl Scene {
    /// Views of the three matrices in the results of [`Scene::forward_dynamics_derivatives`] or
    /// [`Scene::inverse_dynamics_derivatives`] (3 x nv x nv), without copying.
    ///
    /// ```
    /// # fn main() -> Result<(), phipsi::Error> {
    /// let scene = phipsi::scenes::chain(3)?;
    /// let mut out = [f64::NAN; 27];
    /// let (q, qd, tau) = ([0.3; 3], [0.1; 3], [1.0; 3]);
    /// scene.forward_dynamics_derivatives(&mut scene.workspace(), &q, &qd, &tau, &[], &mut out)?;
    /// let derivatives = scene.derivative_matrices(&out)?;
    /// assert_eq!(derivatives.by_q[(1, 2)], out[3 + 2]);
    /// let inverse = derivatives.by_u; // M^-1
    /// assert!((inverse - inverse.transpose()).amax() <= 1e-12 * inverse.amax());
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    ///
    /// [`Error::Shape`] if `out` has not 3 nv^2 entries.
    pub fn derivative_matrices<'a>(&self, out: &'a [f64]) -> Result<DerivativeMatrices<'a>, Error> {
        let nv = self.nv();
        check_length("out", out.len(), 3 * nv * nv)?;
        let matrix = |k: usize| {
            let entries = &out[k * nv * nv..(k + 1) * nv * nv];
            RowMajor::from_slice_with_strides_generic(entries, Dyn(nv), Dyn(nv), Dyn(nv), Const::<1>)
        };
        Ok(DerivativeMatrices { by_q: matrix(0), by_qd: matrix(1), by_u: matrix(2) })
    }
}
