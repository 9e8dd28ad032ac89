//! Kinetic and potential energy, and momentum.

use super::mass_matrix::composite_inertias_tip_to_base;
use crate::algorithm::KinematicQuantity;
use crate::kinematics::{joint_motion, placements_base_to_tip};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{BodyInertia, dot, sum};
use crate::workspace::Workspace;
use nalgebra::Vector6;

/// Energy of one state, J.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Energy<T> {
    /// Half of v* M v over all bodies, plus half of armature times the square of the joint velocity.
    pub kinetic: T,
    /// Minus gravity times the first moment of mass; zero with the center of mass at the base's origin.
    pub potential: T,
}

/// Computes the quantities of this file into `out`; returns false for others.
#[inline(always)]
pub(super) fn quantity<T: Real>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    what: &KinematicQuantity<'_>,
    (q, qd, _): (&[T], &[T], &[T]),
    out: &mut [T],
) -> bool {
    match what {
        KinematicQuantity::Momentum => out.copy_from_slice(momentum(model, workspace, q, qd).as_slice()),
        KinematicQuantity::KineticEnergy => out[0] = kinetic_energy(model, workspace, q, qd),
        KinematicQuantity::PotentialEnergy => out[0] = potential_energy(model, workspace, q),
        KinematicQuantity::Energy => {
            let both = energy(model, workspace, q, qd);
            out.copy_from_slice(&[both.kinetic, both.potential]);
        }
        _ => return false,
    }
    true
}

/// Kinetic and potential energy in O(N).
#[inline(always)]
pub fn energy<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, q: &[T], qd: &[T]) -> Energy<T> {
    let kinetic = kinetic_energy(model, workspace, q, qd);
    Energy { kinetic, potential: potential(model, workspace) }
}

/// Potential energy of gravity alone in O(N), J: minus gravity times the first moment of mass.
#[inline(always)]
fn potential_energy<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, q: &[T]) -> T {
    placements_base_to_tip(model, q, &mut workspace.store.shifts);
    potential(model, workspace)
}

/// Potential energy with phi in the workspace.
#[inline(always)]
fn potential<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>) -> T {
    let (moment, g) = (total_inertia(model, workspace).first_moment, &model.gravity);
    -(g[0] * moment[0] + g[1] * moment[1] + g[2] * moment[2])
}

/// Kinetic energy alone in O(N), J: half of v* M v over all bodies, plus half of armature times the square of the joint
/// velocity.
#[inline(always)]
pub fn kinetic_energy<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, q: &[T], qd: &[T]) -> T {
    placements_base_to_tip(model, q, &mut workspace.store.shifts);
    velocities_base_to_tip(model, workspace, qd);
    let mut twice_kinetic = T::zero();
    for (body, v) in model.bodies.iter().zip(&workspace.velocity) {
        twice_kinetic += dot(v, &body.inertia.mul_motion(v));
    }
    for (&armature, &rate) in model.system.noise.iter().zip(qd) {
        twice_kinetic += armature * rate * rate;
    }
    T::from_f64(0.5) * twice_kinetic
}

/// Spatial momentum (angular about the origin of the base, linear) of all moving bodies, in the base frame: N m s, N s.
///
/// Armature is measurement noise, not a body: rotors do not contribute.
#[inline(always)]
pub fn momentum<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, q: &[T], qd: &[T]) -> Vector6<T> {
    placements_base_to_tip(model, q, &mut workspace.store.shifts);
    velocities_base_to_tip(model, workspace, qd);
    for ((z, body), v) in workspace.z.iter_mut().zip(&model.bodies).zip(&workspace.velocity) {
        *z = body.inertia.mul_motion(v);
    }
    sum_on_base(model, workspace)
}

/// Tip to base: the sum of the forces (or momenta) `z` on all bodies, about the base's origin and in its axes.
#[inline(always)]
pub(super) fn sum_on_base<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>) -> Vector6<T> {
    let mut total = Vector6::from_element(T::zero());
    for (k, stage) in model.system.stages.iter().enumerate().rev() {
        let carried = workspace.store.shifts[k].force_to_parent(&workspace.z[k]);
        match stage.parent {
            Some(parent) => workspace.z[parent] = sum(&workspace.z[parent], &carried),
            None => total = sum(&total, &carried),
        }
    }
    total
}

/// Base to tip: spatial velocities, with phi already in the workspace.
#[inline(always)]
pub(super) fn velocities_base_to_tip<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, qd: &[T]) {
    for (k, body) in model.bodies.iter().enumerate() {
        let stage = &model.system.stages[k];
        let mut velocity = joint_motion(body, stage.first_row, qd);
        if let Some(parent) = stage.parent {
            velocity = sum(&velocity, &workspace.store.shifts[k].motion_to_child(&workspace.velocity[parent]));
        }
        workspace.velocity[k] = velocity;
    }
}

/// Composite inertia of all moving bodies, about the origin of the base.
#[inline(always)]
fn total_inertia<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>) -> BodyInertia<T> {
    composite_inertias_tip_to_base(model, workspace);
    let mut total = BodyInertia::zero();
    for (k, stage) in model.system.stages.iter().enumerate() {
        if stage.parent.is_none() {
            total = total.add(&workspace.composite[k].to_parent(&workspace.store.shifts[k]));
        }
    }
    total
}
