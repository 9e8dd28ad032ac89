//! Jacobian-vector and vector-Jacobian products of inverse and forward dynamics, in O(N) and without matrices. States
//! whose error estimate exceeds the tolerance are recomputed in double-double arithmetic.

use super::adjoint::{self, CoStates, Constants};
use super::forward::accelerations;
use super::tangent::{self, Changes, Directions};
use crate::dynamics::forces::Motion;
use crate::dynamics::refined::{DoubleDoubleState, narrow};
use crate::dynamics::solve;
use crate::dynamics::sweeps::motion::carriers;
use crate::dynamics::sweeps::scratch::SweepScratch;
use crate::dynamics::sweeps::{self, SweepModel, general};
use crate::filter::Form;
use crate::filter::pivots::LostPivot;
use crate::model::Model;
use crate::scalar::{ColumnsOf, DoubleDouble, Real, larger};
use crate::workspace::{Made, Workspace};
use nalgebra::{Vector3, Vector6};

/// Scratch of these products in any scalar of one lane, in addition to the store of the workspace; initialized with
/// NaN.
#[derive(Debug)]
pub struct ProductScratch<T: Real<Parameter = T>> {
    co_states: CoStates<T>,
    changes: Changes<T>,
    /// One scalar per degree of freedom: the accelerations of the state, and a right-hand side.
    acceleration: Vec<T>,
    right: Vec<T>,
}

impl<T: Real<Parameter = T>> ProductScratch<T> {
    /// Scratch for `model`.
    #[must_use]
    pub fn new(model: &Model<T>) -> Self {
        let (nan, nv, sweeps) = (T::from_f64(f64::NAN), model.nv(), SweepModel::general(model));
        Self {
            co_states: CoStates::new(&sweeps),
            changes: Changes::new(&sweeps),
            acceleration: vec![nan; nv],
            right: vec![nan; nv],
        }
    }

    /// Enables the error estimate of solutions by the test vector of the factor of M, or disables it.
    pub(super) fn judge(&mut self, judges: bool) {
        self.changes.judges = judges;
    }

    /// True if the estimated error of the last solution exceeds the tolerance of products.
    pub(super) fn has_lost(&self, workspace: &Workspace<T>, solution: &[T]) -> bool {
        !(self.changes.lost(of_products(workspace), solution).lane(0) <= 0.0)
    }

    /// Bound on the terms of the moments of M x in the last gradients of torques, where x is their cotangent.
    pub(super) fn terms(&self) -> T {
        self.co_states.terms
    }
}

/// dtau of [`inverse_dynamics`](crate::dynamics::inverse_dynamics) along one direction, (nv) into `out`: dtau/dq dq +
/// dtau/dqd dqd + M dqdd, plus the contributions of changes of wrenches, inertias, armature and gravity. O(N).
///
/// `q` (nq), `qd`, `qdd` (nv), SI units; `wrenches` as in `inverse_dynamics`. dq is in the tangent space of q, for q
/// (+) dq as in [`Scene::integrate`](crate::Scene::integrate).
pub fn inverse_dynamics_jvp<T: Real<Parameter = T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut ProductScratch<T>,
    (q, qd, qdd): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    along: &Directions<'_, T>,
    out: &mut [T],
) {
    let (scene, store) = workspace.passes(model);
    carriers(scene.1, store, T::zero(), q);
    let (state, changes) = (Motion { q, qd, qdd: Some(qdd), wrenches }, &mut scratch.changes);
    changes_of_forces(scene, (store, changes), (state, along), &model.gravity);
    tangent::tip_to_base::<T, false>(scene, (store, &[]), changes, (along, &[]), out);
    tangent::add_armature(model, (state, along), out);
}

