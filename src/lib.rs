//! Dynamics of robots and other articulated rigid bodies, in O(N), computed as estimation.
//!
//! A [`Scene`] is a robot: links, joints, gravity. It does not change and is shared between threads. Scratch is the caller's: a [`Workspace`] for calls on one state, an
//! [`Evaluator`](batch::Evaluator) for many states a call. What is wrong with an argument is an [`Error`] that names it, and nothing is repaired silently.
//!
//! SI units, radians; spatial vectors are angular first; bodies, joints and arrays run from the base outward. `q` has [`Scene::nq`] numbers a state; `qd`, `qdd` and `tau` have
//! [`Scene::nv`].
//!
//! # Read a robot
//!
//! From a URDF (feature `urdf`), or from code as in [`scene`]; [`scenes`] has some that ship.
//!
//! ```
//! # #[cfg(feature = "urdf")]
//! # fn main() -> Result<(), phipsi::Error> {
//! use phipsi::SceneBuilder;
//!
//! let scene = SceneBuilder::from_urdf(phipsi::scenes::BUNDLED_ARM)?.build()?; // or from_urdf_file(path)
//! for warning in scene.warnings() {
//!     eprintln!("{warning:?}"); // inertias that no body can have, mimic joints, what was not understood
//! }
//! let names: Vec<&str> = scene.joints().iter().map(|joint| joint.name.as_str()).collect();
//! assert_eq!((names.len(), scene.nv()), (6, 6));
//!
//! let flying = SceneBuilder::from_urdf(phipsi::scenes::BUNDLED_ARM)?.floating_base(true).build()?;
//! assert_eq!((flying.nq(), flying.nv()), (13, 12)); // a quaternion has four numbers
//! # Ok(())
//! # }
//! # #[cfg(not(feature = "urdf"))]
//! # fn main() {}
//! ```
//!
//! # Forward dynamics
//!
//! And what goes with it: inverse dynamics, the mass matrix and its inverse, bias and gravity torques, energy, and where links are and how they move ([`kinematics`]).
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
//!
//! let mut mass_matrix = [f64::NAN; 49]; // row by row
//! scene.mass_matrix(&mut workspace, &q, &mut mass_matrix)?;
//! let hand = scene.placement(&q, "link6")?;
//! assert!(mass_matrix[0] > 0.0 && hand.lever.norm() < 7.0 * 0.3);
//! # Ok(())
//! # }
//! ```
//!
//! The [`Form`] of the workspace says how covariances are carried. `Form::Auto`, the default, runs the fast one, estimates what rounding did to it, and does states that lost digits again
//! in square-root form, and with twice the digits where even that is in doubt.
//!
//! # Batches
//!
//! As many states at once as a register holds, with the bits that they have one by one ([`batch`]).
//!
//! ```
//! use phipsi::{Algorithm, Arguments};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(7)?;
//! let (q, qd, qdd) = ([0.3; 7], [0.1; 7], [1.0; 7]);
//! let states = [Arguments { q: &q, qd: &qd, u: &qdd, ..Arguments::default() }; 100];
//! let mut tau = [f64::NAN; 700];
//! let mut evaluator = scene.evaluator(); // one for each thread
//! scene.evaluate(&mut evaluator, Algorithm::InverseDynamics, &states, &mut tau).map_err(|fault| fault.error)?;
//! assert_eq!(tau[..7], tau[693..]);
//! # Ok(())
//! # }
//! ```
//!
//! # Derivatives
//!
//! Analytic: whole matrices, products with them in O(N) ([`Scene::forward_dynamics_jvp`], [`Scene::forward_dynamics_vjp`]), Hessians times a direction, and gradients by inertias,
//! armature and gravity ([`dynamics::derivatives`]). By `q` they are taken in its tangent space.
//!
//! ```
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(3)?;
//! let (q, qd, tau) = ([0.3; 3], [0.1; 3], [1.0; 3]);
//! let mut workspace = scene.workspace();
//! let mut out = [f64::NAN; 27];
//! scene.forward_dynamics_derivatives(&mut workspace, &q, &qd, &tau, &[], &mut out)?;
//! let (by_q, by_tau) = (&out[..9], &out[18..]); // dqdd/dq and M^-1
//!
//! // Along (dq, dqd, dtau) without any matrix.
//! let mut along = [f64::NAN; 3];
//! let direction: [&[f64]; 3] = [&[1.0, 0.0, 0.0], &[0.0; 3], &[0.0, 1.0, 0.0]];
//! scene.forward_dynamics_jvp(&mut workspace, &q, &qd, &tau, &[], direction, &mut along)?;
//! assert!((along[0] - (by_q[0] + by_tau[1])).abs() <= 1e-9 * by_tau[0]);
//! # Ok(())
//! # }
//! ```
//!
//! # Simulate
//!
//! Batches of states through many steps on all threads, or step by step, with springs, damping and PD gains that may be stiff ([`motion`]); gradients back through the steps.
//!
//! ```
//! use phipsi::motion::{Settings, Simulator, Torque};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(7)?;
//! let mut simulator = Simulator::new(&scene, Settings::new(&scene, 1e-3), &[0.3; 7], &[0.0; 7])?;
//! simulator.step(&Torque::Zero, 100).map_err(|fault| fault.error)?;
//! let (q, qd) = simulator.state(0);
//! assert!(q.iter().chain(qd).all(|x| x.is_finite()));
//! # Ok(())
//! # }
//! ```
//!
//! # Estimate
//!
//! Torque sensors with noise, some joints without any, and the mechanism as the prior: the most likely accelerations, torques and forces in every joint, with their variances.
//!
//! ```
//! use phipsi::dynamics::{Estimate, EstimateCovariance, Measurements};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(3)?;
//! let (torque, noise) = ([1.0, 0.5, f64::NAN], [0.01, 0.01, f64::INFINITY]); // the last joint has no sensor
//! let measurements =
//!     Measurements { torque: &torque, noise: &noise, prior_acceleration: None, acceleration_variance: 100.0 };
//! let (mut workspace, mut scratch) = (scene.workspace(), scene.estimate_scratch());
//! let (mut estimate, mut covariance) = (Estimate::new(scene.model()), EstimateCovariance::new(scene.model()));
//! let (q, qd) = ([0.3; 3], [0.1; 3]);
//! scene.estimate(&mut workspace, &mut scratch, &q, &qd, &measurements, &[], &mut estimate, Some(&mut covariance))?;
//! assert!((estimate.torque[0] - 1.0).abs() < 0.5 && covariance.torque[0] <= 0.01);
//! # Ok(())
//! # }
//! ```
//!
//! # Inverse kinematics
//!
//! Joint positions that bring links where they should be, within limits, from several starts, with their covariance ([`inverse_kinematics`]).
//!
//! # The paper's operators
//!
//! G. Rodriguez (JPL, 1987) read robot arm dynamics as an estimation problem. Spatial forces z(k) are the states of a linear system that runs along the bodies from tip to base,
//!
//! ```text
//! z^-(k) = sum over children c of phi(k,c) z^+(c) + w(k)        E w = b(k),  cov w = M(k)      (1.1, 1.3)
//! tau(k) = H(k) z^+(k)                                          joint torques: measurements    (1.4)
//! ```
//!
//! and the covariance of the measurements is the joint-space mass matrix, M = H phi Q phi* H* (5.1). A Kalman filter factors it, M = (1 + K) D (1 + K*) (3.1), and filter plus
//! Bryson-Frazier smoother give the joint accelerations in O(N): M^-1 = (1 - L*) D^-1 (1 - L) (3.3). Each of these is an object to apply and to look at ([`operators`]).
//!
//! ```
//! use phipsi::operators::{Kind, Operator};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(4)?;
//! let factor = scene.factor(&mut scene.workspace(), &[0.3; 4])?;
//! // (1 + K)(1 - L) = 1.
//! let (x, mut lx, mut y) = ([1.0, -2.0, 0.5, 3.0], [f64::NAN; 4], [f64::NAN; 4]);
//! factor.operator(Kind::L).apply(&x, &mut lx);
//! let rest: Vec<f64> = x.iter().zip(&lx).map(|(x, lx)| x - lx).collect();
//! factor.operator(Kind::K).apply(&rest, &mut y);
//! assert!(x.iter().zip(rest.iter().zip(&y)).all(|(x, (rest, y))| (rest + y - x).abs() <= 1e-12));
//! # Ok(())
//! # }
//! ```
//!
//! | section of the paper | here |
//! |---|---|
//! | 1, the spatially random model | [`filter::system`], [`scene`], [`Scene::bias_torque`] (bias b), `stochastic` (samples) |
//! | 2, conditional means and their covariances | [`Scene::estimate`], [`filter::smoothed`], [`dynamics::inverse_dynamics`], [`operators`] |
//! | 3, Riccati recursion, K, L, D | [`filter::riccati`], [`operators::Factor`], [`dynamics::mass_matrix`] (3.4, 3.5) |
//! | 4, filter and smoother | [`filter::innovations`], [`filter::smoother`], [`dynamics::forward_dynamics`] |
//! | 5, covariance of the co-states | [`filter::covariance`], [`Scene::operational_inverse_inertia`] |
//! | 6, closed form of M^-1 | [`dynamics::mass_matrix_inverse`] |
//!
//! The paper counts bodies from the tip; recursions work in body frames with joint axes on z. They are generic over the scalar ([`scalar::Real`]): f64, f32, dual numbers, and
//! [`scalar::DoubleDouble`] of about 31 digits, against which errors are measured.
//!
//! # Features
//!
//! The bare crate needs none of them.
//!
//! | feature | adds |
//! |---|---|
//! | `urdf` | scenes from URDF, and the bundled arm |
//! | `parallel` | batches on threads |
//! | `adaptive` | `motion::Adaptive`: steps to a tolerance, explicit and stiff, by diffsol |
//! | `dense` | composite matrices and faer's LDLT as the check, `report` |
//! | `stochastic` | the random model, sampled |
//! | `avx512` | kernels for processors with AVX-512; as many seconds to compile as all others together |
//! | `float32` | kernels for states in f32, twice as many in a register ([`Scene::evaluator_f32`]) |
//! | `python` | the Python module, which maturin builds; not for use from Rust |

