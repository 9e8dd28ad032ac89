//! Connections, which close loops in the tree of joints: user description and checks.

use super::constraint::{Constraint, Constraints, Coordinate, Coupled, Tie};
use super::polynomial::Polynomial;
use super::{Joint, Scene};
use crate::error::{Error, number};
use crate::joints::JointKind;
use crate::kinematics::pair::Pair;
use crate::kinematics::{Frame, placement};
use crate::setters::setters;
use crate::spatial::RigidShift;
use nalgebra::{Matrix3, Vector3};
use std::collections::HashSet;

/// Largest accepted entry of R^T R - 1 for the rotation R of a frame.
const ROTATION_SLACK: f64 = 1e-9;

/// Origins this close, relative to the positions that they are the difference of, coincide but for rounding.
const COINCIDENT: f64 = 1e-12;

/// Default tolerance of linkages. A right angle written as 1.5708 is off by 3.7e-6, and several such errors add up.
pub(super) const DEFAULT_TOLERANCE: f64 = 3e-5;

/// The constraint of a connection.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum ConnectionKind {
    /// The origins of the two frames coincide: 3 rows.
    Point,
    /// The origins and this direction in both frames (of any length) coincide, as in a revolute joint: 5 rows.
    Axis(Vector3<f64>),
    /// The frames coincide: 6 rows.
    Weld,
    /// The distance of the origins is fixed, m, as by a massless rod: 1 row. `None` selects the distance in the neutral
    /// configuration.
    Distance(Option<f64>),
    /// The coordinate of one joint is a polynomial of that of another joint, rad or m: 1 row. `link` and `other` are
    /// the names of the joints, which have one axis each; without `other` the coordinate equals the value of the
    /// polynomial at zero. The frames are not used. [`Polynomial::linear`] describes gears and belts.
    Joint(Polynomial),
}

impl ConnectionKind {
    /// The kind between two links with this name (a rod is a distance), of the connection `connection`; without an
    /// axis, that of a hinge is z.
    ///
    /// # Errors
    ///
    /// [`Error::Scene`], which names the connection: an unknown name, or an axis or a length of another kind.
    pub fn named(connection: &str, name: &str, axis: Option<Vector3<f64>>, length: Option<f64>) -> Result<Self, Error> {
        let known = [
            ("point", Self::Point),
            ("axis", Self::Axis(axis.unwrap_or_else(Vector3::z))),
            ("weld", Self::Weld),
            ("distance", Self::Distance(length)),
            ("rod", Self::Distance(length)),
        ];
        let refused =
            |found: String, expected: &str| Error::scene(format!("connection {connection:?}"), found, expected);
        let Some((_, kind)) = known.into_iter().find(|(known, _)| *known == name) else {
            let names = known.map(|(name, _)| format!("{name:?}")).join(", ");
            return Err(refused(format!("kind {name:?}"), &format!("one of {names} (couple ties joints)")));
        };
        if axis.is_some() && !matches!(kind, Self::Axis(_)) {
            return Err(refused(format!("an axis for kind {name:?}"), "an axis for kind \"axis\" only"));
        }
        if length.is_some() && !matches!(kind, Self::Distance(_)) {
            return Err(refused(format!("a length for kind {name:?}"), "a length for kind \"distance\" only"));
        }
        Ok(kind)
    }

    /// The name in Python and in messages.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Point => "point",
            Self::Axis(_) => "axis",
            Self::Weld => "weld",
            Self::Distance(_) => "distance",
            Self::Joint(_) => "joint",
        }
    }
}

/// A connection between two links, or between a link and the world, in addition to the tree of joints.
///
/// ```
/// use phipsi::scene::{Connection, ConnectionKind};
/// # fn main() -> Result<(), phipsi::Error> {
/// // A chain of three rods whose tip is attached to the world at its position in the neutral configuration.
/// let mut tip = Connection::new("tip", ConnectionKind::Point, "link2", None);
/// tip.frame.lever = [0.0, 0.0, 0.3].into();
/// let scene = phipsi::scenes::chain(3)?.source().clone().connect(tip).build()?;
/// assert_eq!(scene.constraint_rows(), 3);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Connection {
    /// Name, unique among the connections.
    pub name: String,
    /// The constraint.
    pub kind: ConnectionKind,
    /// Name of the link of the first frame.
    pub link: String,
    /// Name of the link of the second frame; `None` for the world, which is the base frame.
    pub other: Option<String>,
    /// Pose of the first frame in its link frame.
    pub frame: RigidShift<f64>,
    /// Pose of the second frame in its link frame; `None` for its coincidence with the first frame in the neutral
    /// configuration.
    pub other_frame: Option<RigidShift<f64>>,
}

