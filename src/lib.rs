//! Articulated-body dynamics as estimation.
//!
//! G. Rodriguez (JPL, 1987) read robot arm dynamics as an estimation problem. Spatial forces z(k) are the states of a linear
//! system that runs along the bodies from tip to base,
//!
//! ```text
//! z^-(k) = sum over children c of phi(k,c) z^+(c) + w(k)        E w = b(k),  cov w = M(k)      (1.1, 1.3)
//! tau(k) = H(k) z^+(k)                                          joint torques: measurements    (1.4)
//! ```
//!
//! and the covariance of the measurements is the joint-space mass matrix, M = H phi Q phi* H* (5.1). A Kalman filter
//! factors it, M = (1 + K) D (1 + K*) (3.1), and filter plus Bryson-Frazier smoother give the joint accelerations in O(N):
//! M^-1 = (1 - L*) D^-1 (1 - L) (3.3).
//!
//! | section of the paper | here |
//! |---|---|
//! | 1, the spatially random model | [`filter::system`], [`scene`], [`kinematics`] (bias b), [`stochastic`] (samples) |
//! | 2, conditional means and their covariances | [`dynamics::estimate`](mod@dynamics::estimate), [`filter::smoothed`], [`dynamics::inverse`], [`operators`] |
//! | 3, Riccati recursion, K, L, D | [`filter::riccati`], [`operators::Factor`], [`dynamics::mass_matrix`](mod@dynamics::mass_matrix) (3.4, 3.5) |
//! | 4, filter and smoother | [`filter::innovations`], [`filter::smoother`], [`dynamics::forward`] |
//! | 5, covariance of the co-states | [`filter::covariance`], [`dynamics::operational`] |
//! | 6, closed form of M^-1 | [`dynamics::mass_inverse`] |
//!
//! Conventions: SI units, radians; spatial vectors are angular first; bodies, joints and arrays run from the base outward,
//! where the paper counts from the tip; recursions work in body frames with joint axes on z. Everything is generic over the
//! scalar ([`scalar::Real`]): f64, f32, and [`scalar::DoubleDouble`] of about 31 digits, against which errors are measured.
//!
//! ```
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(7)?;
//! let (q, qd, tau) = ([0.3; 7], [0.1; 7], [1.0; 7]);
//! let mut workspace = scene.workspace(); // with the compiled kernels, so that the calls below allocate nothing
//! let mut qdd = [f64::NAN; 7];
//! scene.forward_dynamics(&mut workspace, &q, &qd, &tau, &[], &mut qdd)?;
//! let mut back = [f64::NAN; 7];
//! scene.inverse_dynamics(&mut workspace, &q, &qd, &qdd, &[], &mut back)?;
//! assert!(back.iter().zip(&tau).all(|(b, t)| (b - t).abs() <= 1e-9));
//! # Ok(())
//! # }
//! ```
//!
//! Features, none needed by the recursions: `urdf` (scenes from files), `parallel` (batches on threads), `dense` (composite
//! matrices and faer's LDLT as the check), `stochastic` (the random model, sampled), `python` (the module that maturin builds).

mod accuracy;
mod algorithm;
mod api;
pub mod batch;
pub mod dynamics;
mod error;
pub mod filter;
mod joints;
pub mod kinematics;
mod memory;
mod model;
pub mod motion;
pub mod operators;
mod plan;
#[cfg(feature = "python")]
mod python;
pub mod report;
pub mod scalar;
pub mod scene;
pub mod scenes;
pub mod spatial;
#[cfg(feature = "stochastic")]
pub mod stochastic;
pub mod watch;
mod workspace;

pub use accuracy::{Accuracy, ESTIMATE_SPREAD};
pub use algorithm::{Algorithm, Arguments, Derivatives, Everyday, Products};
pub use api::{BodyWrenches, OnLink, TaskFrame};
pub use error::{Error, Shortage};
pub use filter::Form;
pub use plan::{Omission, Plan};
pub use scene::{Scene, SceneBuilder};
pub use workspace::{Tally, Workspace};

/// The README's Rust runs as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

/// So does that of the page on everyday functions.
#[cfg(doctest)]
#[doc = include_str!("../docs/everyday.md")]
struct EverydayPage;

/// And that of the page on the random model.
#[cfg(all(doctest, feature = "stochastic"))]
#[doc = include_str!("../docs/stochastic.md")]
struct RandomModelPage;
