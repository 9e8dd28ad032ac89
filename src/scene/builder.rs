//! From links and joints by name to a [`Scene`]: the checks, the order, the merging.

use super::description::{Inertial, JointDescription, JointKind, LinkDescription, SceneWarning};
use super::inertia_check::{check_numbers, unphysical};
use super::joint_check::check_joint;
use super::{Joint, Link, Scene};
use crate::error::Error;
use crate::scene::model::Motion;
use crate::spatial::{BodyInertia, BodyRoot, RigidShift, inertia_root, join_roots, root_of_merged};
use nalgebra::{Matrix3, Vector3, Vector6};
use std::collections::{HashMap, HashSet};

/// Name of the joint that a floating base gets.
pub const ROOT_JOINT: &str = "root_joint";

/// Collects links and joints; [`SceneBuilder::build`] checks them and makes the scene.
///
/// ```
/// use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
/// use phipsi::spatial::Symmetric3;
/// # fn main() -> Result<(), phipsi::Error> {
/// let rod = Inertial {
///     mass: 1.0,
///     centre: [0.0, 0.0, -0.5].into(),
///     central: Symmetric3::new([0.08, 0.0, 0.0, 0.08, 0.0, 0.001]),
/// };
/// let mut hinge = JointDescription::new("hinge", JointKind::Revolute, "base", "rod");
/// hinge.axis = [0.0, 1.0, 0.0].into();
/// let scene = SceneBuilder::new()
///     .link(LinkDescription { name: "base".into(), inertial: None })
///     .link(LinkDescription { name: "rod".into(), inertial: Some(rod) })
///     .joint(hinge)
///     .build()?;
/// assert_eq!(scene.nv(), 1);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SceneBuilder {
    pub(super) links: Vec<LinkDescription>,
    pub(super) joints: Vec<JointDescription>,
    pub(super) gravity: Vector3<f64>,
    pub(super) floating_base: bool,
    pub(super) strict: bool,
}

impl Default for SceneBuilder {
    fn default() -> Self {
        Self::new()
    }
}

impl SceneBuilder {
    /// An empty scene with a fixed base and gravity (0, 0, -9.81).
    #[must_use]
    pub fn new() -> Self {
        Self {
            links: Vec::new(),
            joints: Vec::new(),
            gravity: Vector3::new(0.0, 0.0, -9.81),
            floating_base: false,
            strict: false,
        }
    }

    /// Adds a link.
    #[must_use]
    pub fn link(mut self, link: LinkDescription) -> Self {
        self.links.push(link);
        self
    }

    /// Adds a joint; the links that it names may come later.
    #[must_use]
    pub fn joint(mut self, joint: JointDescription) -> Self {
        self.joints.push(joint);
        self
    }

    /// Sets gravity in the base frame, m/s^2.
    #[must_use]
    pub fn gravity(mut self, gravity: [f64; 3]) -> Self {
        self.gravity = gravity.into();
        self
    }

    /// Puts a free joint, named "`root_joint`", under the root link.
    #[must_use]
    pub fn floating_base(mut self, floating: bool) -> Self {
        self.floating_base = floating;
        self
    }

    /// Makes unphysical inertias and mimics of unknown joints an error.
    #[must_use]
    pub fn strict(mut self, strict: bool) -> Self {
        self.strict = strict;
        self
    }

    /// Gravity as set so far, m/s^2.
    #[must_use]
    pub fn gravity_vector(&self) -> [f64; 3] {
        self.gravity.into()
    }

    /// The links so far.
    #[must_use]
    pub fn links(&self) -> &[LinkDescription] {
        &self.links
    }

    /// The joints so far.
    #[must_use]
    pub fn joints(&self) -> &[JointDescription] {
        &self.joints
    }

    /// Whether the base floats.
    #[must_use]
    pub fn is_floating(&self) -> bool {
        self.floating_base
    }

