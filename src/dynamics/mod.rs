//! Robot dynamics, by binding the physics of rigid bodies to the filter.
//!
//! Each file is one problem; the functions take a [`Model`](crate::scene::Model) in any scalar, slices for one state and a
//! [`Workspace`](crate::Workspace), check nothing and allocate nothing. [`Scene`](crate::Scene) wraps them with checks and names.

pub(crate) mod auto;
pub(crate) mod centroidal;
mod checked;
mod columns;
pub mod derivatives;
pub(crate) mod energy;
pub(crate) mod estimate;
pub(crate) mod forces;
pub(crate) mod forward;
mod forward_root;
pub(crate) mod inverse;
pub(crate) mod mass_inverse;
pub(crate) mod mass_matrix;
pub(crate) mod operational;
pub(crate) mod refined;
pub(crate) mod sweeps;
mod widened;

#[cfg(feature = "stochastic")]
pub(crate) use inverse::bias_forces_base_to_tip;

#[doc(hidden)]
pub use auto::{Choice, forward_dynamics_auto};
pub use energy::{Energy, energy, kinetic_energy, momentum};
pub use estimate::{Estimate, EstimateCovariance, EstimateScratch, Measurements, estimate, estimate_covariance};
pub use forward::{factorise, forward_dynamics, solve};
pub use inverse::{bias_torque, inverse_dynamics, mul_mass};
pub use mass_inverse::{InverseScratch, mass_matrix_inverse};
pub use mass_matrix::{log_det_mass_matrix, mass_matrix};
pub use operational::{OperationalScratch, operational_inverse_inertia};
#[doc(hidden)]
pub use refined::{Judged, forward_dynamics_judged};
