//! The user description of a scene: links and joints by name.

use super::spring::Spring;
use crate::error::{Error, in_language};
use crate::joints::JointKind;
use crate::setters::setters;
use crate::spatial::{RigidShift, Symmetric3};
use nalgebra::Vector3;

/// Mass, center of mass and inertia of a link, in the link frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertial {
    /// Mass, kg.
    pub mass: f64,
    /// Center of mass, m.
    pub center: Vector3<f64>,
    /// Rotational inertia about the center of mass, in axes parallel to the link frame, kg m^2.
    pub central: Symmetric3<f64>,
}

/// A link: a name, and optionally an inertia.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkDescription {
    /// Name, unique among the links.
    pub name: String,
    /// Inertia; `None` for a massless frame.
    pub inertial: Option<Inertial>,
}

/// Limits of a joint. Position limits act as stops in simulations; the other limits are reported.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Limits {
    /// Smallest position, rad or m.
    pub lower: f64,
    /// Largest position, rad or m.
    pub upper: f64,
    /// Largest speed, rad/s or m/s.
    pub velocity: f64,
    /// Largest torque or force, N m or N.
    pub effort: f64,
    /// Largest acceleration that increases the speed, rad/s^2 or m/s^2.
    pub acceleration: f64,
    /// Largest acceleration that decreases the speed, rad/s^2 or m/s^2.
    pub deceleration: f64,
    /// Largest rate of the acceleration, rad/s^3 or m/s^3.
    pub jerk: f64,
}

impl Default for Limits {
    fn default() -> Self {
        let none = f64::INFINITY;
        let (velocity, effort, acceleration, deceleration, jerk) = (none, none, none, none, none);
        Self { lower: -none, upper: none, velocity, effort, acceleration, deceleration, jerk }
    }
}

/// The joint that another joint follows: q = multiplier * q of that joint + offset.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Mimic {
    /// Name of the joint that it follows.
    pub joint: String,
    /// Ratio of the coordinates.
    pub multiplier: f64,
    /// Coordinate for a zero coordinate of the other joint, rad or m.
    pub offset: f64,
}

/// Treatment of mimic joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum MimicJoints {
    /// Mimic joints are independent, and a [`SceneWarning::Mimic`] names each.
    #[default]
    Free,
    /// Mimic joints follow and have no coordinates of their own: see [`Coupling`](super::Coupling).
    Coupled,
}

impl MimicJoints {
    /// The setting, for messages.
    pub(crate) fn text(self) -> &'static str {
        match self {
            Self::Free => in_language("MimicJoints::Free", "mimic=\"free\""),
            Self::Coupled => in_language("MimicJoints::Coupled", "mimic=\"couple\""),
        }
    }
}

impl Mimic {
    /// Follows a joint with multiplier 1 and offset 0.
    pub fn of(joint: impl Into<String>) -> Self {
        Self { joint: joint.into(), multiplier: 1.0, offset: 0.0 }
    }
}

/// Terms of dry friction beside Coulomb friction f: with the sign s of the velocity v and the load t, which is the
/// torque that the joint transmits to the bodies, the friction torque is -(o + s (f + g exp(-(v/v0)^2) + c |t|)).
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct FrictionCurve {
    /// o, N m or N, of either sign: friction is f + o in the positive direction and f - o in the negative one.
    pub offset: f64,
    /// g, N m or N: the excess of friction at rest over f.
    pub stribeck: f64,
    /// v0, rad/s or m/s.
    pub stribeck_speed: f64,
    /// c, from 0 to below 1.
    pub load: f64,
}

impl Default for FrictionCurve {
    fn default() -> Self {
        Self { offset: 0.0, stribeck: 0.0, stribeck_speed: 0.1, load: 0.0 }
    }
}

impl FrictionCurve {
    /// True if friction is that of Coulomb alone.
    #[must_use]
    pub fn is_flat(&self) -> bool {
        [self.offset, self.stribeck, self.load].iter().all(|&term| term == 0.0)
    }
}

setters!(FrictionCurve {
    with_offset: offset: f64,
    with_stribeck: stribeck: f64,
    with_stribeck_speed: stribeck_speed: f64,
    with_load: load: f64,
});

