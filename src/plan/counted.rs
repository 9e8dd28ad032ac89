//! Savings that are counted: the sweeps of generated code, run on scalars that count their operations.

use super::{NOTHING, Omission, counted};
use crate::codegen::{Function, Program, count};
use crate::dynamics::traced::TracedSweeps;
use crate::model::{Body, Model, Omissions};
use crate::scalar::{Operations, Real, Traced};
use crate::scene::Scene;
use crate::spatial::transform::{turns_about_a_tilted_axis, turns_about_an_axis};
use nalgebra::Matrix3;

/// Dense results are counted up to this many degrees of freedom: they are O(N^2).
const MOST_DENSE: usize = 256;
/// Programs are written for up to this many: longer ones take milliseconds a joint.
const MOST_COMPILED: usize = 64;

/// Floating-point operations.
fn flops(operations: &Operations) -> usize {
    usize::try_from(operations.flops()).unwrap_or(usize::MAX)
}

/// Operations of a body that a new factor does not compute, but propagates to a parent that is computed again: the
/// measurement of its row, and its P^+ at the parent. Counted for a revolute joint (docs/leaving-out.md).
const PROPAGATED_AGAIN: usize = 360;

/// Operations of one function on a state that moves, in covariance form.
fn of(scene: &Scene, function: &Function) -> usize {
    with(scene, scene.model().omissions, function)
}

/// The same with other switches than those of the scene.
fn with(scene: &Scene, omissions: Omissions, function: &Function) -> usize {
    let (q, ones) = (scene.neutral(), vec![1.0; scene.nv()]);
    let model = Model { omissions, ..scene.model().clone() };
    // Functions of the dynamics are of no link.
    count(scene, &model, function, &[&q, &ones, &ones]).map_or(0, |operations| flops(&operations))
}

/// Operations of a factor of M, and of one solution with it.
fn of_factor(scene: &Scene) -> [usize; 2] {
    let q: Vec<Traced> = scene.neutral().into_iter().map(Traced::from_f64).collect();
    let (tau, mut out) = (vec![Traced::from_f64(1.0); scene.nv()], vec![Traced::from_f64(f64::NAN); scene.nv()]);
    let mut traced = TracedSweeps::new(scene.model());
    let (_, made) = Traced::counted(|| traced.factor(&q));
    let ((), solved) = Traced::counted(|| traced.solve(&tau, &mut out));
    [flops(&made), flops(&solved)]
}

impl Scene {
    /// Rotations of the tree that keep the joint on an axis.
    pub(super) fn renamed_item(&self) -> Omission {
        let count = self.bodies_on(turns_about_an_axis).count();
        // The saving of tilted axes depends on it, and has an item of its own.
        let saved = self.saved_beside(
            count,
            |omissions| omissions.tilted_axes = false,
            |omissions| omissions.renamed_axes = false,
        );
        self.switched(
            "renamed_axes",
            Omission {
                what: "rotations of the tree that rename axes, or turn about the joint's own",
                count,
                why: "the joint's angle, a constant, or both together are all there is to turn by, about z, and entries change places and signs",
                saved: counted(count, "rotation matrix", "rotation matrices")
                    + ", and P turned by an angle instead of by it",
                operations: saved,
                ..NOTHING
            },
        )
    }

    /// Rotations of the tree that bring the joint's axis anywhere.
    pub(super) fn tilted_item(&self) -> Omission {
        let renamed = self.model().omissions.renamed_axes;
        let count = if renamed { self.bodies_on(turns_about_a_tilted_axis).count() } else { 0 };
        let saved = self.saved_in_sweeps(count, |omissions| omissions.tilted_axes = false);
        self.switched(
            "tilted_axes",
            Omission {
                what: "rotations of the tree at other joints that turn or slide",
                count,
                why: "a constant angle or two bring the joint's axis to one of its parent's",
                saved: counted(count, "rotation matrix", "rotation matrices")
                    + ", and P turned by angles instead of by it",
                operations: saved,
                ..NOTHING
            },
        )
    }

    /// Bodies that turn or slide on a rotation of the tree like this.
    fn bodies_on(&self, is_like: impl Fn(&Matrix3<f64>) -> bool) -> impl Iterator<Item = &Body<f64>> {
        let moves = |body: &Body<f64>| body.motion.has_constant_axis();
        let is_in = move |body: &&Body<f64>| moves(body) && is_like(&body.tree.rotation);
        self.model().bodies.iter().filter(is_in)
    }

