//! The algorithms as methods of [`Scene`](crate::Scene). They check arguments, and their errors name the argument or
//! joint that caused them.

mod centroidal;
mod constraints;
mod contacts;
mod derivatives;
mod estimation;
mod kernels;
mod links;
mod matrices;
pub mod methods;
pub mod operational;
mod products;
mod quantities;
mod uncertainty;

pub use constraints::{Constrained, Projection};
pub use links::OnLink;
pub use matrices::{DerivativeMatrices, RowMajor};
pub use methods::BodyWrenches;
pub use operational::TaskFrame;
