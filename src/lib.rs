//! phipsi: articulated-body dynamics as estimation.

pub mod dynamics;
pub mod error;
pub mod filter;
pub mod kinematics;
pub mod operators;
pub mod plan;
pub mod report;
pub mod scalar;
pub mod scene;
pub mod scenes;
pub use scene::{Scene, SceneBuilder};
pub mod spatial;
mod workspace;
pub use error::Error;
pub use workspace::Workspace;
