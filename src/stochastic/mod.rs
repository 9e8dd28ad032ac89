//! The random model (1.1 to 1.6), and the estimation of M from its samples (5.1).
//!
//! Random forces w(k) with mean b(k) and covariance M(k) act on the bodies and are independent between bodies. The
//! resulting joint torques T = H phi W have the mass matrix as covariance. M can therefore be *measured* by sampling W,
//! without deriving equations of motion. [`RandomModel`] draws samples. [`Method`] selects the estimator:
//! [`Method::MonteCarlo`] (error proportional to n^-1/2, with a confidence interval for every entry), [`Method::Sobol`]
//! (scrambled points, error about n^-1), or [`Method::SigmaPoints`] (12 points per body, exact).
//!
//! Random streams are counter-based: sample i does not depend on the number of threads or on the other samples.
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
