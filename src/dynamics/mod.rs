//! The equations of motion in any scalar: rigid-body dynamics by the [`filter`](crate::filter).
//!
//! The functions take a [`Model`](crate::scene::Model) in any scalar, slices for one state and a
//! [`Workspace`](crate::Workspace). They do not check arguments and do not allocate memory. The methods of
//! [`Scene`](crate::Scene) add checks and names.
//!
//! # Panics
//!
//! The functions of this module and of [`derivatives`] panic or return undefined results if a slice is shorter than the
//! model requires, or if a workspace or scratch was created for another model. The methods of [`Scene`](crate::Scene)
//! return errors.
//!
//! ```
//! use phipsi::scalar::{DoubleDouble, Real};
//! use phipsi::{Form, Workspace, dynamics};
//! # fn main() -> Result<(), phipsi::Error> {
//! // Accelerations with about 31 digits, and how far those of f64 are from them.
//! let scene = phipsi::scenes::chain(7)?;
//! let model = scene.model().cast::<DoubleDouble>();
//! let mut workspace = Workspace::new(&model).in_form(Form::Covariance);
//! let wide = |x: f64| [DoubleDouble::from_f64(x); 7];
//! let mut exact = wide(f64::NAN);
//! let monitor = dynamics::forward_dynamics(&model, &mut workspace, &wide(0.3), &wide(0.1), &wide(1.0), &[], &mut exact);
//! assert!(workspace.lost_pivot(&model, &monitor).is_none());
//!
//! let mut qdd = [f64::NAN; 7];
//! scene.forward_dynamics(&mut scene.workspace(), &[0.3; 7], &[0.1; 7], &[1.0; 7], &[], &mut qdd)?;
//! assert!(qdd.iter().zip(&exact).all(|(a, b)| (a - b.lane(0)).abs() <= 1e-12 * a.abs().max(1.0)));
//! # Ok(())
//! # }
//! ```

pub(crate) mod auto;
pub(crate) mod centroidal;
mod checked;
#[cfg(feature = "derivatives")]
mod checked_derivatives;
mod columns;
pub(crate) mod constraints;
pub(crate) mod contact_kernel;
pub(crate) mod contact_rows;
#[cfg(feature = "motion")]
pub(crate) mod contacts;
pub(crate) mod coupled;
#[cfg(feature = "derivatives")]
pub mod derivatives;
pub(crate) mod energy;
pub(crate) mod estimate;
pub(crate) mod fixed_rows;
pub(crate) mod forces;
pub(crate) mod forward;
pub(crate) mod inverse;
pub(crate) mod mass_inverse;
pub(crate) mod mass_matrix;
pub(crate) mod operational;
pub(crate) mod quantities;
pub(crate) mod refined;
pub(crate) mod sweeps;
pub(crate) mod traced;
pub(crate) mod workspace;

#[doc(hidden)]
pub use auto::{Choice, forward_dynamics_auto};
pub use constraints::ConstraintScratch;
pub use energy::{Energy, energy, momentum};
pub use estimate::{Estimate, EstimateCovariance, EstimateScratch, Measurements, estimate, estimate_covariance};
pub use forward::{factorise, forward_dynamics, solve};
pub use inverse::{bias_torque, inverse_dynamics, mul_mass};
pub use mass_inverse::{InverseScratch, mass_matrix_inverse};
pub use mass_matrix::{log_det_mass_matrix, mass_matrix};
pub use operational::{OperationalScratch, operational_inverse_inertia};
#[doc(hidden)]
pub use refined::{SquareRootResult, forward_dynamics_square_root};
#[doc(hidden)]
pub use sweeps::co_state_covariances;
