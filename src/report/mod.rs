//! What the library says about itself: residuals of the identities, error against run time, growth with size,
//! operations.

#[cfg(feature = "dense")]
pub mod accuracy;
#[cfg(all(feature = "dense", feature = "stochastic"))]
#[doc(hidden)]
pub mod emergence;
#[doc(hidden)]
pub mod growth;
#[doc(hidden)]
pub mod operations;
#[cfg(feature = "dense")]
pub mod residuals;
#[doc(hidden)]
pub mod sensitivity;
#[cfg(feature = "dense")]
#[doc(hidden)]
pub mod stability;
