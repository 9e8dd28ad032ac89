//! Kinetic and potential energy, and momentum.

use crate::kinematics::propagation::sum_tip_to_base;
use crate::kinematics::{placements_base_to_tip, velocities_base_to_tip};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{BodyInertia, dot, sum, zero};
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

/// Kinetic and potential energy in O(N).
#[inline(always)]
pub fn energy<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, q: &[T], qd: &[T]) -> Energy<T> {
    placements_base_to_tip(model, q, &mut workspace.store.shifts);
    velocities_base_to_tip(model, &workspace.store.shifts, qd, &mut workspace.velocity);
    first_moments_tip_to_base(model, workspace);
    Energy { kinetic: kinetic_energy(model, workspace, qd), potential: potential_energy(model, workspace) }
}

/// Potential energy of gravity, J: minus gravity times the first moment of mass; from first moments and phi.
#[inline(always)]
pub(super) fn potential_energy<T: Real>(model: &Model<T>, workspace: &Workspace<T>) -> T {
    let mut total = BodyInertia::zero().first();
    for (k, stage) in model.system.stages.iter().enumerate() {
        if stage.parent.is_none() {
            total = total.add(&workspace.first_moment[k].at_parent(&workspace.store.shifts[k]));
        }
    }
    let (moment, g) = (&total.moment, &model.gravity);
    -(g[0] * moment[0] + g[1] * moment[1] + g[2] * moment[2])
}

/// Tip to base: mass and first moment of r(k) (3.5), with phi in the workspace.
#[inline(always)]
pub(super) fn first_moments_tip_to_base<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>) {
    let Workspace { first_moment, store, .. } = workspace;
    for (first_moment, body) in first_moment.iter_mut().zip(&model.bodies) {
        *first_moment = body.inertia.first();
    }
    sum_tip_to_base(&model.system.stages, &store.shifts, first_moment);
}

/// Kinetic energy, J: half of v* M v over all bodies, plus half of armature times the square of the joint velocity;
/// from velocities.
#[inline(always)]
pub(super) fn kinetic_energy<T: Real>(model: &Model<T>, workspace: &Workspace<T>, qd: &[T]) -> T {
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
    velocities_base_to_tip(model, &workspace.store.shifts, qd, &mut workspace.velocity);
    momenta_of_bodies(model, workspace);
    total_on_base(model, workspace)
}

/// The momentum of each body in `workspace.z`, from velocities.
#[inline(always)]
pub(super) fn momenta_of_bodies<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>) {
    for ((z, body), v) in workspace.z.iter_mut().zip(&model.bodies).zip(&workspace.velocity) {
        *z = body.inertia.mul_motion(v);
    }
}

/// Tip to base: the sum of the forces (or momenta) `workspace.z` on all bodies, about the base's origin and in its
/// axes.
#[inline(always)]
pub(super) fn total_on_base<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>) -> Vector6<T> {
    let Workspace { z, store, .. } = workspace;
    sum_tip_to_base(&model.system.stages, &store.shifts, z);
    let mut total = zero();
    for (k, stage) in model.system.stages.iter().enumerate().rev() {
        if stage.parent.is_none() {
            total = sum(&total, &store.shifts[k].force_to_parent(&z[k]));
        }
    }
    total
}