/// Gradients of x . tau of [`inverse_dynamics`](crate::dynamics::inverse_dynamics), where x is the cotangent of tau: by
/// q (in its tangent space), qd and qdd, (3 x nv) into `out`; and the requested gradients by wrenches, inertias,
/// armature and gravity, into `constants`. O(N).
///
/// Arguments as in `inverse_dynamics`, `cotangent` (nv).
pub fn inverse_dynamics_vjp<T: Real<Parameter = T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut ProductScratch<T>,
    (q, qd, qdd): (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    cotangent: &[T],
    (constants, out): (&mut Constants<'_, T>, &mut [T]),
) {
    let (scene, store) = workspace.passes(model);
    carriers(scene.1, store, T::zero(), q);
    out[2 * model.nv()..].copy_from_slice(cotangent);
    let state = Motion { q, qd, qdd: Some(qdd), wrenches };
    gradients_of_torques(scene, (store, &mut scratch.co_states), state, constants, out);
}

/// dqdd of [`forward_dynamics`](crate::dynamics::forward_dynamics) along one direction, (nv) into `out`: dqdd/dq dq +
/// dqdd/dqd dqd + M^-1 dtau, plus the contributions of changes of wrenches, inertias, armature and gravity. One more
/// right-hand side of the filter, with the gains of the state: O(N).
///
/// Arguments as in [`inverse_dynamics_jvp`], with `along.u` the change of tau. P is propagated in the form of the
/// workspace. In form `auto`, a state is recomputed in double-double arithmetic and rounded if the error estimate of
/// the factor of M exceeds the tolerance, as in [`forward_dynamics_derivatives`](super::forward_dynamics_derivatives),
/// or if the estimated error of the product, by the test vector of the factor, exceeds the tolerance of products.
///
/// # Errors
///
/// The lost pivot furthest from the base; `out` is then undefined.
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
    let is_doubled = lost.is_none()
        && is_auto
        && monitor.of_roots
        && doubled_tangent((model, &mut workspace.wide), state, wrenches, along, out);
    let mut is_lost = false;
    if lost.is_none() && !is_doubled {
        let (q, qd, _) = state;
        let judges = is_auto && !monitor.of_roots;
        scratch.judge(judges);
        let motion = Motion { q, qd, qdd: Some(&qdd), wrenches };
        solved(model, workspace, scratch, (motion, along, &model.gravity), out);
        is_lost = judges && scratch.has_lost(workspace, out);
        scratch.judge(false);
    }
    scratch.acceleration = qdd;
    if let Some(lost) = lost {
        return Err(lost);
    }
    if is_lost {
        // If there is no wider model, the result is kept.
        doubled_tangent((model, &mut workspace.wide), state, wrenches, along, out);
    }
    Ok(())
}

/// M^-1 (dtau - the change of inverse dynamics for dqdd = 0), with the factor and the shifts of the joints in the
/// workspace.
pub(super) fn solved<T: Real<Parameter = T>>(
    model: &Model<T>,
    workspace: &mut Workspace<T>,
    scratch: &mut ProductScratch<T>,
    (motion, along, gravity): (Motion<'_, T>, &Directions<'_, T>, &Vector3<T>),
    out: &mut [T],
) {
    let ProductScratch { changes, right, .. } = scratch;
    let (scene, store) = workspace.passes(model);
    let unaccelerated = Directions { u: &[], ..*along };
    changes_of_forces(scene, (store, changes), (motion, &unaccelerated), gravity);
    tangent::right_side((motion, along), right);
    tangent::tip_to_base::<T, true>(scene, (store, &store.measured), changes, (along, right), out);
    general::smooth(scene, store, out);
}

/// Gradients of c . qdd of [`forward_dynamics`](crate::dynamics::forward_dynamics), where c is the cotangent of qdd: by
/// q (in its tangent space), qd and tau, (3 x nv) into `out`; and the requested gradients by wrenches, inertias,
/// armature and gravity, into `constants`. O(N).
///
/// The gradient by tau is x = M^-1 c, one more right-hand side of filter and smoother. All others are those of
/// [`inverse_dynamics_vjp`] at the accelerations of the state with the cotangent -x. Arguments as in
/// `forward_dynamics`; P as in [`forward_dynamics_jvp`]. In form `auto`, a state is recomputed in double-double
/// arithmetic if the error estimate of the factor of M exceeds the tolerance. It is also recomputed if M x, the sum of
/// the forces that the gradients use, or the rounding of its terms, deviates from c by more than the tolerance of
/// products times the largest entry.
///
/// # Errors
///
/// The lost pivot furthest from the base; the results are then undefined.
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
        && doubled_gradients((model, &mut workspace.wide), state, wrenches, cotangent, (constants, out));
    let mut off = T::zero();
    if lost.is_none() && !is_doubled {
        let (q, qd, _) = state;
        let mut x = std::mem::take(&mut scratch.right);
        solve(model, workspace, cotangent, &mut x);
        let co_states = &mut scratch.co_states;
        let (scene, store) = workspace.passes(model);
        let motion = Motion { q, qd, qdd: Some(&qdd), wrenches };
        let last = 2 * model.nv();
        negated(&mut out[last..], &x);
        gradients_of_torques(scene, (store, co_states), motion, constants, out);
        off = solved_short_of(cotangent, (co_states.terms, of_products(workspace)), &mut out[last..], &x);
        scratch.right = x;
    }
    scratch.acceleration = qdd;
    if let Some(lost) = lost {
        return Err(lost);
    }
    if workspace.form == Form::Auto && !is_doubled && off.lane(0) > 0.0 {
        // If there is no wider model, the result is kept.
        doubled_gradients((model, &mut workspace.wide), state, wrenches, cotangent, (constants, out));
    }
    Ok(())
}

