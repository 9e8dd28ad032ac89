//! The algorithms as methods of a [`Scene`](crate::Scene): arguments are checked, faults named.

mod derivatives;
mod estimation;
pub mod methods;
pub mod operational;
mod own;
mod products;

pub use methods::BodyWrenches;
pub use operational::TaskFrame;
