//! O(N) dynamics of robots and other articulated rigid bodies, computed as an estimation problem.
//!
//! A [`Scene`] describes a robot: links, joints, gravity. It is immutable and can be shared between threads. The caller
//! owns the scratch memory: a [`Workspace`] for calls on one state, an [`Evaluator`](batch::Evaluator) for calls on
//! many states. An invalid argument returns an [`Error`] that names it; nothing is repaired silently.
//!
//! Units are SI and radians. Spatial vectors are angular first. Bodies, joints and arrays are ordered from the base
//! outward. A configuration `q` has [`Scene::nq`] entries; `qd`, `qdd` and `tau` have [`Scene::nv`].
//!
//! # Read a robot
//!
//! Read a URDF file (feature `urdf`), or build a scene in code as in [`scene`]. [`scenes`] contains example robots.
//!
//! ```
//! # #[cfg(feature = "urdf")]
//! # fn main() -> Result<(), phipsi::Error> {
//! use phipsi::SceneBuilder;
//!
//! let scene = SceneBuilder::from_urdf(phipsi::scenes::BUNDLED_ARM)?.build()?; // or from_urdf_file(path)
//! for warning in scene.warnings() {
//!     eprintln!("{warning:?}"); // nonphysical inertias, mimic joints, elements that were ignored
//! }
//! let names: Vec<&str> = scene.joints().iter().map(|joint| joint.name.as_str()).collect();
//! assert_eq!((names.len(), scene.nv()), (6, 6));
//!
//! let flying = SceneBuilder::from_urdf(phipsi::scenes::BUNDLED_ARM)?.floating_base(true).build()?;
//! assert_eq!((flying.nq(), flying.nv()), (13, 12)); // a quaternion has four coordinates
//! # Ok(())
//! # }
//! # #[cfg(not(feature = "urdf"))]
//! # fn main() {}
//! ```
//!
//! # Forward dynamics
//!
//! This example also uses inverse dynamics, the mass matrix and forward kinematics. Other methods compute the inverse
//! mass matrix, bias and gravity torques, energy, and link velocities and Jacobians ([`kinematics`]).
//!
//! ```
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(7)?;
//! let (q, qd, tau) = ([0.3; 7], [0.1; 7], [1.0; 7]);
//! let mut workspace = scene.workspace(); // includes compiled kernels; the calls below do not allocate
//! let mut qdd = [f64::NAN; 7];
//! scene.forward_dynamics(&mut workspace, &q, &qd, &tau, &[], &mut qdd)?;
//! let mut back = [f64::NAN; 7];
//! scene.inverse_dynamics(&mut workspace, &q, &qd, &qdd, &[], &mut back)?;
//! assert!(back.iter().zip(&tau).all(|(b, t)| (b - t).abs() <= 1e-9));
//!
//! let mut mass_matrix = [f64::NAN; 49]; // row-major
//! scene.mass_matrix(&mut workspace, &q, &mut mass_matrix)?;
//! let hand = scene.placement(&q, "link6")?;
//! assert!(mass_matrix[0] > 0.0 && hand.lever.norm() < 7.0 * 0.3);
//! # Ok(())
//! # }
//! ```
//!
//! The [`Form`] of the workspace selects the factorization. `Form::Auto`, the default, runs the covariance form and
//! estimates its rounding error. A state whose estimate exceeds the tolerance is recomputed in square-root form, and in
//! double-double arithmetic if that estimate also exceeds it.
//!
//! # Batches
//!
//! Batches are vectorized (SIMD) over states with the feature `lanes`. Results are bit-identical to those of single
//! states ([`batch`]).
//!
//! ```
//! use phipsi::{Algorithm, Arguments};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(7)?;
//! let (q, qd, qdd) = ([0.3; 7], [0.1; 7], [1.0; 7]);
//! let states = [Arguments { q: &q, qd: &qd, u: &qdd, ..Arguments::default() }; 100];
//! let mut tau = [f64::NAN; 700];
//! let mut evaluator = scene.evaluator(); // one for each thread
//! scene.evaluate(&mut evaluator, Algorithm::InverseDynamics, &states, &mut tau)?;
//! assert_eq!(tau[..7], tau[693..]);
//! # Ok(())
//! # }
//! ```
//!
//! # Derivatives
//!
//! Derivatives are analytic: matrices, products with them in O(N) ([`Scene::forward_dynamics_jvp`],
//! [`Scene::forward_dynamics_vjp`]), Hessian-vector products, and gradients by inertias, armature and gravity
//! ([`dynamics::derivatives`]). Derivatives by `q` are in its tangent space.
//!
//! ```
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(3)?;
//! let (q, qd, tau) = ([0.3; 3], [0.1; 3], [1.0; 3]);
//! let mut workspace = scene.workspace();
//! let mut out = [f64::NAN; 27];
//! scene.forward_dynamics_derivatives(&mut workspace, &q, &qd, &tau, &[], &mut out)?;
//! let matrices = scene.derivative_matrices(&out)?; // views: dqdd/dq, dqdd/dqd and M^-1
//!
//! // Directional derivative along (dq, dqd, dtau), without forming a matrix.
//! let mut along = [f64::NAN; 3];
//! let direction: [&[f64]; 3] = [&[1.0, 0.0, 0.0], &[0.0; 3], &[0.0, 1.0, 0.0]];
//! scene.forward_dynamics_jvp(&mut workspace, &q, &qd, &tau, &[], direction, &mut along)?;
//! let expected = matrices.by_q[(0, 0)] + matrices.by_u[(0, 1)];
//! assert!((along[0] - expected).abs() <= 1e-9 * matrices.by_u[(0, 0)]);
//! # Ok(())
//! # }
//! ```
//!
//! # Simulate
//!
//! Integrate batches of states on all threads, or step by step, with stiff springs, damping and PD control, and compute
//! gradients by backpropagation through the steps ([`motion`]).
//!
//! ```
//! use phipsi::motion::{Settings, Simulator, Torque};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(7)?;
//! let mut simulator = Simulator::new(&scene, Settings::new(&scene, 1e-3), &[0.3; 7], &[0.0; 7])?;
//! simulator.step(&Torque::Zero, 100)?;
//! let (q, qd) = simulator.state(0);
//! assert!(q.iter().chain(qd).all(|x| x.is_finite()));
//! # Ok(())
//! # }
//! ```
//!
//! # Estimate
//!
//! Estimate the most likely accelerations, torques and joint forces with their variances from noisy torque sensors on
//! some joints, with the dynamics model as the prior.
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
//! Compute joint positions that bring links to target poses within joint limits, from several starting points, with
//! their covariance ([`inverse_kinematics`]).
//!
//! # Optimal control
//!
//! Compute motions of least cost with the feedback laws that hold a robot on them, within limits of effort, position
//! and speed ([`control`]).
//!
//! # The paper's operators
//!
//! G. Rodriguez (JPL, 1987) formulated robot arm dynamics as an estimation problem. Spatial forces z(k) are the states
//! of a linear system that runs from tip to base,
//!
//! ```text
//! z^-(k) = sum over children c of phi(k,c) z^+(c) + w(k)        E w = b(k),  cov w = M(k)      (1.1, 1.3)
//! tau(k) = H(k) z^+(k)                                          joint torques: measurements    (1.4)
//! ```
//!
//! and the covariance of the measurements is the joint-space mass matrix, M = H phi Q phi* H* (5.1). A Kalman filter
//! factors it, M = (1 + K) D (1 + K*) (3.1). The filter and a Bryson-Frazier smoother compute the joint accelerations
//! in O(N): M^-1 = (1 - L*) D^-1 (1 - L) (3.3). Each factor is an object that can be applied and inspected
//! ([`operators`]).
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
//! | 1, spatially random model | [`filter::system`], [`scene`], [`Scene::bias_torque`] (bias b), `stochastic` |
//! | 2, conditional means and covariances | [`Scene::estimate`], [`filter::smoothed`], [`operators`] |
//! | 3, Riccati recursion, K, L, D | [`filter::riccati`], [`operators::Factor`], [`dynamics::mass_matrix`] (3.4, 3.5) |
//! | 4, filter and smoother | [`filter::innovations`], [`filter::smoother`], [`dynamics::forward_dynamics`] |
//! | 5, covariance of the co-states | [`filter::covariance`], [`Scene::operational_inverse_inertia`] |
//! | 6, closed form of M^-1 | [`dynamics::mass_matrix_inverse`] |
//!
//! The paper numbers bodies from the tip; the recursions work in body frames with joint axes along z. They are generic
//! over the scalar ([`scalar::Real`]): f64, dual numbers, and [`scalar::DoubleDouble`] with about 31 digits, which
//! serves as the reference for error measurements.
//!
//! # Features
//!
//! The default features are `control`, `estimation`, `inverse-kinematics`, `motion` and `report`. A program that needs
//! the dynamics of single states alone compiles in half of the time with `default-features = false`. Without `lanes`
//! every function exists and computes one state at a time in plain f64, with the same results up to rounding.
//!
//! | feature | adds |
//! |---|---|
//! | `derivatives` | derivatives of forward and inverse dynamics: [`dynamics::derivatives`] |
//! | `motion` | simulation, contacts, gradients of rollouts: [`motion`]; includes `derivatives` |
//! | `estimation` | observers, variances, parts of identification (the rest is in Python): [`estimation`]; includes `derivatives` |
//! | `inverse-kinematics` | [`inverse_kinematics`] |
//! | `control` | optimal control: [`control`]; includes `estimation`, `inverse-kinematics` and `motion` |
//! | `collision` | shapes that touch, by parry3d: [`scene::Collider`] |
//! | `operators` | the operators of the paper as objects: [`operators`] |
//! | `codegen` | code for one robot in C, CUDA or Rust: [`codegen`]; includes `derivatives` |
//! | `report` | counts of operations, [`Scene::plan`]: [`report`]; includes `codegen` and `operators` |
//! | `lanes` | kernels for the vector registers of the processor: several states at once, and fused multiply-add |
//! | `urdf` | URDF reader, and the bundled arm |
//! | `parallel` | batches on several threads; includes `lanes` |
//! | `dense` | dense operators with faer's LDLT as a reference; includes `report` |
//! | `stochastic` | sampling of the random model |
//! | `avx512` | kernels for AVX-512 processors; doubles the compilation time of the kernels; includes `lanes` |
//! | `python` | the Python module, built by maturin; not for use from Rust |

