//! The center of mass of all moving bodies, its motion, and the momentum about it.
//!
//! Links on the base and rotors do not count: links on the base do not move, whether they are simplified away or not,
//! and armature is measurement noise. Levers are computed relative to the center of mass by way of the origin of the
//! first moving body, so that the distance of a floating robot from the origin of the base causes no loss of precision.
//! If no moving body has mass, there is no center of mass, and results are NaN.

use crate::filter::System;
use crate::joints::vectors::plus;
use crate::kinematics::propagation::sum_tip_to_base;
use crate::kinematics::{accelerations_base_to_tip, write_column};
use crate::model::Model;
use crate::scalar::Real;
use crate::spatial::{FirstMoment, RigidShift, cross, cross_force, cross_motion, linear, scaled_add, spatial, sum};
use crate::workspace::Workspace;
use nalgebra::{Vector3, Vector6};

/// Mass of all bodies that move relative to the base, kg.
#[inline(always)]
pub fn total_mass<T: Real>(model: &Model<T>) -> T {
    let moving = model.bodies.iter().enumerate().filter(|&(k, _)| moves(&model.system, k));
    moving.fold(T::zero(), |sum, (_, body)| sum + body.inertia.mass)
}

/// The force M a + b of each body in `workspace.z` at joint accelerations qdd, without gravity, from velocities: their
/// sum is the mass times the acceleration of the center of mass.
#[inline(always)]
pub(super) fn forces_of_bodies<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, rates: (&[T], &[T])) {
    let Workspace { store, velocity, z: acceleration, .. } = &mut *workspace;
    accelerations_base_to_tip(model, (&store.shifts, velocity), rates, None, acceleration);
    for ((z, body), velocity) in acceleration.iter_mut().zip(&model.bodies).zip(velocity) {
        *z = body.inertia.bias_force(velocity, z);
    }
}

/// The Jacobian of the center of mass into `out`, (3 x nv) row by row: the velocity in the base frame is J qd. From
/// first moments and placements from the center.
#[inline(always)]
pub(super) fn center_of_mass_jacobian<T: Real>(model: &Model<T>, (workspace, center): At<'_, T>, out: &mut [T]) {
    let by_mass = center.mass.recip();
    each_row(model, |k, j, axis| {
        let momentum = workspace.first_moment[k].momentum_of(axis);
        let column = workspace.store.shifts[k].rotate(&momentum);
        write_column(out, model.nv(), j, &[column[0] * by_mass, column[1] * by_mass, column[2] * by_mass]);
    });
}

/// The centroidal momentum matrix into `out`, (6 x nv) row by row: the momentum (angular about the center of mass,
/// linear) in the base frame is A qd. From composite inertias and placements from the center.
///
/// Column j is the momentum of all bodies outboard of joint k, moving rigidly at a unit joint velocity: phi(base, k)
/// r(k) S, with the moment about the center of mass.
#[inline(always)]
pub(super) fn centroidal_momentum_matrix<T: Real>(model: &Model<T>, workspace: &Workspace<T>, out: &mut [T]) {
    each_row(model, |k, j, axis| {
        let column = workspace.store.shifts[k].force_to_parent(&workspace.composite[k].mul_motion(axis));
        write_column(out, model.nv(), j, column.as_slice());
    });
}

/// The time derivative of the centroidal momentum matrix into `out`, (6 x nv) row by row. From velocities, composite
/// inertias with their rates, and placements from the center.
///
/// With r' the time derivative of r(k) in fixed axes and S' = v(k) x S, the columns about a fixed point are phi(base,
/// k) (r' S + r S'). The center of mass moves with c', so c' x the linear half of A is subtracted from the angular
/// half.
#[inline(always)]
pub(super) fn centroidal_momentum_matrix_rate<T: Real>(
    model: &Model<T>,
    (workspace, center): At<'_, T>,
    out: &mut [T],
) {
    let (one, mut momentum) = (center.mass.constant(1.0), Vector3::from_element(center.mass.constant(0.0)));
    for k in roots(model) {
        momentum = plus(&momentum, one, &workspace.store.shifts[k].rotate(&workspace.composite_rate[k].first_moment));
    }
    let velocity = divided(&momentum, center.mass);
    each_row(model, |k, j, axis| {
        let (composite, shift) = (&workspace.composite[k], &workspace.store.shifts[k]);
        let turned = composite.mul_motion(&cross_motion(&workspace.velocity[k], axis));
        let rate = shift.force_to_parent(&sum(&workspace.composite_rate[k].mul_motion(axis), &turned));
        let pushed = shift.rotate(&linear(&composite.mul_motion(axis)));
        let left_behind = spatial(&cross(&velocity, &pushed), &Vector3::from_element(one.constant(0.0)));
        let column = scaled_add(&left_behind, one.constant(-1.0), &rate);
        write_column(out, model.nv(), j, column.as_slice());
    });
}

