//! Locking joints: a new scene with those joints folded into the bodies around them.

use super::Scene;
use super::description::JointDescription;
use super::properties::Properties;
use crate::error::Error;
use crate::joints::JointKind;
use crate::kinematics::joint_shift;
use crate::spatial::RigidShift;
use crate::watch;
use nalgebra::Matrix3;

impl Scene {
    /// The scene with `joints` fixed where the configuration `q` has them; names of links stay.
    ///
    /// A link on a locked joint becomes part of the body that carries it, and so a subtree whose joints are all locked; what is
    /// locked onto the base is no body at all. M, bias and accelerations are those of this scene with the locked rows left out and the locked
    /// rates zero. Joints that follow a locked one are locked with it.
    ///
    /// # Errors
    ///
    /// An unknown joint, or a bad configuration.
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
            watch::check()?;
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
        source.build()
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

/// The nearest rotation to one that products of rotations have worn by rounding: one Newton step, R (3 - R^T R)/2.
fn tidy(shift: &RigidShift<f64>) -> RigidShift<f64> {
    let r = shift.rotation;
    RigidShift { rotation: r * (Matrix3::identity() * 3.0 - r.transpose() * r) * 0.5, lever: shift.lever }
}