/// [`adjoint::in_sweeps`] in any scalar of one lane, compiled once for its two callers.
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

/// [`tangent::base_to_tip`], compiled once for its two callers.
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

/// The product along a direction, for states in lanes and for one state: of torques, or with `solves` of accelerations.
/// The latter needs the factor and the rotations and shifts of the joints in the scratch; `right` is scratch. Returns a
/// positive value if a solution is `judged` and its estimated error exceeds the tolerance.
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

/// The gradients by q, qd and u, and the requested ones by the constants: of torques, or with `solves` of
/// accelerations. The latter needs the factor and the rotations and shifts of the joints in the scratch; x is scratch.
/// Returns a positive value if precision is lost.
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

/// Replaces -M x, the result of the inward pass, by x. Returns the larger of the deviation of M x from the right-hand
/// side c and the rounding of its `terms`, minus the accepted error: positive if the forces that the gradients use have
/// lost precision.
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

/// [`forward_dynamics_jvp`] in double-double arithmetic, see [`DoubleDoubleState::recompute`].
fn doubled_tangent<T: Real>(
    model: (&Model<T>, &mut Made),
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    along: &Directions<'_, T>,
    out: &mut [T],
) -> bool {
    DoubleDoubleState::recompute(model, state, wrenches, out, |wide, out| {
        let DoubleDoubleState { model, workspace, q, qd, tau, wrenches } = wide;
        let widened = |x: T| DoubleDouble::from_f64(x.lane(0));
        let parameters = DoubleDouble::each_of(along.parameters.as_flattened());
        let along = Directions {
            q: &DoubleDouble::each_of(along.q),
            qd: &DoubleDouble::each_of(along.qd),
            u: &DoubleDouble::each_of(along.u),
            wrenches: &along.wrenches.iter().map(|wrench| wrench.map(widened)).collect::<Vec<_>>(),
            parameters: parameters.as_chunks().0,
            armature: &DoubleDouble::each_of(along.armature),
            gravity: &DoubleDouble::each_of(along.gravity),
        };
        let scratch = &mut ProductScratch::new(model);
        forward_dynamics_jvp(model, workspace, scratch, (q, qd, tau), wrenches, &along, out).is_ok()
    })
}

/// [`forward_dynamics_vjp`] in double-double arithmetic.
#[cold]
fn doubled_gradients<T: Real>(
    model: (&Model<T>, &mut Made),
    state: (&[T], &[T], &[T]),
    wrenches: &[Vector6<T>],
    cotangent: &[T],
    (constants, out): (&mut Constants<'_, T>, &mut [T]),
) -> bool {
    DoubleDoubleState::with(model, state, wrenches, |wide| {
        let DoubleDoubleState { model, workspace, q, qd, tau, wrenches } = wide;
        let mut scratch = ProductScratch::new(model);
        let nan = DoubleDouble::from_f64(f64::NAN);
        let mut found = vec![nan; out.len()];
        let (mut of_wrenches, mut parameters, mut armature, mut gravity) = (
            vec![Vector6::from_element(nan); constants.wrenches.len()],
            vec![[nan; 10]; constants.parameters.len()],
            vec![nan; constants.armature.len()],
            vec![nan; constants.gravity.len()],
        );
        let mut wide = Constants {
            wrenches: &mut of_wrenches,
            parameters: &mut parameters,
            armature: &mut armature,
            gravity: &mut gravity,
        };
        let (state, cotangent) = ((&q[..], &qd[..], &tau[..]), DoubleDouble::each_of(cotangent));
        let results = (&mut wide, &mut found[..]);
        let done = forward_dynamics_vjp(model, workspace, &mut scratch, state, wrenches, &cotangent, results);
        if done.is_err() || !found.iter().all(|x| x.high.is_finite()) {
            return false;
        }
        narrow(&found, out);
        for (to, from) in constants.wrenches.iter_mut().zip(&of_wrenches) {
            narrow(from.as_slice(), to.as_mut_slice());
        }
        let of_parameters = (constants.parameters.as_flattened_mut(), parameters.as_flattened());
        for (to, from) in [of_parameters, (constants.armature, &armature), (constants.gravity, &gravity)] {
            narrow(from, to);
        }
        true
    })
}
