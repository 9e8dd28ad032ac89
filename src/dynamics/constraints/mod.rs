//! Closed loops: accelerations, forces, velocities and positions that meet the connections of a scene.
//!
//! A connection is a set of scalar rows of a Jacobian J. J qdd = -gamma is a noise-free measurement of the
//! accelerations. With the factor of the tree (gains g, pivots D),
//!
//! ```text
//! M qdd + bias = tau + J* lambda,   J qdd + gamma = 0,   gamma = J' qd
//! W = D^-1/2 (1 - L) J*             innovations of a unit force along each row, propagated inward to the base
//! G = W* W = J M^-1 J*              without subtraction
//! lambda = -G^+ (J qdd0 + gamma)    qdd0: the accelerations of the tree
//! ```
//!
//! The cost is O(N + m^2 depth + m^3) for m rows. Dependent rows are allowed: G^+ omits the eigenvalues of G that are
//! rounding errors, and gives the rank. The accelerations are then unique, and the forces are those with the smallest
//! sum of `G_ii` `lambda_i`^2. A residual that no force can remove and that exceeds rounding is reported as
//! [`Outcome::contradicted`].
//!
//! In a model with rounded dimensions, rows that should be dependent differ in the last digits. Geometry and the
//! tolerance of the scene decide which combinations count as dependent; Q J then replaces J.

#[cfg(feature = "derivatives")]
mod adjoint;
#[cfg(feature = "derivatives")]
mod derivatives;
mod elimination;
mod faults;
mod geometry;
mod gram;
mod gram_inverse;
#[cfg(feature = "derivatives")]
mod hessian;
mod inverse;
mod kernel;
#[cfg(feature = "derivatives")]
mod loops;
mod mobility;
#[cfg(feature = "derivatives")]
mod products;
mod projection;
#[cfg(feature = "derivatives")]
mod row_matrices;
mod rows;
mod scratch;
mod solution;

#[cfg(feature = "motion")]
pub(crate) use crate::scalar::largest_of;
#[cfg(feature = "derivatives")]
pub(crate) use adjoint::ConstraintAdjoint;
#[cfg(feature = "motion")]
pub(crate) use adjoint::{Pushed, Results, RowProducts, SolutionGradients, subtract_products};
#[cfg(feature = "derivatives")]
pub(crate) use derivatives::constrained_derivatives;
pub(crate) use elimination::Elimination;
#[cfg(feature = "derivatives")]
pub(crate) use hessian::constrained_hvp;
pub(crate) use inverse::{constrained_inverse_dynamics, constrained_mass_matrix_inverse};
pub(crate) use kernel::{ConstraintKernel, Residuals};
pub(crate) use mobility::jacobian_of_rows;
#[cfg(feature = "motion")]
pub(crate) use products::RowGradients;
pub(crate) use projection::{
    CLOSED, FARTHEST, Projected, ProjectionStep, ROUNDED, extent, project_positions, project_velocities,
    project_with_factors,
};
#[cfg(feature = "derivatives")]
pub(crate) use row_matrices::{RowMatrices, RowSolutions};
pub(crate) use rows::errors_of_rows;
#[cfg(test)]
pub(super) use rows::tests::robot;
pub use scratch::ConstraintScratch;
pub(crate) use solution::{Outcome, constrained_dynamics};

/// Rows of connections that do not exist at a state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum RowFault {
    /// A rod whose two ends coincide and therefore define no direction: the index of its connection.
    NoDirection(usize),
    /// A row with an entry that is not finite, because numbers overflow: the row and the entry.
    NotFinite(usize, f64),
}
