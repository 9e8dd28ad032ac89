//! Scenes from URDF: `<link>` and `<joint>` elements under `<robot>`, by the specification at wiki.ros.org/urdf/XML.
//!
//! Read: names, `<inertial>`, and the joint's type, parent, child, origin, axis, limit, dynamics and mimic. One
//! extension: `<dynamics armature="..." stiffness="..." rest="...">`, in kg m^2 or kg, N m/rad or N/m, and rad or m (rest: for
//! joints of one coordinate only). Everything else (visual, collision, transmission, gazebo,
//! ...) is passed over. What a link or joint says wrongly is an error that names it; whether the links and joints make
//! a tree of physical bodies is checked by [`SceneBuilder::build`].

mod xml;

use super::description::{Inertial, JointDescription, JointKind, Limits, LinkDescription, Mimic};
use super::{SceneBuilder, Spring};
use crate::error::Error;
use crate::spatial::{RigidShift, Symmetric3};
use nalgebra::{Matrix3, Vector3};
use std::path::Path;
use xml::{Element, Source};

/// The joint types of URDF, and "spherical", which is not in the specification but can mean only one thing.
const KINDS: [JointKind; 7] = [
    JointKind::Revolute,
    JointKind::Continuous,
    JointKind::Prismatic,
    JointKind::Fixed,
    JointKind::Floating,
    JointKind::Planar,
    JointKind::Spherical,
];

impl SceneBuilder {
    /// The links and joints of a URDF given as text; base, gravity and strictness are set on the result.
    ///
    /// # Errors
    ///
    /// [`Error::Scene`]: XML that is malformed (with line and column) or declares entities; a root element other than
    /// `robot`; a link or joint, by name, with something missing or a number that is none or not finite; an unknown
    /// joint type. The rest is checked by [`SceneBuilder::build`].
    pub fn from_urdf(xml: &str) -> Result<Self, Error> {
        read(xml, "URDF")
    }

    /// The links and joints of a URDF file in UTF-8.
    ///
    /// # Errors
    ///
    /// [`Error::Scene`] for a file that cannot be read or is not UTF-8, naming its path, and as for
    /// [`SceneBuilder::from_urdf`].
    pub fn from_urdf_file(path: impl AsRef<Path>) -> Result<Self, Error> {
        let path = path.as_ref();
        let subject = format!("file {:?}", path.display().to_string());
        let refuse = |found: String| Err(Error::scene(&subject, found, "a URDF file in UTF-8"));
        if path.is_dir() {
            return refuse("a directory".into());
        }
        let bytes = match std::fs::read(path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return refuse("no such file".into()),
            Err(error) => return refuse(error.to_string()),
        };
        match std::str::from_utf8(&bytes) {
            Ok(xml) => read(xml, &subject),
            Err(error) => refuse(format!("a byte that is not UTF-8 at offset {}", error.valid_up_to())),
        }
    }
}

/// Reads a document that messages call `name`.
fn read(xml: &str, name: &str) -> Result<SceneBuilder, Error> {
    let source = Source::new(xml, name);
    let document = source.parse()?;
    let robot = document.root_element();
    if robot.tag_name().name() != "robot" {
        return Err(source.refuse(format!("root element <{}>", robot.tag_name().name()), "<robot>"));
    }
    let mut builder = SceneBuilder::new();
    for node in robot.children().filter(roxmltree::Node::is_element) {
        let tag = node.tag_name();
        if tag.namespace().is_some_and(|uri| uri.ends_with("xacro")) {
            let found = format!("<xacro:{}>", tag.name());
            return Err(Error::scene(source.place_of(&node), found, "plain URDF: run xacro on the file first"));
        }
        if tag.namespace() != robot.tag_name().namespace() {
            continue;
        }
        match tag.name() {
            "link" => builder.links.push(link(&Element::named(node, &source)?)?),
            "joint" => builder.joints.push(joint(&Element::named(node, &source)?)?),
            _ => {}
        }
    }
    if builder.links.is_empty() {
        return Err(source.refuse("a <robot> without links", "at least one <link>"));
    }
    Ok(builder)
}

fn link(element: &Element) -> Result<LinkDescription, Error> {
    let inertial = element.child("inertial").map(|inertial| read_inertial(&inertial)).transpose()?;
    Ok(LinkDescription { name: element.name().to_owned(), inertial })
}

