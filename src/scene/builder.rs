//! From links and joints by name to a [`Scene`]: what the user says, and the checks of it.

use super::Scene;
use super::assembly::{Tree, assemble};
use super::connection::Connection;
use super::contact::Contact;
use super::description::{JointDescription, LinkDescription, MimicJoints, SceneWarning};
use super::inertia_check::check_numbers;
use super::joint_check::check_joint;
use super::properties::Properties;
use crate::error::Error;
use crate::joints::JointKind;
use crate::model::Simplifications;
use crate::{interrupt, memory};
use nalgebra::Vector3;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

/// Name of the joint that a floating base gets, unless a joint of the scene has it.
pub const ROOT_JOINT: &str = "root_joint";

/// Links or joints that are looked at before it is asked whether to go on.
pub(crate) const AT_A_TIME: usize = 1 << 12;

/// Linkages that are looser than this are no planar linkages drawn with few digits.
const MOST_TOLERANCE: f64 = 0.1;

/// About what a link with its joint takes in a scene, in bytes, beside what describes it.
pub(crate) const A_LINK: usize = 2_000;

/// Collects links and joints; [`SceneBuilder::build`] checks them and makes the scene.
///
/// ```
/// use phipsi::scene::{Inertial, JointDescription, JointKind, LinkDescription, SceneBuilder};
/// use phipsi::spatial::Symmetric3;
/// # fn main() -> Result<(), phipsi::Error> {
/// let rod = Inertial {
///     mass: 1.0,
///     center: [0.0, 0.0, -0.5].into(),
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
    /// What closes loops.
    pub(super) connections: Vec<Connection>,
    /// What may touch planes of the world.
    pub(super) contacts: Vec<Contact>,
    pub(super) gravity: Vector3<f64>,
    pub(super) floating_base: bool,
    pub(super) strict: bool,
    /// The geometric tolerance of linkages; none: the default.
    pub(super) tolerance: Option<f64>,
    pub(super) simplifications: Simplifications,
    /// What the free joint of a floating base has beside its freedom.
    pub(super) root: Properties,
    /// The joints that [`Scene::lock`] fixed, with what they were.
    pub(super) locked: Vec<(String, JointKind)>,
    /// Whether links and joints come from a file: from code, a scene without mass is meant so.
    pub(super) from_file: bool,
    /// The file that links and joints come from.
    pub(super) file: Option<PathBuf>,
    /// What becomes of joints with a mimic.
    pub(super) mimic_joints: MimicJoints,
    /// What the file was read with, for the scene's warnings.
    pub(super) notes: Vec<SceneWarning>,
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
            connections: Vec::new(),
            contacts: Vec::new(),
            gravity: Vector3::new(0.0, 0.0, -9.81),
            floating_base: false,
            strict: false,
            tolerance: None,
            simplifications: Simplifications::default(),
            root: Properties::default(),
            locked: Vec::new(),
            from_file: false,
            file: None,
            mimic_joints: MimicJoints::default(),
            notes: Vec::new(),
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

    /// Adds a connection that closes a loop; the links that it names may come later. [`SceneBuilder::build`] checks it.
    #[must_use]
    pub fn connect(mut self, connection: Connection) -> Self {
        self.connections.push(connection);
        self
    }

    /// The connections so far.
    #[must_use]
    pub fn connections(&self) -> &[Connection] {
        &self.connections
    }

    /// Adds a contact; the link that it names may come later. [`SceneBuilder::build`] checks it.
    #[must_use]
    pub fn contact(mut self, contact: Contact) -> Self {
        self.contacts.push(contact);
        self
    }

    /// The contacts so far.
    #[must_use]
    pub fn contacts(&self) -> &[Contact] {
        &self.contacts
    }

    /// Sets gravity in the base frame, m/s^2.
    #[must_use]
    pub fn gravity(mut self, gravity: [f64; 3]) -> Self {
        self.gravity = gravity.into();
        self
    }

    /// Puts a free joint under the root link, named [`ROOT_JOINT`], with as many "_" behind as make the name unique.
    #[must_use]
    pub fn floating_base(mut self, floating: bool) -> Self {
        self.floating_base = floating;
        self
    }

    /// Makes an error of unphysical inertias and mimics of unknown joints; in a file also of moving links that all have no
    /// mass, of what is not understood, and of limits that mean nothing.
    #[must_use]
    pub fn strict(mut self, strict: bool) -> Self {
        self.strict = strict;
        self
    }

    /// Says what becomes of joints with a [`Mimic`](super::Mimic); they are free, unless this is called.
    #[must_use]
    pub fn mimic_joints(mut self, mimic_joints: MimicJoints) -> Self {
        self.mimic_joints = mimic_joints;
        self
    }

    /// Sets what is left out; all that can be, unless this is called.
    #[must_use]
    #[doc(hidden)]
    pub fn simplifications(mut self, simplifications: Simplifications) -> Self {
        self.simplifications = simplifications;
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

    /// What is left out.
    #[must_use]
    #[doc(hidden)]
    pub fn left_out(&self) -> Simplifications {
        self.simplifications
    }

    /// The free joint that a floating base puts under the link of that name.
    pub(crate) fn root_joint(&self, link: String) -> JointDescription {
        let mut joint = JointDescription::new(self.root_joint_name(), JointKind::Floating, "", link);
        self.root.give(&mut joint);
        joint
    }

    /// The same of what such a joint has beside its freedom, for a copy of the description elsewhere.
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) fn root_properties(&self) -> Properties {
        self.root
    }

    /// Sets what the free joint of a floating base has beside its freedom.
    #[must_use]
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) fn with_root(mut self, root: Properties) -> Self {
        self.root = root;
        self
    }

    /// Sets the file that it comes from.
    #[must_use]
    #[cfg_attr(not(any(feature = "python", feature = "urdf")), allow(dead_code))]
    pub(crate) fn with_file(mut self, file: Option<PathBuf>) -> Self {
        self.file = file;
        self
    }

    /// The file that it was read from; none where it comes from text or code.
    #[must_use]
    pub fn file(&self) -> Option<&Path> {
        self.file.as_deref()
    }

    /// Names of the joints that were movable before [`Scene::lock`] fixed them.
    pub fn locked_joints(&self) -> impl Iterator<Item = &str> {
        self.locked.iter().map(|(name, _)| name.as_str())
    }

    /// The same joints with what they were, for a copy of the description elsewhere.
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) fn locked(&self) -> &[(String, JointKind)] {
        &self.locked
    }

    /// Notes that these joints were locked; they are fixed joints of the description already.
    #[must_use]
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) fn with_locked(mut self, locked: Vec<(String, JointKind)>) -> Self {
        self.locked = locked;
        self
    }

    /// The description with the locked joints movable again, at zero where they were locked.
    #[must_use]
    pub(crate) fn unlocked(&self) -> Self {
        let mut source = self.clone();
        let locked: HashMap<String, JointKind> = source.locked.drain(..).collect();
        for joint in &mut source.joints {
            if let Some(&kind) = locked.get(&joint.name) {
                joint.kind = kind;
            }
        }
        source
    }

    /// What becomes of joints with a mimic.
    #[must_use]
    #[doc(hidden)]
    pub fn of_mimic_joints(&self) -> MimicJoints {
        self.mimic_joints
    }

    /// The geometric tolerance of linkages: rows of connections that depend on each other to within this angle in rad, or this length over the reach of the loop, count as dependent.
    /// None: 3e-5. A file whose angles have two, three or four decimals sets 5e-3, 2e-3 or 2e-4. With [`SceneBuilder::strict`] only rounding does.
    #[must_use]
    pub fn tolerance(mut self, tolerance: Option<f64>) -> Self {
        self.tolerance = tolerance;
        self
    }

    /// The tolerance that was set, or that a file gave.
    #[must_use]
    pub fn tolerance_of_linkages(&self) -> Option<f64> {
        self.tolerance
    }

    /// Whether unphysical inertias are an error.
    #[must_use]
    pub fn is_strict(&self) -> bool {
        self.strict
    }

    /// Checks everything and makes the scene: bodies in depth-first order, siblings in the order of their joints, fixed
    /// joints merged (unless [`SceneBuilder::simplifications`] says otherwise), axes turned onto z.
    ///
    /// # Errors
    ///
    /// [`Error::Scene`], naming the link or joint, for: no link, a name used twice, an unknown parent or child, a link
    /// with two parents, two roots, a cycle, an axis of no direction, numbers that are not finite, a negative mass,
    /// armature, damping, friction or stiffness, a rest that is no configuration of the joint, lower limit above upper; a
    /// floating base for what floats already, under a root link without mass; with [`MimicJoints::Coupled`] a mimic of what does not move, of a joint of several
    /// coordinates, or in a circle; and what [`SceneBuilder::strict`] makes one. Naming the
    /// connection, for: a name used twice, an unknown link or joint, links that are rigidly attached to each other, frames that are none, an axis of
    /// no direction, a length that is not above zero, joints of several axes. Naming the contact, for: a name used twice, an unknown link or one that
    /// cannot move, a normal of no direction, numbers that are not finite, a negative radius or friction, a restitution that is not from 0 to 1,
    /// connections beside contacts.
    pub fn build(self) -> Result<Scene, Error> {
        memory::room("links", memory::bytes_of::<[u8; A_LINK]>(&[self.links.len()]))?;
        let tree = self.check_tree().map_err(|error| self.with_notes(error))?;
        self.check_numbers()?;
        self.check_base(&tree)?;
        if let Some(tolerance) = self.tolerance
            && !(0.0..=MOST_TOLERANCE).contains(&tolerance)
        {
            let expected = "from 0 (rounding only) to 0.1, in rad or over the reach of the loop";
            return Err(Error::scene("tolerance", crate::error::number(tolerance), expected));
        }
        let warnings = self.warnings(&tree)?;
        let mimic_joints = self.mimic_joints;
        let scene = assemble(Scene::unfilled(self, warnings), &tree)?.connected()?.touching()?;
        if mimic_joints == MimicJoints::Coupled { Scene::coupled(scene) } else { Ok(scene) }
    }

    /// Children's joints of each link, and the root.
    fn check_tree(&self) -> Result<Tree, Error> {
        if !self.gravity.iter().all(|g| g.is_finite()) {
            return Err(Error::scene("gravity", format!("{:?}", self.gravity_vector()), "finite numbers"));
        }
        let mut index = HashMap::new();
        for (i, link) in self.links.iter().enumerate() {
            interrupt::check_at(i, AT_A_TIME)?;
            if index.insert(link.name.as_str(), i).is_some() {
                return Err(Error::scene(format!("link {:?}", link.name), "the name twice", "unique link names"));
            }
        }
        let mut names: HashSet<&str> = HashSet::new();
        let mut parent_joint: Vec<Option<usize>> = vec![None; self.links.len()];
        let mut children: Vec<Vec<(usize, usize)>> = vec![Vec::new(); self.links.len()];
        for (j, joint) in self.joints.iter().enumerate() {
            interrupt::check_at(j, AT_A_TIME)?;
            let subject = || format!("joint {:?}", joint.name);
            if !names.insert(&joint.name) {
                return Err(Error::scene(subject(), "the name twice", "unique joint names"));
            }
            let find = |role: &str, name: &str| {
                index.get(name).copied().ok_or_else(|| {
                    let found = format!("{role} link {name:?}, which is not there");
                    Error::scene(subject(), found, self.known_links(name))
                })
            };
            let (parent, child) = (find("parent", &joint.parent)?, find("child", &joint.child)?);
            if let Some(other) = parent_joint[child] {
                return Err(Error::scene(
                    format!("link {:?}", joint.child),
                    format!("two parent joints, {:?} and {:?}", self.joints[other].name, joint.name),
                    "one parent joint a link (SceneBuilder.connect closes loops)",
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

    /// A short list of the links, for messages; how to declare the ground, for the link that many files leave out.
    pub(super) fn known_links(&self, wanted: &str) -> String {
        let names: Vec<_> = self.links.iter().take(8).map(|l| format!("{:?}", l.name)).collect();
        let more = if self.links.len() > 8 { ", ..." } else { "" };
        let listed = format!("one of the links {}{more}", names.join(", "));
        if wanted == "world" {
            return format!("<link name=\"world\"/> in the file (in code: a link \"world\" without mass), or {listed}");
        }
        listed
    }

    /// The name of the joint that a floating base gets.
    pub(super) fn root_joint_name(&self) -> String {
        let mut name = ROOT_JOINT.to_owned();
        while self.joints.iter().any(|joint| joint.name == name) {
            name.push('_');
        }
        name
    }

    fn check_numbers(&self) -> Result<(), Error> {
        for (i, link) in self.links.iter().enumerate() {
            interrupt::check_at(i, AT_A_TIME)?;
            if let Some(inertial) = &link.inertial {
                check_numbers(&link.name, inertial)?;
            }
        }
        self.joints.iter().try_for_each(check_joint)?;
        check_joint(&self.root_joint(String::new()))
    }
}
