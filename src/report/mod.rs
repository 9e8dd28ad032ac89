//! What the library says about itself: residuals of the identities, error against run time, growth with size.

#[cfg(feature = "dense")]
pub mod accuracy;
pub mod growth;
#[cfg(feature = "dense")]
pub mod residuals;
