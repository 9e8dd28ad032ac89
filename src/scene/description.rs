//! What a scene is made of, as the user says it: links and joints by name.

use super::spring::Spring;
use crate::error::Error;
use crate::joints::JointKind;
use crate::spatial::{RigidShift, Symmetric3};
use nalgebra::Vector3;

/// Mass, mass center and inertia of a link, in the link's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertial {
    /// Mass, kg.
    pub mass: f64,
    /// Mass center, m.
    pub center: Vector3<f64>,
    /// Rotational inertia about the mass center, axes parallel to the link's frame, kg m^2.
    pub central: Symmetric3<f64>,
}

/// A link: a name, and an inertia if it has one.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkDescription {
    /// Name, unique among the links.
    pub name: String,
    /// Inertia; none for a link that is a mere frame.
    pub inertial: Option<Inertial>,
}

/// Limits of a joint: positions are stops in simulations, the others are reported.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Smallest position, rad or m.
    pub lower: f64,
    /// Largest position, rad or m.
    pub upper: f64,
    /// Largest speed, rad/s or m/s.
    pub velocity: f64,
    /// Largest torque or force, N m or N.
    pub effort: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { lower: f64::NEG_INFINITY, upper: f64::INFINITY, velocity: f64::INFINITY, effort: f64::INFINITY }
    }
}

/// Which joint another should follow: its coordinate is the multiplier times that joint's, plus the offset.
#[derive(Debug, Clone, PartialEq)]
pub struct Mimic {
    /// Name of the joint to follow.
    pub joint: String,
    /// Ratio of the coordinates.
    pub multiplier: f64,
    /// Coordinate where the other is at zero, rad or m.
    pub offset: f64,
}

/// What becomes of joints that should follow others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MimicJoints {
    /// They are independent, and a [`SceneWarning::Mimic`] names each.
    #[default]
    Free,
    /// They follow, and have no coordinates of their own: see [`Coupling`](super::Coupling).
    Coupled,
}

impl Mimic {
    /// The same coordinate as another joint's.
    pub fn of(joint: impl Into<String>) -> Self {
        Self { joint: joint.into(), multiplier: 1.0, offset: 0.0 }
    }
}

/// A joint between two links.
#[derive(Debug, Clone, PartialEq)]
pub struct JointDescription {
    /// Name, unique among the joints.
    pub name: String,
    /// What it lets move.
    pub kind: JointKind,
    /// Name of the link on the base's side.
    pub parent: String,
    /// Name of the link that it carries.
    pub child: String,
    /// The child's frame at zero configuration, seen from the parent's.
    pub origin: RigidShift<f64>,
    /// Axis in the child's frame; its length does not matter.
    pub axis: Vector3<f64>,
    /// Inertia of the rotor, seen at the joint, for each of its degrees of freedom: kg m^2 or kg.
    pub armature: f64,
    /// Viscous damping, N m s/rad or N s/m (simulation only).
    pub damping: f64,
    /// Coulomb friction, N m or N (simulation only).
    pub friction: f64,
    /// Spring (simulation only).
    pub spring: Spring,
    /// Limits.
    pub limits: Limits,
    /// The joint that this one should follow; [`MimicJoints`] says whether it does.
    pub mimic: Option<Mimic>,
}

impl JointDescription {
    /// A joint at the parent's origin, axis z, with no armature, damping, friction, spring or limits.
    pub fn new(name: impl Into<String>, kind: JointKind, parent: impl Into<String>, child: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            kind,
            parent: parent.into(),
            child: child.into(),
            origin: RigidShift::identity(),
            axis: Vector3::z(),
            armature: 0.0,
            damping: 0.0,
            friction: 0.0,
            spring: Spring::default(),
            limits: Limits::default(),
            mimic: None,
        }
    }
}

/// Something about a scene that its user should know, though it can be computed with.
#[derive(Debug, Clone, PartialEq)]
pub enum SceneWarning {
    /// A link whose inertia no distribution of mass can have.
    Inertia {
        /// The link.
        link: String,
        /// What is wrong with it.
        found: String,
    },
    /// A joint that should mimic another, taken as an independent coordinate.
    Mimic {
        /// The joint.
        joint: String,
        /// The joint that it should follow.
        source: String,
    },
    /// A file none of whose moving links has mass.
    NoMass {
        /// The moving links.
        links: Vec<String>,
    },
    /// Elements and attributes of a file that are not understood and were passed over.
    NotUnderstood {
        /// "URDF", or the path.
        source: String,
        /// What they are, and where.
        found: String,
    },
    /// Limits in a file that mean nothing and are taken as none.
    Limits {
        /// The joints, and what is wrong with their limits.
        found: String,
    },
}

impl SceneWarning {
    /// The error that it is in a strict scene.
    pub(super) fn into_error(self) -> Error {
        let (subject, found, expected) = match self {
            Self::Inertia { link, found } => {
                (format!("link {link:?}"), found, "an inertia that a body can have (strict)".to_owned())
            }
            Self::Mimic { joint, source } => (
                format!("joint {joint:?}"),
                format!("a mimic of joint {source:?}, which is not there"),
                "the name of another joint (strict)".to_owned(),
            ),
            Self::NoMass { links } => {
                ("scene".to_owned(), no_mass(&links), "a moving link with mass (strict)".to_owned())
            }
            Self::NotUnderstood { source, found } => (
                source,
                format!("what is not understood: {found}"),
                "elements and attributes that are read (strict)".to_owned(),
            ),
            Self::Limits { found } => {
                let expected = "lower not above upper, velocity and effort zero or positive (strict)";
                ("limits".to_owned(), found, expected.to_owned())
            }
        };
        Error::scene(subject, found, expected)
    }
}

/// The words for moving links without mass.
fn no_mass(links: &[String]) -> String {
    let names: Vec<String> = links.iter().take(8).map(|link| format!("{link:?}")).collect();
    let more = if links.len() > names.len() { ", ..." } else { "" };
    let (n, have) = (links.len(), if links.len() == 1 { "link has" } else { "links have" });
    format!("{n} of {n} moving {have} no mass: {}{more}", names.join(", "))
}

impl std::fmt::Display for SceneWarning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Inertia { link, found } => write!(f, "link {link:?}: {found}; no body has such an inertia"),
            Self::Mimic { joint, source } => {
                write!(f, "joint {joint:?}: mimics {source:?}; it is taken as an independent coordinate")
            }
            Self::NoMass { links } => {
                write!(f, "{}; torques are zero, and accelerations not defined, but for armature", no_mass(links))
            }
            Self::NotUnderstood { source, found } => write!(f, "{source}: not understood and passed over: {found}"),
            Self::Limits { found } => write!(f, "limits that mean nothing, taken as none: {found}"),
        }
    }
}
