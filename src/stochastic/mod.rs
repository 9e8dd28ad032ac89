//! The spatially random model itself (1.1 to 1.6), and M as what emerges from it (5.1).
//!
//! Forces w(k) with mean b(k) and covariance M(k) act on the bodies, white from body to body; the joint torques they cause,
//! T = H phi W, have the mass matrix as covariance. Nobody derived equations of motion for that: it can be *measured*, by
//! drawing W. [`RandomModel`] draws; [`Method`] is how: [`Method::MonteCarlo`] (error falls as n^-1/2, with a confidence
//! interval for every entry), [`Method::Sobol`] (scrambled points, about n^-1), [`Method::SigmaPoints`] (12 points a body, exact).
//!
//! Random streams are counter-based: sample i is the same for any number of threads and any number of samples around it.
//!
//! ```
//! use phipsi::stochastic::Method;
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(4)?;
//! let model = scene.random_model(&[0.3; 4], None, 1.0)?;
//! let sampled = model.mass_matrix(Method::SigmaPoints)?; // exact, from 12 points a body
//! let mut m = [f64::NAN; 16];
//! scene.mass_matrix(&mut scene.workspace(), &[0.3; 4], &mut m)?;
//! assert!(sampled.mass_matrix.iter().zip(&m).all(|(found, m)| (found - m).abs() <= 1e-13));
//! # Ok(())
//! # }
//! ```

mod estimate;
mod interval;
mod model;
mod points;
mod sigma_points;
mod sobol;

pub use estimate::{MassEstimate, Method, Spread};
pub use interval::Quantiles;
pub use model::{RandomModel, Samples};
pub use points::Points;
pub use sobol::DIMENSIONS as SOBOL_DIMENSIONS;
