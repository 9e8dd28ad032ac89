//! The scene: an immutable articulated system that threads can share.
//!
//! A [`SceneBuilder`] collects links and joints from code or from a URDF file (feature `urdf`) and checks them.
//! [`Scene`] provides the algorithms, and methods that return modified scenes. [`Model`] holds the numerical values
//! that the functions of [`dynamics`](crate::dynamics) read, in any scalar type.
//!
//! ```
//! use nalgebra::Vector3;
//! use phipsi::SceneBuilder;
//! use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription};
//! use phipsi::spatial::Symmetric3;
//! # fn main() -> Result<(), phipsi::Error> {
//! // A pendulum: 1 kg, 0.5 m below a revolute joint about y.
//! let bob = Inertial { mass: 1.0, center: Vector3::new(0.0, 0.0, -0.5), central: Symmetric3::zero() };
//! let mut hinge = JointDescription::new("hinge", JointKind::Revolute, "base", "rod");
//! hinge.axis = Vector3::y();
//! let scene = SceneBuilder::new()
//!     .link(LinkDescription { name: "base".into(), inertial: None })
//!     .link(LinkDescription { name: "rod".into(), inertial: Some(bob) })
//!     .joint(hinge)
//!     .build()?;
//! let mut torque = [f64::NAN];
//! scene.gravity_torque(&mut scene.workspace(), &[0.1], &mut torque)?;
//! assert!((torque[0] - 9.81 * 0.5 * 0.1_f64.sin()).abs() < 1e-14);
//!
//! let heavier = scene.with_payload("rod", &Inertial { mass: 2.0, ..bob })?;
//! assert_eq!(heavier.joint("hinge")?.v, 0..1);
//! # Ok(())
//! # }
//! ```

mod actuator;
mod assembly;
mod attach;
mod builder;
mod checks;
mod collider;
pub(crate) mod collider_pairs;
mod configuration;
mod connection;
pub(crate) mod constraint;
mod contact;
pub(crate) mod contact_point;
mod coupling;
mod description;
mod inertia_check;
mod joint_check;
mod joint_forces;
mod linkage;
mod lock;
mod part;
mod payload;
mod polynomial;
pub(crate) mod properties;
mod reroot;
mod shared;
mod spring;
mod start;
#[cfg(feature = "urdf")]
mod urdf;
mod whole_check;

pub use crate::collision::Solid;
pub use crate::joints::JointKind;
pub use crate::kinematics::Link;
#[doc(hidden)]
pub use crate::model::{Body, Motion, Simplifications};
pub use crate::model::{Model, StateModel};
pub use actuator::Actuator;
pub(crate) use assembly::AT_A_TIME;
pub(crate) use builder::A_LINK;
pub use builder::{ROOT_JOINT, SceneBuilder};
pub(crate) use checks::check_tolerance;
pub use collider::{Collider, ColliderPair};
pub use connection::{Connection, ConnectionKind};
pub use contact::{Contact, Surface};
pub use coupling::Coupling;
pub(crate) use coupling::mirror;
pub use description::{
    FrictionCurve, Inertial, JointDescription, Limits, LinkDescription, Mimic, MimicJoints, SceneWarning,
};
pub(crate) use joint_forces::JointForces;
pub use polynomial::Polynomial;
pub use properties::Property;
pub use spring::Spring;
pub use start::Start;

use self::collider_pairs::Colliders;
use self::constraint::Constraints;
use self::contact_point::ContactPoint;
use self::shared::Shared;
use crate::error::{Error, known_names};
use crate::model::Identity;
use crate::setters::accessors;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

/// A movable joint of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Name.
    pub name: String,
    /// Kind of motion.
    pub kind: JointKind,
    /// Name of the child link.
    pub child: String,
    /// Indices of its coordinates in q.
    pub q: Range<usize>,
    /// Indices of its degrees of freedom in qd, qdd and tau.
    pub v: Range<usize>,
    /// Limits. Position limits act as stops in simulations; the other limits are reported.
    pub limits: Limits,
}

