//! phipsi: articulated-body dynamics as estimation.

pub mod batch;
pub mod dynamics;
pub mod error;
pub mod filter;
pub mod kinematics;
#[cfg(feature = "python")]
mod python;
pub mod scalar;
pub mod scene;
pub use scene::{Scene, SceneBuilder};
pub mod spatial;
mod workspace;
pub use error::Error;
pub use workspace::Workspace;
