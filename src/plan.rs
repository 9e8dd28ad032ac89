//! The simplifications of a scene, and what they save.

mod counted;

use crate::filter::{HingeMap, Rows};
use crate::model::{Body, Omissions};
use crate::scene::{JointKind, Scene};
use crate::watch;
use std::collections::HashSet;

/// One thing left out.
#[derive(Debug, Clone, PartialEq)]
pub struct Omission {
    /// What, in a few words.
    pub what: &'static str,
    /// The name of the switch that turns it off; none where there is one way to compute only.
    pub switch: Option<&'static str>,
    /// How many.
    pub count: usize,
    /// The joints or links, where they have names.
    pub names: Vec<String>,
    /// Why the results are the same without it.
    pub why: &'static str,
    /// The saving, in words.
    pub saved: String,
    /// How many floating-point operations (a product with a sum is two) forward dynamics of one state in covariance
    /// form does less, in a call that needs nothing of this; zero where nothing was counted. Items of calls on the
    /// factor say beside what they count.
    pub operations: usize,
}

/// An item yet to be filled in: no switch, and no operations counted.
const NOTHING: Omission =
    Omission { what: "", switch: None, count: 0, names: Vec::new(), why: "", saved: String::new(), operations: 0 };

/// The simplifications of a scene when it was built, and those of its calls.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Bodies that the sweeps visit.
    pub bodies: usize,
    /// Links that the user gave.
    pub links: usize,
    /// The simplifications that apply to this scene.
    pub items: Vec<Omission>,
}

/// Operations of one body in the covariance form. Counted by running it on a scalar that counts: docs/leaving-out.md.
mod operations {
    use super::Body;

    /// A body without rows and without mass: shifts of motions, of its force and of P, and their sums.
    pub const FIXED_BODY: usize = 550;
    /// The force that a body propagates inward: phi z, and both sums.
    pub const INWARD: usize = 113;
    /// M a + v x* M v.
    pub const FORCE: usize = 102;
    /// M a.
    pub const WEIGHT: usize = 42;
    /// phi* a.
    pub const SHIFTED: usize = 42;

    /// Velocities of a body, and what they cause: phi* v, v x H* qd, v x* M v.
    pub fn of_velocity(body: &Body<f64>) -> usize {
        body.motion.operations_of_velocity() + FORCE - WEIGHT
    }

    /// The acceleration of gravity at a body, and its weight.
    pub const OF_WEIGHT: usize = SHIFTED + WEIGHT;
}

