//! Locked joints: a new scene in which they are fixed and their links merged.

use super::Scene;
use super::connection::{ConnectionKind, tidy};
use super::description::JointDescription;
use super::polynomial::Polynomial;
use super::properties::Properties;
use crate::error::{Error, in_language};
use crate::interrupt;
use crate::joints::JointKind;
use crate::kinematics::joint_shift;
use crate::spatial::RigidShift;

/// Largest constraint error accepted for a connection whose two ends are locked to each other, m or rad.
const HELD: f64 = 1e-6;

/// A configuration to lock joints at.
fn closed_by_projection() -> &'static str {
    in_language(
        "a configuration that satisfies the connections, such as the result of Scene::project",
        "a configuration that satisfies the connections, such as the result of scene.loops.project",
    )
}

impl Scene {
    /// A scene with `joints` fixed at their positions in `q`; link names are unchanged.
    ///
    /// A link on a locked joint becomes part of its parent's body, and a subtree whose joints are all locked becomes
    /// one body. Links locked to the base are removed from the dynamics. M, bias and accelerations equal those of this
    /// scene without the rows of the locked joints and with zero velocities there. Joints that follow a locked joint
    /// are locked with it. Connections remain unless both ends are locked to each other, and contacts remain unless
    /// their link cannot move, or cannot move against the other link. The start, the keyframes and the actuators of the
    /// other joints remain.
    ///
    /// ```
    /// # fn main() -> Result<(), phipsi::Error> {
    /// let scene = phipsi::scenes::chain(3)?;
    /// let locked = scene.lock(&["j1"], &[0.0, 0.4, 0.0])?;
    /// assert_eq!(locked.nv(), 2);
    /// assert_eq!(locked.links().len(), scene.links().len());
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    ///
    /// [`Error::Argument`] for an unknown joint, an error for an invalid configuration, and [`Error::Scene`] for a
    /// connection whose ends are locked to each other while it is violated.
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
        source.starts.iter_mut().for_each(|start| start.forget(joints));
        source.actuators.retain(|actuator| !joints.contains(&actuator.joint.as_str()));
        self.lock_connections(&mut source, joints, q)?;
        self.lock_contacts(&mut source)?;
        source.build()
    }

    /// Removes the contacts of links that cannot move, or cannot move against each other.
    fn lock_contacts(&self, source: &mut super::SceneBuilder) -> Result<(), Error> {
        if self.contacts().is_empty() {
            return Ok(());
        }
        let contacts = std::mem::take(&mut source.contacts);
        let built = source.clone().build()?;
        let tree = built.tree();
        let moves = |name: &String| tree.link(name).is_ok_and(|link| tree.carrier(link.body).is_some());
        for contact in contacts {
            // A sphere that cannot move, on a surface that can, is an error of the locked scene.
            let is_swept = contact.other.as_ref().is_some_and(moves) && !moves(&contact.link);
            if is_swept || tree.contact_point(&contact).is_ok() {
                source.contacts.push(contact);
            }
        }
        Ok(())
    }

    /// The connections of the locked scene. Couplings to locked joints become fixed coordinates. Connections whose ends
    /// are rigidly attached to each other are removed if `q` satisfies them.
    fn lock_connections(&self, source: &mut super::SceneBuilder, joints: &[&str], q: &[f64]) -> Result<(), Error> {
        if self.constraints().is_empty() {
            return Ok(());
        }
        let connections = std::mem::take(&mut source.connections);
        let tree = source.clone().build()?;
        let held =
            |name: &str| joints.contains(&name).then(|| self.joint(name).ok().map(|joint| q[joint.q.start])).flatten();
        for (mut connection, constraint) in connections.into_iter().zip(&self.constraints().all) {
            let is_rigid = if let ConnectionKind::Joint(polynomial) = &mut connection.kind {
                if let Some(other) = connection.other.as_deref().and_then(held) {
                    *polynomial = Polynomial::linear(0.0, polynomial.value(other));
                    connection.other = None;
                }
                match (held(&connection.link), connection.other.take()) {
                    (None, other) => {
                        connection.other = other;
                        false
                    }
                    (Some(_), None) => true,
                    (Some(first), Some(other)) => {
                        // The first coordinate determines the other one, unless the polynomial is constant.
                        let is_constant = polynomial.is_below_degree(1);
                        if !is_constant {
                            let (root, left) = polynomial.solve(first, q[self.joint(&other)?.q.start]);
                            if !(left <= HELD * first.abs().max(1.0)) {
                                return Err(Error::scene(
                                    format!("connection {:?}", connection.name),
                                    format!("no coordinate of joint {other:?} for that of the locked joint"),
                                    closed_by_projection(),
                                ));
                            }
                            *polynomial = Polynomial::linear(0.0, root);
                        }
                        connection.link = other;
                        is_constant
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
            let defined = constraint.error(self.model(), q, &mut errors);
            let error = errors.iter().fold(0.0_f64, |largest, error| largest.max(error.abs()));
            if defined.is_none() || !(error <= HELD) {
                return Err(Error::scene(
                    format!("connection {:?}", connection.name),
                    format!("an error of {error:.1e} (m or rad), which the locked joints cannot correct"),
                    closed_by_projection(),
                ));
            }
        }
        Ok(())
    }

    /// Pose of the child link frame in the parent link frame at `q`.
    fn child_placement(&self, joint: &super::Joint, q: &[f64]) -> RigidShift<f64> {
        let model = self.model();
        let bodies =
            (0..model.bodies.len()).filter(|&k| self.joint_of_body(k).is_some_and(|mover| mover.name == joint.name));
        // Composes the poses from the carrier of the parent link to the child's body with those of the two links on
        // their bodies.
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

/// Replaces the free joint of the floating base by a fixed joint.
fn on_a_base(mut source: super::SceneBuilder, free: &super::Joint, placement: &RigidShift<f64>) -> super::SceneBuilder {
    let mut base = "base".to_owned();
    while source.links.iter().any(|link| link.name == base) {
        base.push('_');
    }
    // Armature, damping, friction and stiffness of the free joint are kept.
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
