//! One robot on another, and a part of a robot as a scene of its own.

use super::builder::SceneBuilder;
use super::description::{JointDescription, MimicJoints};
use super::{Connection, ConnectionKind, Scene, Start};
use crate::error::Error;
use crate::joints::JointKind;
use crate::spatial::RigidShift;
use std::collections::{BTreeMap, HashSet};

impl SceneBuilder {
    /// Adds another robot, whose root link is fixed to a link by a joint `name`, by default that of the root link and
    /// "_mount"; `origin` is the pose of its root link in the frame of that link. All its names get the prefix, those
    /// of keyframes too.
    ///
    /// Joints, connections, contacts, colliders, actuators and starts come with it, and a floating base becomes fixed.
    /// Gravity and the other settings of the scene remain those of this builder; colliders of the base of the other
    /// robot, such as a ground, are not part of it.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for a link that this builder does not have, for names that both robots have, and for robots
    /// with mimic joints of which one is coupled.
    pub fn attach(
        mut self,
        other: &Self,
        (link, name): (&str, Option<&str>),
        prefix: &str,
        origin: RigidShift<f64>,
    ) -> Result<Self, Error> {
        if !self.links.iter().any(|own| own.name == link) {
            let names: Vec<&str> = self.links.iter().map(|own| own.name.as_str()).collect();
            return Err(Error::argument("link", format!("{link:?}"), format!("one of {}", names.join(", "))));
        }
        let root = other.root_link()?;
        let mut other = other.clone();
        // Its free joint becomes fixed.
        if other.floating_base {
            let root_joint = other.root_joint_name();
            other.starts.iter_mut().for_each(|start| start.forget(&[&root_joint]));
        }
        // The ground of the other robot is not part of it.
        let collisions = &mut other.collisions;
        collisions.colliders.retain(|collider| collider.link.is_some());
        let kept: HashSet<_> = collisions.colliders.iter().map(|of| of.name.clone()).collect();
        collisions.pairs.retain(|pair| pair.colliders.iter().all(|of| kept.contains(of)));
        collisions.excluded.retain(|links| links.iter().all(Option::is_some));
        let mut other = other.renamed(&|name: &str| format!("{prefix}{name}"));
        let has_mimic = |of: &Self| of.joints.iter().any(|joint| joint.mimic.is_some());
        if self.mimic_joints != other.mimic_joints && has_mimic(&other) {
            if has_mimic(&self) {
                let found = "robots with mimic joints, of which one is coupled";
                return Err(Error::argument("scene", found, "the same treatment of mimic joints for both"));
            }
            self.mimic_joints = other.mimic_joints;
        }
        let name = name.map_or_else(|| format!("{prefix}{root}_mount"), str::to_owned);
        let mut fixed = JointDescription::new(name, JointKind::Fixed, link, format!("{prefix}{root}"));
        fixed.origin = origin;
        other.joints.push(fixed);
        let known: HashSet<&str> = self.links.iter().map(|own| own.name.as_str()).collect();
        let joints: HashSet<&str> = self.joints.iter().map(|own| own.name.as_str()).collect();
        let twice = other.links.iter().map(|of| &of.name).find(|name| known.contains(name.as_str()));
        let twice = twice.or(other.joints.iter().map(|of| &of.name).find(|name| joints.contains(name.as_str())));
        if let Some(twice) = twice {
            let found = format!("{prefix:?} with {twice:?} in both robots");
            return Err(Error::argument("prefix", found, "a prefix after which no name stands twice"));
        }
        self.links.extend(other.links);
        self.joints.extend(other.joints);
        self.connections.extend(other.connections);
        self.contacts.extend(other.contacts);
        self.collisions.colliders.extend(other.collisions.colliders);
        self.collisions.pairs.extend(other.collisions.pairs);
        self.collisions.excluded.extend(other.collisions.excluded);
        self.locked.extend(other.locked);
        self.notes.extend(other.notes);
        for actuator in other.actuators {
            self = self.actuator(actuator);
        }
        for start in other.starts {
            match self.starts.iter_mut().find(|own| own.keyframe == start.keyframe) {
                Some(own) => {
                    own.q.extend(start.q);
                    own.qd.extend(start.qd);
                }
                None => self.starts.push(start),
            }
        }
        Ok(self)
    }

    /// The link that no joint carries.
    fn root_link(&self) -> Result<String, Error> {
        let children: HashSet<&str> = self.joints.iter().map(|joint| joint.child.as_str()).collect();
        let root = self.links.iter().find(|link| !children.contains(link.name.as_str()));
        root.map(|link| link.name.clone()).ok_or_else(|| Error::argument("scene", "no link", "a scene with links"))
    }

