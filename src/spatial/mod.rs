//! Spatial algebra in 3x3 blocks, on which all sweeps are built.
//!
//! A spatial vector is a nalgebra `Vector6`, angular part first: a force is (moment, force), a motion (angular,
//! linear). The kernels work on components instead of multiplying 6x6 matrices: phi is a rotation and a lever, P and M
//! are symmetric, and structural zeros are not computed.
//!
//! ```
//! use nalgebra::{Matrix3, Vector3};
//! use phipsi::spatial::{RigidShift, angular, spatial};
//!
//! // A force of 2 N along y at a point 0.5 m along x has a moment about the origin.
//! let shift = RigidShift { rotation: Matrix3::identity(), lever: Vector3::new(0.5, 0.0, 0.0) };
//! let force = spatial(&Vector3::zeros(), &Vector3::new(0.0, 2.0, 0.0));
//! assert_eq!(angular(&shift.force_to_parent(&force)), Vector3::new(0.0, 0.0, 1.0));
//! assert_eq!(shift.compose(&shift.inverse()), RigidShift::identity());
//! ```

mod body_inertia;
mod inertia_root;
pub(crate) mod inertial_parameters;
mod rigid_shift;
mod root;
mod symmetric;
pub(crate) mod transform;
mod vector;

#[doc(hidden)]
pub use body_inertia::BodyInertia;
pub(crate) use body_inertia::FirstMoment;
#[doc(hidden)]
pub use inertia_root::BodyRoot;
pub(crate) use inertia_root::{inertia_root, join_roots, root_of_merged};
pub use rigid_shift::RigidShift;
pub(crate) use rigid_shift::rotate_block;
#[doc(hidden)]
pub use root::{Dropped, Root6, RootColumns, root_row};
pub use symmetric::{Symmetric3, Symmetric6};
pub use vector::{SpatialVector, angular, cross_force, cross_motion, linear, skew, spatial};
pub(crate) use vector::{absolute, column, cross_add, from_rows, less, minus, product, row, square, sum3, times_each};
#[doc(hidden)]
pub use vector::{cross, dot, scaled, scaled_add, sum, zero};
