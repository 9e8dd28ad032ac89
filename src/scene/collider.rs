//! Colliders: shapes on links that touch each other in simulations, and the rules that say which pairs can.

use super::Scene;
use super::collider_pairs::{Colliders, PairValues, Placed};
use super::connection::frame_fault;
use crate::collision::{Geometry, Solid};
use crate::error::{Error, known_names, number};
use crate::kinematics::{Frame, placement};
use crate::setters::setters;
use crate::spatial::RigidShift;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// A shape on a link, or on the base, that touches others in simulations.
///
/// Two colliders can touch if the links that carry them can move against each other, if a bit of the groups of one is a
/// bit of the mask of the other, if their links are not parent and child (a child of the base touches the base), and if
/// [`SceneBuilder::exclude`](super::SceneBuilder::exclude) does not name their links; or if a [`ColliderPair`] names
/// them. The friction and the restitution of a pair are the larger ones of both.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Collider {
    /// Name, unique among the colliders.
    pub name: String,
    /// Name of the link that carries it; `None` for the base.
    pub link: Option<String>,
    /// Pose of its frame in the frame of that link, or in the base frame.
    pub frame: RigidShift<f64>,
    /// The shape.
    pub solid: Solid,
    /// Coefficient of friction, zero or positive.
    pub friction: f64,
    /// Coefficient of restitution, from 0 (perfectly inelastic) to 1 (elastic).
    pub restitution: f64,
    /// The groups that it belongs to, as bits.
    pub groups: u32,
    /// The groups that it can touch, as bits.
    pub mask: u32,
}

setters!(Collider {
    with_name: name => String,
    with_link: link => Option<String>,
    with_frame: frame: RigidShift<f64>,
    with_solid: solid: Solid,
    with_friction: friction: f64,
    with_restitution: restitution: f64,
    with_groups: groups: u32,
    with_mask: mask: u32,
});

impl Collider {
    /// A collider about the origin of the base frame, with a friction of 1, without restitution, in group 1.
    pub fn new(name: impl Into<String>, solid: Solid) -> Self {
        Self {
            name: name.into(),
            link: None,
            frame: RigidShift::identity(),
            solid,
            friction: 1.0,
            restitution: 0.0,
            groups: 1,
            mask: 1,
        }
    }
}

/// Two colliders that can touch in any case, with their own values.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ColliderPair {
    /// Names of the colliders.
    pub colliders: [String; 2],
    /// Coefficient of friction; `None` for the larger one of both.
    pub friction: Option<f64>,
    /// Coefficient of restitution; `None` for the larger one of both.
    pub restitution: Option<f64>,
    /// Distance at which the contact begins to act, m.
    pub margin: f64,
}

setters!(ColliderPair {
    with_friction: friction: Option<f64>,
    with_restitution: restitution: Option<f64>,
    with_margin: margin: f64,
});

impl ColliderPair {
    /// A pair with the values of its colliders.
    pub fn new(first: impl Into<String>, second: impl Into<String>) -> Self {
        Self { colliders: [first.into(), second.into()], friction: None, restitution: None, margin: 0.0 }
    }
}

/// The colliders of a builder, and their rules.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct ColliderRules {
    pub colliders: Vec<Collider>,
    pub pairs: Vec<ColliderPair>,
    /// Pairs of links whose colliders do not touch; `None` for the base.
    pub excluded: Vec<[Option<String>; 2]>,
    /// True if parent and child can touch too.
    pub with_parents: bool,
}

impl ColliderRules {
    /// The pairs of links that are excluded, in both orders.
    fn excluded(&self) -> HashSet<[Option<&str>; 2]> {
        let one = self.excluded.iter().map(|links| links.each_ref().map(Option::as_deref));
        one.flat_map(|[a, b]| [[a, b], [b, a]]).collect()
    }
}

impl ColliderPair {
    /// Its name in messages.
    fn subject(&self) -> String {
        format!("pair of colliders {:?}, {:?}", self.colliders[0], self.colliders[1])
    }
}

fn fault(name: &str, found: impl Into<String>, expected: impl Into<String>) -> Error {
    Error::scene(format!("collider {name:?}"), found, expected)
}

impl Collider {
    fn check_numbers(&self) -> Result<(), Error> {
        if let Some((found, expected)) = self.solid.fault() {
            return Err(fault(&self.name, format!("a {} with {found}", self.solid.name()), expected));
        }
        check_values(&format!("collider {:?}", self.name), Some(self.friction), Some(self.restitution))?;
        let Some((found, expected)) = frame_fault(&self.frame) else { return Ok(()) };
        Err(fault(&self.name, format!("a frame {found}"), expected))
    }
}

/// Checks coefficients of friction and restitution, if they are given.
pub(super) fn check_values(subject: &str, friction: Option<f64>, restitution: Option<f64>) -> Result<(), Error> {
    if let Some(friction) = friction.filter(|value| !(value.is_finite() && *value >= 0.0)) {
        let expected = "a finite number, zero or positive";
        return Err(Error::scene(subject, format!("friction {}", number(friction)), expected));
    }
    if let Some(restitution) = restitution.filter(|value| !(0.0..=1.0).contains(value)) {
        return Err(Error::scene(subject, format!("restitution {}", number(restitution)), "a number from 0 to 1"));
    }
    Ok(())
}

impl Scene {
    /// The colliders, in order of creation.
    #[must_use]
    pub fn colliders(&self) -> &[Collider] {
        self.source().colliders()
    }

    /// The colliders by index, if any of them can touch another.
    pub(crate) fn shapes(&self) -> Option<&Arc<Colliders>> {
        self.placed_colliders().filter(|of| of.touches)
    }

