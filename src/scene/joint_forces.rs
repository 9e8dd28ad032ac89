//! Damping, springs and friction of the joints: torques that act in addition to tau in simulations, and the linear ones
//! also in linearizations.

use super::Scene;
use super::description::FrictionCurve;
use crate::error::Error;
use crate::model::{Body, Model};
use std::collections::HashMap;
use std::sync::Arc;

/// Viscous damping, springs and friction of the joints of a tree, by its degrees of freedom; the rest configuration has
/// its coordinates.
#[derive(Debug)]
pub(crate) struct JointForces {
    pub damping: Vec<f64>,
    pub stiffness: Vec<f64>,
    pub rest: Vec<f64>,
    pub friction: Vec<f64>,
    /// Terms of friction beside it; empty if no joint has any.
    pub curves: Vec<FrictionCurve>,
}

impl Scene {
    /// The damping, springs and friction in the description of the [`tree`](Self::tree), read once.
    pub(crate) fn joint_forces(&self) -> Arc<JointForces> {
        let tree = self.tree();
        tree.shared().get_or_make(|| JointForces::of(tree))
    }

    /// Adds the torque of springs and damping, -k (q (-) rest) - d qd, to `torque` (nv).
    ///
    /// Returns an error if valid arguments overflow; invalid ones remain for the checks of the caller.
    pub(crate) fn add_linear_joint_forces(&self, q: &[f64], qd: &[f64], torque: &mut [f64]) -> Result<(), Error> {
        let (forces, model) = (self.joint_forces(), self.model());
        if self.check_coordinates("q", q).is_err() || qd.iter().chain(&*torque).any(|value| !value.is_finite()) {
            return Ok(());
        }
        if let Some(coupling) = self.coupling() {
            let (mut of_tree, mut reduced) = (vec![0.0; model.nv()], vec![0.0; torque.len()]);
            forces.add(model, (&coupling.configuration(q), &coupling.rates(qd)), &mut of_tree);
            coupling.reduce(&of_tree, &mut reduced);
            torque.iter_mut().zip(reduced).for_each(|(sum, more)| *sum += more);
        } else {
            forces.add(model, (q, qd), torque);
        }
        self.check_result("tau with springs and damping", torque)
    }

    /// Adds the accelerations by this torque to A of a linearized system, (2nv x 2nv), from M^-1 in its B, (2nv x nv).
    pub(crate) fn add_linear_joint_forces_to_system(&self, q: &[f64], (a, b): (&mut [f64], &[f64])) {
        let nv = self.nv();
        for (a, b) in a.chunks_exact_mut((2 * nv).max(1)).zip(b.chunks_exact(nv.max(1))).skip(nv) {
            self.add_linear_joint_forces_to_row(q, b, a);
        }
    }

    /// Adds the derivatives by (q, qd), (2nv), of a function through this torque, from that by the torque, (nv).
    pub(crate) fn add_linear_joint_forces_to_row(&self, q: &[f64], by_torque: &[f64], row: &mut [f64]) {
        let (forces, model, nv) = (self.joint_forces(), self.model(), self.nv());
        let (by_q, by_qd) = row.split_at_mut(nv);
        let Some(coupling) = self.coupling() else {
            forces.add_cotangents(model, (q, by_torque), (by_q, by_qd));
            return;
        };
        let [mut of_q, mut of_qd] = [(); 2].map(|()| vec![0.0; model.nv()]);
        forces.add_cotangents(model, (&coupling.configuration(q), &coupling.rates(by_torque)), (&mut of_q, &mut of_qd));
        for (of_tree, by) in [(of_q, by_q), (of_qd, by_qd)] {
            let mut reduced = vec![0.0; nv];
            coupling.reduce(&of_tree, &mut reduced);
            by.iter_mut().zip(reduced).for_each(|(sum, more)| *sum += more);
        }
    }
}

impl JointForces {
    fn of(tree: &Scene) -> Self {
        let zeros = || vec![0.0; tree.nv()];
        let curves = vec![FrictionCurve::default(); tree.nv()];
        let mut all = Self { damping: zeros(), stiffness: zeros(), rest: tree.neutral(), friction: zeros(), curves };
        let described: HashMap<&str, _> =
            tree.source().joints().iter().map(|joint| (joint.name.as_str(), joint)).collect();
        let root = tree.source().root_joint(String::new());
        for joint in tree.joints() {
            // The free joint of a floating base has no description.
            let of = described.get(joint.name.as_str()).copied().unwrap_or(&root);
            all.damping[joint.v.clone()].fill(of.damping);
            all.friction[joint.v.clone()].fill(of.friction);
            all.curves[joint.v.clone()].fill(of.friction_curve);
            all.stiffness[joint.v.clone()].fill(of.spring.stiffness);
            if !of.spring.rest.is_empty() {
                all.rest[joint.q.clone()].copy_from_slice(&of.spring.rest);
            }
        }
        if all.curves.iter().all(FrictionCurve::is_flat) {
            all.curves.clear();
        }
        all
    }

    /// True if any spring or damping acts.
    #[cfg(feature = "python")]
    pub fn are_linear(&self) -> bool {
        self.damping.iter().chain(&self.stiffness).any(|&value| value != 0.0)
    }

    /// The rows of each body with springs: the body, its first row and their number.
    fn sprung<'a>(&'a self, model: &'a Model<f64>) -> impl Iterator<Item = (&'a Body<f64>, usize, usize)> {
        let each = model.bodies.iter().zip(&model.system.stages);
        let each = each.map(|(body, stage)| (body, stage.first_row, stage.rows.count()));
        each.filter(|&(_, first, count)| self.stiffness[first..first + count].iter().any(|&k| k != 0.0))
    }

    fn add(&self, model: &Model<f64>, (q, qd): (&[f64], &[f64]), torque: &mut [f64]) {
        for (torque, (d, v)) in torque.iter_mut().zip(self.damping.iter().zip(qd)) {
            *torque -= d * v;
        }
        for (body, first, count) in self.sprung(model) {
            let mut displaced = [0.0; 6];
            body.motion.displacement(&self.rest[body.q..], &q[body.q..], &mut displaced);
            for (row, displaced) in (first..first + count).zip(displaced) {
                torque[row] -= self.stiffness[row] * displaced;
            }
        }
    }

    /// Adds the gradients of a function by q, in its tangent space, and qd through this torque, from that by the
    /// torque.
    fn add_cotangents(
        &self,
        model: &Model<f64>,
        (q, by_torque): (&[f64], &[f64]),
        (by_q, by_qd): (&mut [f64], &mut [f64]),
    ) {
        for (by_qd, (d, by)) in by_qd.iter_mut().zip(self.damping.iter().zip(by_torque)) {
            *by_qd -= d * by;
        }
        for (body, first, count) in self.sprung(model) {
            let mut pulled = [0.0; 6];
            for (row, pulled) in (first..first + count).zip(&mut pulled) {
                *pulled = -self.stiffness[row] * by_torque[row];
            }
            body.motion.displacement_cotangent((&self.rest[body.q..], &q[body.q..]), &pulled, &mut by_q[first..]);
        }
    }
}
