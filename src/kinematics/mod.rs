//! Where bodies are and how they move, without forces.
//!
//! [`outward`] goes base to tip, over all bodies; [`inward`] and [`jacobian`](mod@jacobian) go from one frame to the base, over the joints that move it, and need
//! no scratch.

pub mod frame;
pub mod inward;
pub mod jacobian;
pub mod outward;

pub use frame::{AccelerationKind, Frame, ReferenceFrame};
pub use inward::{FrameMotion, frame_motion, placement, placements_on_the_way};
pub use jacobian::{jacobian, jacobian_rate};
pub(crate) use jacobian::{local_jacobian, write_column};
pub use outward::{
    base_acceleration, coordinate_rates, joint_motion, joint_shift, motion_past_joint, motion_step,
    placements_base_to_tip,
};
