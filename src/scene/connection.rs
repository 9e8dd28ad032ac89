//! Connections: what closes a loop in the tree of joints, as the user says it.

use crate::error::{Error, number};
use crate::spatial::RigidShift;
use nalgebra::{Matrix3, Vector3};

/// How far R^T R of a frame's rotation may be from the identity.
const ROTATION_SLACK: f64 = 1e-9;

/// What a connection holds together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ConnectionKind {
    /// The origins of the two frames coincide: 3 rows.
    Point,
    /// The origins coincide and so does this direction in both frames (of any length): a hinge, 5 rows.
    Axis(Vector3<f64>),
    /// The frames coincide: 6 rows.
    Weld,
    /// The origins are this far apart, m; none: as far as in the neutral configuration. A rod without mass, 1 row.
    Distance(Option<f64>),
    /// The coordinate of one joint is the multiplier times that of another, plus the offset (rad or m): 1 row. `link` and `other` are the names of
    /// the joints, which have one axis each; without `other` the coordinate is the offset. No frames.
    Joint {
        /// Ratio of the coordinates.
        multiplier: f64,
        /// Coordinate where the other is at zero, rad or m.
        offset: f64,
    },
}

impl ConnectionKind {
    /// Its name in Python and in messages.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Point => "point",
            Self::Axis(_) => "axis",
            Self::Weld => "weld",
            Self::Distance(_) => "distance",
            Self::Joint { .. } => "joint",
        }
    }
}

/// A connection of two links, or of a link with the world, that the tree of joints does not have.
///
/// ```
/// use phipsi::scene::{Connection, ConnectionKind};
/// # fn main() -> Result<(), phipsi::Error> {
/// // A chain of three rods whose tip hangs on the world where it is at zero.
/// let mut tip = Connection::new("tip", ConnectionKind::Point, "link2", None);
/// tip.frame.lever = [0.0, 0.0, 0.3].into();
/// let scene = phipsi::scenes::chain(3)?.source().clone().connect(tip).build()?;
/// assert_eq!(scene.constraint_rows(), 3);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Connection {
    /// Name, unique among the connections.
    pub name: String,
    /// What it holds together.
    pub kind: ConnectionKind,
    /// Name of the link that its first frame is on.
    pub link: String,
    /// Name of the link that its second frame is on; none: the world, which is the base's frame.
    pub other: Option<String>,
    /// From the first frame to its link's frame.
    pub frame: RigidShift<f64>,
    /// From the second frame to its link's frame; none: where the first frame is in the neutral configuration.
    pub other_frame: Option<RigidShift<f64>>,
}

impl Connection {
    /// A connection whose first frame is that of `link`, and whose second is where that one is in the neutral configuration.
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

    pub(super) fn fault(&self, found: impl Into<String>, expected: impl Into<String>) -> Error {
        Error::scene(format!("connection {:?}", self.name), found, expected)
    }

    /// A frame whose numbers mean a frame.
    pub(super) fn check_frame(&self, which: &str, frame: &RigidShift<f64>) -> Result<(), Error> {
        if !frame.lever.iter().chain(frame.rotation.iter()).all(|x| x.is_finite()) {
            return Err(self.fault(format!("{which} with numbers that are not finite"), "finite numbers"));
        }
        let defect = (frame.rotation.transpose() * frame.rotation - Matrix3::identity()).amax();
        if !(defect <= ROTATION_SLACK && frame.rotation.determinant() > 0.0) {
            let found =
                format!("{which} whose rotation R has R^T R off the identity by {defect:.1e}, or is a reflection");
            return Err(self.fault(found, "a rotation matrix, to within 1e-9"));
        }
        Ok(())
    }

    /// The numbers of the kind.
    pub(super) fn check_kind(&self) -> Result<(), Error> {
        match self.kind {
            ConnectionKind::Axis(axis) if !(axis.iter().all(|x| x.is_finite()) && axis.amax() > 0.0) => {
                Err(self.fault(format!("axis {:?}", axis.as_slice()), "finite numbers, not all zero"))
            }
            ConnectionKind::Distance(Some(length)) if !(length.is_finite() && length > 0.0) => {
                let expected = "a finite length above zero, m (kind \"point\" where there is none)";
                Err(self.fault(format!("length {}", number(length)), expected))
            }
            ConnectionKind::Joint { multiplier, offset } if !(multiplier.is_finite() && offset.is_finite()) => {
                let found = format!("multiplier {} and offset {}", number(multiplier), number(offset));
                Err(self.fault(found, "finite numbers"))
            }
            _ => Ok(()),
        }
    }
}