setters!(Connection {
    with_name: name => String,
    with_kind: kind: ConnectionKind,
    with_link: link => String,
    with_other: other => Option<String>,
    with_frame: frame: RigidShift<f64>,
    with_other_frame: other_frame => Option<RigidShift<f64>>,
});

impl Connection {
    /// A connection whose first frame is the link frame of `link`, and whose second frame coincides with it in the
    /// neutral configuration.
    pub fn new(name: impl Into<String>, kind: ConnectionKind, link: impl Into<String>, other: Option<&str>) -> Self {
        Self {
            name: name.into(),
            kind,
            link: link.into(),
            other: other.map(str::to_owned),
            frame: RigidShift::identity(),
            other_frame: None,
        }
    }

    fn fault(&self, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::scene(format!("connection {:?}", self.name), found, expected)
    }

    /// Checks that a frame is finite and its rotation is a rotation matrix.
    fn check_frame(&self, which: &str, frame: &RigidShift<f64>) -> Result<(), Error> {
        let fault = |(found, expected)| Err(self.fault(format!("{which} {found}"), expected));
        frame_fault(frame).map_or(Ok(()), fault)
    }

    /// Checks the values of the kind.
    fn check_kind(&self) -> Result<(), Error> {
        match self.kind {
            ConnectionKind::Axis(axis) if !(axis.iter().all(|x| x.is_finite()) && axis.amax() > 0.0) => {
                Err(self.fault(format!("axis {:?}", axis.as_slice()), "finite numbers, not all zero"))
            }
            ConnectionKind::Distance(Some(length)) if !(length.is_finite() && length > 0.0) => {
                let expected = "a finite length above zero, m (kind \"point\" for a length of zero)";
                Err(self.fault(format!("length {}", number(length)), expected))
            }
            ConnectionKind::Joint(polynomial) if !polynomial.coefficients().iter().all(|c| c.is_finite()) => {
                let [offset, multiplier, ..] = polynomial.coefficients();
                let found = if polynomial.is_below_degree(2) {
                    format!("multiplier {} and offset {}", number(multiplier), number(offset))
                } else {
                    format!("polynomial {:?}", polynomial.coefficients())
                };
                Err(self.fault(found, "finite numbers"))
            }
            _ => Ok(()),
        }
    }
}

impl Scene {
    /// The connections, in order of creation. Second frames and lengths that were `None` have their values from the
    /// neutral configuration.
    #[must_use]
    pub fn connections(&self) -> &[Connection] {
        self.source().connections()
    }

    /// Number of scalar constraints: 3 for a point, 5 for an axis, 6 for a weld, 1 for a distance or a joint.
    #[must_use]
    pub fn constraint_rows(&self) -> usize {
        self.constraints.rows
    }

    /// The constraint rows of each connection, with its name.
    pub fn rows_of_connections(&self) -> impl Iterator<Item = (&str, std::ops::Range<usize>)> {
        self.constraints.all.iter().map(|constraint| (constraint.name.as_str(), constraint.rows()))
    }

    /// The same scene without connections.
    ///
    /// # Errors
    ///
    /// Those of [`SceneBuilder::build`](super::SceneBuilder::build), none of which this scene caused.
    pub fn without_constraints(&self) -> Result<Self, Error> {
        let mut source = self.source().clone();
        source.connections.clear();
        source.build()
    }

    /// The scene whose dynamics accept states that do not meet its connections.
    #[cfg(feature = "control")]
    pub(crate) fn with_open_connections(mut self) -> Self {
        /// An error, m or rad, beyond those of all robots.
        const FAR: f64 = 1e9;
        if !self.constraints.is_empty() {
            self.constraints.allowance = FAR;
            self.identity = crate::model::Identity::unique();
            // The kernels of this scene have the allowance.
            self.shared = super::shared::Shared::default();
        }
        self
    }

    /// Adds the connections to the scene of an assembled tree, after checking and completing them.
    pub(super) fn connected(mut self) -> Result<Self, Error> {
        if self.source.connections.is_empty() {
            return Ok(self);
        }
        let mut connections = std::mem::take(&mut self.source.connections);
        let mut names = HashSet::new();
        let mut constraints = Constraints::default();
        for connection in &mut connections {
            if !names.insert(connection.name.clone()) {
                return Err(connection.fault("a duplicate name", "unique names of connections"));
            }
            connection.check_kind()?;
            let tie = if let ConnectionKind::Joint(polynomial) = connection.kind {
                self.tie_of_joints(connection, polynomial)?
            } else {
                self.tie(connection)?
            };
            self.constrain(&mut constraints, connection.name.clone(), tie);
        }
        constraints.tolerance = self.tolerance();
        constraints.neutral = self.neutral();
        self.source.connections = connections;
        self.constraints = constraints;
        Ok(self)
    }

