//! Assembles a scene from a checked tree: order of bodies, body frames, merging of fixed joints.

use super::description::{Inertial, JointDescription};
use super::{Joint, Link, Scene};
use crate::error::Error;
use crate::interrupt;
use crate::joints::{JointKind, Parts};
use crate::model::Motion;
use crate::spatial::{BodyInertia, BodyRoot, RigidShift, inertia_root, join_roots, root_of_merged};
use nalgebra::Vector6;

/// Number of links or joints processed between two interruption checks.
pub(crate) const AT_A_TIME: usize = 1 << 12;

/// The checked tree: the (joint, child link) pairs of every link, and the root link.
pub(super) struct Tree {
    pub children: Vec<Vec<(usize, usize)>>,
    pub root: usize,
}

/// Fills an empty scene with links and joints. Fails only if it is interrupted.
pub(super) fn assemble(unfilled: Scene, tree: &Tree) -> Result<Scene, Error> {
    Assembly { scene: unfilled }.run(tree)
}

/// Inertia of a link in the frame of the body that carries it. Center of mass and axes are transformed before the
/// parallel-axis terms are formed, so that these terms do not cancel.
fn placed(inertial: &Inertial, placement: &RigidShift<f64>) -> BodyInertia<f64> {
    let center = placement.rotate(&inertial.center) + placement.lever;
    BodyInertia::from_central(inertial.mass, &center, &inertial.central.congruence(&placement.rotation))
}

/// The square root of [`placed`], if the inertia is positive definite.
fn placed_root(inertial: &Inertial, placement: &RigidShift<f64>) -> Option<BodyRoot<f64>> {
    let center = placement.rotate(&inertial.center) + placement.lever;
    inertia_root(inertial.mass, center, &inertial.central, &placement.rotation)
}

/// Sums of the absolute values of the terms of each diagonal entry of [`placed`].
fn placed_terms(inertial: &Inertial, placement: &RigidShift<f64>) -> Vector6<f64> {
    let r = placement.rotation.abs();
    let center = r * inertial.center.abs() + placement.lever.abs();
    let central = r * inertial.central.to_matrix().abs() * r.transpose();
    let square = center.component_mul(&center) * inertial.mass;
    let total = square.sum();
    let angular = |i: usize| central[(i, i)] + (total - square[i]);
    Vector6::new(angular(0), angular(1), angular(2), inertial.mass, inertial.mass, inertial.mass)
}

/// A scene under construction, filled depth first.
struct Assembly {
    scene: Scene,
}

/// The body that carries a link (`None` for the base), and the pose of the link frame in the body frame.
type Place = (Option<usize>, RigidShift<f64>);

impl Assembly {
    fn run(mut self, tree: &Tree) -> Result<Scene, Error> {
        let place = if self.scene.source.floating_base {
            let root = self.scene.source.root_joint(self.scene.source.links[tree.root].name.clone());
            self.add_joint(&root, (None, RigidShift::identity()))
        } else if self.scene.source.simplifications.base_links {
            (None, RigidShift::identity())
        } else {
            (Some(self.add_fixed_body(None, RigidShift::identity())), RigidShift::identity())
        };
        let mut stack: Vec<(Option<usize>, usize, Place)> = vec![(None, tree.root, place)];
        while let Some((joint, link, at)) = stack.pop() {
            interrupt::check_at(self.scene.links.len(), AT_A_TIME)?;
            let at = match joint {
                Some(joint) => {
                    let joint = self.scene.source.joints[joint].clone();
                    self.add_joint(&joint, at)
                }
                None => at,
            };
            self.add_link(link, &at);
            // Reversed, so that the stack returns the first child in file order first.
            for &(joint, child) in tree.children[link].iter().rev() {
                stack.push((Some(joint), child, at));
            }
        }
        Ok(self.scene)
    }

    /// Adds a joint on a parent link at `at`, and returns the place of its child link.
    fn add_joint(&mut self, joint: &JointDescription, at: Place) -> Place {
        let (parent, placement) = at;
        let origin = placement.compose_rounded(&joint.origin);
        if joint.kind == JointKind::Fixed {
            if parent.is_some() && !self.scene.source.simplifications.fixed_joints {
                return (Some(self.add_fixed_body(parent, origin)), RigidShift::identity());
            }
            self.scene.merged.push(joint.name.clone());
            return (parent, origin);
        }
        let (first_q, first_v) = (self.scene.model.nq, self.scene.model.nv());
        let Parts { motions, end } = joint.kind.parts(&joint.axis);
        let (mut body, mut at) = (parent, origin);
        for (tree, motion) in motions {
            self.scene.joint_of_body.push(Some(self.scene.joints.len()));
            body = Some(self.scene.model.push(body, at.compose_rounded(&tree), motion, joint.armature));
            at = RigidShift::identity();
        }
        self.scene.joint_index.insert(joint.name.clone(), self.scene.joints.len());
        self.scene.joints.push(Joint {
            name: joint.name.clone(),
            kind: joint.kind,
            child: joint.child.clone(),
            q: first_q..self.scene.model.nq,
            v: first_v..self.scene.model.nv(),
            limits: joint.limits,
        });
        (body, end)
    }

    /// Adds a body that is fixed to its parent, for a joint that would otherwise be merged or removed.
    fn add_fixed_body(&mut self, parent: Option<usize>, tree: RigidShift<f64>) -> usize {
        self.scene.joint_of_body.push(None);
        self.scene.model.push(parent, tree, Motion::Fixed, 0.0)
    }

    /// Stores a link and adds its inertia to the body that carries it.
    fn add_link(&mut self, link: usize, at: &Place) {
        let description = &self.scene.source.links[link];
        let (body, placement) = *at;
        if let (Some(body), Some(inertial)) = (body, &description.inertial) {
            let carrier = &mut self.scene.model.bodies[body];
            carrier.inertia = carrier.inertia.add(&placed(inertial, &placement));
            carrier.inertia_terms += placed_terms(inertial, &placement);
            let root = &mut self.scene.model.inertia_roots[body];
            *root = match (*root, placed_root(inertial, &placement)) {
                (Some(first), Some(second)) => Some(join_roots(&first, &second)),
                // The inertia of this link alone is nonphysical; the sum over the merged links can be physical.
                _ => root_of_merged(&carrier.inertia),
            };
        }
        self.scene.link_index.insert(description.name.clone(), self.scene.links.len());
        self.scene.links.push(Link { name: description.name.clone(), body, placement });
    }
}
