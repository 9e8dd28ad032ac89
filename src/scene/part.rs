//! Parts of the coordinates and velocities of a joint, by name.

use super::Joint;
use crate::error::Error;
use crate::joints::JointKind;
use std::ops::Range;

impl Joint {
    /// Indices in q of a part of the coordinates: "position" (3) and "quaternion" (4) of a free joint, "quaternion" of
    /// a spherical joint.
    ///
    /// ```
    /// # fn main() -> Result<(), phipsi::Error> {
    /// let scene = phipsi::scenes::chain(2)?.source().clone().floating_base(true).build()?;
    /// let root = &scene.joints()[0];
    /// assert_eq!((root.q_part("quaternion")?, root.v_part("angular")?), (3..7, 3..6));
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    ///
    /// A part that the joint does not have.
    pub fn q_part(&self, part: &str) -> Result<Range<usize>, Error> {
        let parts: &[_] = match self.kind {
            JointKind::Floating => &[("position", 0..3), ("quaternion", 3..7)],
            JointKind::Spherical => &[("quaternion", 0..4)],
            _ => &[],
        };
        self.part(&self.q, part, parts)
    }

    /// Indices in qd, qdd and tau of a part of the velocity: "linear" and "angular" (3 each) of a free joint, "angular"
    /// of a spherical joint. In tau these are force and moment.
    ///
    /// # Errors
    ///
    /// A part that the joint does not have.
    pub fn v_part(&self, part: &str) -> Result<Range<usize>, Error> {
        let parts: &[_] = match self.kind {
            JointKind::Floating => &[("linear", 0..3), ("angular", 3..6)],
            JointKind::Spherical => &[("angular", 0..3)],
            _ => &[],
        };
        self.part(&self.v, part, parts)
    }

    fn part(&self, whole: &Range<usize>, name: &str, parts: &[(&str, Range<usize>)]) -> Result<Range<usize>, Error> {
        let found = parts.iter().find(|(known, _)| *known == name);
        found.map(|(_, at)| whole.start + at.start..whole.start + at.end).ok_or_else(|| {
            let known: Vec<String> = parts.iter().map(|(known, _)| format!("{known:?}")).collect();
            let expected = if known.is_empty() { String::new() } else { format!("{} or ", known.join(", ")) };
            Error::argument("part", format!("{name:?}"), format!("{expected}none for joint {:?}", self.name))
        })
    }
}
