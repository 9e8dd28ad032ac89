//! Savings that are counted: the sweeps of generated code, run on scalars that count their operations.

use super::{NOTHING, Simplification, counted};
use crate::codegen::{Function, Program, count};
use crate::error::in_language;
use crate::model::{Body, Model, Simplifications};
use crate::report::operations::of_factor;
use crate::scalar::Operations;
use crate::scene::Scene;
use crate::spatial::transform::{rotates_about_a_parent_axis, rotates_about_an_oblique_axis};
use nalgebra::Matrix3;

/// Dense results are counted up to this number of degrees of freedom, because they are O(N^2).
const MOST_DENSE: usize = 256;
/// Compiled programs are generated up to this number of degrees of freedom; beyond, generation takes milliseconds per
/// joint.
const MOST_COMPILED: usize = 64;

/// Floating-point operations.
fn flops(operations: &Operations) -> usize {
    usize::try_from(operations.flops()).unwrap_or(usize::MAX)
}

/// Operations of one function on a state that moves, in covariance form.
fn of(scene: &Scene, function: &Function) -> usize {
    with(scene, scene.model().simplifications, function)
}

/// The same with other switches than those of the scene.
fn with(scene: &Scene, simplifications: Simplifications, function: &Function) -> usize {
    let (q, ones) = (scene.neutral(), vec![1.0; scene.nv()]);
    let model = Model { simplifications, ..scene.model().clone() };
    // Functions of the dynamics are of no link.
    count(scene, &model, function, &[&q, &ones, &ones]).map_or(0, |operations| flops(&operations))
}

impl Scene {
    /// Rotations of the tree that keep the joint on an axis.
    pub(super) fn permuted_item(&self) -> Simplification {
        let count = self.bodies_on(rotates_about_a_parent_axis).count();
        // The saving of tilted axes depends on it, and has an item of its own.
        let saved = self.saved_beside(
            count,
            |simplifications| simplifications.oblique_axes = false,
            |simplifications| simplifications.permuted_axes = false,
        );
        Simplification {
            switch: Some("permuted_axes"),
            what: "rotations to the parent that permute axes, or rotate about the joint axis",
            count,
            why: "a rotation about z by the joint angle, a constant angle, or their sum suffices, \
                      with a permutation and signs of the entries",
            saved: counted(count, "rotation matrix", "rotation matrices")
                + ", and P rotated by an angle instead of by it",
            operations: saved,
            ..NOTHING
        }
    }

    /// Joints with axes in any other direction.
    pub(super) fn oblique_item(&self) -> Simplification {
        let permuted = self.model().simplifications.permuted_axes;
        let count = if permuted { self.bodies_on(rotates_about_an_oblique_axis).count() } else { 0 };
        let saved = self.saved_in_sweeps(count, |simplifications| simplifications.oblique_axes = false);
        Simplification {
            switch: Some("oblique_axes"),
            what: "rotations to the parent of the other revolute and prismatic joints",
            count,
            why: "one or two constant angles rotate the joint axis onto an axis of the parent frame",
            saved: counted(count, "rotation matrix", "rotation matrices")
                + ", and P rotated by angles instead of by it",
            operations: saved,
            ..NOTHING
        }
    }

    /// Bodies on revolute or prismatic joints whose constant rotation to the parent satisfies `is_like`.
    fn bodies_on(&self, is_like: impl Fn(&Matrix3<f64>) -> bool) -> impl Iterator<Item = &Body<f64>> {
        let moves = |body: &Body<f64>| body.motion.has_constant_axis();
        let is_in = move |body: &&Body<f64>| moves(body) && is_like(&body.tree.rotation);
        self.model().bodies.iter().filter(is_in)
    }

    /// Operations of forward dynamics with a switch off, minus those with it on.
    fn saved_in_sweeps(&self, count: usize, turn_off: impl Fn(&mut Simplifications)) -> usize {
        self.saved_beside(count, |_| {}, turn_off)
    }

    /// As `saved_in_sweeps`, with other switches off in both counts.
    fn saved_beside(
        &self,
        count: usize,
        others_off: impl Fn(&mut Simplifications),
        turn_off: impl Fn(&mut Simplifications),
    ) -> usize {
        let mut on = self.model().simplifications;
        others_off(&mut on);
        let mut off = on;
        turn_off(&mut off);
        if count == 0 || off == on {
            return 0;
        }
        let of = |simplifications| with(self, simplifications, &Function::ForwardDynamics);
        of(off).saturating_sub(of(on))
    }

