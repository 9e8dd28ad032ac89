//! The simplifications that apply to a scene, and the operations that they save.

mod counted;

use crate::filter::{HingeMap, Rows};
use crate::interrupt;
use crate::model::{Body, Simplifications};
use crate::scene::{JointKind, Scene};
use std::collections::HashSet;

/// One simplification of a scene.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Simplification {
    /// Short description.
    pub what: &'static str,
    /// Name of the switch that disables it; `None` if it cannot be disabled.
    pub switch: Option<&'static str>,
    /// Number of elements to which it applies.
    pub count: usize,
    /// Names of the joints or links to which it applies, if they have names.
    pub names: Vec<String>,
    /// The reason why the results are unchanged.
    pub why: &'static str,
    /// Description of the saved computations.
    pub saved: String,
    /// Floating-point operations that it saves in forward dynamics of one state in covariance form (a multiply-add
    /// counts as two); zero if they were not counted. Simplifications of calls on the factor document what they count.
    pub operations: usize,
}

/// Initial value of an item: no switch, no operations.
const NOTHING: Simplification = Simplification {
    what: "",
    switch: None,
    count: 0,
    names: Vec::new(),
    why: "",
    saved: String::new(),
    operations: 0,
};

/// The simplifications made when the scene was built and in its calls.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Plan {
    /// Number of bodies that the sweeps visit.
    pub bodies: usize,
    /// Number of links that the user defined.
    pub links: usize,
    /// The simplifications that apply to this scene.
    pub items: Vec<Simplification>,
}

/// Operations per body in covariance form, counted by running it on a counting scalar: docs/leaving-out.md.
mod operations {
    use super::Body;

    /// A body without measurement rows and without mass: shifts of motions, of its force and of P, and their sums.
    pub const FIXED_BODY: usize = 550;
    /// Propagation from a body to its parent: phi z, and both sums.
    pub const INWARD: usize = 113;
    /// M a + v x* M v.
    pub const FORCE: usize = 102;
    /// M a.
    pub const WEIGHT: usize = 42;
    /// phi* a.
    pub const SHIFTED: usize = 42;

    /// Velocity of a body and the terms that depend on it: phi* v, v x H* qd, v x* M v.
    pub fn of_velocity(body: &Body<f64>) -> usize {
        body.motion.operations_of_velocity() + FORCE - WEIGHT
    }

    /// Gravitational acceleration at a body, and its weight.
    pub const OF_WEIGHT: usize = SHIFTED + WEIGHT;
}