/// A number with its noun.
fn counted(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

impl Scene {
    /// The simplifications of this scene, and what they save.
    ///
    /// Some of it is counted by running the algorithms on numbers that count: O(N), some microseconds a body. Under a
    /// [`watch`] that ends the work, only what was found until then.
    #[must_use]
    pub fn plan(&self) -> Plan {
        // Joints that follow each other change nothing of what the sweeps of the tree leave out.
        if let Some(coupling) = self.coupling() {
            return coupling.tree().plan();
        }
        let built: [fn(&Self) -> Omission; 4] =
            [Self::merged_item, Self::base_item, Self::renamed_item, Self::tilted_item];
        let called: [fn(&Self) -> Omission; 2] = [Self::velocity_item, Self::gravity_item];
        let others: [fn(&Self) -> Omission; 5] =
            [Self::locked_item, Self::factor_item, Self::branch_item, Self::outputs_item, Self::compiled_item];
        let always: [fn(&Self) -> Omission; 2] = [Self::axes_item, Self::armature_item];
        let all = built.into_iter().chain(called).chain(others).chain(always);
        let found = all.map_while(|item| watch::check().ok().map(|()| item(self)));
        let items = found.filter(|item| item.count > 0).collect();
        Plan { bodies: self.model().bodies.len(), links: self.links().len(), items }
    }

    /// An item that is left out where its switch is on.
    fn switched(&self, switch: &'static str, item: Omission) -> Omission {
        let mut omissions = self.source().left_out();
        let on = Omissions::SWITCHES.iter().any(|&(name, of)| name == switch && *of(&mut omissions));
        Omission { switch: Some(switch), count: if on { item.count } else { 0 }, ..item }
    }

    fn merged_item(&self) -> Omission {
        let names = self.merged_joints().to_vec();
        // Links fixed to the base are not merged for a sweep: they cannot move and are dropped.
        let children: HashSet<&str> = self
            .source()
            .joints()
            .iter()
            .filter(|joint| joint.kind == JointKind::Fixed)
            .map(|joint| joint.child.as_str())
            .collect();
        let moving = self.links().iter().filter(|link| link.body.is_some());
        let bodies = moving.filter(|link| children.contains(link.name.as_str())).count();
        let saved = counted(names.len(), "shift of an inertia and of a force", "shifts of an inertia and of a force");
        self.switched(
            "fixed_joints",
            Omission {
                what: "fixed joints, merged into their parents",
                count: names.len(),
                names,
                why: "a fixed joint transmits every force: two links are one body",
                saved: saved + ", each sweep",
                operations: bodies * (operations::FIXED_BODY + operations::FORCE),
                ..NOTHING
            },
        )
    }

    fn base_item(&self) -> Omission {
        let links = self.links().iter().filter(|link| link.body.is_none());
        let names: Vec<String> = links.map(|link| link.name.clone()).collect();
        // Kept, they are one body where fixed joints are merged.
        let omissions = self.model().omissions;
        let most = if omissions.fixed_joints { 1 } else { usize::MAX };
        let bodies = names.len().min(most);
        let carried = self.model().system.stages.iter().filter(|stage| stage.parent.is_none()).count();
        // The body of the base sends nothing inward itself.
        let kept = bodies * (operations::FIXED_BODY + operations::FORCE) + carried * operations::INWARD;
        self.switched(
            "base_links",
            Omission {
                what: "links on the base",
                count: names.len(),
                names,
                why: "a link that cannot move adds nothing to M, to the bias or to the energy's changes",
                saved: counted(bodies, "body that is not visited", "bodies that are not visited"),
                operations: kept.saturating_sub(operations::INWARD),
                ..NOTHING
            },
        )
    }

    fn velocity_item(&self) -> Omission {
        let bodies = &self.model().bodies;
        self.switched(
            "zero_velocity",
            Omission {
                what: "velocities, in a call whose rates are all zero",
                count: bodies.len(),
                why: "without velocity there is no velocity product",
                saved: counted(bodies.len(), "velocity and what it causes", "velocities and what they cause"),
                // Looking whether they are zero is a sum a rate.
                operations: bodies.iter().map(operations::of_velocity).sum::<usize>().saturating_sub(self.nv()),
                ..NOTHING
            },
        )
    }

    fn gravity_item(&self) -> Omission {
        let model = self.model();
        let weightless = model.omissions.zero_velocity && model.gravity.iter().all(|&g| g == 0.0);
        self.switched(
            "zero_gravity",
            Omission {
                what: "the bias, in a call whose rates are all zero",
                count: if weightless { model.bodies.len() } else { 0 },
                why: "without velocity and gravity b = 0",
                saved: counted(model.bodies.len(), "acceleration and force", "accelerations and forces"),
                // Looking at gravity is three sums.
                operations: (model.bodies.len() * operations::OF_WEIGHT).saturating_sub(3),
                ..NOTHING
            },
        )
    }

    fn axes_item(&self) -> Omission {
        let stages = self.model().system.stages.iter();
        let count = stages.filter(|stage| matches!(stage.rows, Rows::One(HingeMap::Axis(_)))).count();
        Omission {
            what: "general joint axes, turned onto z when the scene was built",
            count,
            why: "in a frame with the axis on z, H picks a row: P H* is a column of P, not a product",
            saved: format!("{count} products of P with an axis (36 multiplications each), each factorisation"),
            ..NOTHING
        }
    }

    fn armature_item(&self) -> Omission {
        let count = self.model().system.noise.iter().filter(|&&noise| noise == 0.0).count();
        Omission {
            what: "measurement noise (armature)",
            count,
            why: "without armature H g = 1 and H P^+ = 0 hold exactly and are written, not computed",
            saved: format!("the rounding of {count} rows of P^+"),
            ..NOTHING
        }
    }
}