    /// The colliders by index, if there are any.
    pub(crate) fn placed_colliders(&self) -> Option<&Arc<Colliders>> {
        self.shapes.as_ref()
    }

    /// True if it has contacts, or colliders that can touch.
    pub(crate) fn touches(&self) -> bool {
        !self.contacts().is_empty() || self.shapes().is_some()
    }

    /// Adds the colliders to the scene of an assembled tree, after checking them.
    pub(super) fn colliding(mut self) -> Result<Self, Error> {
        let rules = &self.source.collisions;
        let (n, mut all, mut index) =
            (rules.colliders.len(), Vec::with_capacity(rules.colliders.len()), HashMap::new());
        for (at, collider) in rules.colliders.iter().enumerate() {
            if index.insert(collider.name.as_str(), at).is_some() {
                return Err(fault(&collider.name, "a duplicate name", "unique names of colliders"));
            }
            collider.check_numbers()?;
            all.push(self.placed(collider)?);
        }
        self.check_rules(&index)?;
        if all.is_empty() {
            return Ok(self);
        }
        let (mut touch, excluded) = (vec![false; n * n], rules.excluded());
        for i in 0..n {
            for j in i + 1..n {
                let may = self.may_touch((i, j), &all, &excluded);
                (touch[i * n + j], touch[j * n + i]) = (may, may);
            }
        }
        let mut made = Colliders { all, touch, given: HashMap::new(), margin: 0.0, touches: false };
        for pair in &rules.pairs {
            let [i, j] = pair.colliders.each_ref().map(|name| index.get(name.as_str()).copied().unwrap_or_default());
            if self.carrier(made.all[i].body) == self.carrier(made.all[j].body) {
                if self.source.locked.is_empty() {
                    let expected = "colliders of two links that can move against each other";
                    return Err(Error::scene(
                        pair.subject(),
                        "links that are rigidly attached to each other",
                        expected,
                    ));
                }
                // Locked joints attach links that could move before.
                continue;
            }
            let mixed = made.mixed(i, j);
            let (friction, restitution) = (pair.friction, pair.restitution);
            let (friction, restitution) =
                (friction.unwrap_or(mixed.friction), restitution.unwrap_or(mixed.restitution));
            made.give(i, j, PairValues { friction, restitution, margin: pair.margin });
        }
        made.touches = made.touch.iter().any(|&may| may);
        self.shapes = Some(Arc::new(made));
        Ok(self)
    }

    /// A collider on its body.
    fn placed(&self, collider: &Collider) -> Result<Placed, Error> {
        let link = collider.link.as_ref().map(|name| self.link_of(|| format!("collider {:?}", collider.name), name));
        let link = link.transpose()?;
        let mut body = link.and_then(|link| link.body);
        let mut frame = link.map_or(collider.frame, |link| link.placement.compose(&collider.frame));
        if body.is_some() && self.carrier(body).is_none() {
            // A body without joints, which was not merged: its pose on the base is constant.
            frame = placement(self.model(), &self.neutral(), &Frame { body, placement: frame });
            body = None;
        }
        if collider.solid.is_ground() && body.is_some() {
            let found = format!("a {} on a link that moves", collider.solid.name());
            return Err(fault(&collider.name, found, "a link that no joint moves, or the base"));
        }
        let geometry = Geometry::new(&collider.solid).map_err(|(found, expected)| {
            fault(&collider.name, format!("a {} {found}", collider.solid.name()), expected)
        })?;
        let (name, friction, restitution) = (collider.name.as_str().into(), collider.friction, collider.restitution);
        Ok(Placed { name, body, frame, geometry, friction, restitution })
    }

    /// Checks the names and the values of the rules, with the colliders by name.
    fn check_rules(&self, index: &HashMap<&str, usize>) -> Result<(), Error> {
        let rules = &self.source.collisions;
        for pair in &rules.pairs {
            if let Some(name) = pair.colliders.iter().find(|name| !index.contains_key(name.as_str())) {
                let names = rules.colliders.iter().map(|of| of.name.as_str());
                let expected = format!("one of {}", known_names(name, names, 8));
                return Err(Error::scene(pair.subject(), format!("{name:?}, which does not exist"), expected));
            }
            check_values(&pair.subject(), pair.friction, pair.restitution)?;
            if !(pair.margin.is_finite() && pair.margin >= 0.0) {
                let expected = "a finite length, zero or positive, m";
                return Err(Error::scene(pair.subject(), format!("margin {}", number(pair.margin)), expected));
            }
        }
        for name in rules.excluded.iter().flatten().flatten() {
            self.link_of(|| "exclude".to_owned(), name)?;
        }
        Ok(())
    }

    /// True if two colliders can touch by the rules.
    fn may_touch(&self, (i, j): (usize, usize), all: &[Placed], excluded: &HashSet<[Option<&str>; 2]>) -> bool {
        let rules = &self.source.collisions;
        let (a, b) = (&rules.colliders[i], &rules.colliders[j]);
        let carriers = [&all[i], &all[j]].map(|of| self.carrier(of.body));
        if carriers[0] == carriers[1] || (a.groups & b.mask) | (b.groups & a.mask) == 0 {
            return false;
        }
        if excluded.contains(&[a.link.as_deref(), b.link.as_deref()]) {
            return false;
        }
        let parent = |k: usize| self.carrier(self.model().system.stages[k].parent);
        let is_child = |child: Option<usize>, other: Option<usize>| {
            child.is_some_and(|child| other.is_some() && parent(child) == other)
        };
        rules.with_parents || !(is_child(carriers[0], carriers[1]) || is_child(carriers[1], carriers[0]))
    }
}