    /// Adds a constraint, whose rows follow those of the others.
    pub(super) fn constrain(&self, constraints: &mut Constraints, name: String, tie: Tie) {
        let (first_row, ends) = (constraints.rows, tie.bodies());
        let path = self.inward_from(ends);
        let (branches, junction) = self.branches(ends);
        let constraint = Constraint { name, tie, first_row, path, branches, junction };
        constraints.rows = constraint.rows().end;
        constraints.all.push(constraint);
    }

    /// The constraint between two frames, with the second frame and the length completed if they are `None`.
    fn tie(&self, connection: &mut Connection) -> Result<Tie, Error> {
        let first = self.end_of(connection, Some(&connection.link))?;
        let second = self.end_of(connection, connection.other.as_deref())?;
        connection.check_frame("a first frame", &connection.frame)?;
        if let Some(frame) = &connection.other_frame {
            connection.check_frame("a second frame", frame)?;
        }
        if self.carrier(first.body) == self.carrier(second.body) {
            let other =
                connection.other.as_ref().map_or_else(|| "the world".to_owned(), |name| format!("link {name:?}"));
            let found = if connection.other.as_ref() == Some(&connection.link) {
                format!("link {:?} connected with itself", connection.link)
            } else {
                format!("link {:?} and {other}, which are rigidly attached to each other", connection.link)
            };
            return Err(connection.fault(found, "two links that can move against each other"));
        }
        let neutral = self.neutral();
        let on = |end: &Frame<f64>, frame: &RigidShift<f64>| Frame {
            body: end.body,
            placement: end.placement.compose(frame),
        };
        let first = on(&first, &connection.frame);
        let at = placement(self.model(), &neutral, &first);
        let link = placement(self.model(), &neutral, &second);
        let other_frame = *connection.other_frame.get_or_insert_with(|| tidy(&link.inverse().compose(&at)));
        let second = on(&second, &other_frame);
        let pair = match &mut connection.kind {
            ConnectionKind::Point => Pair::Point,
            ConnectionKind::Weld => Pair::Weld,
            ConnectionKind::Axis(_) => Pair::Axis,
            ConnectionKind::Distance(length) => {
                let apart = (at.lever - placement(self.model(), &neutral, &second).lever).norm();
                let size = at.lever.norm() + first.placement.lever.norm() + second.placement.lever.norm();
                let coincide = length.is_none() && apart <= COINCIDENT * size;
                let length = *length.get_or_insert(apart);
                if !length.is_finite() {
                    let found = format!("no length, and frames {length} m apart in the neutral configuration");
                    return Err(connection.fault(found, "a finite length above zero, m"));
                }
                if coincide {
                    let found = "no length, and frames whose origins coincide in the neutral configuration";
                    return Err(connection.fault(found, "a length above zero, m, or a second frame elsewhere"));
                }
                Pair::Distance(length)
            }
            ConnectionKind::Joint(_) => return Err(connection.fault("joints", "links")),
        };
        let mut frames = [first, second];
        if let ConnectionKind::Axis(axis) = connection.kind {
            let turn = RigidShift { rotation: z_onto(&axis), lever: Vector3::zeros() };
            for frame in &mut frames {
                frame.placement = frame.placement.compose(&turn);
            }
        }
        Ok(Tie::Frames { pair, frames })
    }

    /// The frame of a link by name, or of the world without a name.
    fn end_of(&self, connection: &Connection, link: Option<&str>) -> Result<Frame<f64>, Error> {
        let Some(name) = link else { return Ok(Frame { body: None, placement: RigidShift::identity() }) };
        self.link_of(|| format!("connection {:?}", connection.name), name).map(Frame::from)
    }

    /// The link that a part of the scene names; `subject` is that part in messages.
    pub(super) fn link_of(&self, subject: impl FnOnce() -> String, name: &str) -> Result<&super::Link, Error> {
        self.link_index.get(name).map(|&at| &self.links()[at]).ok_or_else(|| {
            let found = format!("link {name:?}, which does not exist");
            Error::scene(subject(), found, self.source.known_links(name))
        })
    }

    /// The innermost movable body that `body` is rigidly attached to; `None` for the base.
    pub(super) fn carrier(&self, mut body: Option<usize>) -> Option<usize> {
        while let Some(k) = body {
            let stage = &self.model().system.stages[k];
            if stage.rows.count() > 0 {
                break;
            }
            body = stage.parent;
        }
        body
    }

