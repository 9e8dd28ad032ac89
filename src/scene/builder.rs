//! Builds a [`Scene`] from links and joints given by name, and checks them.

use super::Scene;
use super::actuator::Actuator;
use super::assembly::{AT_A_TIME, Tree, assemble};
use super::collider::{Collider, ColliderPair, ColliderRules};
use super::connection::Connection;
use super::contact::Contact;
use super::description::{JointDescription, LinkDescription, MimicJoints, SceneWarning};
use super::inertia_check::check_numbers;
use super::joint_check::check_joint;
use super::properties::Properties;
use super::start::Start;
use crate::error::{Error, in_language, known_names};
use crate::joints::JointKind;
use crate::model::Simplifications;
use crate::setters::accessors;
use crate::{interrupt, memory};
use nalgebra::Vector3;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

/// Name of the free joint of a floating base, unless another joint of the scene has that name.
pub const ROOT_JOINT: &str = "root_joint";

/// Largest tolerance accepted for linkages.
const MOST_TOLERANCE: f64 = 0.1;

/// Approximate memory per link and joint in a scene, in bytes, in addition to their descriptions.
pub(crate) const A_LINK: usize = 2_000;

/// Collects links and joints; [`SceneBuilder::build`] checks them and builds the scene.
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
    /// Loop-closing connections.
    pub(super) connections: Vec<Connection>,
    /// Contacts with planes, spheres and boxes of the world and of links.
    pub(super) contacts: Vec<Contact>,
    /// Shapes that touch, and their rules.
    pub(super) collisions: ColliderRules,
    /// The start and the keyframes.
    pub(super) starts: Vec<Start>,
    /// The actuators.
    pub(super) actuators: Vec<Actuator>,
    pub(super) gravity: Vector3<f64>,
    pub(super) floating_base: bool,
    pub(super) strict: bool,
    /// Geometric tolerance of linkages; `None` for the default.
    pub(super) tolerance: Option<f64>,
    pub(super) simplifications: Simplifications,
    /// Armature, damping, friction and stiffness of the free joint of a floating base.
    pub(super) root: Properties,
    /// The joints that [`Scene::lock`] fixed, with their previous kinds.
    pub(super) locked: Vec<(String, JointKind)>,
    /// True if links and joints come from a file. A scene without mass is reported only then.
    pub(super) from_file: bool,
    /// The file that contains the links and joints.
    pub(super) file: Option<PathBuf>,
    /// Robot descriptions as URDF texts whose `<visual>` elements are drawn, in addition to those of the file.
    pub(super) shapes: Vec<String>,
    /// Treatment of mimic joints.
    pub(super) mimic_joints: MimicJoints,
    /// Warnings of the file reader, which the scene reports.
    pub(super) notes: Vec<SceneWarning>,
}

impl Default for SceneBuilder {
    fn default() -> Self {
        Self::new()
    }
}

