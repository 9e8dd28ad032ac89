//! Checks of a scene as a whole, after its links and joints form a tree: warnings, and duplicate floating bases.

use super::assembly::Tree;
use super::description::{Inertial, JointDescription, Mimic, MimicJoints, SceneWarning};
use super::inertia_check::{far_gyration, unphysical};
use super::{AT_A_TIME, SceneBuilder};
use crate::error::{Error, in_language, number};
use crate::interrupt;
use crate::joints::JointKind;
use std::collections::HashSet;

/// Whole numbers beyond the first and up to the second value are no limits of a joint in rad but in degrees. Limits of
/// joints of several turns are no whole numbers, and numbers that stand for no limit are larger.
const DEGREES: (f64, f64) = (20.0, 360.0);

impl SceneBuilder {
    /// Adds the unrecognized elements of the file to an error of the tree: a misspelled joint element causes two trees.
    pub(super) fn with_notes(&self, mut error: Error) -> Error {
        if let Error::Scene { found, .. } = &mut error {
            for note in &self.notes {
                if let SceneWarning::NotUnderstood { found: passed_over, .. } = note {
                    *found = format!("{found} (not recognized in the file: {passed_over})");
                }
            }
        }
        error
    }

    /// True if a link has mass or inertia.
    fn has_mass(&self, link: usize) -> bool {
        let heavy = |inertial: &Inertial| inertial.mass != 0.0 || inertial.central.entries.iter().any(|&x| x != 0.0);
        self.links[link].inertial.as_ref().is_some_and(heavy)
    }

    /// Rejects a floating base for a robot that already has a free joint on its massless root link; the ground would
    /// float.
    pub(super) fn check_base(&self, tree: &Tree) -> Result<(), Error> {
        // A scene with locked joints was checked before locking.
        if !self.floating_base || !self.locked.is_empty() {
            return Ok(());
        }
        let (mut heavy, mut joints, mut stack) = (false, Vec::new(), vec![tree.root]);
        while let Some(link) = stack.pop() {
            heavy |= self.has_mass(link);
            for &(joint, child) in &tree.children[link] {
                if self.joints[joint].kind == JointKind::Fixed { stack.push(child) } else { joints.push(joint) }
            }
        }
        let floats = |joint: &&usize| self.joints[**joint].kind == JointKind::Floating;
        let root = &self.links[tree.root].name;
        let Some(&joint) = joints.iter().find(floats) else {
            return Ok(());
        };
        if root != "world" && (heavy || !joints.iter().all(|joint| floats(&joint))) {
            return Ok(());
        }
        Err(Error::scene(
            format!("floating base of root link {root:?}"),
            format!("joint {:?}, which makes the scene floating already", self.joints[joint].name),
            format!(
                "no floating base ({}), or a description without that joint and its parent link",
                in_language("floating_base(false)", "floating_base=False")
            ),
        ))
    }

    /// Warnings for the user, those of the reader first; an error if the scene is strict.
    pub(super) fn warnings(&self, tree: &Tree) -> Result<Vec<SceneWarning>, Error> {
        let mut warnings = self.notes.clone();
        warnings.extend(self.no_mass(tree));
        for (i, link) in self.links.iter().enumerate() {
            interrupt::check_at(i, AT_A_TIME)?;
            if let Some(found) = link.inertial.as_ref().and_then(unphysical) {
                warnings.push(SceneWarning::Inertia { link: link.name.clone(), found });
            }
        }
        warnings.extend(self.large_inertias(tree));
        let locked = self.joints.iter().filter(|joint| joint.kind != JointKind::Fixed && joint.limits.are_all_zero());
        let joints: Vec<String> = locked.map(|joint| joint.name.clone()).collect();
        warnings.extend((!joints.is_empty()).then_some(SceneWarning::Locked { joints }));
        let names: HashSet<&str> = self.joints.iter().map(|joint| joint.name.as_str()).collect();
        // A fixed joint with a <mimic> has no coordinate.
        let free = |joint: &&JointDescription| joint.kind != JointKind::Fixed && self.mimic_joints == MimicJoints::Free;
        for joint in self.joints.iter().filter(free) {
            if let Some(Mimic { joint: source, .. }) = &joint.mimic {
                warnings.push(SceneWarning::Mimic { joint: joint.name.clone(), source: source.clone() });
            }
        }
        for joint in self.joints.iter().filter(|joint| joint.kind == JointKind::Revolute) {
            let bounds = [joint.limits.lower, joint.limits.upper];
            if bounds.iter().any(|bound| bound.fract() == 0.0 && DEGREES.0 < bound.abs() && bound.abs() <= DEGREES.1) {
                let [lower, upper] = bounds.map(number);
                let found = format!("limits from {lower} to {upper} rad");
                warnings.push(SceneWarning::Degrees { joint: joint.name.clone(), found });
            }
        }
        if self.strict {
            // In a strict scene, report inertias before other warnings. A mimic of an existing joint is not an error.
            let physical = |warning: &SceneWarning| matches!(warning, SceneWarning::Inertia { .. });
            let fault = |warning: &SceneWarning| match warning {
                SceneWarning::Mimic { source, .. } => !names.contains(source.as_str()),
                _ => true,
            };
            if let Some(first) = warnings.iter().position(physical).or_else(|| warnings.iter().position(fault)) {
                return Err(warnings.swap_remove(first).into_error());
            }
        }
        Ok(warnings)
    }

    /// Moving links whose radius of gyration is far beyond the size of the scene, which the origins of its joints show:
    /// a body alone has no known size.
    fn large_inertias(&self, tree: &Tree) -> Vec<SceneWarning> {
        let mut moving = Vec::new();
        let (mut size, mut stack) = (0.0_f64, vec![(tree.root, self.floating_base, 0.0_f64)]);
        let mut reach = 0.0_f64;
        while let Some((link, moves, distance)) = stack.pop() {
            reach = reach.max(distance);
            if let Some(inertial) = &self.links[link].inertial {
                size = size.max(distance + inertial.center.norm());
                moving.extend(moves.then_some((&self.links[link].name, inertial)));
            }
            stack.extend(tree.children[link].iter().map(|&(joint, child)| {
                let joint = &self.joints[joint];
                (child, moves || joint.kind != JointKind::Fixed, distance + joint.origin.lever.norm())
            }));
        }
        let large = moving.into_iter().filter(|_| reach > 0.0).filter_map(|(link, inertial)| {
            far_gyration(inertial, size).map(|radius| SceneWarning::LargeInertia { link: link.clone(), radius, size })
        });
        large.collect()
    }

    /// The moving links of a file, if there are some and none has mass. A scene with locked joints was checked before
    /// locking.
    fn no_mass(&self, tree: &Tree) -> Option<SceneWarning> {
        if !self.from_file || !self.locked.is_empty() {
            return None;
        }
        let mut links = Vec::new();
        let mut stack = vec![(tree.root, self.floating_base)];
        while let Some((link, moving)) = stack.pop() {
            if moving && self.has_mass(link) {
                return None;
            }
            links.extend(moving.then(|| self.links[link].name.clone()));
            let children = tree.children[link].iter().rev();
            stack
                .extend(children.map(|&(joint, child)| (child, moving || self.joints[joint].kind != JointKind::Fixed)));
        }
        (!links.is_empty()).then_some(SceneWarning::NoMass { links })
    }
}
