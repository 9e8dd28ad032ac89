//! Self-tests of the library: residuals of the identities, and error against run time (feature `dense`).
//!
//! ```
//! # #[cfg(feature = "dense")]
//! # fn main() -> Result<(), phipsi::Error> {
//! use phipsi::report::residuals::residuals;
//!
//! let scene = phipsi::scenes::chain(4)?;
//! for residual in residuals(&scene, &[0.3; 4], &[0.1; 4], &[1.0; 4])? {
//!     println!("{}: {:.1e}", residual.name, residual.value);
//! }
//! # Ok(())
//! # }
//! # #[cfg(not(feature = "dense"))]
//! # fn main() {}
//! ```

#[cfg(feature = "dense")]
pub mod accuracy;
#[cfg(all(feature = "dense", feature = "stochastic"))]
#[doc(hidden)]
pub mod emergence;
#[cfg(feature = "dense")]
#[doc(hidden)]
pub mod growth;
#[doc(hidden)]
pub mod operations;
#[cfg(feature = "dense")]
pub mod residuals;
#[cfg(feature = "dense")]
#[doc(hidden)]
pub mod sensitivity;
#[cfg(feature = "dense")]
#[doc(hidden)]
pub mod stability;