impl SceneBuilder {
    /// A builder without links, with a fixed base and gravity (0, 0, -9.81) m/s^2.
    #[must_use]
    pub fn new() -> Self {
        Self {
            links: Vec::new(),
            joints: Vec::new(),
            connections: Vec::new(),
            contacts: Vec::new(),
            collisions: ColliderRules::default(),
            starts: Vec::new(),
            actuators: Vec::new(),
            gravity: Vector3::new(0.0, 0.0, -9.81),
            floating_base: false,
            strict: false,
            tolerance: None,
            simplifications: Simplifications::default(),
            root: Properties::default(),
            locked: Vec::new(),
            from_file: false,
            file: None,
            shapes: Vec::new(),
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

    /// Adds a joint. The links that it names can be added later.
    #[must_use]
    pub fn joint(mut self, joint: JointDescription) -> Self {
        self.joints.push(joint);
        self
    }

    /// Adds a connection that closes a loop. The links that it names can be added later; [`SceneBuilder::build`] checks
    /// it.
    #[must_use]
    pub fn connect(mut self, connection: Connection) -> Self {
        self.connections.push(connection);
        self
    }

    /// Adds a contact. The link that it names can be added later; [`SceneBuilder::build`] checks it.
    #[must_use]
    pub fn contact(mut self, contact: Contact) -> Self {
        self.contacts.push(contact);
        self
    }

    /// Adds a shape that touches others. The link that it names can be added later; [`SceneBuilder::build`] checks it.
    #[must_use]
    pub fn collider(mut self, collider: Collider) -> Self {
        self.collisions.colliders.push(collider);
        self
    }

    /// Two colliders that can touch in any case, with their own values.
    #[must_use]
    pub fn collider_pair(mut self, pair: ColliderPair) -> Self {
        self.collisions.pairs.push(pair);
        self
    }

    /// The colliders of two links do not touch each other; `None` for the base.
    #[must_use]
    pub fn exclude(mut self, links: [Option<String>; 2]) -> Self {
        self.collisions.excluded.push(links);
        self
    }

    /// Sets whether the colliders of parent and child can touch; false by default.
    #[must_use]
    pub fn collisions_with_parents(mut self, with_parents: bool) -> Self {
        self.collisions.with_parents = with_parents;
        self
    }

    /// The pairs of colliders with values of their own, the excluded pairs of links, and whether parent and child
    /// touch.
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) fn collision_rules(&self) -> (&[ColliderPair], &[[Option<String>; 2]], bool) {
        let ColliderRules { pairs, excluded, with_parents, .. } = &self.collisions;
        (pairs, excluded, *with_parents)
    }

    /// The colliders added so far.
    #[must_use]
    pub fn colliders(&self) -> &[Collider] {
        &self.collisions.colliders
    }

    /// Sets the start, or adds a keyframe; replaces the one with the same name. The joints that it names can be added
    /// later; [`SceneBuilder::build`] checks it.
    #[must_use]
    pub fn start(mut self, start: Start) -> Self {
        match self.starts.iter_mut().find(|other| other.keyframe == start.keyframe) {
            Some(other) => *other = start,
            None => self.starts.push(start),
        }
        self
    }

    /// Adds an actuator, or replaces the one with the same name. The joint can be added later;
    /// [`SceneBuilder::build`] checks it.
    #[must_use]
    pub fn actuator(mut self, actuator: Actuator) -> Self {
        match self.actuators.iter_mut().find(|other| other.name == actuator.name) {
            Some(other) => *other = actuator,
            None => self.actuators.push(actuator),
        }
        self
    }

    /// Sets gravity in the base frame, m/s^2.
    #[must_use]
    pub fn gravity(mut self, gravity: [f64; 3]) -> Self {
        self.gravity = gravity.into();
        self
    }

    /// Gravity in the base frame, m/s^2.
    #[must_use]
    pub fn gravity_vector(&self) -> [f64; 3] {
        self.gravity.into()
    }

    /// The free joint of a floating base whose root link has the name `link`.
    pub(crate) fn root_joint(&self, link: String) -> JointDescription {
        let mut joint = JointDescription::new(self.root_joint_name(), JointKind::Floating, "", link);
        self.root.give(&mut joint);
        joint
    }

    /// The file that contains the description; `None` for text or code.
    #[must_use]
    pub fn file(&self) -> Option<&Path> {
        self.file.as_deref()
    }

    /// Adds URDF texts whose `<visual>` elements are drawn.
    #[must_use]
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) fn with_shapes(mut self, shapes: impl IntoIterator<Item = String>) -> Self {
        self.shapes.extend(shapes);
        self
    }

    /// Names of the joints that were movable before [`Scene::lock`] fixed them.
    pub fn locked_joints(&self) -> impl Iterator<Item = &str> {
        self.locked.iter().map(|(name, _)| name.as_str())
    }

    /// The description with the locked joints movable again; their locked positions become zero.
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

