//! Jacobians of inverse and forward dynamics times a vector, and vectors times them, in O(N) and without any matrix.

use super::adjoint::{self, CoStates, Constants};
use super::doubled_products;
use super::forward::accelerations;
use super::tangent::{self, Changes, Directions};
use crate::dynamics::forces::Motion;
use crate::dynamics::solve;
use crate::dynamics::sweeps::motion::carriers;
use crate::dynamics::sweeps::scratch::SweepScratch;
use crate::dynamics::sweeps::{self, SweepModel, general};
use crate::filter::Form;
use crate::filter::pivots::LostPivot;
use crate::model::Model;
use crate::scalar::{ColumnsOf, Real, larger};
use crate::workspace::Workspace;
use nalgebra::{Vector3, Vector6};

/// Scratch of these products in any scalar of one lane, and what the sweeps read of the model; starts as NaN.
#[derive(Debug)]
pub struct ProductScratch<T: Real<Parameter = T>> {
    pub(super) sweeps: SweepModel<T>,
    pub(super) sweep_scratch: SweepScratch<T>,
    co_states: CoStates<T>,
    changes: Changes<T>,
    /// One number a degree of freedom: accelerations of the state, and a right side.
    acceleration: Vec<T>,
    right: Vec<T>,
}

impl<T: Real<Parameter = T>> ProductScratch<T> {
    /// Scratch for `model`.
    #[must_use]
    pub fn new(model: &Model<T>) -> Self {
        let (nan, nv, sweeps) = (T::from_f64(f64::NAN), model.nv(), SweepModel::general(model));
        Self {
            sweep_scratch: SweepScratch::new(model, &sweeps),
            co_states: CoStates::new(&sweeps),
            changes: Changes::new(&sweeps),
            sweeps,
            acceleration: vec![nan; nv],
            right: vec![nan; nv],
        }
    }

    /// From here on the errors of solutions are estimated by the test vector of the factor of M in this store, or are
    /// not estimated.
    pub(super) fn judge_by(&mut self, factor: Option<&SweepScratch<T>>) {
        self.changes.judges = factor.is_some();
        if let Some(factor) = factor {
            self.sweep_scratch.take_test_vector(factor);
        }
    }

    /// True if the estimated error of the last solution exceeds the tolerance of products.
    pub(super) fn has_lost(&self, workspace: &Workspace<T>, solution: &[T]) -> bool {
        !(self.changes.lost(of_products(workspace), solution).lane(0) <= 0.0)
    }

    /// Bound on the terms of the moments of M x in the last gradients of torques, x being their cotangent.
    pub(super) fn terms(&self) -> T {
        self.co_states.terms
    }
}

/// dtau of [`inverse_dynamics`](crate::dynamics::inverse_dynamics) along one direction, (nv) into `out`: dtau/dq dq +
/// dtau/dqd dqd + M dqdd, and what changes of wrenches, inertias, armature and gravity add. O(N).
///
/// `q` (nq), `qd`, `qdd` (nv), SI units; `wrenches` as there; dq is in the tangent space of q: q (+) dq as
/// [`Scene::integrate`](crate::Scene::integrate) adds it.
pub fn inverse_dynamics_jvp<T: Real<Parameter = T>>(
    model: &Model<T>,
    scratch: &mut ProductScratch<T>,
    (q, qd, qdd): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    along: &Directions<'_, T>,
    out: &mut [T],
) {
    let ProductScratch { sweeps, sweep_scratch, changes, .. } = scratch;
    carriers(sweeps, sweep_scratch, T::zero(), q);
    let state = Motion { q, qd, qdd: Some(qdd), wrenches };
    changes_of_forces((model, sweeps), (sweep_scratch, changes), (state, along), &model.gravity);
    tangent::tip_to_base::<T, false>((model, sweeps), (sweep_scratch, &[]), changes, (along, &[]), out);
    tangent::add_armature(model, (state, along), out);
}