#![cfg_attr(
    not(all(
        feature = "control",
        feature = "estimation",
        feature = "inverse-kinematics",
        feature = "motion",
        feature = "report"
    )),
    allow(dead_code, unused_imports, rustdoc::broken_intra_doc_links)
)]

mod accuracy;
mod algorithm;
mod api;
pub mod batch;
#[cfg(feature = "codegen")]
pub mod codegen;
mod collision;
#[cfg(feature = "motion")]
mod contact;
#[cfg(feature = "control")]
pub mod control;
mod decompositions;
pub mod dynamics;
mod error;
#[cfg(feature = "estimation")]
pub mod estimation;
pub mod filter;
pub mod interrupt;
#[cfg(feature = "inverse-kinematics")]
pub mod inverse_kinematics;
mod joints;
pub mod kinematics;
mod memory;
mod model;
#[cfg(feature = "motion")]
pub mod motion;
#[cfg(feature = "operators")]
pub mod operators;
#[cfg(feature = "report")]
mod plan;
#[cfg(feature = "python")]
mod python;
#[cfg(feature = "report")]
pub mod report;
pub mod scalar;
pub mod scene;
pub mod scenes;
mod setters;
pub mod spatial;
#[cfg(feature = "stochastic")]
pub mod stochastic;

/// The table of functions: arguments, results, cost, and the function of which each is the derivative.
pub mod function_table {
    pub use crate::algorithm::FUNCTIONS;
    pub use crate::algorithm::table::{Array, Axis, Compiled, FunctionEntry, Sizes, width};
}

