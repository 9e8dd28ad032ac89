//! Joint springs: stiffness and rest position. Simulation and linearization only.

use crate::error::{Error, number};
use crate::joints::JointKind;
use crate::joints::quaternion::QUATERNION_SLACK;
use crate::setters::setters;

/// A joint spring, with the same stiffness for each degree of freedom of the joint.
///
/// Its torque is minus the stiffness times the deviation from the rest position: the difference of angles or lengths;
/// for spherical joints the rotation vector from rest, in the child frame; for a free joint also the displacement, in
/// the child frame.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct Spring {
    /// Stiffness, N m/rad or N/m; zero or positive.
    pub stiffness: f64,
    /// Coordinates of the joint at rest; empty for the neutral ones (zero, identity quaternion).
    pub rest: Vec<f64>,
}

setters!(Spring { with_stiffness: stiffness: f64, with_rest: rest => Vec<f64> });

impl Spring {
    /// Describes an invalid spring for a joint of this kind as (found, expected).
    pub(super) fn fault(&self, kind: JointKind) -> Option<(String, String)> {
        let positive = "a finite number, zero or positive".to_owned();
        if !(self.stiffness.is_finite() && self.stiffness >= 0.0) {
            return Some((format!("stiffness {}", self.stiffness), positive));
        }
        if self.rest.is_empty() {
            return None;
        }
        let nq = kind.nq();
        if self.rest.len() != nq {
            let expected = format!("{nq} coordinates for a {} joint", kind.name());
            return Some((format!("{} coordinates of the rest position", self.rest.len()), expected));
        }
        if let Some(value) = self.rest.iter().find(|x| !x.is_finite()) {
            return Some((format!("rest {value}"), "finite numbers".to_owned()));
        }
        let quaternion = &self.rest[kind.quaternion()?];
        let norm = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
        let off = !((norm - 1.0).abs() <= QUATERNION_SLACK);
        off.then(|| (format!("a quaternion of norm {} at rest", number(norm)), "unit norm, to within 1e-3".to_owned()))
    }
}

/// Checks the spring of a joint.
pub(super) fn check_spring(name: &str, kind: JointKind, spring: &Spring) -> Result<(), Error> {
    spring.fault(kind).map_or(Ok(()), |(found, expected)| Err(Error::scene(format!("joint {name:?}"), found, expected)))
}