    /// Operations of forward dynamics with a switch off, less those with it on.
    fn saved_in_sweeps(&self, count: usize, turn_off: impl Fn(&mut Omissions)) -> usize {
        self.saved_beside(count, |_| {}, turn_off)
    }

    /// The same where others are off on both sides.
    fn saved_beside(
        &self,
        count: usize,
        others_off: impl Fn(&mut Omissions),
        turn_off: impl Fn(&mut Omissions),
    ) -> usize {
        let mut on = self.model().omissions;
        others_off(&mut on);
        let mut off = on;
        turn_off(&mut off);
        if count == 0 || off == on {
            return 0;
        }
        let of = |omissions| with(self, omissions, &Function::ForwardDynamics);
        of(off).saturating_sub(of(on))
    }

    /// The joints that [`Scene::lock`] fixed, beside the scene where they move.
    pub(super) fn locked_item(&self) -> Omission {
        let names: Vec<String> = self.source().locked_joints().map(str::to_owned).collect();
        let before = if names.is_empty() { None } else { self.source().unlocked().build().ok() };
        let (bodies, operations) = before.map_or((0, 0), |before| {
            let of = |scene| of(scene, &Function::ForwardDynamics);
            let saved = of(&before).saturating_sub(of(self));
            (before.model().bodies.len().saturating_sub(self.model().bodies.len()), saved)
        });
        Omission {
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
        self.nv() > 0 && self.model().omissions.every_body_moves()
    }

    /// Calls that share q.
    pub(super) fn factor_item(&self) -> Omission {
        if !self.has_factor() {
            return NOTHING;
        }
        let (whole, [_, solve]) = (of(self, &Function::ForwardDynamics), of_factor(self));
        Omission {
            what: "the factor of M, in calls that share q",
            count: self.model().bodies.len(),
            why: "P, D and g depend on q alone: factor(q) once, solve(tau - bias) for each right side",
            saved: format!("{solve} operations for each right side after the first, instead of {whole}"),
            operations: whole.saturating_sub(solve),
            ..NOTHING
        }
    }

    /// Calls in which the last joint alone moves: the end of the last branch.
    pub(super) fn branch_item(&self) -> Omission {
        if !self.has_factor() {
            return NOTHING;
        }
        let stages = &self.model().system.stages;
        let Some(last) = stages.iter().position(|stage| stage.first_row + stage.rows.count() == self.nv()) else {
            return NOTHING;
        };
        let path: Vec<usize> = std::iter::successors(Some(last), |&body| stages[body].parent).collect();
        let is_beside = |body: usize| !path.contains(&body) && stages[body].parent.is_some_and(|k| path.contains(&k));
        let beside = (0..stages.len()).filter(|&body| is_beside(body)).count();
        let [made, _] = of_factor(self);
        let updated = (made * path.len() / stages.len() + PROPAGATED_AGAIN * beside).min(made);
        Omission {
            what: "bodies beside the path to the base, in a factor of which the last joint alone has moved",
            count: stages.len() - path.len(),
            why: "P, D and g of a body depend on the joints that it carries: factor.update(q)",
            saved: format!("about {updated} operations instead of the {made} of a new factor in covariance form"),
            operations: made.saturating_sub(updated),
            ..NOTHING
        }
    }

    /// The operations of forward dynamics that generated code omits.
    pub(super) fn compiled_item(&self) -> Omission {
        if self.nv() == 0 || self.nv() > MOST_COMPILED {
            return NOTHING;
        }
        // No item for functions without a program.
        let Ok(program) = Program::new(self, &Function::ForwardDynamics) else { return NOTHING };
        let asked = of(self, &Function::ForwardDynamics);
        let left = flops(&program.operations());
        Omission {
            what: "operations that this robot's constants decide, in code compiled for it",
            count: asked.saturating_sub(left),
            why: "products by zero and one, sums of constants, and what is computed twice are known when the code is written: phipsi.compile, to_c",
            saved: format!("{left} operations of forward dynamics instead of {asked}"),
            operations: asked.saturating_sub(left),
            ..NOTHING
        }
    }

    /// The outputs that forward dynamics does not compute.
    pub(super) fn outputs_item(&self) -> Omission {
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
        Omission {
            what: "outputs that are not asked for",
            count: each.len(),
            why: "each method computes what it returns",
            saved: format!("operations, in a call of forward dynamics: {}", text.join(", ")),
            operations: each.iter().map(|(_, operations)| operations).sum(),
            ..NOTHING
        }
    }
}