/// The linear algebra crate whose vectors and matrices appear in the interface.
pub use nalgebra;

pub use accuracy::{Accuracy, Bound, ESTIMATE_SPREAD};
pub use algorithm::{Algorithm, Arguments, KinematicQuantity};
#[cfg(feature = "derivatives")]
pub use algorithm::{Derivatives, Products};
pub use api::{BodyWrenches, ColliderDistance, Constrained, OnLink, Projection, TaskFrame};
#[cfg(feature = "derivatives")]
pub use api::{DerivativeMatrices, RowMajor};
pub use error::{ConstraintViolation, Error, MemoryRequest};
pub use filter::Form;
#[cfg(feature = "report")]
pub use plan::{Plan, Simplification};
pub use scene::{Scene, SceneBuilder};
pub use workspace::{Tally, Workspace};

pub(crate) use dynamics::workspace;

/// Runs the Rust examples of docs/rust.md as tests.
#[cfg(doctest)]
#[doc = include_str!("../docs/rust.md")]
struct CratePage;

/// Runs the Rust examples of docs/kinematic-quantities.md as tests.
#[cfg(doctest)]
#[doc = include_str!("../docs/kinematic-quantities.md")]
struct KinematicQuantitiesPage;

/// Runs the Rust examples of docs/stochastic.md as tests.
#[cfg(all(doctest, feature = "stochastic"))]
#[doc = include_str!("../docs/stochastic.md")]
struct RandomModelPage;
