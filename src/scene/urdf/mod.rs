//! Scenes from URDF: `<link>` and `<joint>` elements in `<robot>`, as specified at wiki.ros.org/urdf/XML.
//!
//! The reader reads names, `<inertial>`, and type, parent, child, origin, axis, limit, dynamics and mimic of joints. An
//! extension is `<dynamics armature="..." stiffness="..." rest="...">`, in kg m^2 or kg, N m/rad or N/m, and rad or m
//! (rest: only for joints of one coordinate). `<robot version="...">` is 1.0, which is the default, 1.1, which adds
//! `quat_xyzw` of `<origin>`, or 1.2, which adds acceleration, deceleration and jerk of `<limit>`, as in urdfdom. Rotor
//! inertia in the notation of Drake is read as armature. Visual, collision, gazebo and similar elements, and elements
//! and attributes with a foreign prefix, are ignored. All other content is reported by one
//! [`SceneWarning::NotUnderstood`], or by an error in strict scenes. Invalid content of a link or joint is an error
//! that names it. Invalid limits are ignored with a [`SceneWarning::Limits`], because they do not enter the dynamics.
//! [`SceneBuilder::build`] checks that the links and joints form a tree of physical bodies.

mod known;
mod lenient;
mod rotor;
mod survey;
mod xml;

use super::description::{FrictionCurve, Inertial, JointDescription, Limits, LinkDescription, Mimic, SceneWarning};
use super::{AT_A_TIME, SceneBuilder, Spring};
use crate::error::{Error, number};
use crate::joints::JointKind;
use crate::joints::quaternion::QUATERNION_SLACK;
use crate::spatial::{RigidShift, Symmetric3};
use crate::{interrupt, memory};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use rotor::read_transmissions;
use std::path::Path;
use survey::Findings;
use xml::{Element, Source, VERSIONS, plain_attribute, quoted};

/// The joint types of URDF, and "spherical", which is unambiguous although it is not in the specification.
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
    /// Reads links and joints from URDF text. Set base, gravity and strictness on the result.
    ///
    /// # Errors
    ///
    /// [`Error::Scene`] for XML that is malformed (with line and column) or declares entities; a root element other
    /// than `robot`; a link or joint, by name, with a missing or invalid value; an unknown joint type.
    /// [`SceneBuilder::build`] checks the rest.
    pub fn from_urdf(xml: &str) -> Result<Self, Error> {
        read(xml, "URDF")
    }

    /// Reads links and joints from a URDF file in UTF-8.
    ///
    /// # Errors
    ///
    /// [`Error::Scene`] for a file that cannot be read or is not UTF-8, naming its path, and the errors of
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
            // The file exists, so that its path has an absolute form.
            Ok(xml) => Ok(read(xml, &subject)?.with_file(std::path::absolute(path).ok())),
            Err(error) => refuse(format!("a byte that is not UTF-8 at offset {}", error.valid_up_to())),
        }
    }
}

/// Approximate memory per byte of a document while it is read.
const A_LETTER: usize = 8;

/// Reads a document, which messages call `name`.
fn read(xml: &str, name: &str) -> Result<SceneBuilder, Error> {
    memory::room("source", memory::bytes_of::<[u8; A_LETTER]>(&[xml.len()]))?;
    let source = Source::new(xml, name);
    let mut restated = String::new();
    let document = source.parse(&mut restated)?;
    let robot = document.root_element();
    let tag = robot.tag_name().name();
    if tag != "robot" {
        return Err(source.refuse(format!("root element <{tag}>"), robot_instead(tag)));
    }
    let mut findings = Findings::new(&source, &document);
    findings.survey()?;
    if let Some(version) = plain_attribute(&robot, "version").filter(|version| !VERSIONS.contains(version)) {
        let expected = format!("one of the versions {}, or no version", VERSIONS.join(", "));
        return Err(source.refuse(format!("version {} of <robot>", quoted(version)), expected));
    }
    let mut builder = SceneBuilder { from_file: true, ..SceneBuilder::new() };
    let mut limits = Vec::new();
    let mut decimals = None;
    let parts = robot.children().filter(|node| node.is_element() && same_namespace(node, &robot));
    for (i, node) in parts.enumerate() {
        interrupt::check_at(i, AT_A_TIME)?;
        match node.tag_name().name() {
            "link" => builder.links.push(link(&Element::named(node, &source)?)?),
            "joint" => {
                let element = Element::named(node, &source)?;
                decimals = decimals.max(decimals_of_angles(&element));
                builder.joints.push(joint(&element, &mut limits)?);
            }
            _ => {}
        }
    }
    builder.tolerance = decimals.and_then(tolerance_of);
    builder.actuators = read_transmissions(&robot, &source, &mut builder.joints, &mut findings)?;
    let found = findings.into_text();
    if builder.links.is_empty() {
        let besides = found.map_or_else(String::new, |found| format!("; not recognized: {found}"));
        return Err(source.refuse(format!("a <robot> without links{besides}"), "at least one <link>"));
    }
    let source = || name.to_owned();
    builder.notes.extend(found.map(|found| SceneWarning::NotUnderstood { source: source(), found }));
    if !limits.is_empty() {
        builder.notes.push(SceneWarning::Limits { found: limits.join("; ") });
    }
    Ok(builder)
}