/// A number followed by its noun in singular or plural.
fn counted(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

impl Scene {
    /// Lists the simplifications that apply to this scene and the operations that they save.
    ///
    /// Some are counted by running the algorithms on a counting scalar: O(N), a few microseconds per body. If
    /// [`interrupt`] stops the work, the list contains the items found so far.
    #[must_use]
    pub fn plan(&self) -> Plan {
        // Coupled joints do not change the simplifications of the tree.
        if let Some(coupling) = self.coupling() {
            return coupling.tree().plan();
        }
        let built: [fn(&Self) -> Simplification; 4] =
            [Self::merged_item, Self::base_item, Self::permuted_item, Self::oblique_item];
        let called: [fn(&Self) -> Simplification; 2] = [Self::velocity_item, Self::gravity_item];
        let others: [fn(&Self) -> Simplification; 5] =
            [Self::locked_item, Self::factor_item, Self::branch_item, Self::outputs_item, Self::compiled_item];
        let always: [fn(&Self) -> Simplification; 2] = [Self::axes_item, Self::armature_item];
        let all = built.into_iter().chain(called).chain(others).chain(always);
        let found = all.map_while(|item| interrupt::check().ok().map(|()| self.if_switched(item(self))));
        let items = found.filter(|item| item.count > 0).collect();
        Plan { bodies: self.model().bodies.len(), links: self.links().len(), items }
    }

    /// An item with its switch; its count is zero if the switch is off.
    fn if_switched(&self, item: Simplification) -> Simplification {
        let Some(switch) = item.switch else { return item };
        let mut simplifications = self.source().left_out();
        let on = Simplifications::SWITCHES.iter().any(|&(name, of)| name == switch && *of(&mut simplifications));
        Simplification { count: if on { item.count } else { 0 }, ..item }
    }

    fn merged_item(&self) -> Simplification {
        let names = self.merged_joints().to_vec();
        // Links fixed to the base are excluded: they cannot move and are removed, not merged.
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
        Simplification {
            switch: Some("fixed_joints"),
            what: "fixed joints, merged into their parents",
            count: names.len(),
            names,
            why: "a fixed joint transmits every force: two links are one body",
            saved: saved + ", each sweep",
            operations: bodies * (operations::FIXED_BODY + operations::FORCE),
            ..NOTHING
        }
    }

    fn base_item(&self) -> Simplification {
        let links = self.links().iter().filter(|link| link.body.is_none());
        let names: Vec<String> = links.map(|link| link.name.clone()).collect();
        // If they are kept, they form a single body, provided that fixed joints are merged.
        let simplifications = self.model().simplifications;
        let most = if simplifications.fixed_joints { 1 } else { usize::MAX };
        let bodies = names.len().min(most);
        let carried = self.model().system.stages.iter().filter(|stage| stage.parent.is_none()).count();
        // The body of the base propagates nothing to a parent.
        let kept = bodies * (operations::FIXED_BODY + operations::FORCE) + carried * operations::INWARD;
        Simplification {
            switch: Some("base_links"),
            what: "links on the base",
            count: names.len(),
            names,
            why: "a link that cannot move adds nothing to M, to the bias or to the energy's changes",
            saved: counted(bodies, "body that is not visited", "bodies that are not visited"),
            operations: kept.saturating_sub(operations::INWARD),
            ..NOTHING
        }
    }

    fn velocity_item(&self) -> Simplification {
        let bodies = &self.model().bodies;
        Simplification {
            switch: Some("zero_velocity"),
            what: "velocities, in a call with zero joint velocities",
            count: bodies.len(),
            why: "without velocity there is no velocity product",
            saved: counted(
                bodies.len(),
                "velocity and its velocity products",
                "velocities and their velocity products",
            ),
            // The test for zero velocities is one sum per joint velocity.
            operations: bodies.iter().map(operations::of_velocity).sum::<usize>().saturating_sub(self.nv()),
            ..NOTHING
        }
    }

    fn gravity_item(&self) -> Simplification {
        let model = self.model();
        let weightless = model.simplifications.zero_velocity && model.gravity.iter().all(|&g| g == 0.0);
        Simplification {
            switch: Some("zero_gravity"),
            what: "the bias, in a call with zero joint velocities",
            count: if weightless { model.bodies.len() } else { 0 },
            why: "without velocity and gravity b = 0",
            saved: counted(model.bodies.len(), "acceleration and force", "accelerations and forces"),
            // The test for zero gravity is three sums.
            operations: (model.bodies.len() * operations::OF_WEIGHT).saturating_sub(3),
            ..NOTHING
        }
    }

    fn axes_item(&self) -> Simplification {
        let stages = self.model().system.stages.iter();
        let count = stages.filter(|stage| matches!(stage.rows, Rows::One(HingeMap::Axis(_)))).count();
        Simplification {
            what: "general joint axes, rotated onto z when the scene was built",
            count,
            why: "in a frame with the axis on z, H picks a row: P H* is a column of P, not a product",
            saved: format!("{count} products of P with an axis (36 multiplications each), each factorization"),
            ..NOTHING
        }
    }

    fn armature_item(&self) -> Simplification {
        let count = self.model().system.noise.iter().filter(|&&noise| noise == 0.0).count();
        Simplification {
            what: "measurement noise (armature)",
            count,
            why: "without armature H g = 1 and H P^+ = 0 hold exactly and are set, not computed",
            saved: format!("the rounding of {count} rows of P^+"),
            ..NOTHING
        }
    }
}
