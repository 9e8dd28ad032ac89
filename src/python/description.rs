//! A scene as plain tuples of numbers and names, for pickling, and as one line, for `repr`.

use super::choice::{choose, name_of_mimic, names, read_mimic};
use super::collider_tuple::{CollisionTuple, collision_tuple, with_collisions};
use super::connection_tuple::{ConnectionTuple, FrameTuple, connection_of, connection_tuple, frame_from, frame_tuple};
use super::contact_tuple::{ContactTuple, contact_of, contact_tuple};
use super::object::Object;
use crate::error::{Error, number};
use crate::memory;
use crate::scene::properties::Properties;
use crate::scene::{
    Actuator, FrictionCurve, Inertial, JointDescription, JointKind, Limits, LinkDescription, Mimic, Scene,
    SceneBuilder, Simplifications, Spring, Start,
};
use crate::spatial::Symmetric3;
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Names of the links that joints carry, also those of joints that follow others: the bodies of every argument and
/// result with an axis of bodies, and `Scene.body_names`.
pub(super) fn body_names(scene: &Scene) -> impl ExactSizeIterator<Item = &str> {
    scene.tree().joints().iter().map(|joint| joint.child.as_str())
}

/// Version of the tuples.
const VERSION: u32 = 14;

/// Name, then mass, center of mass and inertia about it (xx, xy, xz, yy, yz, zz), if any.
type LinkTuple = (String, Option<(f64, [f64; 3], [f64; 6])>);

/// Name, kind, pitch, parent, child, origin (rotation in row-major order, lever), axis, (armature, damping, friction,
/// friction_offset, stribeck, stribeck_speed, load_friction), limits (lower, upper, velocity, effort, acceleration,
/// deceleration, jerk), mimic (joint, multiplier, offset), spring (stiffness, rest).
pub(super) type JointTuple = (
    String,
    String,
    Option<f64>,
    String,
    String,
    FrameTuple,
    [f64; 3],
    [f64; 7],
    [f64; 7],
    Option<(String, f64, f64)>,
    (f64, Vec<f64>),
);

/// A locked joint: name, kind, pitch.
type LockedTuple = (String, String, Option<f64>);

/// Version, gravity, floating base, strict, links, joints, names of simplifications, locked joints, (armature, damping,
/// friction, stiffness) of the free joint of a floating base, file, treatment of mimic joints, connections, contacts,
/// tolerance of linkages, shapes, starts, actuators.
#[derive(IntoPyObject, FromPyObject)]
pub(super) struct Description(
    u32,
    [f64; 3],
    bool,
    bool,
    Vec<LinkTuple>,
    Vec<JointTuple>,
    Vec<String>,
    Vec<LockedTuple>,
    [f64; 8],
    Option<PathBuf>,
    Beyond,
);

/// Parts beyond a kinematic tree: the treatment of mimic joints, connections, contacts, the tolerance of linkages,
/// shapes, colliders, the start and the keyframes, actuators.
type Beyond = (
    String,
    Vec<ConnectionTuple>,
    Vec<ContactTuple>,
    Option<f64>,
    Vec<String>,
    CollisionTuple,
    Vec<StartTuple>,
    Vec<ActuatorTuple>,
);

/// Name of a keyframe, coordinates and velocities by joint.
type StartTuple = (Option<String>, BTreeMap<String, Vec<f64>>, BTreeMap<String, Vec<f64>>);

/// Index of the links in a description.
const LINKS: usize = 4;

/// Approximate size of the description of a link and its joint, in bytes, including the Python objects.
const A_COPY: usize = 3_000;

impl Description {
    /// The complete description of a scene.
    pub fn of(source: &SceneBuilder) -> Result<Self, Error> {
        memory::room("scene", memory::bytes_of::<[u8; A_COPY]>(&[source.links().len()]))?;
        let links = source.links().iter().map(link_tuple).collect();
        let joints = source.joints().iter().map(joint_tuple).collect();
        let mut simplifications = source.left_out();
        let on = Simplifications::SWITCHES.iter().filter(|(_, switch)| *switch(&mut simplifications));
        let left_out = on.map(|&(name, _)| name.to_owned()).collect();
        let locked = source.locked().iter();
        let locked = locked.map(|(name, kind)| (name.clone(), kind.name().to_owned(), pitch_of(*kind))).collect();
        let (gravity, floating, strict) = (source.gravity_vector(), source.is_floating(), source.is_strict());
        let root = source.root_properties().0;
        Ok(Self(
            VERSION,
            gravity,
            floating,
            strict,
            links,
            joints,
            left_out,
            locked,
            root,
            source.file().map(Path::to_owned),
            (
                name_of_mimic(source.of_mimic_joints()).to_owned(),
                source.connections().iter().map(connection_tuple).collect(),
                source.contacts().iter().map(contact_tuple).collect(),
                source.tolerance_of_linkages(),
                source.shapes().to_vec(),
                collision_tuple(source),
                source.starts().iter().map(start_tuple).collect(),
                source.actuators().iter().map(actuator_tuple).collect(),
            ),
        ))
    }

