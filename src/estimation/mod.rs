//! Estimation: observers, and covariances of parameters and torques propagated through forward and inverse dynamics in
//! O(N). Identification of inertial parameters from logs exists in the Python package alone; the crate has its parts:
//! the regressor ([`Scene::regressor`](crate::Scene::regressor)), the smoother of logs ([`log_smoother`]) and the
//! information form of least squares ([`triangle`]).
//!
//! An error in the parameters of a body is a random force on that body, an error in the parameters of a joint is torque
//! noise. The filter and the smoother of the model then use gains that were computed for another process noise, and the
//! variances of the accelerations are those of this suboptimal filter.
//!
//! ```
//! use phipsi::estimation::{TorqueVariance, Variances};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(3)?;
//! // The mass of the last link is known to 0.1 kg, the other bodies exactly; torques to 0.2 N m.
//! let column = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
//! let parameters = scene.parameter_roots(&[vec![], vec![], vec![column]])?;
//! let torque = TorqueVariance::new(&[0.04; 3]);
//!
//! let (mut workspace, mut scratch) = (scene.workspace(), scene.variance_scratch());
//! let mut variances = [f64::NAN; 3];
//! let mut out = Variances { joints: &mut variances, bodies: &mut [] };
//! let state = (&[0.3; 3][..], &[0.1; 3][..], &[1.0; 3][..]);
//! scene.forward_dynamics_variance(&mut workspace, &mut scratch, state, &[], &parameters, &torque, &mut out)?;
//! assert!(variances.iter().all(|&variance| variance > 0.0));
//! # Ok(())
//! # }
//! ```

pub mod identification;
#[cfg(feature = "python")]
pub(crate) mod lanes;
pub mod log_smoother;
pub mod observer;
mod parameter_roots;
#[cfg(test)]
mod tests;
pub mod triangle;
mod variance;

pub use observer::{
    ExternalWrench, MotionEstimate, Mount, Observer, ObserverSettings, Quantity, Sensor, SmoothedMotion,
};
pub use parameter_roots::ParameterRoots;
pub use variance::{
    JointCovariance, TorqueVariance, VarianceScratch, Variances, forward_dynamics_variance, inverse_dynamics_variance,
};
