//! Poses, velocities and accelerations of bodies, without forces.
//!
//! These are methods of [`Scene`](crate::Scene). [`placements`](crate::Scene::placements) computes the poses of all
//! bodies from base to tip. [`placement`](crate::Scene::placement), [`velocity`](crate::Scene::velocity),
//! [`acceleration`](crate::Scene::acceleration) and [`jacobian`](crate::Scene::jacobian) follow the joints from one
//! frame to the base and need no scratch. This module has the types of their arguments and results.
//!
//! ```
//! use phipsi::kinematics::{AccelerationKind, ReferenceFrame};
//! # fn main() -> Result<(), phipsi::Error> {
//! let scene = phipsi::scenes::chain(3)?;
//! let (q, qd, qdd) = ([0.3; 3], [0.1; 3], [1.0; 3]);
//! let hand = "link2";
//! let placement = scene.placement(&q, hand)?; // rotation, and origin in m
//! let velocity = scene.velocity(&q, &qd, hand, ReferenceFrame::LocalWorldAligned)?; // (angular, linear)
//! let mut jacobian = [f64::NAN; 18];
//! scene.jacobian(&q, hand, ReferenceFrame::LocalWorldAligned, &mut jacobian)?;
//! let row = &jacobian[..3];
//! assert!((row.iter().zip(&qd).map(|(j, v)| j * v).sum::<f64>() - velocity[0]).abs() < 1e-15);
//! let frame = ReferenceFrame::Local;
//! let acceleration = scene.acceleration(&q, &qd, &qdd, hand, frame, AccelerationKind::Classical)?;
//! assert!(placement.lever.norm() < 0.9 && acceleration.norm() > 0.0);
//! # Ok(())
//! # }
//! ```

pub(crate) mod derivatives;
pub(crate) mod frame;
pub(crate) mod inward;
pub(crate) mod jacobian;
pub(crate) mod manifold;
pub(crate) mod outward;
pub(crate) mod pair;
pub(crate) mod propagation;
pub(crate) mod relative;

pub use frame::{ACCELERATION_KINDS, AccelerationKind, Frame, Link, REFERENCE_FRAMES, ReferenceFrame};
#[doc(hidden)]
pub use inward::{FrameMotion, frame_motion, placement, placements_on_the_way};
#[doc(hidden)]
pub use jacobian::{jacobian, jacobian_rate};
pub(crate) use jacobian::{local_jacobian, write_column};
#[doc(hidden)]
pub use outward::{
    accelerations_base_to_tip, base_acceleration, coordinate_rates, joint_motion, joint_shift, motion_past_joint,
    placements_base_to_tip, placements_on_base, velocities_base_to_tip,
};