    /// Reads the tuples, if the described scene fits in memory.
    pub fn read(what: &str, tuples: &Object<'_>) -> PyResult<Self> {
        if let Ok(links) = tuples.get_item(LINKS).and_then(|links| links.len()) {
            memory::room(what, memory::bytes_of::<[u8; A_COPY]>(&[links]))?;
        }
        tuples.extract()
    }

    /// The builder of the scene.
    pub fn builder(self) -> Result<SceneBuilder, Error> {
        let Self(version, gravity, floating, strict, links, joints, left_out, locked, root, file, beyond) = self;
        let (mimic, connections, contacts, tolerance, shapes, collisions, starts, actuators) = beyond;
        if version != VERSION {
            return Err(Error::scene("pickled scene", format!("version {version}"), format!("version {VERSION}")));
        }
        let (simplifications, mimic) = (simplifications("leave_out", &left_out)?, read_mimic(&mimic)?);
        let mut builder = SceneBuilder::new()
            .gravity(gravity)
            .floating_base(floating)
            .strict(strict)
            .simplifications(simplifications);
        for (name, inertial) in links {
            let inertial = inertial.map(|(mass, center, central)| Inertial {
                mass,
                center: center.into(),
                central: Symmetric3::new(central),
            });
            builder = builder.link(LinkDescription { name, inertial });
        }
        for joint in joints {
            builder = builder.joint(joint_of(joint)?);
        }
        for connection in connections {
            builder = builder.connect(connection_of(connection)?);
        }
        for contact in contacts {
            builder = builder.contact(contact_of(contact));
        }
        builder = with_collisions(builder, collisions)?;
        for (keyframe, q, qd) in starts {
            builder = builder.start(Start::new(keyframe.as_deref()).with_q(q).with_qd(qd));
        }
        let kind = |(name, kind, pitch): LockedTuple| joint_kind(&name, &kind, pitch).map(|kind| (name, kind));
        let locked = locked.into_iter().map(kind).collect::<Result<_, _>>()?;
        Ok(builder
            .mimic_joints(mimic)
            .tolerance(tolerance)
            .with_locked(locked)
            .with_root(Properties(root))
            .with_file(file)
            .with_shapes(shapes)
            .with_actuators(actuators.into_iter().map(actuator_of).collect()))
    }
}

/// Name, joint, gear, gain, bias, ranges of control, force and joint torque, activation (time constant, range), control
/// and activation of keyframes, reason why it cannot be represented.
pub(super) type ActuatorTuple = (
    String,
    String,
    f64,
    [f64; 3],
    [f64; 3],
    [[f64; 2]; 3],
    Option<(f64, [f64; 2])>,
    BTreeMap<String, [f64; 2]>,
    Option<String>,
);

pub(super) fn actuator_tuple(actuator: &Actuator) -> ActuatorTuple {
    let Actuator { name, joint, gear, gain, bias, control, force, torque, activation, keyframes, missing } =
        actuator.clone();
    (name, joint, gear, gain, bias, [control, force, torque], activation, keyframes, missing)
}

pub(super) fn actuator_of(tuple: ActuatorTuple) -> Actuator {
    let (name, joint, gear, gain, bias, [control, force, torque], activation, keyframes, missing) = tuple;
    Actuator { name, joint, gear, gain, bias, control, force, torque, activation, keyframes, missing }
}

fn start_tuple(start: &Start) -> StartTuple {
    (start.keyframe.clone(), start.q.clone(), start.qd.clone())
}

fn link_tuple(link: &LinkDescription) -> LinkTuple {
    let LinkDescription { name, inertial } = link;
    (name.clone(), inertial.map(|Inertial { mass, center, central }| (mass, center.into(), central.entries)))
}

pub(super) fn limits_as_array(limits: &Limits) -> [f64; 7] {
    let Limits { lower, upper, velocity, effort, acceleration, deceleration, jerk } = *limits;
    [lower, upper, velocity, effort, acceleration, deceleration, jerk]
}

pub(super) fn limits_from([lower, upper, velocity, effort, acceleration, deceleration, jerk]: [f64; 7]) -> Limits {
    Limits { lower, upper, velocity, effort, acceleration, deceleration, jerk }
}

/// The complete description of a joint, as numbers and names.
pub(super) fn joint_tuple(joint: &JointDescription) -> JointTuple {
    // All fields are named, so that a new one cannot be forgotten.
    let JointDescription {
        name,
        kind,
        parent,
        child,
        origin,
        axis,
        armature,
        damping,
        friction,
        friction_curve: FrictionCurve { offset, stribeck, stribeck_speed, load },
        spring,
        limits,
        mimic,
    } = joint;
    (
        name.clone(),
        kind.name().to_owned(),
        pitch_of(*kind),
        parent.clone(),
        child.clone(),
        frame_tuple(origin),
        (*axis).into(),
        [*armature, *damping, *friction, *offset, *stribeck, *stribeck_speed, *load],
        limits_as_array(limits),
        mimic.as_ref().map(|Mimic { joint, multiplier, offset }| (joint.clone(), *multiplier, *offset)),
        (spring.stiffness, spring.rest.clone()),
    )
}

