//! Joints: one file a kind, and what all have in common.
//!
//! [`JointKind`] is what people name; it is made of [`Motion`]s about or along z, one body each. To add a kind that is made of motions that there
//! are: a file with its parts, a line in each `match` of [`kind`], and its name in the docstring of `SceneBuilder.joint`.

mod cotangents;
mod exact;
mod frames;
mod free;
pub mod kind;
mod motion;
mod parts;
mod planar;
mod prismatic;
pub mod quaternion;
mod revolute;
mod screw;
mod spherical;
mod universal;
pub(crate) mod vectors;

pub use kind::JointKind;
pub use motion::Motion;
pub use parts::Parts;