/// The expected part of the error for a document in another format.
fn robot_instead(tag: &str) -> String {
    let read = |format: &str, way: &str| {
        format!("<robot>: only URDF is read, not {format}; {way}, or build the scene in code with SceneBuilder")
    };
    match tag {
        "mujoco" => read("MJCF", "use phipsi.load in Python, convert it to URDF"),
        "mujocoinclude" => "a whole robot: load an MJCF file that includes this one".to_owned(),
        "sdf" | "world" | "model" => read("SDF", "use the URDF that it was made from, convert it to URDF"),
        _ => "<robot>".to_owned(),
    }
}

fn same_namespace(one: &roxmltree::Node, other: &roxmltree::Node) -> bool {
    one.tag_name().namespace() == other.tag_name().namespace()
}

fn link(element: &Element) -> Result<LinkDescription, Error> {
    let inertial = element.child("inertial").map(|inertial| read_inertial(&inertial)).transpose()?;
    Ok(LinkDescription { name: element.name().to_owned(), inertial })
}

/// Mass, center of mass and inertia. The file gives the inertia along the axes of the inertial origin; R I R^T
/// expresses it in link axes.
fn read_inertial(element: &Element) -> Result<Inertial, Error> {
    let frame = origin(element)?;
    let mass = element.required_child("mass", "a <mass value=\"...\"> in kg")?.required_number("value")?;
    let inertia = element.required_child("inertia", "an <inertia> with ixx, ixy, ixz, iyy, iyz, izz in kg m^2")?;
    let mut entries = [0.0; 6];
    for (entry, name) in entries.iter_mut().zip(["ixx", "ixy", "ixz", "iyy", "iyz", "izz"]) {
        *entry = inertia.required_number(name)?;
    }
    Ok(Inertial { mass, center: frame.lever, central: Symmetric3::new(entries).congruence(&frame.rotation) })
}