    /// Whether unphysical inertias are an error.
    #[must_use]
    pub fn is_strict(&self) -> bool {
        self.strict
    }

    /// Checks everything and makes the scene: bodies in depth-first order, siblings in the order of their joints, fixed
    /// joints merged, axes turned onto z.
    ///
    /// # Errors
    ///
    /// [`Error::Scene`], naming the link or joint, for: no link, a name used twice, an unknown parent or child, a link
    /// with two parents, two roots, a cycle, an axis of no direction, numbers that are not finite, a negative mass,
    /// armature, damping or friction, lower limit above upper; with `strict`, an unphysical inertia or a mimic of an
    /// unknown joint.
    pub fn build(self) -> Result<Scene, Error> {
        let tree = self.check_tree()?;
        self.check_numbers()?;
        let warnings = self.warnings()?;
        Ok(Assembly { scene: Scene::unfilled(self, warnings) }.run(&tree))
    }

    /// Children's joints of each link, and the root.
    fn check_tree(&self) -> Result<Tree, Error> {
        if !self.gravity.iter().all(|g| g.is_finite()) {
            return Err(Error::scene("gravity", format!("{:?}", self.gravity_vector()), "finite numbers"));
        }
        let mut index = HashMap::new();
        for (i, link) in self.links.iter().enumerate() {
            if index.insert(link.name.as_str(), i).is_some() {
                return Err(Error::scene(format!("link {:?}", link.name), "the name twice", "unique link names"));
            }
        }
        let mut names: HashSet<&str> = HashSet::new();
        if self.floating_base {
            names.insert(ROOT_JOINT);
        }
        let mut parent_joint: Vec<Option<usize>> = vec![None; self.links.len()];
        let mut children: Vec<Vec<(usize, usize)>> = vec![Vec::new(); self.links.len()];
        for (j, joint) in self.joints.iter().enumerate() {
            let subject = || format!("joint {:?}", joint.name);
            if !names.insert(&joint.name) {
                return Err(Error::scene(subject(), "the name twice", "unique joint names"));
            }
            let find = |role: &str, name: &str| {
                index.get(name).copied().ok_or_else(|| {
                    Error::scene(subject(), format!("{role} link {name:?}, which is not there"), self.known_links())
                })
            };
            let (parent, child) = (find("parent", &joint.parent)?, find("child", &joint.child)?);
            if let Some(other) = parent_joint[child] {
                return Err(Error::scene(
                    format!("link {:?}", joint.child),
                    format!("two parent joints, {:?} and {:?}", self.joints[other].name, joint.name),
                    "one parent joint a link (loops are not supported)",
                ));
            }
            parent_joint[child] = Some(j);
            children[parent].push((j, child));
        }
        let roots: Vec<usize> = (0..self.links.len()).filter(|&i| parent_joint[i].is_none()).collect();
        let root = match roots[..] {
            [root] => root,
            [] if self.links.is_empty() => return Err(Error::scene("scene", "no link", "at least one link")),
            [] => {
                return Err(Error::scene(
                    format!("link {:?}", self.links[0].name),
                    "a cycle: every link is the child of a joint",
                    "a tree with one root link",
                ));
            }
            [first, second, ..] => {
                return Err(Error::scene(
                    format!("link {:?}", self.links[second].name),
                    format!("a second root beside {:?} ({} in all)", self.links[first].name, roots.len()),
                    "a tree with one root link",
                ));
            }
        };
        let mut reached = vec![false; self.links.len()];
        let mut stack = vec![root];
        while let Some(link) = stack.pop() {
            reached[link] = true;
            stack.extend(children[link].iter().map(|&(_, child)| child));
        }
        if let Some(missed) = reached.iter().position(|&r| !r) {
            return Err(Error::scene(
                format!("link {:?}", self.links[missed].name),
                format!("a cycle: no path from it to the root link {:?}", self.links[root].name),
                "a tree with one root link",
            ));
        }
        Ok(Tree { children, root })
    }

