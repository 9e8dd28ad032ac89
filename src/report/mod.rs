//! What the library says about itself: residuals of the identities, error against run time, growth with size,
//! operations.

#[cfg(feature = "dense")]
pub mod accuracy;
#[cfg(all(feature = "dense", feature = "stochastic"))]
pub mod emergence;
pub mod growth;
pub mod operations;
#[cfg(feature = "dense")]
pub mod residuals;
pub mod sensitivity;
#[cfg(feature = "dense")]
pub mod stability;