    /// Checks the description and builds the scene.
    ///
    /// Bodies are in depth-first order, siblings in the order of their joints. Fixed joints are merged (unless
    /// [`SceneBuilder::simplifications`] disables it), and body frames are rotated so that joint axes are along z.
    ///
    /// # Errors
    ///
    /// [`Error::Scene`], which names the link, joint, connection or contact:
    ///
    /// - Links and joints: no link, a duplicate name, an unknown parent or child, a link with two parents, two root
    ///   links, a cycle, a zero axis, values that are not finite, a negative mass, armature, damping, friction or
    ///   stiffness, a spring rest position with the wrong number of coordinates, a lower limit above the upper one, a
    ///   floating base for a robot that has a free joint on a massless root link.
    /// - Mimic joints with [`MimicJoints::Coupled`]: a source joint that is fixed, a joint of several coordinates, a
    ///   cycle.
    /// - Warnings, if [`SceneBuilder::strict`] is set.
    /// - Connections: a duplicate name, an unknown link or joint, links that are rigidly attached to each other, an
    ///   invalid frame, a zero axis, a length that is not positive, joints of several axes.
    /// - Contacts: a duplicate name, a link that is unknown or cannot move, two links that are rigidly attached to each
    ///   other, a zero normal, an invalid frame, values that are not finite, a negative radius or friction, a size that
    ///   is not positive, a restitution outside 0 to 1.
    /// - Starts: a wrong number of values.
    /// - Actuators: a joint with several degrees of freedom, values that are not finite, an empty range.
    ///
    /// [`Error::Argument`] and [`Error::NotFinite`], named after the start or actuator, for an unknown joint, a
    /// quaternion that is not of unit norm, values that are not finite, and joints that follow others (mimic) and are
    /// elsewhere.
    pub fn build(self) -> Result<Scene, Error> {
        memory::room("links", memory::bytes_of::<[u8; A_LINK]>(&[self.links.len()]))?;
        let tree = self.check_tree().map_err(|error| self.with_notes(error))?;
        self.check_numbers()?;
        self.check_base(&tree)?;
        if let Some(tolerance) = self.tolerance
            && !(0.0..=MOST_TOLERANCE).contains(&tolerance)
        {
            let expected = "from 0 (rounding only) to 0.1, in rad or relative to the reach of the loop";
            return Err(Error::scene("tolerance", crate::error::number(tolerance), expected));
        }
        let warnings = self.warnings(&tree)?;
        let mimic_joints = self.mimic_joints;
        let scene = assemble(Scene::unfilled(self, warnings), &tree)?
            .connected()?
            .touching()?
            .colliding()?
            .starting()?
            .actuated()?;
        if mimic_joints == MimicJoints::Coupled { Scene::coupled(scene)?.following() } else { Ok(scene) }
    }