/// The derivatives of the centroidal momentum A qd with respect to q and qd into `out`, (2 x 6 x nv) row by row. From
/// the linear momentum `whole`, velocities, momenta of subtrees in `workspace.z`, composite inertias and placements
/// from the center.
///
/// With h the momentum of all bodies outboard of joint k about the origin of body k and V(p) the velocity inboard of
/// the joint, that about a fixed point changes by S x* h + r (V(p) x S). The center of mass moves by c' = (r S)/m, so
/// c' x the whole linear momentum is subtracted from the angular half.
#[inline(always)]
pub(super) fn centroidal_momentum_derivatives<T: Real>(
    model: &Model<T>,
    (workspace, center): At<'_, T>,
    (qd, whole): (&[T], &Vector3<T>),
    out: &mut [T],
) {
    let nv = model.nv();
    let (by_q, by_qd) = out.split_at_mut(6 * nv);
    let (none, by_mass) = (Vector3::from_element(center.mass.constant(0.0)), -center.mass.recip());
    each_row(model, |k, j, axis| {
        let (composite, shift, stage) = (&workspace.composite[k], &workspace.store.shifts[k], &model.system.stages[k]);
        let mut inboard = workspace.velocity[k];
        for i in 0..stage.rows.count() {
            let (own, minus) = (stage.rows.row(i).to_column(), -qd[stage.first_row + i]);
            inboard = scaled_add(&own, minus, &inboard);
        }
        let turned = composite.mul_motion(&cross_motion(&inboard, axis));
        let change = shift.force_to_parent(&sum(&cross_force(axis, &workspace.z[k]), &turned));
        let column = shift.force_to_parent(&composite.mul_motion(axis));
        // -c' x p
        let left_behind = spatial(&cross(&linear(&column), whole), &none);
        write_column(by_q, nv, j, scaled_add(&left_behind, by_mass, &change).as_slice());
        write_column(by_qd, nv, j, column.as_slice());
    });
}

/// x / s.
#[inline(always)]
pub(super) fn divided<T: Real>(x: &Vector3<T>, s: T) -> Vector3<T> {
    Vector3::new(x[0] / s, x[1] / s, x[2] / s)
}

/// True if a body moves relative to the base, that is if a joint at the body or inboard of it moves.
#[inline(always)]
fn moves<T: Real>(system: &System<T>, body: usize) -> bool {
    let mut inward = std::iter::successors(Some(body), |&k| system.stages[k].parent);
    inward.any(|k| system.stages[k].rows.count() > 0)
}

/// The parent of a body if it moves.
#[inline(always)]
fn moving_parent<T: Real>(system: &System<T>, body: usize) -> Option<usize> {
    system.stages[body].parent.filter(|&parent| moves(system, parent))
}

/// The moving bodies whose parents do not move. Every moving body is one of them or outboard of one.
#[inline(always)]
fn roots<T: Real>(model: &Model<T>) -> impl Iterator<Item = usize> {
    let system = &model.system;
    let stages = system.stages.iter().enumerate();
    stages.filter(|&(k, stage)| stage.rows.count() > 0 && moving_parent(system, k).is_none()).map(|(k, _)| k)
}

