//! Closed loops: accelerations, forces, velocities and positions that meet the connections of a scene.
//!
//! A connection is some scalar rows of a Jacobian J, and J qdd = -gamma is a measurement of the accelerations without noise. With the factor of the
//! tree at hand (gains g, pivots D),
//!
//! ```text
//! M qdd + bias = tau + J* lambda,   J qdd + gamma = 0,   gamma = J' qd
//! W = D^-1/2 (1 - L) J*             a unit force along each row runs inward to the base, collecting innovations
//! G = W* W = J M^-1 J*              never a difference
//! lambda = -G^+ (J qdd0 + gamma)    qdd0: the tree's accelerations
//! ```
//!
//! O(N + m^2 depth + m^3) for m rows. Rows that depend on each other are no fault: G^+ leaves out what of G is lost in rounding, and tells the rank.
//! The accelerations are unique then, the forces those of least sum `G_ii` `lambda_i`^2. What no force can take away is no rounding, and is reported
//! as [`Outcome::contradicted`].
//!
//! A linkage that is drawn with few digits has rows that depend on each other but for the last digit. Which combinations count as dependent is judged by geometry, against the tolerance of
//! the scene; Q J is then in the place of J.

mod derivatives;
mod faults;
mod geometry;
mod gram;
mod gram_inverse;
mod inverse;
mod kernel;
mod mobility;
mod projection;
mod relaxed;
mod rows;
mod scratch;
mod sized_rows;
mod solution;
mod unit_row;

pub(crate) use derivatives::constrained_derivatives;
pub(crate) use inverse::{constrained_inverse_dynamics, constrained_mass_matrix_inverse};
pub(crate) use kernel::ConstraintKernel;
pub(crate) use projection::{project_positions, project_velocities};
pub(crate) use rows::{accelerations_of_rows, errors_of_rows, jacobian_of_rows};
pub use scratch::ConstraintScratch;
pub(crate) use solution::{Outcome, RowsAre, constrained_dynamics};

/// A rod whose two ends coincide, so that it has no direction: the index of its connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct NoDirection(pub usize);
