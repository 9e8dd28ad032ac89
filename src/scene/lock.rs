//! Locking joints: a new scene with those joints folded into the bodies around them.

use super::Scene;
use super::connection::{ConnectionKind, tidy};
use super::description::JointDescription;
use super::properties::Properties;
use crate::error::Error;
use crate::interrupt;
use crate::joints::JointKind;
use crate::kinematics::joint_shift;
use crate::spatial::RigidShift;

/// How much a connection of links that are locked onto each other may be off, m or rad.
const HELD: f64 = 1e-6;

impl Scene {
    /// The scene with `joints` fixed where the configuration `q` has them; names of links stay.
    ///
    /// A link on a locked joint becomes part of the body that carries it, and so a subtree whose joints are all locked; what is
    /// locked onto the base is no body at all. M, bias and accelerations are those of this scene with the locked rows left out and the locked
    /// rates zero. Joints that follow a locked one are locked with it. Connections stay, but for those whose two ends are locked onto each other, and
    /// contacts, but for those of links that cannot move any more.
    ///
    /// # Errors
    ///
    /// An unknown joint, a bad configuration, and a connection that does not hold there and never can.
    pub fn lock(&self, joints: &[&str], q: &[f64]) -> Result<Self, Error> {
        self.check_coordinates("q", q)?;
        if let Some(coupling) = self.coupling() {
            let followers = joints
                .iter()
                .map(|name| self.joint(name).map(|joint| coupling.moved_by(joint)))
                .collect::<Result<Vec<_>, _>>()?;
            let all: Vec<&str> = followers.iter().flatten().map(String::as_str).collect();
            return coupling.tree().lock(&all, &coupling.configuration(q));
        }
        let mut source = self.source().clone();
        let free = source.floating_base.then(|| source.root_joint_name());
        for name in joints {
            interrupt::check()?;
            let joint = self.joint(name)?;
            let moved = self.child_placement(joint, q);
            source.locked.push((joint.name.clone(), joint.kind));
            if source.floating_base && free.as_deref() == Some(*name) {
                source.floating_base = false;
                source = on_a_base(source, joint, &moved);
                continue;
            }
            if let Some(description) = source.joints.iter_mut().find(|d| d.name == *name) {
                description.kind = JointKind::Fixed;
                description.mimic = None;
                description.origin = tidy(&moved);
            }
        }
        self.lock_connections(&mut source, joints, q)?;
        self.lock_contacts(&mut source)?;
        source.build()
    }

    /// Without the contacts of what cannot move any more.
    fn lock_contacts(&self, source: &mut super::SceneBuilder) -> Result<(), Error> {
        if self.contact_points().is_empty() {
            return Ok(());
        }
        let contacts = std::mem::take(&mut source.contacts);
        let tree = source.clone().build()?;
        for contact in contacts {
            if tree.contact_point(&contact).is_ok() {
                source.contacts.push(contact);
            }
        }
        Ok(())
    }

    /// The connections of the locked scene: couplings of locked joints with what these are held at, and without those whose ends are rigidly attached
    /// to each other by now, if they hold at `q`.
    fn lock_connections(&self, source: &mut super::SceneBuilder, joints: &[&str], q: &[f64]) -> Result<(), Error> {
        if self.constraints().is_empty() {
            return Ok(());
        }
        let connections = std::mem::take(&mut source.connections);
        let tree = source.clone().build()?;
        let held =
            |name: &str| joints.contains(&name).then(|| self.joint(name).ok().map(|joint| q[joint.q.start])).flatten();
        for (mut connection, constraint) in connections.into_iter().zip(&self.constraints().all) {
            let is_rigid = if let ConnectionKind::Joint { multiplier, offset } = &mut connection.kind {
                if let Some(other) = connection.other.as_deref().and_then(held) {
                    *offset += *multiplier * other;
                    connection.other = None;
                }
                match (held(&connection.link), connection.other.take()) {
                    (None, other) => {
                        connection.other = other;
                        false
                    }
                    (Some(_), None) => true,
                    (Some(first), Some(other)) => {
                        // The other is held by the first, unless it does not matter to it.
                        *offset = (first - *offset) / *multiplier;
                        connection.link = other;
                        *multiplier == 0.0
                    }
                }
            } else {
                let body = |name: &str| tree.link(name).map(|link| tree.carrier(link.body));
                body(&connection.link)? == connection.other.as_deref().map_or(Ok(None), body)?
            };
            if !is_rigid {
                source.connections.push(connection);
                continue;
            }
            let mut errors = vec![f64::NAN; constraint.rows().len()];
            let told = constraint.error(self.model(), q, &mut errors);
            let error = errors.iter().fold(0.0_f64, |largest, error| largest.max(error.abs()));
            if told.is_none() || !(error <= HELD) {
                return Err(Error::scene(
                    format!("connection {:?}", connection.name),
                    format!("an error of {error:.1e} (m or rad) that the locked joints leave as it is"),
                    "a configuration that meets the connections, as scene.project gives it",
                ));
            }
        }
        Ok(())
    }

    /// The child link's frame seen from the parent link's, at `q`.
    fn child_placement(&self, joint: &super::Joint, q: &[f64]) -> RigidShift<f64> {
        let model = self.model();
        let bodies =
            (0..model.bodies.len()).filter(|&k| self.joint_of_body(k).is_some_and(|mover| mover.name == joint.name));
        // From the carrier of the parent link to the child's body, then the frames of the two links on them.
        let on_carrier =
            bodies.fold(RigidShift::identity(), |shift, k| shift.compose(&joint_shift(&model.bodies[k], q)));
        let child = self.link(&joint.child).map_or_else(|_| RigidShift::identity(), |link| link.placement);
        let parent = self
            .source()
            .joints
            .iter()
            .find(|description| description.name == joint.name)
            .and_then(|description| self.link(&description.parent).ok())
            .map_or_else(RigidShift::identity, |link| link.placement);
        parent.inverse().compose(&on_carrier).compose(&child)
    }
}

/// A fixed joint in place of the floating base's free one.
fn on_a_base(mut source: super::SceneBuilder, free: &super::Joint, placement: &RigidShift<f64>) -> super::SceneBuilder {
    let mut base = "base".to_owned();
    while source.links.iter().any(|link| link.name == base) {
        base.push('_');
    }
    // Of the free joint it keeps what that has beside its freedom.
    let mut joint = JointDescription {
        name: free.name.clone(),
        kind: JointKind::Fixed,
        parent: base.clone(),
        ..source.root_joint(free.child.clone())
    };
    source.root = Properties::default();
    joint.origin = tidy(placement);
    source.links.insert(0, super::LinkDescription { name: base, inertial: None });
    source.joints.insert(0, joint);
    source
}