    /// The constraint between two joint coordinates.
    fn tie_of_joints(&self, connection: &Connection, polynomial: Polynomial) -> Result<Tie, Error> {
        let first = self.coordinate_of(connection, &connection.link)?;
        let second = connection.other.as_ref().map(|name| self.coordinate_of(connection, name)).transpose()?;
        if second.is_some_and(|second| second.v == first.v) {
            return Err(connection.fault(format!("joint {:?} coupled to itself", connection.link), "two joints"));
        }
        Ok(Tie::Coordinates(Coupled { first, second, polynomial }))
    }

    /// The coordinate of a joint with one axis.
    fn coordinate_of(&self, connection: &Connection, name: &str) -> Result<Coordinate, Error> {
        let joint = self.joint(name).map_err(|error| {
            let expected = if let Error::Argument { expected, .. } = error { expected } else { String::new() };
            connection.fault(format!("joint {name:?}, which does not exist or does not move"), expected)
        })?;
        if joint.v.len() != 1 || joint.kind == JointKind::Fixed {
            let found = format!("joint {name:?} of type {:?}", joint.kind.name());
            return Err(connection.fault(found, "a joint of one axis: revolute, continuous, prismatic or screw"));
        }
        Ok(self.coordinate(joint))
    }

    /// The coordinate of a joint of this scene with one axis.
    pub(super) fn coordinate(&self, joint: &Joint) -> Coordinate {
        let body = self.joint_of_body.iter().position(|of| of.is_some_and(|at| self.joints()[at].name == joint.name));
        Coordinate { q: joint.q.start, v: joint.v.start, body: body.unwrap_or_default() }
    }

    /// The bodies from `end` to the base, outermost first.
    fn way(&self, end: Option<usize>) -> impl Iterator<Item = usize> {
        std::iter::successors(end, |&k| self.model().system.stages[k].parent)
    }

    /// The bodies on the path to the base from exactly one of the two ends, outermost first, and the body where the two
    /// paths meet.
    fn branches(&self, [first, second]: [Option<usize>; 2]) -> (Vec<usize>, Option<usize>) {
        let other: HashSet<usize> = self.way(second).collect();
        let junction = self.way(first).find(|k| other.contains(k));
        let branch = |end: Option<usize>| self.way(end).take_while(move |&k| Some(k) != junction);
        let mut branches: Vec<usize> = branch(first).chain(branch(second)).collect();
        branches.sort_unstable_by(|a, b| b.cmp(a));
        (branches, junction)
    }

    /// The bodies on the paths from both ends to the base, each once, outermost first.
    pub(crate) fn inward_from(&self, ends: [Option<usize>; 2]) -> Vec<usize> {
        let mut path: Vec<usize> = ends.into_iter().flat_map(|end| self.way(end)).collect();
        path.sort_unstable_by(|a, b| b.cmp(a));
        path.dedup();
        path
    }
}

/// The fault of a frame with values that are not finite, or a rotation that is no rotation matrix: its description, and
/// the expected value.
pub(super) fn frame_fault(frame: &RigidShift<f64>) -> Option<(String, &'static str)> {
    if !frame.lever.iter().chain(frame.rotation.iter()).all(|x| x.is_finite()) {
        return Some(("with numbers that are not finite".to_owned(), "finite numbers"));
    }
    let defect = (frame.rotation.transpose() * frame.rotation - Matrix3::identity()).amax();
    (!(defect <= ROTATION_SLACK && frame.rotation.determinant() > 0.0)).then(|| {
        let found = format!("whose rotation R is a reflection, or R^T R differs from the identity by {defect:.1e}");
        (found, "a rotation matrix, to within 1e-9")
    })
}

/// The rotation of least angle that maps z onto a direction; about x for the direction -z.
fn z_onto(axis: &Vector3<f64>) -> Matrix3<f64> {
    let direction = (axis / axis.amax()).normalize();
    let (across, cosine) = (Vector3::z().cross(&direction), direction.z);
    let square = across.norm_squared();
    if square == 0.0 {
        let sign = cosine.signum();
        return Matrix3::from_diagonal(&Vector3::new(1.0, sign, sign));
    }
    // 1 / (1 + cosine); an angle from the cosine would lose tilts below 1e-8.
    let share = if cosine > 0.0 { 1.0 / (1.0 + cosine) } else { (1.0 - cosine) / square };
    let cross = across.cross_matrix();
    Matrix3::identity() + cross + cross * cross * share
}

/// Re-orthonormalizes a rotation that has accumulated rounding errors: one Newton step, R (3 - R^T R)/2.
pub(super) fn tidy(shift: &RigidShift<f64>) -> RigidShift<f64> {
    let r = shift.rotation;
    RigidShift { rotation: r * (Matrix3::identity() * 3.0 - r.transpose() * r) * 0.5, lever: shift.lever }
}
