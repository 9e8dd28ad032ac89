//! Kalman filtering and Bryson-Frazier smoothing on a tree, independent of robotics.
//!
//! Stage k has a state z(k) of six scalars. States are propagated inward along a tree, from the leaves (tips) to the
//! root (base), `z^-(k) = sum over children c of phi(k,c) z^+(c) + b(k)`, with process noise of covariance Q(k). Each
//! stage is measured by a few scalar rows, `tau = H z^- + v`, where v has variance r (often zero). The files follow the
//! sections of the paper: [`system`] is section 1, [`riccati`] section 3 ([`PivotMonitor`] detects lost pivots),
//! [`innovations`] and [`smoother`] section 4, [`covariance`] section 5, and [`smoothed`] computes the covariances of
//! section 2 from it. A row with infinite noise is not measured: its gain is zero.
//!
//! # Panics
//!
//! The functions of this module do not check their arguments: they panic if a slice is shorter than the system
//! requires.
//!
//! ```
//! use nalgebra::{Matrix3, Vector6};
//! use phipsi::filter::riccati::measurement_update;
//! use phipsi::filter::{HingeMap, Rows, Stage, System, innovations, smoother};
//! use phipsi::spatial::{RigidShift, Symmetric3, Symmetric6};
//!
//! // Two stages, each measured once without noise: component 2 of its state.
//! let stage = |parent, first_row| Stage { parent, rows: Rows::One(HingeMap::Axis(2)), first_row };
//! let system = System { stages: vec![stage(None, 0), stage(Some(0), 1)], noise: vec![0.0; 2] };
//! let phi = RigidShift { rotation: Matrix3::identity(), lever: [0.5, 0.0, 0.0].into() };
//! let one: Symmetric3<f64> = Symmetric3::new([1.0, 0.0, 0.0, 1.0, 0.0, 1.0]);
//! let noise = Symmetric6 { angular: one, coupling: Matrix3::zeros(), linear: one };
//!
//! // Tip to base: covariances, pivots D and gains g (3.6, 3.10).
//! let mut p = noise;
//! let tip = measurement_update(&mut p, &HingeMap::Axis(2), 0.0);
//! let mut p = noise.add(&phi.inertia_to_parent(&p));
//! let measured = [measurement_update(&mut p, &HingeMap::Axis(2), 0.0), tip];
//! // The tip brings its force across the lever: D of the base is 1 + 0.5^2.
//! assert!((measured[1].pivot - 1.0).abs() < 1e-15 && (measured[0].pivot - 1.25).abs() < 1e-15);
//!
//! // Tip to base: what the measurements add to the prediction; base to tip: the smoothed estimates.
//! let (torque, mut z, mut estimates) = ([1.0, 2.0], Vector6::zeros(), [f64::NAN; 2]);
//! innovations::through_stage((&system, 1), &measured, &torque, &mut z, &mut estimates);
//! z = phi.force_to_parent(&z);
//! innovations::through_stage((&system, 0), &measured, &torque, &mut z, &mut estimates);
//! let mut co_state = Vector6::zeros();
//! smoother::through_stage(&system.stages[0], &measured, &mut co_state, &mut estimates);
//! co_state = phi.motion_to_child(&co_state);
//! smoother::through_stage(&system.stages[1], &measured, &mut co_state, &mut estimates);
//! assert!(estimates.iter().all(|a| a.is_finite()));
//! ```

#[doc(hidden)]
pub mod cancellation;
pub mod covariance;
mod forms;
pub mod innovations;
pub(crate) mod pivots;
pub mod riccati;
#[doc(hidden)]
pub mod rounding;
pub mod smoothed;
pub mod smoother;
#[doc(hidden)]
pub mod square_root;
pub mod system;
pub(crate) mod tolerance;

pub use forms::{FORMS, Form};
pub use pivots::{LostPivot, PivotMonitor, Scale};
pub use system::{HingeMap, Rows, Stage, System};
