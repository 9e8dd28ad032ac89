//! The spring of a joint: stiffness, and where it is at rest. Simulation only.

use crate::error::{Error, number};
use crate::joints::JointKind;
use crate::joints::quaternion::QUATERNION_SLACK;

/// A spring in a joint, the same for each of its degrees of freedom.
///
/// Its torque is minus the stiffness times how far the joint is from rest: a difference of angles or lengths; for a rotation of
/// three degrees of freedom the rotation vector from rest, in the child's frame; for a free joint also the displacement, in
/// the child's frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Spring {
    /// Stiffness, N m/rad or N/m; zero or positive.
    pub stiffness: f64,
    /// The joint's coordinates at rest; empty where these are the neutral ones (zero, quaternions the identity).
    pub rest: Vec<f64>,
}

impl Spring {
    /// What is wrong with it in a joint of this kind, as (found, expected).
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
            let expected = format!("{nq} coordinates, as a {} joint has", kind.name());
            return Some((format!("{} coordinates of rest", self.rest.len()), expected));
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

/// Whether the spring of a joint can be used.
pub(super) fn check_spring(name: &str, kind: JointKind, spring: &Spring) -> Result<(), Error> {
    spring.fault(kind).map_or(Ok(()), |(found, expected)| Err(Error::scene(format!("joint {name:?}"), found, expected)))
}