/// A joint between two links.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct JointDescription {
    /// Name, unique among the joints.
    pub name: String,
    /// Kind of motion.
    pub kind: JointKind,
    /// Name of the parent link, on the base side.
    pub parent: String,
    /// Name of the child link, which the joint moves.
    pub child: String,
    /// Pose of the child link frame in the parent link frame at zero configuration.
    pub origin: RigidShift<f64>,
    /// Joint axis in the child link frame, of any length.
    pub axis: Vector3<f64>,
    /// Armature (rotor inertia reflected to the joint) at each degree of freedom: kg m^2 or kg.
    pub armature: f64,
    /// Viscous damping, N m s/rad or N s/m (simulation and linearization only).
    pub damping: f64,
    /// Coulomb friction, N m or N (simulation only).
    pub friction: f64,
    /// Further terms of dry friction (simulation only).
    pub friction_curve: FrictionCurve,
    /// Spring (simulation and linearization only).
    pub spring: Spring,
    /// Limits.
    pub limits: Limits,
    /// The joint that this one follows, if [`MimicJoints`] enables it.
    pub mimic: Option<Mimic>,
}

setters!(JointDescription {
    with_name: name => String,
    with_kind: kind: JointKind,
    with_parent: parent => String,
    with_child: child => String,
    with_origin: origin: RigidShift<f64>,
    with_axis: axis => Vector3<f64>,
    with_armature: armature: f64,
    with_damping: damping: f64,
    with_friction: friction: f64,
    with_friction_curve: friction_curve: FrictionCurve,
    with_spring: spring: Spring,
    with_limits: limits: Limits,
    with_mimic: mimic => Option<Mimic>,
});

setters!(Limits {
    with_lower: lower: f64,
    with_upper: upper: f64,
    with_velocity: velocity: f64,
    with_effort: effort: f64,
    with_acceleration: acceleration: f64,
    with_deceleration: deceleration: f64,
    with_jerk: jerk: f64,
});

impl Limits {
    /// The limits with one sign, by name: velocity, effort, acceleration, deceleration, jerk.
    pub(super) fn of_one_sign(&mut self) -> [(&'static str, &mut f64); 5] {
        let Self { lower: _, upper: _, velocity, effort, acceleration, deceleration, jerk } = self;
        [
            ("velocity", velocity),
            ("effort", effort),
            ("acceleration", acceleration),
            ("deceleration", deceleration),
            ("jerk", jerk),
        ]
    }

    /// True if position, speed and torque are limited to zero, as exporters write limits that were not entered.
    pub(super) fn are_all_zero(&self) -> bool {
        [self.lower, self.upper, self.velocity, self.effort].iter().all(|&limit| limit == 0.0)
    }
}

setters!(Mimic { with_joint: joint => String, with_multiplier: multiplier: f64, with_offset: offset: f64 });

impl JointDescription {
    /// A joint at the parent origin with axis z, without armature, damping, friction, spring and limits.
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
            friction_curve: FrictionCurve::default(),
            spring: Spring::default(),
            limits: Limits::default(),
            mimic: None,
        }
    }
}

/// A property of a scene that is probably unintended but does not prevent computations.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum SceneWarning {
    /// A link with an inertia that no mass distribution has.
    Inertia {
        /// Name of the link.
        link: String,
        /// Description of the defect.
        found: String,
    },
    /// A moving link with an inertia that is too large for its mass and the size of the scene.
    LargeInertia {
        /// Name of the link.
        link: String,
        /// Radius of gyration: root mean square distance of the mass from its center, m.
        radius: f64,
        /// Largest distance of a center of mass from the root link, along the links, m.
        size: f64,
    },
    /// Joints whose limits of position, velocity and effort are all zero.
    Locked {
        /// Names of the joints.
        joints: Vec<String>,
    },
    /// A mimic joint that is treated as independent.
    Mimic {
        /// Name of the joint.
        joint: String,
        /// Name of the joint that it should follow.
        source: String,
    },
    /// A file in which no moving link has mass.
    NoMass {
        /// Names of the moving links.
        links: Vec<String>,
    },
    /// Elements and attributes of a file that were not recognized and are ignored.
    NotUnderstood {
        /// "URDF", or the path.
        source: String,
        /// The elements and attributes with their positions.
        found: String,
    },
    /// Position limits of a joint that are probably in degrees.
    Degrees {
        /// Name of the joint.
        joint: String,
        /// The limits.
        found: String,
    },
    /// Invalid limits in a file, which are ignored.
    Limits {
        /// The joints, and the defects of their limits.
        found: String,
    },
}