/// Reads a joint; appends invalid limits to `invalid_limits`.
fn joint(element: &Element, invalid_limits: &mut Vec<String>) -> Result<JointDescription, Error> {
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
        let (limits, found) = limits(&limit, kind)?;
        joint.limits = limits;
        invalid_limits.extend((!found.is_empty()).then(|| format!("joint {:?}: {}", joint.name, found.join(", "))));
    }
    if let Some(dynamics) = element.child("dynamics") {
        joint.damping = dynamics.number("damping")?.unwrap_or(0.0);
        joint.friction = dynamics.number("friction")?.unwrap_or(0.0);
        joint.armature = dynamics.number("armature")?.unwrap_or(0.0);
        joint.friction_curve = friction_curve(&dynamics)?;
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

/// Reads the terms of friction beside Coulomb friction.
fn friction_curve(dynamics: &Element) -> Result<FrictionCurve, Error> {
    let usual = FrictionCurve::default();
    Ok(FrictionCurve {
        offset: dynamics.number("friction_offset")?.unwrap_or(usual.offset),
        stribeck: dynamics.number("stribeck")?.unwrap_or(usual.stribeck),
        stribeck_speed: dynamics.number("stribeck_speed")?.unwrap_or(usual.stribeck_speed),
        load: dynamics.number("load_friction")?.unwrap_or(usual.load),
    })
}

/// Reads stiffness and rest position; the builder checks that the joint has one coordinate.
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

/// Reads the limits, and describes those that are ignored. The specification sets lower and upper to 0 by default; a
/// joint with neither has no limits.
fn limits(element: &Element, kind: JointKind) -> Result<(Limits, Vec<String>), Error> {
    let none = Limits::default();
    let (mut limits, mut found) = (none, Vec::new());
    let (lower, upper) = (element.limit("lower")?, element.limit("upper")?);
    let (is_new, is_bounded) = (element.has_version("1.2"), matches!(kind, JointKind::Revolute | JointKind::Prismatic));
    for (name, limit) in [("lower", lower), ("upper", upper)] {
        found.extend((is_new && is_bounded && limit.is_none()).then(|| format!("no {name}, which URDF 1.2 requires")));
    }
    if is_bounded && (lower.is_some() || upper.is_some()) {
        // URDF 1.2 has no default.
        limits.lower = lower.unwrap_or(if is_new { none.lower } else { 0.0 });
        limits.upper = upper.unwrap_or(if is_new { none.upper } else { 0.0 });
        if limits.lower > limits.upper {
            found.push(format!("lower {} above upper {}", number(limits.lower), number(limits.upper)));
            (limits.lower, limits.upper) = (none.lower, none.upper);
        }
    }
    if kind != JointKind::Fixed {
        for (i, (name, limit)) in limits.of_one_sign().into_iter().enumerate() {
            match element.limit(name)? {
                Some(value) if i > 1 && !is_new => {
                    found.push(format!("{name} {}, which requires <robot version=\"1.2\">", number(value)));
                }
                Some(value) if value < 0.0 => found.push(format!("{name} {} below zero", number(value))),
                value => *limit = value.unwrap_or(*limit),
            }
        }
        if element.text("deceleration").is_none() {
            limits.deceleration = limits.acceleration;
        }
    }
    Ok((limits, found))
}

/// The largest number of decimals of the angles and axes of a joint; `None` if all are integers, which are exact.
fn decimals_of_angles(joint: &Element) -> Option<usize> {
    let texts = [("origin", "rpy"), ("origin", "quat_xyzw"), ("axis", "xyz")];
    let texts = texts.into_iter().filter_map(|(tag, attribute)| joint.child(tag)?.text(attribute));
    let decimals = |word: &str| {
        let (mantissa, exponent) = word.split_once(['e', 'E']).unwrap_or((word, "0"));
        let digits = mantissa.split_once('.').map_or(0, |(_, fraction)| fraction.trim_end_matches('0').len());
        let exponent: i64 = exponent.parse().unwrap_or(0);
        usize::try_from(i64::try_from(digits).unwrap_or(i64::MAX).saturating_sub(exponent)).unwrap_or(0)
    };
    texts.flat_map(str::split_ascii_whitespace).map(decimals).filter(|&decimals| decimals > 0).max()
}

/// The linkage tolerance for a file whose angles have this number of decimals: four times the largest rounding error,
/// if that exceeds the default. A right angle written as 1.57 has two decimals and an error below half a unit of the
/// last one.
fn tolerance_of(decimals: usize) -> Option<f64> {
    match decimals {
        2 => Some(5e-3),
        3 => Some(2e-3),
        4 => Some(2e-4),
        _ => None,
    }
}

/// The `<origin xyz rpy>` or `<origin xyz quat_xyzw>` of the element; the identity if there is none.
fn origin(element: &Element) -> Result<RigidShift<f64>, Error> {
    let Some(origin) = element.child("origin") else {
        return Ok(RigidShift::identity());
    };
    let lever = origin.vector("xyz")?.unwrap_or_default();
    let rotation = match (origin.vector("rpy")?, origin.numbers::<4>("quat_xyzw", "four numbers")?) {
        (rpy, None) => rotation(&rpy.unwrap_or_default()),
        (_, Some(_)) if !origin.has_version("1.1") => {
            let expected = "<robot version=\"1.1\">, or the rotation as rpy: three angles in rad";
            return Err(origin.refuse("quat_xyzw in <origin> of a file of version 1.0", expected));
        }
        (Some(_), Some(_)) => return Err(origin.refuse("rpy and quat_xyzw in <origin>", "one of them")),
        (None, Some([x, y, z, w])) => {
            let quaternion = Quaternion::new(w, x, y, z);
            if !((quaternion.norm() - 1.0).abs() <= QUATERNION_SLACK) {
                return Err(origin.bad("quat_xyzw", "a quaternion x y z w of norm 1, to within 1e-3"));
            }
            UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix().into_inner()
        }
    };
    Ok(RigidShift { rotation, lever })
}

/// Rotation Rz(yaw) Ry(pitch) Rx(roll) from the axes of the element to the parent axes. Angles are used as written:
/// 1.5708 is not rounded to a right angle.
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