    /// The joints that [`Scene::lock`] fixed, compared with the scene in which they move.
    pub(super) fn locked_item(&self) -> Simplification {
        let names: Vec<String> = self.source().locked_joints().map(str::to_owned).collect();
        let before = if names.is_empty() { None } else { self.source().unlocked().build().ok() };
        let (bodies, operations) = before.map_or((0, 0), |before| {
            let of = |scene| of(scene, &Function::ForwardDynamics);
            let saved = of(&before).saturating_sub(of(self));
            (before.model().bodies.len().saturating_sub(self.model().bodies.len()), saved)
        });
        Simplification {
            what: "locked joints, folded into the bodies around them",
            count: names.len(),
            names,
            why: "a joint that cannot move is a fixed joint: the rows and columns of M that move are the same",
            saved: counted(bodies, "body that is not visited", "bodies that are not visited"),
            operations,
            ..NOTHING
        }
    }

    /// True if the scene has a factor.
    fn has_factor(&self) -> bool {
        self.nv() > 0 && self.model().simplifications.every_body_moves()
    }

    /// Calls that share q.
    pub(super) fn factor_item(&self) -> Simplification {
        if !self.has_factor() {
            return NOTHING;
        }
        let q = self.neutral();
        let (whole, solve) = (of(self, &Function::ForwardDynamics), flops(&of_factor(self, &q, &q).solved));
        Simplification {
            what: "the factor of M, in calls that share q",
            count: self.model().bodies.len(),
            why: "P, D and g depend on q alone: factor(q) once, solve(tau - bias) for each right side",
            saved: format!("{solve} operations for each right side after the first, instead of {whole}"),
            operations: whole.saturating_sub(solve),
            ..NOTHING
        }
    }

    /// Update of a factor after a change of the last joint only, which is the tip of the last branch.
    pub(super) fn branch_item(&self) -> Simplification {
        if !self.has_factor() {
            return NOTHING;
        }
        let (q, mut step, mut moved) = (self.neutral(), vec![0.0; self.nv()], self.neutral());
        step[self.nv() - 1] = 0.1;
        if self.integrate(&q, &step, &mut moved).is_err() {
            return NOTHING;
        }
        let calls = of_factor(self, &q, &moved);
        let (made, updated) = (flops(&calls.made), flops(&calls.updated));
        Simplification {
            what: "bodies that are not on the path to the base, in a factor of which only the last joint has moved",
            count: self.model().bodies.len() - calls.bodies,
            why: "P, D and g of a body depend on the joints that it carries: factor.update(q)",
            saved: format!("{updated} operations instead of the {made} of a new factor in covariance form"),
            operations: made.saturating_sub(updated),
            ..NOTHING
        }
    }

    /// The operations of forward dynamics that generated code omits.
    pub(super) fn compiled_item(&self) -> Simplification {
        // The counts are those of the tree.
        if self.nv() == 0 || self.nv() > MOST_COMPILED || !self.constraints().is_empty() {
            return NOTHING;
        }
        // No item for functions without a program.
        let Ok(program) = Program::new(self, &Function::ForwardDynamics) else { return NOTHING };
        let asked = of(self, &Function::ForwardDynamics);
        let left = flops(&program.operations());
        Simplification {
            what: "operations that are constant for this robot, in code compiled for it",
            count: asked.saturating_sub(left),
            why: in_language(
                "products by zero and one, constant sums and repeated terms are resolved when the code is generated: \
                 codegen::sources",
                "products by zero and one, constant sums and repeated terms are resolved when the code is generated: \
                 phipsi.compile, to_c",
            ),
            saved: format!("{left} operations of forward dynamics instead of {asked}"),
            operations: asked.saturating_sub(left),
            ..NOTHING
        }
    }

    /// The outputs that forward dynamics does not compute.
    pub(super) fn outputs_item(&self) -> Simplification {
        let nv = self.nv();
        if nv == 0 {
            return NOTHING;
        }
        let mut outputs = vec![("inverse dynamics", Function::InverseDynamics), ("bias torque", Function::BiasTorque)];
        if nv <= MOST_DENSE {
            outputs.extend([("mass matrix", Function::MassMatrix), ("its inverse", Function::MassMatrixInverse)]);
        }
        let each: Vec<(&str, usize)> = outputs.iter().map(|(name, output)| (*name, of(self, output))).collect();
        let text: Vec<String> = each.iter().map(|(name, operations)| format!("{name} {operations}")).collect();
        Simplification {
            what: "outputs that are not asked for",
            count: each.len(),
            why: "each method computes what it returns",
            saved: format!("operations, in a call of forward dynamics: {}", text.join(", ")),
            operations: each.iter().map(|(_, operations)| operations).sum(),
            ..NOTHING
        }
    }
}