    /// Returns the (joint, child link) pairs of every link, and the root link.
    fn check_tree(&self) -> Result<Tree, Error> {
        if !self.gravity.iter().all(|g| g.is_finite()) {
            return Err(Error::scene("gravity", format!("{:?}", self.gravity_vector()), "finite numbers"));
        }
        let mut index = HashMap::new();
        for (i, link) in self.links.iter().enumerate() {
            interrupt::check_at(i, AT_A_TIME)?;
            if index.insert(link.name.as_str(), i).is_some() {
                return Err(Error::scene(format!("link {:?}", link.name), "a duplicate name", "unique link names"));
            }
        }
        let mut names: HashSet<&str> = HashSet::new();
        let mut parent_joint: Vec<Option<usize>> = vec![None; self.links.len()];
        let mut children: Vec<Vec<(usize, usize)>> = vec![Vec::new(); self.links.len()];
        for (j, joint) in self.joints.iter().enumerate() {
            interrupt::check_at(j, AT_A_TIME)?;
            let subject = || format!("joint {:?}", joint.name);
            if !names.insert(&joint.name) {
                return Err(Error::scene(subject(), "a duplicate name", "unique joint names"));
            }
            let find = |role: &str, name: &str| {
                index.get(name).copied().ok_or_else(|| {
                    let found = format!("{role} link {name:?}, which does not exist");
                    Error::scene(subject(), found, self.known_links(name))
                })
            };
            let (parent, child) = (find("parent", &joint.parent)?, find("child", &joint.child)?);
            if let Some(other) = parent_joint[child] {
                return Err(Error::scene(
                    format!("link {:?}", joint.child),
                    format!("two parent joints, {:?} and {:?}", self.joints[other].name, joint.name),
                    format!(
                        "one parent joint per link ({} closes loops)",
                        in_language("SceneBuilder::connect", "SceneBuilder.connect")
                    ),
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
                    format!("a second root link besides {:?} ({} in all)", self.links[first].name, roots.len()),
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

    /// A short list of the links, for messages. For "world", which many files omit, the text shows how to declare it.
    pub(super) fn known_links(&self, wanted: &str) -> String {
        let names = known_names(wanted, self.links.iter().map(|link| link.name.as_str()), 8);
        let listed = format!("one of the links {names}");
        if wanted == "world" {
            return format!("<link name=\"world\"/> in the file (in code: a link \"world\" without mass), or {listed}");
        }
        listed
    }

    /// The name of the free joint of a floating base.
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

accessors!(SceneBuilder {
    /// The connections added so far.
    pub view connections(connections): &[Connection];

    /// The contacts added so far.
    pub view contacts(contacts): &[Contact];

    /// The start and the keyframes added so far.
    pub view starts(starts): &[Start];

    /// The actuators added so far.
    pub view actuators(actuators): &[Actuator];

    /// Adds a free joint between the base and the root link. Its name is [`ROOT_JOINT`], followed by the number of "_"
    /// that makes it unique.
    pub set floating_base(floating_base): bool;

    /// Turns warnings into errors: nonphysical inertias and mimics of unknown joints; for a file also moving links
    /// without mass, unrecognized elements and invalid limits.
    pub set strict(strict): bool;

    /// Sets the treatment of joints with a [`Mimic`](super::Mimic); the default is [`MimicJoints::Free`].
    pub set mimic_joints(mimic_joints): MimicJoints;

    /// Sets the simplifications; all are on by default.
    #[doc(hidden)]
    pub set simplifications(simplifications): Simplifications;

    /// The links added so far.
    pub view links(links): &[LinkDescription];

    /// The joints added so far.
    pub view joints(joints): &[JointDescription];

    /// True if the base is floating.
    pub get is_floating(floating_base): bool;

    /// The simplifications.
    #[doc(hidden)]
    pub get left_out(simplifications): Simplifications;

    /// Armature, damping, friction and stiffness of the free joint of a floating base, for copies of the description.
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) get root_properties(root): Properties;

    /// Sets armature, damping, friction and stiffness of the free joint of a floating base.
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) set with_root(root): Properties;

    /// Sets the file that contains the description.
    #[cfg_attr(not(any(feature = "python", feature = "urdf")), allow(dead_code))]
    pub(crate) set with_file(file): Option<PathBuf>;

    /// URDF texts whose `<visual>` elements are drawn.
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) view shapes(shapes): &[String];

    /// Sets the actuators, whose names are unique.
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) set with_actuators(actuators): Vec<Actuator>;

    /// The locked joints with their previous kinds, for copies of the description.
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) view locked(locked): &[(String, JointKind)];

    /// Marks joints as locked; they are fixed joints of the description already.
    #[cfg_attr(not(feature = "python"), allow(dead_code))]
    pub(crate) set with_locked(locked): Vec<(String, JointKind)>;

    /// The treatment of mimic joints.
    #[doc(hidden)]
    pub get of_mimic_joints(mimic_joints): MimicJoints;

    /// Sets the geometric tolerance of linkages: rows of connections that are linearly dependent to within this angle
    /// (rad), or this length relative to the reach of the loop, count as dependent.
    ///
    /// `None` selects 3e-5. A file whose angles have two, three or four decimals sets 5e-3, 2e-3 or 2e-4. With
    /// [`SceneBuilder::strict`], only rounding errors are tolerated.
    pub set tolerance(tolerance): Option<f64>;

    /// The tolerance that was set or derived from the file.
    pub get tolerance_of_linkages(tolerance): Option<f64>;

    /// True if warnings are errors.
    pub get is_strict(strict): bool;
});