/// An immutable articulated system: bodies, joints, gravity, and their names.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Identity of the scene. Copies share it; every newly built scene has another one.
    identity: Identity,
    source: SceneBuilder,
    warnings: Vec<SceneWarning>,
    model: Model<f64>,
    links: Vec<Link>,
    joints: Vec<Joint>,
    /// Index of the joint that moves each body; `None` for a body that is fixed to its parent.
    joint_of_body: Vec<Option<usize>>,
    merged: Vec<String>,
    link_index: HashMap<String, usize>,
    joint_index: HashMap<String, usize>,
    /// The coupling of its joints, if some follow others.
    coupling: Option<Arc<Coupling>>,
    /// The connections, by index.
    constraints: Constraints,
    /// The contacts, by index.
    pub(crate) contact_points: Vec<ContactPoint>,
    /// The colliders, by index, if any can touch.
    shapes: Option<Arc<Colliders>>,
    shared: Shared,
}

impl Scene {
    /// A scene without links, which the builder fills.
    fn unfilled(source: SceneBuilder, warnings: Vec<SceneWarning>) -> Self {
        Self {
            identity: Identity::unique(),
            model: Model::empty(source.gravity, source.simplifications),
            source,
            warnings,
            links: Vec::new(),
            joints: Vec::new(),
            joint_of_body: Vec::new(),
            merged: Vec::new(),
            link_index: HashMap::new(),
            joint_index: HashMap::new(),
            coupling: None,
            constraints: Constraints::default(),
            contact_points: Vec::new(),
            shapes: None,
            shared: Shared::default(),
        }
    }

    /// Geometric tolerance of linkages: an angle in rad, or a length relative to the reach of the loop.
    ///
    /// Combinations of rows of connections that joint motions change by less count as dependent. Zero for strict
    /// scenes, which tolerate rounding errors only.
    #[must_use]
    pub fn tolerance(&self) -> f64 {
        if self.source.strict { 0.0 } else { self.source.tolerance.unwrap_or(connection::DEFAULT_TOLERANCE) }
    }

    /// Identity of the scene in this process. Data stored for one scene is never used for another.
    pub(crate) fn identity(&self) -> u64 {
        self.identity.number()
    }

    /// Number of coordinates in q.
    #[must_use]
    pub fn nq(&self) -> usize {
        self.coupling().map_or(self.model.nq, |coupling| coupling.sizes().0)
    }

    /// Number of degrees of freedom, the length of qd, qdd and tau.
    #[must_use]
    pub fn nv(&self) -> usize {
        self.coupling().map_or(self.model.nv(), |coupling| coupling.sizes().1)
    }

    /// The movable joint named `name`.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`], which lists the existing names.
    pub fn joint(&self, name: &str) -> Result<&Joint, Error> {
        self.joint_index
            .get(name)
            .map(|&i| &self.joints[i])
            .ok_or_else(|| unknown("joint", name, self.joints.iter().map(|joint| joint.name.as_str())))
    }

    /// The link named `name`.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`], which lists the existing names.
    pub fn link(&self, name: &str) -> Result<&Link, Error> {
        self.link_index
            .get(name)
            .map(|&i| &self.links[i])
            .ok_or_else(|| unknown("link", name, self.links.iter().map(|link| link.name.as_str())))
    }

    /// The joint that moves body `body` of the model; `None` for a fixed body that was not merged.
    #[must_use]
    #[doc(hidden)]
    pub fn joint_of_body(&self, body: usize) -> Option<&Joint> {
        self.joint_of_body.get(body).copied().flatten().map(|joint| &self.joints[joint])
    }
}

accessors!(Scene {
    /// The connections in the form that the sweeps read.
    pub(crate) view constraints(constraints): &Constraints;

    /// The contacts in the form that the sweeps read.
    pub(crate) view contact_points(contact_points): &[ContactPoint];

    /// Values computed once per scene.
    pub(crate) view shared(shared): &Shared;

    /// The numerical model that the sweeps read; that of the [`tree`](Scene::tree) if joints are coupled.
    pub view model(model): &Model<f64>;

    /// The description that the scene was built from. Building it again returns an equal scene.
    pub view source(source): &SceneBuilder;

    /// Warnings about probably unintended properties of the scene.
    pub view warnings(warnings): &[SceneWarning];

    /// Movable joints in the order of q.
    pub view joints(joints): &[Joint];

    /// Links in depth-first order, including those on fixed joints.
    pub view links(links): &[Link];

    /// Names of the fixed joints that were merged.
    pub view merged_joints(merged): &[String];
});

/// The error for an unknown name, which lists the existing names.
fn unknown<'a>(what: &str, name: &str, known: impl Iterator<Item = &'a str>) -> Error {
    Error::argument(what, format!("{name:?}"), format!("one of {}", known_names(name, known, 12)))
}