mod accuracy;
mod algorithm;
mod api;
pub mod batch;
pub mod codegen;
mod contact;
pub mod dynamics;
mod error;
pub mod filter;
pub mod inverse_kinematics;
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

/// The table of functions: what each takes and gives, its cost, and what it is the derivative of.
pub mod function_table {
    pub use crate::algorithm::FUNCTIONS;
    pub use crate::algorithm::table::{Array, Axis, Compiled, FunctionEntry, Sizes, width};
}

pub use accuracy::{Accuracy, Bound, ESTIMATE_SPREAD};
pub use algorithm::{Algorithm, Arguments, Derivatives, KinematicQuantity, Products};
pub use api::{BodyWrenches, Constrained, OnLink, Projection, TaskFrame};
pub use error::{ConstraintFault, Error, Shortage};
pub use filter::Form;
pub use plan::{Omission, Plan};
pub use scene::{Scene, SceneBuilder};
pub use workspace::{Tally, Workspace};

/// The README's Rust runs as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

/// So does that of the page on kinematic quantities.
#[cfg(doctest)]
#[doc = include_str!("../docs/kinematic-quantities.md")]
struct KinematicQuantitiesPage;

/// And that of the page on the random model.
#[cfg(all(doctest, feature = "stochastic"))]
#[doc = include_str!("../docs/stochastic.md")]
struct RandomModelPage;