/// The pose of a root body on the base, with phi of each body to its parent in the store.
#[inline(always)]
fn on_base<T: Real>(model: &Model<T>, workspace: &Workspace<T>, root: usize) -> RigidShift<T> {
    let (mut at, mut placement) = (model.system.stages[root].parent, workspace.store.shifts[root]);
    while let Some(k) = at {
        placement = workspace.store.shifts[k].compose(&placement);
        at = model.system.stages[k].parent;
    }
    placement
}

/// A workspace, and the center of mass.
type At<'a, T> = (&'a Workspace<T>, &'a Center<T>);

/// The position of the center of mass, in the base frame.
pub(super) struct Center<T> {
    mass: T,
    /// From the origin of the base to that of the first root body.
    from: Vector3<T>,
    /// From there to the center of mass.
    to: Vector3<T>,
}

impl<T: Real> Center<T> {
    /// The position, m.
    #[inline(always)]
    pub fn position(&self) -> Vector3<T> {
        plus(&self.from, self.mass.constant(1.0), &self.to)
    }
}

/// The center of mass, from the mass and the first moment of each root body with all bodies outboard of it.
#[inline(always)]
pub(super) fn center<T: Real>(
    model: &Model<T>,
    workspace: &Workspace<T>,
    of: impl Fn(usize) -> FirstMoment<T>,
) -> Center<T> {
    let zero = T::zero();
    let (one, minus_one) = (zero.constant(1.0), zero.constant(-1.0));
    let (mut from, mut mass, mut moment) = (None, zero, Vector3::from_element(zero));
    for k in roots(model) {
        let mut place = on_base(model, workspace, k);
        let here = *from.get_or_insert(place.lever);
        place.lever = plus(&place.lever, minus_one, &here);
        let there = of(k).at_parent(&place);
        mass += there.mass;
        moment = plus(&moment, one, &there.moment);
    }
    Center { mass, from: from.unwrap_or(moment), to: divided(&moment, mass) }
}

/// Tip to base: r(k) = M(k) + sum over children of phi r phi* (3.5); a composite of rigid bodies is a rigid body.
#[inline(always)]
pub(super) fn composite_inertias_tip_to_base<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>) {
    let Workspace { composite, store, .. } = workspace;
    for (composite, body) in composite.iter_mut().zip(&model.bodies) {
        *composite = body.inertia;
    }
    sum_tip_to_base(&model.system.stages, &store.shifts, composite);
}

/// Tip to base: the time derivative of r(k) in fixed axes, from velocities. It has the parameters of an inertia without
/// mass.
#[inline(always)]
pub(super) fn composite_rates_tip_to_base<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>) {
    let Workspace { composite_rate, velocity, store, .. } = workspace;
    for (rate, (body, velocity)) in composite_rate.iter_mut().zip(model.bodies.iter().zip(&*velocity)) {
        *rate = body.inertia.rate(velocity);
    }
    sum_tip_to_base(&model.system.stages, &store.shifts, composite_rate);
}

/// Base to tip: phi of every moving body to the base axes at the center of mass, in place of phi to its parent.
#[inline(always)]
pub(super) fn placements_from<T: Real>(model: &Model<T>, workspace: &mut Workspace<T>, center: &Center<T>) {
    for (k, stage) in model.system.stages.iter().enumerate() {
        workspace.store.shifts[k] = match moving_parent(&model.system, k) {
            Some(parent) => workspace.store.shifts[parent].compose(&workspace.store.shifts[k]),
            None if stage.rows.count() > 0 => {
                let place = on_base(model, workspace, k);
                let minus_one = center.mass.constant(-1.0);
                let lever = plus(&plus(&place.lever, minus_one, &center.from), minus_one, &center.to);
                RigidShift { lever, ..place }
            }
            None => continue,
        };
    }
}

/// Calls a function for each degree of freedom with its body, its index, and S.
#[inline(always)]
fn each_row<T: Real>(model: &Model<T>, mut work: impl FnMut(usize, usize, &Vector6<T>)) {
    for (k, stage) in model.system.stages.iter().enumerate() {
        for i in 0..stage.rows.count() {
            work(k, stage.first_row + i, &stage.rows.row(i).to_column());
        }
    }
}
