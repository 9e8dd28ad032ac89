//! Example scenes of the library, for benchmarks, reports, examples and tests.
//!
//! ```
//! # fn main() -> Result<(), phipsi::Error> {
//! use phipsi::scenes;
//!
//! assert_eq!(scenes::chain(7)?.nv(), 7);
//! for name in scenes::names() {
//!     println!("{name}"); // built by `scenes::extreme`: large mass ratios, near-singular, far from the base
//! }
//! # Ok(())
//! # }
//! ```

mod blueprint;
pub(crate) mod draw;
mod extreme;

pub use extreme::{Extreme, extreme, names};

use crate::error::Error;
use crate::scene::{A_LINK, AT_A_TIME, Inertial, JointDescription, JointKind, LinkDescription, Scene, SceneBuilder};
use crate::spatial::{RigidShift, Symmetric3};
use crate::{interrupt, memory};
use nalgebra::{Matrix3, Vector3};

/// The bundled arm as URDF: a PUMA 560 with the published parameters that the file cites.
#[cfg(feature = "urdf")]
pub const BUNDLED_ARM: &str = include_str!("../../assets/puma560.urdf");

/// Approximate memory for the description of a link with its joint, bytes.
const DESCRIBED: usize = 1_000;

/// A chain of `n` equal links of 0.3 m and 1 kg on revolute joints about z, with successive axes perpendicular.
///
/// The benchmarks use this chain, and build the same one for Pinocchio.
///
/// # Errors
///
/// [`Error::Memory`] if the memory for the links is not available.
pub fn chain(n: usize) -> Result<Scene, Error> {
    let rod = Inertial {
        mass: 1.0,
        center: Vector3::new(0.0, 0.0, 0.15),
        central: Symmetric3::new([0.01, 0.0, 0.0, 0.01, 0.0, 0.002]),
    };
    memory::room("n", memory::bytes_of::<[u8; A_LINK + DESCRIBED]>(&[n]))?;
    let quarter = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0);
    let mut builder = SceneBuilder::new().link(LinkDescription { name: "base".into(), inertial: None });
    for k in 0..n {
        interrupt::check_at(k, AT_A_TIME)?;
        let parent = if k == 0 { "base".into() } else { format!("link{}", k - 1) };
        let mut joint = JointDescription::new(format!("j{k}"), JointKind::Revolute, parent, format!("link{k}"));
        joint.origin = RigidShift {
            rotation: if k % 2 == 1 { quarter } else { Matrix3::identity() },
            lever: Vector3::new(0.0, 0.0, if k == 0 { 0.0 } else { 0.3 }),
        };
        builder = builder.link(LinkDescription { name: format!("link{k}"), inertial: Some(rod) }).joint(joint);
    }
    builder.build()
}
