//! The algorithms as methods of a [`Scene`](crate::Scene): arguments are checked, faults named.

mod centroidal;
mod constraints;
mod contacts;
mod derivatives;
mod estimation;
mod links;
pub mod methods;
pub mod operational;
mod own;
mod products;
mod quantities;

pub use constraints::{Constrained, Projection};
pub use links::OnLink;
pub use methods::BodyWrenches;
pub use operational::TaskFrame;
