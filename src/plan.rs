//! What a scene does not need, and what leaving it out saved.

use crate::filter::HingeMap;
use crate::scene::Scene;

/// One thing left out.
#[derive(Debug, Clone, PartialEq)]
pub struct Omission {
    /// What, in a few words.
    pub what: &'static str,
    /// How many.
    pub count: usize,
    /// The joints or links, where they have names.
    pub names: Vec<String>,
    /// Why the results are the same without it.
    pub why: &'static str,
    /// What that saved.
    pub saved: String,
}

/// What was left out when the scene was built.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Moving bodies that the sweeps visit.
    pub bodies: usize,
    /// Links that the user gave.
    pub links: usize,
    /// What was left out; only what this scene had.
    pub items: Vec<Omission>,
}

/// A number with its noun.
fn counted(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

impl Scene {
    /// What this scene does not need, and what leaving it out saved.
    #[must_use]
    pub fn plan(&self) -> Plan {
        let model = self.model();
        let nv = self.nv();
        let mut items = Vec::new();
        let mut add = |what, names: Vec<String>, count: usize, why, saved: String| {
            if count > 0 {
                items.push(Omission { what, count, names, why, saved });
            }
        };
        let on_base: Vec<String> =
            self.links().iter().filter(|link| link.body.is_none()).map(|link| link.name.clone()).collect();
        let merged = self.merged_joints().to_vec();
        let count = merged.len();
        add(
            "fixed joints, merged into their parents",
            merged,
            count,
            "a fixed joint transmits every force: two links are one body",
            counted(count, "shift of an inertia and of a force", "shifts of an inertia and of a force")
                + ", each sweep",
        );
        let count = on_base.len();
        add(
            "links on the base",
            on_base,
            count,
            "a link that cannot move adds nothing to M, to the bias or to the energy's changes",
            counted(count, "body that is not visited", "bodies that are not visited"),
        );
        let one_axis: usize = model
            .system
            .stages
            .iter()
            .filter(|stage| stage.rows.count() == 1 && matches!(stage.rows.row(0), HingeMap::Axis(_)))
            .count();
        add(
            "general joint axes, turned onto z when the scene was built",
            Vec::new(),
            one_axis,
            "in a frame with the axis on z, H picks a row: P H* is a column of P, not a product",
            format!("{one_axis} products of P with an axis (36 multiplications each), each factorisation"),
        );
        let quiet: usize = (0..nv).filter(|&row| model.system.noise[row] == 0.0).count();
        add(
            "measurement noise (armature)",
            Vec::new(),
            quiet,
            "without armature H g = 1 and H P^+ = 0 hold exactly and are written, not computed",
            format!("the rounding of {quiet} rows of P^+"),
        );
        Plan { bodies: model.bodies.len(), links: self.links().len(), items }
    }
}