/// Gradients of x . tau of [`inverse_dynamics`](crate::dynamics::inverse_dynamics), x being the cotangent of tau: by q
/// (in its tangent space), qd and qdd, (3 x nv) into `out`, and into `constants` those by wrenches, inertias, armature
/// and gravity that are asked for. O(N).
///
/// Arguments as there, `cotangent` (nv).
pub fn inverse_dynamics_vjp<T: Real<Parameter = T>>(
    model: &Model<T>,
    scratch: &mut ProductScratch<T>,
    (q, qd, qdd): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    cotangent: &[T],
    (constants, out): (&mut Constants<'_, T>, &mut [T]),
) {
    let ProductScratch { sweeps, sweep_scratch, co_states, .. } = scratch;
    carriers(sweeps, sweep_scratch, T::zero(), q);
    out[2 * model.nv()..].copy_from_slice(cotangent);
    let state = Motion { q, qd, qdd: Some(qdd), wrenches };
    gradients_of_torques((model, sweeps), (sweep_scratch, co_states), state, constants, out);
}

/// dqdd of [`forward_dynamics`](crate::dynamics::forward_dynamics) along one direction, (nv) into `out`: dqdd/dq dq +
/// dqdd/dqd dqd + M^-1 dtau, and what changes of wrenches, inertias, armature and gravity add. One more right side of
/// the filter, with the gains of the state: O(N).
///
/// Arguments as in [`inverse_dynamics_jvp`], `along.u` of tau. P is carried as the workspace's form says. In form
/// `auto` a state is recomputed in double-double arithmetic and rounded where the error estimate of the factor of M
/// exceeds the tolerance, as in [`forward_dynamics_derivatives`](super::forward_dynamics_derivatives), and where the
/// estimated error of the product, by the probe that the factor was watched with, exceeds the tolerance of products.
///
/// # Errors
///
/// The lost pivot furthest from the base, where one was lost; then `out` means nothing.
pub fn forward_dynamics_jvp<T: Real<Parameter = T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut ProductScratch<T>,
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    along: &Directions<'_, T>,
    out: &mut [T],
) -> Result<(), LostPivot> {
    let mut qdd = std::mem::take(&mut scratch.acceleration);
    let monitor = accelerations(model, workspace, &mut qdd, state, wrenches);
    let lost = workspace.lost_pivot(model, &monitor);
    let is_auto = workspace.form == Form::Auto;
    let is_doubled =
        lost.is_none() && is_auto && monitor.of_roots && doubled_products::tangent(model, state, wrenches, along, out);
    let mut is_lost = false;
    if lost.is_none() && !is_doubled {
        let (q, qd, _) = state;
        carriers(&scratch.sweeps, &mut scratch.sweep_scratch, T::zero(), q);
        let judges = is_auto && !monitor.of_roots;
        scratch.judge_by(judges.then_some(&workspace.store));
        let motion = Motion { q, qd, qdd: Some(&qdd), wrenches };
        solved(model, workspace, scratch, (motion, along, &model.gravity), out);
        is_lost = judges && scratch.has_lost(workspace, out);
        scratch.judge_by(None);
    }
    scratch.acceleration = qdd;
    if let Some(lost) = lost {
        return Err(lost);
    }
    if is_lost {
        // Without a wider model the result stays as it is.
        doubled_products::tangent(model, state, wrenches, along, out);
    }
    Ok(())
}

/// M^-1 (dtau - the change of inverse dynamics where dqdd is none), with the factor in the workspace, turns and shifts
/// being there.
pub(super) fn solved<T: Real<Parameter = T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut ProductScratch<T>,
    (motion, along, gravity): (Motion<'_, T>, &Directions<'_, T>, &Vector3<T>),
    out: &mut [T],
) {
    let ProductScratch { sweeps, sweep_scratch, changes, right, .. } = scratch;
    let unaccelerated = Directions { u: &[], ..*along };
    changes_of_forces((model, sweeps), (sweep_scratch, changes), (motion, &unaccelerated), gravity);
    tangent::right_side((motion, along), right);
    let (scene, store) = workspace.passes(model);
    tangent::tip_to_base::<T, true>((model, sweeps), (sweep_scratch, &store.measured), changes, (along, right), out);
    general::smooth(scene, store, out);
}

