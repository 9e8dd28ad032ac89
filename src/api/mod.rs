//! The algorithms as methods of [`Scene`](crate::Scene). They check arguments, and their errors name the argument or
//! joint that caused them.

mod centroidal;
mod colliders;
mod constraints;
mod contacts;
mod declared;
#[cfg(feature = "derivatives")]
mod derivatives;
#[cfg(feature = "estimation")]
mod estimation;
mod kernels;
mod links;
#[cfg(feature = "derivatives")]
mod matrices;
pub mod methods;
pub mod operational;
#[cfg(feature = "derivatives")]
mod products;
mod quantities;
#[cfg(feature = "estimation")]
mod uncertainty;

pub use colliders::ColliderDistance;
pub use constraints::{Constrained, Projection};
pub use links::OnLink;
#[cfg(feature = "derivatives")]
pub use matrices::{DerivativeMatrices, RowMajor};
pub use methods::BodyWrenches;
pub use operational::TaskFrame;