impl SceneWarning {
    /// The error that replaces the warning in a strict scene.
    pub(super) fn into_error(self) -> Error {
        let (subject, found, expected) = match self {
            Self::Inertia { link, found } => {
                (format!("link {link:?}"), found, "a physical inertia (strict)".to_owned())
            }
            Self::LargeInertia { link, radius, size } => {
                (format!("link {link:?}"), large_inertia(radius, size), format!("{LARGE_INERTIA} (strict)"))
            }
            Self::Locked { joints } => {
                ("limits".to_owned(), locked(&joints), "joints that can move, or are of type fixed (strict)".to_owned())
            }
            Self::Mimic { joint, source } => (
                format!("joint {joint:?}"),
                format!("a mimic of joint {source:?}, which does not exist"),
                "the name of another joint (strict)".to_owned(),
            ),
            Self::NoMass { links } => {
                ("scene".to_owned(), no_mass(&links), "a moving link with mass (strict)".to_owned())
            }
            Self::NotUnderstood { source, found } => (
                source,
                format!("unrecognized content: {found}"),
                "elements and attributes of URDF (strict)".to_owned(),
            ),
            Self::Degrees { joint, found } => (format!("joint {joint:?}"), found, "limits in rad (strict)".to_owned()),
            Self::Limits { found } => {
                let expected = "lower not above upper, the others zero or positive (strict)";
                ("limits".to_owned(), found, expected.to_owned())
            }
        };
        Error::scene(subject, found, expected)
    }
}

/// Text about moving links without mass.
fn no_mass(links: &[String]) -> String {
    let (n, have) = (links.len(), if links.len() == 1 { "link has" } else { "links have" });
    format!("{n} of {n} moving {have} no mass: {}", first(links))
}

/// The first names of a list.
fn first(names: &[String]) -> String {
    let quoted: Vec<String> = names.iter().take(8).map(|name| format!("{name:?}")).collect();
    quoted.join(", ") + if names.len() > quoted.len() { ", ..." } else { "" }
}

const LARGE_INERTIA: &str = "an inertia about the center of mass in kg m^2";

fn large_inertia(radius: f64, size: f64) -> String {
    format!("radius of gyration {radius:.3e} m, {:.0} times the size of the scene, {size:.3e} m", radius / size)
}

fn locked(joints: &[String]) -> String {
    let (joint, limits) = if joints.len() == 1 { ("joint", "limits of") } else { ("joints", "limits each of") };
    format!("{joint} {} with {limits} zero for lower, upper, effort and velocity", first(joints))
}

impl std::fmt::Display for SceneWarning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Inertia { link, found } => write!(f, "link {link:?}: {found}; no body has such an inertia"),
            Self::LargeInertia { link, radius, size } => {
                write!(f, "link {link:?}: {}; expected {LARGE_INERTIA}", large_inertia(*radius, *size))
            }
            Self::Locked { joints } => {
                let fix = "enter the limits, remove <limit>, or make the joint continuous";
                write!(f, "{}: locked in simulations; if the limits were not entered: {fix}", locked(joints))
            }
            Self::Mimic { joint, source } => {
                let couple = MimicJoints::Coupled.text();
                write!(
                    f,
                    "joint {joint:?}: mimics {source:?}; it is treated as an independent coordinate; use {couple} to couple it"
                )
            }
            Self::NoMass { links } => {
                write!(f, "{}; torques are zero and accelerations undefined, except for armature", no_mass(links))
            }
            Self::NotUnderstood { source, found } => write!(f, "{source}: not recognized and ignored: {found}"),
            Self::Degrees { joint, found } => {
                write!(
                    f,
                    "joint {joint:?}: {found}, which look like degrees; limits are in rad (degrees times pi / 180)"
                )
            }
            Self::Limits { found } => write!(f, "invalid limits, which are ignored: {found}"),
        }
    }
}