    /// A short list of the links, for messages.
    fn known_links(&self) -> String {
        let names: Vec<_> = self.links.iter().take(8).map(|l| format!("{:?}", l.name)).collect();
        let more = if self.links.len() > 8 { ", ..." } else { "" };
        format!("one of the links {}{more}", names.join(", "))
    }

    fn check_numbers(&self) -> Result<(), Error> {
        for link in &self.links {
            if let Some(inertial) = &link.inertial {
                check_numbers(&link.name, inertial)?;
            }
        }
        self.joints.iter().try_for_each(check_joint)
    }

    fn warnings(&self) -> Result<Vec<SceneWarning>, Error> {
        let mut warnings = Vec::new();
        for link in &self.links {
            if let Some(found) = link.inertial.as_ref().and_then(unphysical) {
                if self.strict {
                    return Err(Error::scene(
                        format!("link {:?}", link.name),
                        found,
                        "an inertia that a body can have (strict)",
                    ));
                }
                warnings.push(SceneWarning::Inertia { link: link.name.clone(), found });
            }
        }
        let names: HashSet<&str> = self.joints.iter().map(|joint| joint.name.as_str()).collect();
        // A fixed joint that keeps its <mimic> has no coordinate to be independent.
        for joint in self.joints.iter().filter(|joint| joint.kind != JointKind::Fixed) {
            if let Some(source) = &joint.mimic {
                if self.strict && !names.contains(source.as_str()) {
                    return Err(Error::scene(
                        format!("joint {:?}", joint.name),
                        format!("a mimic of joint {source:?}, which is not there"),
                        "the name of another joint (strict)",
                    ));
                }
                warnings.push(SceneWarning::Mimic { joint: joint.name.clone(), source: source.clone() });
            }
        }
        Ok(warnings)
    }
}

/// The checked tree: for each link its children as (joint, link), and the root.
struct Tree {
    children: Vec<Vec<(usize, usize)>>,
    root: usize,
}

/// A rotation R with R `e_z` = axis; exact where the axis is a coordinate axis.
fn axis_onto_z(axis: &Vector3<f64>) -> Matrix3<f64> {
    let z = axis / axis.norm();
    if z == Vector3::z() {
        return Matrix3::identity();
    }
    // The coordinate axis least along z gives x by projection; along z itself it would be lost.
    let helper = Vector3::ith(z.iamin(), 1.0);
    let x = (helper - z * z.dot(&helper)).normalize();
    Matrix3::from_columns(&[x, z.cross(&x), z])
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
    fn run(mut self, tree: &Tree) -> Scene {
        let place = if self.scene.source.floating_base {
            let root = JointDescription::new(
                ROOT_JOINT,
                JointKind::Floating,
                "",
                self.scene.source.links[tree.root].name.clone(),
            );
            self.add_joint(&root, (None, RigidShift::identity()))
        } else {
            (None, RigidShift::identity())
        };
        let mut stack: Vec<(Option<usize>, usize, Place)> = vec![(None, tree.root, place)];
        while let Some((joint, link, at)) = stack.pop() {
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
        self.scene
    }

    /// Adds a joint on a parent link placed at `at`; gives the place of its child link.
    fn add_joint(&mut self, joint: &JointDescription, at: Place) -> Place {
        let (parent, placement) = at;
        let origin = placement.compose(&joint.origin);
        if joint.kind == JointKind::Fixed {
            self.scene.merged.push(joint.name.clone());
            return (parent, origin);
        }
        let (first_q, first_v) = (self.scene.model.nq, self.scene.model.nv());
        let align = if joint.kind.has_axis() { axis_onto_z(&joint.axis) } else { Matrix3::identity() };
        let mut push = |parent: Option<usize>, tree: RigidShift<f64>, motion: Motion<f64>| {
            self.scene.joint_of_body.push(self.scene.joints.len());
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