/// Gradients of c . qdd of [`forward_dynamics`](crate::dynamics::forward_dynamics), c being the cotangent of qdd: by q
/// (in its tangent space), qd and tau, (3 x nv) into `out`, and into `constants` those by wrenches, inertias, armature
/// and gravity that are asked for. O(N).
///
/// That by tau is x = M^-1 c, filter and smoother once more; all others are those of [`inverse_dynamics_vjp`] at the
/// accelerations of the state with -x for its cotangent. Arguments as there; P as in [`forward_dynamics_jvp`]. In form
/// `auto` a state is recomputed in double-double arithmetic if the error estimate of the factor of M exceeds the
/// tolerance, as there, and if M x, of which the gradients are made body by body, misses c by more than the tolerance
/// of products of its largest entry, or would by the rounding of its terms.
///
/// # Errors
///
/// The lost pivot furthest from the base, where one was lost; then the results mean nothing.
pub fn forward_dynamics_vjp<T: Real<Parameter = T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut ProductScratch<T>,
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    cotangent: &[T],
    (constants, out): (&mut Constants<'_, T>, &mut [T]),
) -> Result<(), LostPivot> {
    let mut qdd = std::mem::take(&mut scratch.acceleration);
    let monitor = accelerations(model, workspace, &mut qdd, state, wrenches);
    let lost = workspace.lost_pivot(model, &monitor);
    let is_doubled = lost.is_none()
        && workspace.form == Form::Auto
        && monitor.of_roots
        && doubled_products::gradients(model, state, wrenches, cotangent, (constants, out));
    let mut off = T::zero();
    if lost.is_none() && !is_doubled {
        let (q, qd, _) = state;
        let mut x = std::mem::take(&mut scratch.right);
        solve(model, workspace, cotangent, &mut x);
        let ProductScratch { sweeps, sweep_scratch, co_states, .. } = scratch;
        carriers(sweeps, sweep_scratch, T::zero(), q);
        let motion = Motion { q, qd, qdd: Some(&qdd), wrenches };
        let last = 2 * model.nv();
        negated(&mut out[last..], &x);
        gradients_of_torques((model, sweeps), (sweep_scratch, co_states), motion, constants, out);
        off = solved_short_of(cotangent, (co_states.terms, of_products(workspace)), &mut out[last..], &x);
        scratch.right = x;
    }
    scratch.acceleration = qdd;
    if let Some(lost) = lost {
        return Err(lost);
    }
    if workspace.form == Form::Auto && !is_doubled && off.lane(0) > 0.0 {
        // Without a wider model the result stays as it is.
        doubled_products::gradients(model, state, wrenches, cotangent, (constants, out));
    }
    Ok(())
}

/// [`adjoint::in_sweeps`] in any scalar of one lane: compiled once for both that ask for it.
#[inline(never)]
fn gradients_of_torques<T: Real<Parameter = T>>(
    scene: (&Model<T>, &SweepModel<T>),
    scratch: (&SweepScratch<T>, &mut CoStates<T>),
    state: Motion<'_, T>,
    constants: &mut Constants<'_, T>,
    out: &mut [T],
) {
    adjoint::in_sweeps(scene, scratch, state, constants, out);
}

/// [`tangent::base_to_tip`], likewise.
#[inline(never)]
fn changes_of_forces<T: Real<Parameter = T>>(
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, changes): (&SweepScratch<T>, &mut Changes<T>),
    along: (Motion<'_, T>, &Directions<'_, T>),
    gravity: &Vector3<T>,
) {
    tangent::base_to_tip(scene, scratch, changes, along, gravity);
}

