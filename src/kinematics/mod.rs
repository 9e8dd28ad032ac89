//! Where bodies are and how they move, without forces.
//!
//! [`outward`] goes base to tip, over all bodies; [`inward`] and [`jacobian`](mod@jacobian) go from one frame to the base, over the joints that move it, and need
//! no scratch.

pub(crate) mod frame;
pub(crate) mod inward;
pub(crate) mod jacobian;
pub(crate) mod outward;

pub use frame::{ACCELERATION_KINDS, AccelerationKind, Frame, REFERENCE_FRAMES, ReferenceFrame};
#[doc(hidden)]
pub use inward::{FrameMotion, frame_motion, placement, placements_on_the_way};
pub(crate) use jacobian::write_column;
#[doc(hidden)]
pub use jacobian::{jacobian, jacobian_rate};
#[doc(hidden)]
pub use outward::{
    base_acceleration, coordinate_rates, joint_motion, joint_shift, motion_past_joint, motion_step,
    placements_base_to_tip,
};