    /// The same description with other names.
    fn renamed(mut self, name: &dyn Fn(&str) -> String) -> Self {
        let change = |of: &mut String| *of = name(of);
        let optional = |of: &mut Option<String>| of.iter_mut().for_each(change);
        self.links.iter_mut().for_each(|link| change(&mut link.name));
        for joint in &mut self.joints {
            [&mut joint.name, &mut joint.parent, &mut joint.child].into_iter().for_each(change);
            joint.mimic.iter_mut().for_each(|mimic| change(&mut mimic.joint));
        }
        for connection in &mut self.connections {
            [&mut connection.name, &mut connection.link].into_iter().for_each(change);
            optional(&mut connection.other);
        }
        for contact in &mut self.contacts {
            [&mut contact.name, &mut contact.link].into_iter().for_each(change);
            optional(&mut contact.other);
        }
        for collider in &mut self.collisions.colliders {
            change(&mut collider.name);
            optional(&mut collider.link);
        }
        self.collisions.pairs.iter_mut().flat_map(|pair| &mut pair.colliders).for_each(change);
        self.collisions.excluded.iter_mut().flatten().for_each(optional);
        self.locked.iter_mut().for_each(|(joint, _)| change(joint));
        for start in &mut self.starts {
            optional(&mut start.keyframe);
            for of in [&mut start.q, &mut start.qd] {
                *of = std::mem::take(of).into_iter().map(|(joint, values)| (name(&joint), values)).collect();
            }
        }
        for actuator in &mut self.actuators {
            change(&mut actuator.name);
            if !actuator.joint.is_empty() {
                change(&mut actuator.joint);
            }
            let keyframes: BTreeMap<_, _> = std::mem::take(&mut actuator.keyframes);
            actuator.keyframes = keyframes.into_iter().map(|(keyframe, values)| (name(&keyframe), values)).collect();
        }
        self
    }
}

impl Scene {
    /// The part of the robot that a link carries, as a scene: the link is its root, on a fixed or a floating base.
    ///
    /// Contacts, colliders, actuators and the start of these links and joints come with it.
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for an unknown link, for a connection and a mimic joint between this part and the rest.
    pub fn subtree(&self, link: &str, floating_base: bool) -> Result<Self, Error> {
        self.link(link)?;
        let mut source = self.source().clone();
        let mut kept: HashSet<String> = HashSet::from([link.to_owned()]);
        loop {
            let more: Vec<_> = source.joints.iter().filter(|joint| kept.contains(&joint.parent)).collect();
            let more: Vec<_> = more.iter().map(|joint| joint.child.clone()).filter(|of| !kept.contains(of)).collect();
            if more.is_empty() {
                break;
            }
            kept.extend(more);
        }
        source.links.retain(|of| kept.contains(&of.name));
        source.joints.retain(|joint| kept.contains(&joint.parent));
        let joints: HashSet<String> = source.joints.iter().map(|joint| joint.name.clone()).collect();
        let across = |name: &str, what: &str| {
            let found = format!("{link:?}, which {what} {name:?} connects with other links");
            Error::argument("link", found, "a link whose part of the robot is connected with no other")
        };
        let mut connections = Vec::new();
        for connection in std::mem::take(&mut source.connections) {
            let inside =
                |name: &String| if is_of_joints(&connection) { joints.contains(name) } else { kept.contains(name) };
            match (inside(&connection.link), connection.other.as_ref().map(inside)) {
                (true, Some(true)) => connections.push(connection),
                (false, None | Some(false)) => {}
                // A joint at a fixed coordinate.
                (true, None) if is_of_joints(&connection) => connections.push(connection),
                _ => return Err(across(&connection.name, "the connection")),
            }
        }
        source.connections = connections;
        let outside = |joint: &&JointDescription| joint.mimic.as_ref().is_some_and(|of| !joints.contains(&of.joint));
        if source.mimic_joints == MimicJoints::Coupled
            && let Some(joint) = source.joints.iter().find(outside)
        {
            return Err(across(&joint.name, "the mimic joint"));
        }
        for joint in source.joints.iter_mut().filter(|joint| outside(&&**joint)) {
            joint.mimic = None;
        }
        let is_kept = |of: &Option<String>| of.as_ref().is_none_or(|of| kept.contains(of));
        source.contacts.retain(|contact| kept.contains(&contact.link) && is_kept(&contact.other));
        source.collisions.colliders.retain(|collider| is_kept(&collider.link));
        let colliders: HashSet<_> = source.collisions.colliders.iter().map(|of| of.name.clone()).collect();
        source.collisions.pairs.retain(|pair| pair.colliders.iter().all(|of| colliders.contains(of)));
        source.collisions.excluded.retain(|links| links.iter().all(is_kept));
        source.actuators.retain(|actuator| joints.contains(&actuator.joint));
        source.locked.retain(|(joint, _)| joints.contains(joint));
        let removed: Vec<&str> =
            self.source().joints.iter().map(|of| of.name.as_str()).filter(|of| !joints.contains(*of)).collect();
        let root = self.source().root_joint_name();
        source.starts.iter_mut().for_each(|start: &mut Start| {
            start.forget(&removed);
            start.forget(&[&root]);
        });
        source.floating_base = floating_base;
        source.build()
    }
}

/// True for a connection of two joints, whose ends are names of joints.
fn is_of_joints(connection: &Connection) -> bool {
    matches!(connection.kind, ConnectionKind::Joint(_))
}
