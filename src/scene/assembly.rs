//! The scene of a checked tree: the order, the frames, the merging.

use super::builder::AT_A_TIME;
use super::description::{Inertial, JointDescription, JointKind};
use super::{Joint, Link, Scene};
use crate::error::Error;
use crate::model::Motion;
use crate::spatial::{BodyInertia, BodyRoot, RigidShift, inertia_root, join_roots, root_of_merged};
use crate::watch;
use nalgebra::{Matrix3, Vector3, Vector6};

/// The checked tree: for each link its children as (joint, link), and the root.
pub(super) struct Tree {
    pub children: Vec<Vec<(usize, usize)>>,
    pub root: usize,
}

/// Fills a scene that has no links yet; fails where that is interrupted.
pub(super) fn assemble(unfilled: Scene, tree: &Tree) -> Result<Scene, Error> {
    Assembly { scene: unfilled }.run(tree)
}

/// A rotation R with R `e_z` = axis; exact where the axis is a coordinate axis.
fn axis_onto_z(axis: &Vector3<f64>) -> Matrix3<f64> {
    let z = unit(axis);
    if z == Vector3::z() {
        return Matrix3::identity();
    }
    // The coordinate axis least along z gives x by projection; along z itself it would be lost.
    let helper = Vector3::ith(z.iamin(), 1.0);
    let x = (helper - z * z.dot(&helper)).normalize();
    Matrix3::from_columns(&[x, z.cross(&x), z])
}

/// A vector of length 1 in that direction. Lengths whose square is no number of 64 bits are scaled first; others keep their
/// rounding.
fn unit(axis: &Vector3<f64>) -> Vector3<f64> {
    let size = axis.amax();
    let axis = if (1e-100..1e100).contains(&size) { *axis } else { axis / size };
    axis / axis.norm()
}

/// A pure rotation.
fn turn(rotation: Matrix3<f64>) -> RigidShift<f64> {
    RigidShift { rotation, lever: Vector3::zeros() }
}

/// A link's inertia in the frame of the body that carries it: centre and axes are moved first, so that nothing cancels in
/// the parallel-axis terms.
fn placed(inertial: &Inertial, placement: &RigidShift<f64>) -> BodyInertia<f64> {
    let centre = placement.rotate(&inertial.centre) + placement.lever;
    BodyInertia::from_central(inertial.mass, &centre, &inertial.central.congruence(&placement.rotation))
}

/// The square root of [`placed`], if the inertia is positive.
fn placed_root(inertial: &Inertial, placement: &RigidShift<f64>) -> Option<BodyRoot<f64>> {
    let centre = placement.rotate(&inertial.centre) + placement.lever;
    inertia_root(inertial.mass, centre, &inertial.central, &placement.rotation)
}

/// The absolute sums of the terms that form the diagonal of [`placed`].
fn placed_terms(inertial: &Inertial, placement: &RigidShift<f64>) -> Vector6<f64> {
    let r = placement.rotation.abs();
    let centre = r * inertial.centre.abs() + placement.lever.abs();
    let central = r * inertial.central.to_matrix().abs() * r.transpose();
    let square = centre.component_mul(&centre) * inertial.mass;
    let total = square.sum();
    let angular = |i: usize| central[(i, i)] + (total - square[i]);
    Vector6::new(angular(0), angular(1), angular(2), inertial.mass, inertial.mass, inertial.mass)
}

/// The scene as it grows, depth first.
struct Assembly {
    scene: Scene,
}

/// Where a link is: on a moving body or on the base, at a placement seen from there.
type Place = (Option<usize>, RigidShift<f64>);

