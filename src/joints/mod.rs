//! Joints: one file per type, and the code common to all.
//!
//! A [`JointKind`], the type that users name, consists of elementary [`Motion`]s about or along z, one body each. To
//! add a type composed of existing motions, add a file with its parts, a line in each `match` of [`kind`], and its name
//! in the docstring of `SceneBuilder.joint`.

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
