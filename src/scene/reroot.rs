//! The same robot with another link as its root.

use super::description::{FrictionCurve, JointDescription, LinkDescription};
use super::{Connection, ConnectionKind, Scene, SceneBuilder, Start};
use crate::error::Error;
use crate::joints::JointKind;
use crate::spatial::RigidShift;
use nalgebra::{Rotation3, UnitQuaternion};

impl Scene {
    /// The same robot with another root link: the joints between the two roots carry the links on their other side.
    ///
    /// A joint from link p to link c at the origin X, with the motion exp(a q), places p in c at (X exp(a q))^-1 =
    /// exp(-a q) X^-1: a joint about the opposite axis, which carries a massless link, and a fixed joint to p. Joint
    /// positions, velocities and torques, and with them limits, friction and actuators, are therefore the same; their
    /// order is that of the new tree. A free joint carries the new root.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for an unknown link, for joints on the way that have no reverse with the same coordinates
    /// (planar, universal, spherical), for free joints with armature, losses or velocities of a start, and for
    /// contacts, colliders and connections of a base that would move.
    pub fn rerooted(&self, link: &str, floating_base: bool) -> Result<Self, Error> {
        self.link(link)?;
        let mut source = self.source().clone();
        let refused = |found: String, expected: &str| Error::argument("link", format!("{link:?}, {found}"), expected);
        // The joints from the link inward, to the root or to a free joint.
        let (mut way, mut root) = (Vec::new(), link.to_owned());
        let mut free = None;
        while let Some(at) = source.joints.iter().position(|joint| joint.child == root) {
            let joint = &source.joints[at];
            match joint.kind {
                JointKind::Floating => {
                    free = Some(at);
                    break;
                }
                JointKind::Planar | JointKind::Universal | JointKind::Spherical => {
                    let found = format!("which the joint {:?} of type {} carries", joint.name, joint.kind.name());
                    return Err(refused(found, "a link behind joints with one axis, which alone can be reversed"));
                }
                _ => way.push(at),
            }
            root.clone_from(&joint.parent);
        }
        let is_free = free.is_some() || (source.floating_base && floating_base);
        if source.floating_base && !floating_base {
            let root_joint = source.root_joint_name();
            source.starts.iter_mut().for_each(|start| start.forget(&[&root_joint]));
        }
        if !is_free && !way.is_empty() {
            refuse_parts_of_base(&source, &refused)?;
        }
        if let Some(of) = free.map(|at| &source.joints[at]) {
            let losses = [of.armature, of.damping, of.friction, of.spring.stiffness];
            if losses.iter().any(|of| *of != 0.0) || of.friction_curve != FrictionCurve::default() {
                let found = format!("which the free joint {:?} with armature, losses or a spring carries", of.name);
                return Err(refused(found, "a free joint without them, because they act along axes of its link"));
            }
        }
        if is_free && !way.is_empty() {
            let name = free.map_or_else(|| source.root_joint_name(), |at| source.joints[at].name.clone());
            let known = source.starts.iter().filter_map(|start| start.keyframe.clone());
            let keyframes: Vec<_> = [None].into_iter().chain(known.map(Some)).collect();
            for keyframe in keyframes {
                if self.initial_velocity(keyframe.as_deref())?.iter().any(|v| *v != 0.0) {
                    let of = keyframe.map_or_else(|| "the start".to_owned(), |of| format!("the keyframe {of:?}"));
                    return Err(refused(format!("with velocities in {of}"), "a scene whose starts are at rest"));
                }
                let q = self.initial(keyframe.as_deref())?;
                let carrier = free.map(|at| &source.joints[at]);
                let origin = match carrier {
                    Some(of) => self.placement(&q, &of.parent)?.compose(&of.origin),
                    None => RigidShift::identity(),
                };
                let pose = origin.inverse().compose(&self.placement(&q, link)?);
                let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(pose.rotation));
                let values = pose.lever.iter().chain(turn.coords.iter()).copied().collect();
                if !source.starts.iter().any(|start| start.keyframe == keyframe) {
                    source.starts.push(Start::new(keyframe.as_deref()));
                }
                if let Some(start) = source.starts.iter_mut().find(|start| start.keyframe == keyframe) {
                    start.q.insert(name.clone(), values);
                }
            }
        }
        for &at in &way {
            reverse(&mut source, at);
        }
        let reversed: Vec<String> = way.iter().map(|&at| source.joints[at].name.clone()).collect();
        source.locked.retain(|(joint, _)| !reversed.contains(joint));
        if let Some(at) = free {
            link.clone_into(&mut source.joints[at].child);
        }
        source.floating_base = floating_base;
        source.build()
    }
}

/// Reverses a joint: its child becomes the parent.
fn reverse(source: &mut SceneBuilder, at: usize) {
    let fresh = |name: String, is_known: &dyn Fn(&str) -> bool| {
        let mut name = name;
        while is_known(&name) {
            name.push('_');
        }
        name
    };
    let joint = &source.joints[at];
    let (parent, inverse) = (joint.parent.clone(), joint.origin.inverse());
    if joint.kind == JointKind::Fixed {
        let joint = &mut source.joints[at];
        joint.parent = std::mem::replace(&mut joint.child, parent);
        joint.origin = inverse;
        return;
    }
    let frame = fresh(format!("{parent}_at_{}", joint.name), &|name| source.links.iter().any(|of| of.name == name));
    let name = fresh(format!("{}_reversed", joint.name), &|name| source.joints.iter().any(|of| of.name == name));
    let joint = &mut source.joints[at];
    joint.parent = std::mem::replace(&mut joint.child, frame.clone());
    (joint.origin, joint.axis) = (RigidShift::identity(), -joint.axis);
    source.links.push(LinkDescription { name: frame.clone(), inertial: None });
    let mut fixed = JointDescription::new(name, JointKind::Fixed, frame, parent);
    fixed.origin = inverse;
    source.joints.push(fixed);
}

/// Refuses parts of a base that another link would become.
fn refuse_parts_of_base(source: &SceneBuilder, refused: &dyn Fn(String, &str) -> Error) -> Result<(), Error> {
    let is_of_links = |of: &&Connection| of.other.is_none() && !matches!(of.kind, ConnectionKind::Joint(_));
    let connection = source.connections.iter().find(is_of_links).map(|of| ("connection", &of.name));
    let contact = source.contacts.iter().find(|of| of.other.is_none()).map(|of| ("contact", &of.name));
    let collider = source.collisions.colliders.iter().find(|of| of.link.is_none()).map(|of| ("collider", &of.name));
    let Some((what, name)) = connection.or(contact).or(collider) else { return Ok(()) };
    let expected = "no connections, contacts and colliders of the fixed base, which is the root link";
    Err(refused(format!("with the {what} {name:?} of the base"), expected))
}
