//! Uncertainty of the equations of motion: covariances of inertial parameters and torques through forward and inverse dynamics, in O(N).
//!
//! An error of a body's parameters is a random force on that body, and an error of a joint's parameters is torque noise. The model's filter and smoother then run with
//! gains that were made for another process noise, and the variances of the accelerations are those of this suboptimal filter.

mod parameter_roots;
mod variance;

pub use parameter_roots::ParameterRoots;
pub use variance::{
    JointCovariance, TorqueVariance, VarianceScratch, Variances, forward_dynamics_variance, inverse_dynamics_variance,
};
