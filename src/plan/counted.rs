//! What is saved where that is counted by running the algorithms on numbers that count.

use super::{NOTHING, Simplification, counted};
use crate::algorithm::{Algorithm, Arguments};
use crate::codegen::{Function, Program};
use crate::filter::Form;
use crate::model::{Body, Motion, Simplifications};
use crate::report::operations::{Task, count_in_sweeps, count_recursion, of_factor};
use crate::scalar::Operations;
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

/// Operations of one algorithm on a state that moves, by the recursion that keeps everything.
fn of(scene: &Scene, algorithm: Algorithm) -> usize {
    let (q, ones) = (scene.neutral(), vec![1.0; scene.nv()]);
    let state = Arguments { q: &q, qd: &ones, u: &ones, wrenches: &[], ..Arguments::default() };
    flops(&count_recursion(scene, Task::Algorithm(algorithm), &state).operations)
}

/// The same of forward dynamics in covariance form.
fn forward(scene: &Scene) -> usize {
    of(scene, Algorithm::ForwardDynamics(Form::Covariance))
}

impl Scene {
    /// Rotations of the tree that keep the joint on an axis.
    pub(super) fn renamed_item(&self) -> Simplification {
        let count = self.bodies_on(turns_about_an_axis).count();
        // What tilted axes save goes with it, and has an item of its own.
        let saved = self.saved_beside(
            count,
            |simplifications| simplifications.oblique_axes = false,
            |simplifications| simplifications.permuted_axes = false,
        );
        self.switched(
            "permuted_axes",
            Simplification {
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
    pub(super) fn tilted_item(&self) -> Simplification {
        let renamed = self.model().simplifications.permuted_axes;
        let count = if renamed { self.bodies_on(turns_about_a_tilted_axis).count() } else { 0 };
        let saved = self.saved_in_sweeps(count, |simplifications| simplifications.oblique_axes = false);
        self.switched(
            "oblique_axes",
            Simplification {
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
        let moves = |body: &Body<f64>| matches!(body.motion, Motion::Revolute | Motion::Prismatic);
        let is_in = move |body: &&Body<f64>| moves(body) && is_like(&body.tree.rotation);
        self.model().bodies.iter().filter(is_in)
    }

    /// Operations of forward dynamics with a switch off, less those with it on.
    fn saved_in_sweeps(&self, count: usize, turn_off: impl Fn(&mut Simplifications)) -> usize {
        self.saved_beside(count, |_| {}, turn_off)
    }

    /// The same where others are off on both sides.
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
        let (q, ones) = (self.neutral(), vec![1.0; self.nv()]);
        let state = Arguments { q: &q, qd: &ones, u: &ones, wrenches: &[], ..Arguments::default() };
        let of = |simplifications| {
            let algorithm = Algorithm::ForwardDynamics(Form::Covariance);
            flops(&count_in_sweeps(self, simplifications, algorithm, &state).operations)
        };
        of(off).saturating_sub(of(on))
    }

    /// The joints that [`Scene::lock`] fixed, beside the scene where they move.
    pub(super) fn locked_item(&self) -> Simplification {
        let names: Vec<String> = self.source().locked_joints().map(str::to_owned).collect();
        let before = if names.is_empty() { None } else { self.source().unlocked().build().ok() };
        let (bodies, operations) = before.map_or((0, 0), |before| {
            let saved = forward(&before).saturating_sub(forward(self));
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

    /// Whether there is a factor to speak of.
    fn has_factor(&self) -> bool {
        self.nv() > 0 && self.model().simplifications.every_body_moves()
    }

    /// Calls that share q.
    pub(super) fn factor_item(&self) -> Simplification {
        if !self.has_factor() {
            return NOTHING;
        }
        let q = self.neutral();
        let (whole, solve) = (forward(self), flops(&of_factor(self, &q, &q).solved));
        Simplification {
            what: "the factor of M, in calls that share q",
            count: self.model().bodies.len(),
            why: "P, D and g depend on q alone: factor(q) once, solve(tau - bias) for each right side",
            saved: format!("{solve} operations for each right side after the first, instead of {whole}"),
            operations: whole.saturating_sub(solve),
            ..NOTHING
        }
    }

    /// Calls in which the last joint alone moves: the end of the last branch.
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
            what: "bodies beside the path to the base, in a factor of which the last joint alone has moved",
            count: self.model().bodies.len() - calls.bodies,
            why: "P, D and g of a body depend on the joints that it carries: factor.update(q)",
            saved: format!("{updated} operations instead of the {made} of a new factor in covariance form"),
            operations: made.saturating_sub(updated),
            ..NOTHING
        }
    }

    /// What code of this robot alone leaves out of forward dynamics.
    pub(super) fn compiled_item(&self) -> Simplification {
        if self.nv() == 0 || self.nv() > MOST_COMPILED {
            return NOTHING;
        }
        // Of what programs do not have nothing is told.
        let Ok(program) = Program::new(self, &Function::ForwardDynamics) else { return NOTHING };
        let (q, ones) = (self.neutral(), vec![1.0; self.nv()]);
        let state = Arguments { q: &q, qd: &ones, u: &ones, wrenches: &[], ..Arguments::default() };
        let algorithm = Algorithm::ForwardDynamics(Form::Covariance);
        let asked = flops(&count_in_sweeps(self, self.model().simplifications, algorithm, &state).operations);
        let left = flops(&program.operations());
        Simplification {
            what: "operations that this robot's constants decide, in code compiled for it",
            count: asked.saturating_sub(left),
            why: "products by zero and one, sums of constants, and what is computed twice are known when the code is written: phipsi.compile, to_c",
            saved: format!("{left} operations of forward dynamics instead of {asked}"),
            operations: asked.saturating_sub(left),
            ..NOTHING
        }
    }

    /// What forward dynamics does not compute.
    pub(super) fn outputs_item(&self) -> Simplification {
        let (nv, inverse) = (self.nv(), Algorithm::MassMatrixInverse(Form::Covariance));
        if nv == 0 {
            return NOTHING;
        }
        let mut outputs =
            vec![("inverse dynamics", Algorithm::InverseDynamics), ("bias torque", Algorithm::BiasTorque)];
        if nv <= MOST_DENSE {
            outputs.extend([("mass matrix", Algorithm::MassMatrix), ("its inverse", inverse)]);
        }
        let each: Vec<(&str, usize)> = outputs.into_iter().map(|(name, output)| (name, of(self, output))).collect();
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