/// Pitch of a screw joint.
fn pitch_of(kind: JointKind) -> Option<f64> {
    if let JointKind::Screw { pitch } = kind { Some(pitch) } else { None }
}

fn joint_of(tuple: JointTuple) -> Result<JointDescription, Error> {
    let (name, kind, pitch, parent, child, origin, axis, terms, limits, mimic, spring) = tuple;
    let [armature, damping, friction, offset, stribeck, stribeck_speed, load] = terms;
    let (stiffness, rest) = spring;
    let kind = joint_kind(&name, &kind, pitch)?;
    Ok(JointDescription {
        name,
        kind,
        parent,
        child,
        origin: frame_from(origin),
        axis: axis.into(),
        armature,
        damping,
        friction,
        friction_curve: FrictionCurve { offset, stribeck, stribeck_speed, load },
        spring: Spring { stiffness, rest },
        limits: limits_from(limits),
        mimic: mimic.map(|(joint, multiplier, offset)| Mimic { joint, multiplier, offset }),
    })
}

/// Reads a joint type; only a screw joint has a pitch.
pub(super) fn joint_kind(joint: &str, name: &str, pitch: Option<f64>) -> Result<JointKind, Error> {
    let subject = || format!("joint {joint:?}");
    match (name, pitch) {
        ("screw", Some(pitch)) => Ok(JointKind::Screw { pitch }),
        ("screw", None) => Err(Error::scene(subject(), "a screw joint without a pitch", "pitch, in m/rad")),
        _ => {
            let kind = JointKind::PLAIN.into_iter().find(|kind| kind.name() == name).ok_or_else(|| {
                let names: Vec<_> = JointKind::PLAIN.iter().map(|kind| kind.name()).collect();
                Error::scene(subject(), format!("type {name:?}"), format!("one of {}, screw", names.join(", ")))
            })?;
            match pitch {
                None => Ok(kind),
                Some(pitch) => Err(Error::scene(
                    subject(),
                    format!("pitch {} for a {name} joint", number(pitch)),
                    "a pitch for screw joints only",
                )),
            }
        }
    }
}

/// Reads the argument `leave_out`; None: all simplifications.
pub(super) fn left_out(leave_out: Option<&Object<'_>>) -> PyResult<Simplifications> {
    let Some(given) = leave_out else { return Ok(Simplifications::all()) };
    Ok(simplifications("leave_out", &names("leave_out", given, "a collection of names, or None")?)?)
}

/// Enables the named simplifications only.
fn simplifications(argument: &str, names: &[String]) -> Result<Simplifications, Error> {
    let mut simplifications = Simplifications::none();
    for name in names {
        *choose(argument, name, Simplifications::SWITCHES)?(&mut simplifications) = true;
    }
    Ok(simplifications)
}

/// The end of a list of numbers: empty for zero.
pub(super) fn counted(count: usize, what: &str) -> String {
    if count == 0 { String::new() } else { format!(", {count} {what}") }
}

/// Summary of a scene in one line.
pub(super) fn summary(scene: &Scene) -> String {
    let mut kinds: Vec<(&str, usize)> = Vec::new();
    for joint in scene.joints() {
        let name = joint.kind.name();
        match kinds.iter_mut().find(|(known, _)| *known == name) {
            Some((_, count)) => *count += 1,
            None => kinds.push((name, 1)),
        }
    }
    let kinds = kinds.iter().map(|(name, count)| format!("{count} {name}")).collect::<Vec<_>>().join(", ");
    let kinds = if kinds.is_empty() { String::new() } else { format!(" ({kinds})") };
    let closed = counted(scene.connections().len(), "connections");
    let touching = counted(scene.contacts().len(), "contacts");
    let [x, y, z]: [f64; 3] = scene.model().gravity.into();
    let followers = scene.tree().joints().len() - scene.joints().len();
    let followers = if followers == 0 { String::new() } else { format!(" and {followers} that follow") };
    let base = if scene.source().is_floating() { "floating base" } else { base_of(scene) };
    format!(
        "<phipsi.Scene: nq={}, nv={}, {} joints{kinds}{followers}, {} links, \
         {} merged joints{closed}{touching}, {base}, gravity ({x}, {y}, {z})>",
        scene.nq(),
        scene.nv(),
        scene.joints().len(),
        scene.links().len(),
        scene.merged_joints().len(),
    )
}

/// The base of a scene whose file has its own free joints: by the joints that nothing moves.
fn base_of(scene: &Scene) -> &'static str {
    let stages = &scene.model().system.stages;
    let of_roots = (0..stages.len()).filter(|&body| stages[body].parent.is_none());
    let free = |body| scene.joint_of_body(body).is_some_and(|joint| joint.kind == JointKind::Floating);
    let (floating, fixed): (Vec<usize>, Vec<usize>) = of_roots.partition(|&body| free(body));
    match (floating.is_empty(), fixed.is_empty()) {
        (true, _) => "fixed base",
        (false, true) => "floating base",
        (false, false) => "fixed and floating bases",
    }
}
