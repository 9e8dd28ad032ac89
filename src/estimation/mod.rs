//! Estimation from measurements of whole logs: identification of inertial parameters.

pub mod identification;
pub mod log_smoother;
pub mod triangle;