impl Assembly {
    fn run(mut self, tree: &Tree) -> Result<Scene, Error> {
        let place = if self.scene.source.floating_base {
            let root = self.scene.source.root_joint(self.scene.source.links[tree.root].name.clone());
            self.add_joint(&root, (None, RigidShift::identity()))
        } else if self.scene.source.omissions.base_links {
            (None, RigidShift::identity())
        } else {
            (Some(self.add_fixed_body(None, RigidShift::identity())), RigidShift::identity())
        };
        let mut stack: Vec<(Option<usize>, usize, Place)> = vec![(None, tree.root, place)];
        while let Some((joint, link, at)) = stack.pop() {
            watch::check_at(self.scene.links.len(), AT_A_TIME)?;
            let at = match joint {
                Some(joint) => {
                    let joint = self.scene.source.joints[joint].clone();
                    self.add_joint(&joint, at)
                }
                None => at,
            };
            self.add_link(link, &at);
            // Reversed, so that the first child in file order is taken first.
            for &(joint, child) in tree.children[link].iter().rev() {
                stack.push((Some(joint), child, at));
            }
        }
        Ok(self.scene)
    }

    /// Adds a joint on a parent link placed at `at`; gives the place of its child link.
    fn add_joint(&mut self, joint: &JointDescription, at: Place) -> Place {
        let (parent, placement) = at;
        let origin = placement.compose(&joint.origin);
        if joint.kind == JointKind::Fixed {
            if parent.is_some() && !self.scene.source.omissions.fixed_joints {
                return (Some(self.add_fixed_body(parent, origin)), RigidShift::identity());
            }
            self.scene.merged.push(joint.name.clone());
            return (parent, origin);
        }
        let (first_q, first_v) = (self.scene.model.nq, self.scene.model.nv());
        let align = if joint.kind.has_axis() { axis_onto_z(&joint.axis) } else { Matrix3::identity() };
        let mut push = |parent: Option<usize>, tree: RigidShift<f64>, motion: Motion<f64>| {
            self.scene.joint_of_body.push(Some(self.scene.joints.len()));
            Some(self.scene.model.push(parent, tree, motion, joint.armature))
        };
        let aligned = origin.compose(&turn(align));
        let body = match joint.kind {
            JointKind::Revolute | JointKind::Continuous => push(parent, aligned, Motion::Revolute),
            JointKind::Prismatic => push(parent, aligned, Motion::Prismatic),
            JointKind::Screw { pitch } => push(parent, aligned, Motion::Screw(pitch)),
            JointKind::Planar => {
                // u, v, theta one after another, through two massless bodies; each frame has its own axis on z.
                let (along_u, along_v) = (axis_onto_z(&Vector3::x()), axis_onto_z(&Vector3::y()));
                let u = push(parent, aligned.compose(&turn(along_u)), Motion::Prismatic);
                let v = push(u, turn(along_u.transpose() * along_v), Motion::Prismatic);
                push(v, turn(along_v.transpose()), Motion::Revolute)
            }
            JointKind::Spherical => push(parent, origin, Motion::Spherical),
            JointKind::Floating => push(parent, origin, Motion::Free),
            JointKind::Fixed => parent,
        };
        self.scene.joint_index.insert(joint.name.clone(), self.scene.joints.len());
        self.scene.joints.push(Joint {
            name: joint.name.clone(),
            kind: joint.kind,
            child: joint.child.clone(),
            q: first_q..self.scene.model.nq,
            v: first_v..self.scene.model.nv(),
            limits: joint.limits,
        });
        (body, turn(align.transpose()))
    }

    /// A body that does not move against its parent, for what could have been merged or dropped.
    fn add_fixed_body(&mut self, parent: Option<usize>, tree: RigidShift<f64>) -> usize {
        self.scene.joint_of_body.push(None);
        self.scene.model.push(parent, tree, Motion::Fixed, 0.0)
    }

    /// Records a link, and adds its inertia to the body that carries it.
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
                // A link that no body can be, merged with others: the sum may be one.
                _ => root_of_merged(&carrier.inertia),
            };
        }
        self.scene.link_index.insert(description.name.clone(), self.scene.links.len());
        self.scene.links.push(Link { name: description.name.clone(), body, placement });
    }
}
