//! Robot dynamics, by binding the physics of rigid bodies to the filter.
//!
//! Each file is one problem; the functions take a [`Model`](crate::scene::Model) in any scalar, slices for one state and a
//! [`Workspace`](crate::Workspace), check nothing and allocate nothing. [`Scene`](crate::Scene) wraps them with checks and names.

pub mod auto;
pub mod centroidal;
mod checked;
mod columns;
pub mod derivatives;
pub mod energy;
pub mod estimate;
pub(crate) mod forces;
pub mod forward;
mod forward_root;
pub mod inverse;
pub mod mass_inverse;
pub mod mass_matrix;
pub mod operational;
pub mod refined;
pub(crate) mod sweeps;
mod widened;

#[cfg(feature = "stochastic")]
pub(crate) use inverse::bias_forces_base_to_tip;

pub use crate::accuracy::{Accuracy, ESTIMATE_SPREAD};
pub use auto::{Choice, forward_dynamics_auto};
pub use energy::{Energy, energy, kinetic_energy, momentum};
pub use estimate::{Estimate, EstimateCovariance, EstimateScratch, Measurements, estimate, estimate_covariance};
pub use forward::{factorise, forward_dynamics, solve};
pub use inverse::{bias_torque, inverse_dynamics, mul_mass};
pub use mass_inverse::mass_matrix_inverse;
pub use mass_matrix::{log_det_mass_matrix, mass_matrix};
pub use operational::operational_inverse_inertia;
pub use refined::{Judged, forward_dynamics_judged};