/// The accepted error of products, in eps of their largest entry.
fn of_products<T: Real>(workspace: &Workspace<T>) -> T {
    T::from_f64(workspace.accepted_error().of_products() / T::epsilon().lane(0))
}

/// The product along a direction, for states in lanes and for one state: of torques, or where `solves` of
/// accelerations, then with the factor, turns and shifts in the scratch; `right` is scratch too. Positive where a
/// solution is `judged` and its estimated error exceeds the tolerance.
#[inline(always)]
pub(crate) fn tangent_in_sweeps<T: Real, C: ColumnsOf<T>>(
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, changes): (&mut SweepScratch<T>, &mut Changes<T>),
    (motion, along): (Motion<'_, T>, Directions<'_, T>),
    (solves, judged): (bool, bool),
    (right, out): (&mut [T], &mut [T]),
) -> T {
    changes.judges = judged;
    let outward = if solves { Directions { u: &[], ..along } } else { along };
    if !solves {
        carriers(scene.1, scratch, C::zero(), motion.q);
    }
    tangent::base_to_tip(scene, scratch, changes, (motion, &outward), &scene.0.gravity);
    if solves {
        tangent::right_side((motion, &along), right);
        tangent::tip_to_base::<T, true>(scene, (scratch, &scratch.measured), changes, (&along, right), out);
        sweeps::smooth(scene, scratch, out);
        if judged {
            return changes.lost(scratch.accepted_of_products, out);
        }
    } else {
        tangent::tip_to_base::<T, false>(scene, (scratch, &[]), changes, (&along, &[]), out);
        tangent::add_armature(scene.0, (motion, &along), out);
    }
    T::zero()
}

/// The gradients by q, qd and u, and by the constants that are asked for, likewise: of torques, or where `solves` of
/// accelerations, then with the factor, turns and shifts in the scratch; x is scratch. Above zero where digits were
/// lost.
#[inline(always)]
pub(crate) fn gradients_in_sweeps<T: Real, C: ColumnsOf<T>>(
    scene: (&Model<T>, &SweepModel<T>),
    (scratch, co_states): (&mut SweepScratch<T>, &mut CoStates<T>),
    (motion, cotangent): (Motion<'_, T>, &[T]),
    solves: bool,
    (constants, x, out): (&mut Constants<'_, T>, &mut [T], &mut [T]),
) -> T {
    let last = 2 * cotangent.len();
    if solves {
        sweeps::solve(scene, scratch, cotangent, x);
        negated(&mut out[last..], x);
    } else {
        carriers(scene.1, scratch, C::zero(), motion.q);
        out[last..].copy_from_slice(cotangent);
    }
    adjoint::in_sweeps(scene, (scratch, co_states), motion, constants, out);
    let judging = (co_states.terms, scratch.accepted_of_products);
    if solves { solved_short_of(cotangent, judging, &mut out[last..], x) } else { T::zero() }
}

/// x in the place of -M x, which the way inward has found; by how much M x misses the right side c, or the rounding of
/// the `terms` that it is made of where that is more, less what is let pass: not above zero where the forces that
/// gradients are made of kept their digits.
#[inline(always)]
fn solved_short_of<T: Real>(cotangent: &[T], (terms, accepted): (T, T), product: &mut [T], x: &[T]) -> T {
    let zero = T::zero();
    let (mut off, mut size) = (T::epsilon() * terms, zero);
    for ((product, &c), &x) in product.iter_mut().zip(cotangent).zip(x) {
        off = larger(off, (*product + c).abs());
        size = larger(size, c.abs());
        *product = x;
    }
    off.minus_product(size, accepted * T::epsilon())
}

/// -x.
#[inline(always)]
fn negated<T: Real>(to: &mut [T], x: &[T]) {
    for (to, &x) in to.iter_mut().zip(x) {
        *to = -x;
    }
}
