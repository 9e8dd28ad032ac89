//! Kalman filtering and Bryson-Frazier smoothing on a tree; no robotics here.
//!
//! The system: stage k carries a state z(k) of six numbers. States run inward along a tree, from the leaves (tips) to
//! the root (base), `z^-(k) = sum over children c of phi(k,c) z^+(c) + b(k)` with process noise of covariance Q(k), and
//! each stage is measured by a few scalar rows, `tau = H z^- + v`, v of variance r (often zero). The files are the paper's
//! sections: [`system`] is section 1, [`riccati`] section 3 ([`pivots`] says where its pivots are lost), [`innovations`] and [`smoother`] section 4, [`covariance`] section 5, and
//! [`smoothed`] the covariances of section 2 by way of it. A row whose noise is infinite is not measured: its gain is zero.

#[doc(hidden)]
pub mod cancellation;
pub mod covariance;
mod forms;
pub mod innovations;
pub mod pivots;
pub mod riccati;
#[doc(hidden)]
pub mod rounding;
pub mod smoothed;
pub mod smoother;
#[doc(hidden)]
pub mod square_root;
pub mod system;

pub use forms::{FORMS, Form};
pub use system::{HingeMap, Rows, Stage, System};