/// Mass, centre and inertia; the file gives the inertia along the axes of the inertial's origin, R I R^T turns it into
/// the link's.
fn read_inertial(element: &Element) -> Result<Inertial, Error> {
    let frame = origin(element)?;
    let mass = element.required_child("mass", "a <mass value=\"...\"> in kg")?.required_number("value")?;
    let inertia = element.required_child("inertia", "an <inertia> with ixx, ixy, ixz, iyy, iyz, izz in kg m^2")?;
    let mut entries = [0.0; 6];
    for (entry, name) in entries.iter_mut().zip(["ixx", "ixy", "ixz", "iyy", "iyz", "izz"]) {
        *entry = inertia.required_number(name)?;
    }
    Ok(Inertial { mass, centre: frame.lever, central: Symmetric3::new(entries).congruence(&frame.rotation) })
}

fn joint(element: &Element) -> Result<JointDescription, Error> {
    let kind = joint_kind(element)?;
    let parent = element.required_child("parent", "a <parent link=\"...\">")?.required("link")?;
    let child = element.required_child("child", "a <child link=\"...\">")?.required("link")?;
    let mut joint = JointDescription::new(element.name(), kind, parent, child);
    joint.origin = origin(element)?;
    if kind.has_axis() {
        let given = element.child("axis").map(|axis| axis.vector("xyz")).transpose()?.flatten();
        joint.axis = given.unwrap_or_else(Vector3::x);
    }
    if let Some(limit) = element.child("limit") {
        joint.limits = limits(&limit, kind)?;
    }
    if let Some(dynamics) = element.child("dynamics") {
        joint.damping = dynamics.number("damping")?.unwrap_or(0.0);
        joint.friction = dynamics.number("friction")?.unwrap_or(0.0);
        joint.armature = dynamics.number("armature")?.unwrap_or(0.0);
        joint.spring = spring(&dynamics)?;
    }
    if let Some(mimic) = element.child("mimic") {
        joint.mimic = Some(Mimic {
            joint: mimic.required("joint")?.to_owned(),
            multiplier: mimic.number("multiplier")?.unwrap_or(1.0),
            offset: mimic.number("offset")?.unwrap_or(0.0),
        });
    }
    Ok(joint)
}

/// Stiffness and rest; whether the joint has one coordinate is checked by the builder.
fn spring(dynamics: &Element) -> Result<Spring, Error> {
    let rest = dynamics.number("rest")?;
    Ok(Spring { stiffness: dynamics.number("stiffness")?.unwrap_or(0.0), rest: rest.into_iter().collect() })
}

fn joint_kind(element: &Element) -> Result<JointKind, Error> {
    let known = || format!("one of the types {}", KINDS.map(JointKind::name).join(", "));
    let Some(name) = element.text("type") else {
        return Err(element.refuse("no type", known()));
    };
    KINDS
        .into_iter()
        .find(|kind| kind.name() == name)
        .ok_or_else(|| element.refuse(format!("type {}", xml::quoted(name)), known()))
}

/// The specification lets lower and upper default to 0; a joint that gives neither has none.
fn limits(element: &Element, kind: JointKind) -> Result<Limits, Error> {
    let mut limits = Limits::default();
    let (lower, upper) = (element.limit("lower")?, element.limit("upper")?);
    if matches!(kind, JointKind::Revolute | JointKind::Prismatic) && (lower.is_some() || upper.is_some()) {
        limits.lower = lower.unwrap_or(0.0);
        limits.upper = upper.unwrap_or(0.0);
    }
    if kind != JointKind::Fixed {
        limits.velocity = element.limit("velocity")?.unwrap_or(limits.velocity);
        limits.effort = element.limit("effort")?.unwrap_or(limits.effort);
    }
    Ok(limits)
}

/// The element's `<origin xyz rpy>`; the identity if there is none.
fn origin(element: &Element) -> Result<RigidShift<f64>, Error> {
    let Some(origin) = element.child("origin") else {
        return Ok(RigidShift::identity());
    };
    if let Some(quaternion) = origin.text("quat_xyzw") {
        return Err(origin.refuse(
            format!("quat_xyzw={} in <origin>", xml::quoted(quaternion)),
            "the rotation as rpy: three angles in rad",
        ));
    }
    Ok(RigidShift {
        rotation: rotation(&origin.vector("rpy")?.unwrap_or_default()),
        lever: origin.vector("xyz")?.unwrap_or_default(),
    })
}

/// Rz(yaw) Ry(pitch) Rx(roll), from the element's axes to those around it. Angles are taken as written: 1.5708 is not
/// a right angle.
fn rotation(rpy: &Vector3<f64>) -> Matrix3<f64> {
    let [(sr, cr), (sp, cp), (sy, cy)] = [rpy[0].sin_cos(), rpy[1].sin_cos(), rpy[2].sin_cos()];
    Matrix3::new(
        cy * cp,
        cy * sp * sr - sy * cr,
        cy * sp * cr + sy * sr,
        sy * cp,
        sy * sp * sr + cy * cr,
        sy * sp * cr - cy * sr,
        -sp,
        cp * sr,
        cp * cr,
    )
}
